"""Profile likelihood: the least misfit with one parameter held, over what it is held at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ...solvers.least_squares import FAILED, search
from .problem import FitProblem

PLACES = (0.4, 0.75, 1.0, 1.35)  # of the half-interval that the covariance says
WIDER = 4  # times that the outermost place is doubled where the interval is not found
ITERATIONS = 25
TOLERANCE = 1e-5


@dataclass(frozen=True)
class Profile:
    """One parameter held at `values` (m,), increasing: `rise` (m,), the least 2
    ln(likelihood ratio) there, or what F says of it where sigma is not known (by channel it stays
    as it was found); `threshold` at the ends of the `interval` (2,), which are infinite where it is
    not reached, within the bounds.
    """

    name: str
    values: Tensor
    rise: Tensor
    threshold: float
    interval: Tensor


def profiles(
    problem: FitProblem,
    x: Tensor,
    covariance: Tensor,
    step: Tensor,
    which: Sequence[int],
    quantile: Tensor,
    scale: float,
) -> tuple[Profile, ...]:
    """Of the parameters `which`, from the fit's coordinates x (p,), their covariance, row by row,
    and half-intervals `step` (p,) for quantiles (p,); all held values of all of them are one batch
    of fits, and so are those that refine the ends.
    """
    with torch.no_grad():
        none = torch.zeros(1, dtype=torch.long, device=x.device)
        best = _objective(problem, problem.residuals(x[None], none), x[None])
        # place in half-intervals -> signed root of the rise, in quantiles
        points = {j: {0.0: 0.0} for j in which}
        stops = [(end - x) / step for end in problem.parameters.bounds(x)]
        stop = {j: [float(s[j]) for s in stops] for j in which}
        todo = [(j, c) for j in which for c in _within(stop[j], PLACES)]
        for _ in range(WIDER + 2):
            held = torch.tensor([j for j, _ in todo], device=x.device)
            place = torch.tensor([c for _, c in todo], dtype=x.dtype, device=x.device)
            rise = _least(problem, x, covariance, held, place * step[held]) - best
            roots = rise.clamp(min=0).sqrt() / (scale * quantile[held])
            for (j, c), value in zip(todo, roots.tolist(), strict=True):
                points[j][c] = value if c > 0 else -value
            todo = [(j, c) for j in which for c in _next(points[j], stop[j])]
            if not todo:
                break
        limits = []
        for j in which:
            places = torch.tensor(sorted(points[j]), dtype=x.dtype)
            heights = torch.tensor([points[j][c] for c in places.tolist()], dtype=x.dtype)
            ends = x.new_tensor([_end(points[j], side) for side in (-1, 1)])
            coordinates = x.repeat(len(places) + 2, 1)
            coordinates[:, j] = x[j] + step[j] * torch.cat(
                (places.to(x), torch.where(torch.isfinite(ends), ends, 0))
            )
            values = problem.parameters.transform.theta(coordinates)[:, j]
            interval = torch.where(torch.isfinite(ends), values[-2:], ends)
            threshold = quantile[j].item() ** 2
            name, rise = problem.parameters.names[j], heights.square() * threshold
            limits.append(Profile(name, values[:-2], rise, threshold, interval))
    return tuple(limits)


def _least(
    problem: FitProblem, x: Tensor, covariance: Tensor, held: Tensor, away: Tensor
) -> Tensor:
    """Twice the least objective (n,) with `held` (n,) at x + away; infinite without a fit."""
    ridge = covariance[held] / covariance[held, held][:, None]
    starts = x + ridge * away[:, None]
    least, largest = problem.parameters.bounds(starts)
    starts = torch.maximum(torch.minimum(starts, largest), least)
    rows = torch.arange(len(held), device=x.device)
    starts[rows, held] = (x[held] + away).clamp(least[rows, held], largest[rows, held])
    region = problem.region(starts).holding(torch.nn.functional.one_hot(held, len(x)).bool())
    try:
        minima = search(problem, starts, region, ITERATIONS, TOLERANCE)
    except ValueError:  # none of them can be evaluated
        return torch.full_like(away, torch.inf)
    value = _objective(problem, minima.r, minima.x)
    # one that is not finished is still no less than the least
    good = minima.status < FAILED
    return torch.where(good & torch.isfinite(value), value, torch.inf)


def _objective(problem: FitProblem, r: Tensor, x: Tensor) -> Tensor:
    return r.square().sum(-1) + 2 * problem.prior(x)[0]


def _within(stop: Sequence[float], places: Sequence[float]) -> list[float]:
    """Places at both sides, none beyond a bound: the bound itself, of those that would be."""
    sides = {side * c for c in places for side in (-1, 1)}
    return sorted({min(max(c, stop[0]), stop[1]) for c in sides} - {0.0})


def _end(points: dict[float, float], side: int) -> float:
    """Where the signed root passes `side`, linear between neighbours; infinite if nowhere."""
    inner = 0.0
    for c in sorted((c for c in points if c * side > 0), key=abs):
        if points[c] * side >= 1:
            a, b = points[inner] * side, points[c] * side
            return inner + (c - inner) * (1 - a) / (b - a) if b < float("inf") else (inner + c) / 2
        inner = c
    return side * float("inf")


def _next(points: dict[float, float], stop: Sequence[float]) -> list[float]:
    """Places that are wanted: beyond those that were looked at, as far as the bounds `stop`, or at
    an end, unless one is as near as 2 % of the height.
    """
    wanted: list[float] = []
    for side in (-1, 1):
        end, far = _end(points, side), max((abs(c) for c in points if c * side > 0), default=0.0)
        if far == 0:
            continue  # at a bound
        if end == side * float("inf"):
            if far < PLACES[-1] * 2**WIDER:
                wanted += [c for c in _within(stop, (2 * far,)) if c * side > far]
        elif (
            min(abs(points[c] * side - 1) for c in points if c * side > 0) > 0.02
            and round(end, 9) not in points
        ):
            wanted.append(end)
    return wanted
