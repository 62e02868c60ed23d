"""Refinement: the fit of a finer model, by its readings and the coarser one's derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import function
from ...solvers.least_squares import CONVERGED, FAILED, Found
from ...solvers.region import Region
from .problem import FitProblem

STEPS, AGAIN = 20, 3
SMALL = 1e-4  # squared length of a step over the noise's: a hundredth of a deviation


def refined(
    problem: FitProblem, model: Any, x: Tensor, J: Tensor, scale: float
) -> tuple[FitProblem, Found, Region]:
    """The finer problem, and what is found from the coordinates x (S, p) and J (S, T, p) of fits;
    see `Fit.refined`. The status of those for which the models differ too much is FAILED.
    """
    names = [e.name for e in problem.experiments if e.measured]
    if isinstance(model, Mapping) and set(model) != set(names):
        raise ValueError(
            f"models of {', '.join(map(str, model))} were given; those of "
            f"{', '.join(map(str, names))} are wanted"
        )
    by_name = isinstance(model, Mapping)
    experiments = []
    for e in problem.experiments:
        own = function("model", model[e.name] if by_name else model) if e.measured else e.model
        experiments.append(replace(e, model=own))
    finer = replace(problem, experiments=tuple(experiments))
    every, iterates = torch.arange(len(x), device=x.device), [x]
    last, done = torch.full_like(x[:, 0], torch.inf), torch.zeros_like(every, dtype=torch.bool)
    failed = done.clone()
    with torch.no_grad():
        region = problem.region(x)
        for k in range(STEPS):
            r, (_, slope, bend) = finer.residuals(iterates[-1], every), finer.prior(iterates[-1])
            # derivatives from where the finer model is going: deviations follow them
            if k == AGAIN:
                _, J = problem.linearised(iterates[-1], every)
            gradient = ((J.mT @ r[..., None])[..., 0] + slope).nan_to_num()
            free = (~region.held(iterates[-1], gradient)).to(x)
            A = (J.mT @ J + torch.diag_embed(bend)).nan_to_num() * free[:, None] * free[..., None]
            step = -(torch.linalg.pinv(A, hermitian=True) @ (gradient * free)[..., None])[..., 0]
            length = (step * (A @ step[..., None])[..., 0]).sum(-1)
            longer = ~done & (k not in (0, AGAIN)) & ~(length <= 1.0001 * last)
            failed = failed | ~torch.isfinite(r).all(-1) | longer
            done = done | (length <= SMALL * scale**2)
            if k >= AGAIN and (done | failed).all():
                break
            last = length
            moved = torch.maximum(torch.minimum(iterates[-1] + step, region.largest), region.least)
            iterates.append(torch.where((done | failed)[:, None], iterates[-1], moved))
    status = torch.where(done & ~failed, CONVERGED, FAILED)
    found = Found(iterates[-1], r, J, status, torch.stack(iterates))
    return finer, found, problem.region(found.x)
