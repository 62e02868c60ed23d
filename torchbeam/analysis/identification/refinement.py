"""Refinement: from the fit of one model to that of a finer one, by its readings and the other's derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ...solvers.least_squares import CONVERGED, Found
from ...solvers.region import Region
from .problem import Problem

STEPS = 20
SMALL = 1e-4  # squared length of a step over the noise's: a hundredth of a deviation


def refined(problem: Problem, model: Any, x: Tensor, J: Tensor, scale: float) -> tuple[Problem, Found, Region]:
    """The finer problem, and what is found from the coordinates x (p,) and J (T, p) of a fit; see `Fit.refined`."""
    if isinstance(model, Mapping) and set(model) != {e.name for e in problem.experiments}:
        raise ValueError(f"models of {', '.join(map(str, model))} were given; those of "
                         f"{', '.join(str(e.name) for e in problem.experiments)} are wanted")
    finer = replace(problem, experiments=tuple(
        replace(e, model=model[e.name] if isinstance(model, Mapping) else model) for e in problem.experiments))
    which, way = torch.zeros(1, dtype=torch.long, device=x.device), [x[None]]
    with torch.no_grad():
        bounds = [b[0] for b in problem.parameters.bounds(x[None])]
        last = torch.inf
        for _ in range(STEPS):
            r, (_, slope, bend) = finer.residuals(way[-1], which), finer.prior(way[-1])
            A = J.mT @ J + torch.diag(bend[0])
            step = -torch.linalg.lstsq(A, (J.mT @ r[0] + slope[0])[:, None]).solution[:, 0]
            length = ((A @ step) @ step).item()
            if not length <= last * 1.0001:
                raise ValueError("a finer model that fails at the fit, or differs too much from the one that was fitted, was "
                                 "given; one of the same beam, a little finer, is wanted")
            if length <= SMALL * scale**2:
                break
            last = length
            way.append(torch.maximum(torch.minimum(way[-1] + step, bounds[1]), bounds[0]))
    at, parameters = way[-1], problem.parameters
    region = Region(at, parameters.size, parameters.transform.additive, *parameters.bounds(at), problem.target)
    status = torch.full((1,), CONVERGED, device=x.device)
    return finer, Found(at, r, J[None], status, torch.stack(way)), region
