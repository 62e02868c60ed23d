"""Parametric bootstrap: fits of data that the fitted model and noise make."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ...core.arguments import count
from ...math.dense import positive_inverse
from ...solvers.least_squares import CONVERGED, search
from . import student
from .problem import Problem
from .transform import Transform

ITERATIONS = 25
TOLERANCE = 1e-6  # of a step
NEGLIGIBLE = 1e-4  # decrease of the squares over the noise's: a step of a hundredth of a deviation


@dataclass(frozen=True)
class Bootstrap:
    """theta (repeats, p) and status (repeats,) of the repeats, 0 = converged; x (repeats, p) their coordinates and deviation
    (repeats, p) that each repeat's own covariance states, by the noise that it found where sigma is not known; x_fit and
    deviation_fit (p,) of the fit.
    """

    theta: Tensor
    status: Tensor
    x: Tensor
    deviation: Tensor
    x_fit: Tensor
    deviation_fit: Tensor
    transform: Transform

    def interval(self, level: float = 0.95) -> Tensor:
        """(p, 2): the fit less the quantiles of the errors that repeats make, in coordinates, each error in units of the
        deviation that its repeat states (bootstrap-t; Efron and Tibshirani 1993, 12.5; Hall 1988, Annals of Statistics 16,
        927). A share of R repeats is at place (R + 1) times it in their order (Davison and Hinkley 1997, 5.2).
        """
        tail = student.tail(level)
        good = self.status == CONVERGED
        if good.sum() < 2 / tail:
            raise ValueError(f"{int(good.sum())} repeats that converged are too few for a level of {level:g}; "
                             f"{int(2 / tail) + 1} or more are wanted")
        error = ((self.x - self.x_fit) / self.deviation)[good].sort(0).values
        low, high = (self.deviation_fit * _at(error, (len(error) + 1) * share - 1) for share in (tail, 1 - tail))
        return torch.stack([self.transform.theta(end) for end in (self.x_fit - high, self.x_fit - low)], -1)


def bootstrap(problem: Problem, x: Tensor, held: Tensor, scale: float, repeats: int, seed: int) -> Bootstrap:
    """Fits of `repeats` sets of data, from the fit's coordinates x (p,), with noise of `scale` on weighted data; those that are
    `held` (p,) bool stay.
    """
    repeats = count("repeats", repeats, least=2)
    with torch.no_grad():
        starts, every = x.expand(repeats, -1).clone(), torch.zeros(1, dtype=torch.long, device=x.device)
        r, J = problem.linearised(x[None], every)
        exact = r + problem.target
        random = torch.Generator(device=x.device).manual_seed(seed)
        drawn = scale * torch.randn(repeats, r.shape[1], generator=random, dtype=x.dtype, device=x.device)
        repeated = problem.with_targets(exact + drawn)
        region = repeated.region(starts)
        region.least, region.largest = (torch.where(held, x, end) for end in (region.least, region.largest))
        found = search(repeated, starts, region, ITERATIONS, TOLERANCE, known=(-drawn, J.expand(repeats, -1, -1)),
                       negligible=NEGLIGIBLE * scale**2)
        own = _deviation(found.J, held, _variance(problem, found.r, J[0], held))
        of_fit = scale * _deviation(J, held, torch.ones_like(r))[0]
    transform = problem.parameters.transform
    return Bootstrap(transform.theta(found.x), found.status, found.x, own, x, of_fit, transform)


def _deviation(J: Tensor, held: Tensor, variance: Tensor) -> Tensor:
    """(N, p) of coordinates, by J (N, T, p) of data of variances (1 or N, T); of those that are held, 1."""
    found, some = torch.ones_like(J[:, 0]), J[..., ~held]
    moved = positive_inverse(some.mT @ some)[0] @ some.mT  # by each datum
    found[:, ~held] = (moved.square() * variance[:, None]).sum(-1).sqrt()
    return found


def _variance(problem: Problem, r: Tensor, J: Tensor, held: Tensor) -> Tensor:
    """(N, T) of weighted data, by misfits r (N, T) where their noise is not known; J (T, p) as of the fit."""
    noise, known, some = problem.noise, problem.known, J[:, ~held]
    if not noise.names:
        return torch.ones_like(r)
    whole = replace(noise, fitted=(0.0,) * len(noise.names))  # models fit their own numbers to the data that were measured
    redundancy = whole.redundancy(some, positive_inverse(some.mT @ some)[0], known)
    return noise.each(noise.sums(r.square(), known) / redundancy.clamp(min=1))[:, known]


def _at(ordered: Tensor, place: float) -> Tensor:
    """(p,) between the numbers (R, p) at both sides of a place from 0 to R - 1."""
    below = min(int(place), len(ordered) - 2)
    return torch.lerp(ordered[below], ordered[below + 1], place - below)
