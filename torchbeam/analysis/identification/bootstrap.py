"""Parametric bootstrap: fits of data that the fitted model and noise make."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ...core.arguments import count
from ...solvers.least_squares import CONVERGED, search
from . import student
from .problem import Problem
from .transform import Transform

ITERATIONS = 25
TOLERANCE = 1e-6  # of a step
NEGLIGIBLE = 1e-4  # decrease of the squares over the noise's: a step of a hundredth of a deviation


@dataclass(frozen=True)
class Bootstrap:
    """theta (repeats, p) and status (repeats,) of the repeats, 0 = converged; x (repeats, p) their coordinates, x_fit (p,) the
    fit's; scale (repeats,) noise that each repeat found, over that of the fit.
    """

    theta: Tensor
    status: Tensor
    x: Tensor
    x_fit: Tensor
    scale: Tensor
    transform: Transform

    def interval(self, level: float = 0.95) -> Tensor:
        """(p, 2): the fit less the quantiles of the errors that repeats make, in coordinates (the pivotal interval; Efron and
        Tibshirani 1993, 13.3), each error in units of the noise that its repeat found (bootstrap-t, 12.5).
        """
        tail = student.tail(level)
        good = self.status == CONVERGED
        if good.sum() < 2 / tail:
            raise ValueError(f"{int(good.sum())} repeats that converged are too few for a level of {level:g}; "
                             f"{int(2 / tail) + 1} or more are wanted")
        error = (self.x - self.x_fit)[good] / self.scale[good, None]
        low, high = error.quantile(torch.tensor([tail, 1 - tail], dtype=error.dtype, device=error.device), dim=0)
        return torch.stack([self.transform.theta(end) for end in (self.x_fit - high, self.x_fit - low)], -1)


def bootstrap(problem: Problem, x: Tensor, scale: float, repeats: int, seed: int) -> Bootstrap:
    """Fits of `repeats` sets of data, from the fit's coordinates x (p,), with noise of `scale` on weighted data."""
    repeats = count("repeats", repeats, least=2)
    with torch.no_grad():
        starts, every = x.expand(repeats, -1).clone(), torch.zeros(1, dtype=torch.long, device=x.device)
        r, J = problem.linearised(x[None], every)
        exact = r + problem.target
        random = torch.Generator(device=x.device).manual_seed(seed)
        noise = scale * torch.randn(repeats, r.shape[1], generator=random, dtype=x.dtype, device=x.device)
        repeated = problem.with_targets(exact + noise)
        found = search(repeated, starts, repeated.region(starts), ITERATIONS, TOLERANCE,
                       known=(-noise, J.expand(repeats, -1, -1)), negligible=NEGLIGIBLE * scale**2)
        squares = found.r.square().sum(-1) / max(r.shape[1] - len(x), 1)
        own = torch.ones_like(squares) if problem.sigma_given else squares.sqrt() / scale
    transform = problem.parameters.transform
    return Bootstrap(transform.theta(found.x), found.status, found.x, x, own, transform)
