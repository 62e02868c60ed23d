"""Searches in turn with the noise of each channel, until the weights are those of the noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from ...solvers.least_squares import CONVERGED, FAILED, LEFT, UNFINISHED, Found
from .covariance import Spread
from .problem import FitProblem

ROUNDS = 30
LINEAR_ROUNDS = 300  # without the model
SAME = 1e-3  # of the logarithm of a deviation, from one round to the next: a thousandth of it
Run = Callable[[FitProblem, Tensor, Tensor], Found]  # of coordinates (N, p) of the starts (N,)


def search_by_channel(problem: FitProblem, x: Tensor, run: Run) -> tuple[FitProblem, Found]:
    """The problem with weights of the noise, and what is found from coordinates x (S, p): the
    deviation of each channel is the root of its squares over its redundancy, which at the end is
    restricted maximum likelihood (Foerstner 1979, Zeitschrift fuer Vermessungswesen 104, 149;
    Patterson and Thompson 1971, Biometrika 58, 545). The best start goes through the rounds, the
    others follow with the last weights.

    Raises ValueError where the parameters leave a channel no reading to know its noise by.
    """
    every = torch.arange(len(x), device=x.device)
    begun, first = problem, run(problem, x, every)
    least = problem.deviations * torch.finfo(x.dtype).eps ** 0.5
    best = _best(begun, first)
    search_result, settled = first.of(every[best : best + 1]), False
    for _ in range(ROUNDS):
        problem, settled = _settled_where_linear(problem, search_result, least)
        if settled:
            break
        search_result = run(problem, search_result.x, every[best : best + 1])
    last = (
        search_result
        if len(x) == 1
        else run(problem, first.x.index_put((every[best],), search_result.x[0]), every)
    )
    status = (
        last.status if settled else torch.where(last.status == CONVERGED, UNFINISHED, last.status)
    )
    start = (
        None
        if first.first is None
        else (first.first + begun.target) / begun.weight * problem.weight - problem.target
    )
    history = torch.cat((first.history, last.history[1:]))
    return problem, Found(
        last.x, last.r, last.J, status, history, first.raised + last.raised, start
    )


def _settled_where_linear(
    problem: FitProblem, search_result: Found, least: Tensor
) -> tuple[FitProblem, bool]:
    """The problem with the noise of what one start found, on which its readings' tangent settles:
    the rounds, which converge linearly, by Gauss and Newton steps without the model. Whether the
    first of them was the last: the noise is that of the weights as they are.
    """
    region = problem.region(search_result.x)
    for k in range(LINEAR_ROUNDS):
        factor = _factor(problem, search_result, least)
        if factor.log().abs().max() < SAME:
            return problem, k == 0
        less = 1 / problem.noise.each(factor)[problem.known]
        problem = problem.reweighted(factor)
        x, r, J = search_result.x, search_result.r * less, search_result.J * less[:, None]
        search_result = replace(search_result, r=r, J=J)
        free = Spread.of(problem, search_result, 0).free
        pull = (J.mT @ r[..., None])[..., 0] + problem.prior(x)[1]
        moved = region.cut(x, x - (free @ pull[..., None])[..., 0])
        r = r + (J @ (moved - x)[..., None])[..., 0]
        search_result = replace(search_result, x=moved, r=r)
    return problem, False


def _best(problem: FitProblem, search_result: Found) -> int:
    total = search_result.r.square().sum(-1) + 2 * problem.prior(search_result.x)[0]
    good = torch.isfinite(total) & (search_result.status != FAILED) & (search_result.status != LEFT)
    return int(torch.where(good, total, torch.inf).argmin())


def _factor(problem: FitProblem, search_result: Found, least: Tensor) -> Tensor:
    """(channels,) by which deviations are to be larger, of what one start found; they are `least`
    at least.
    """
    spread = Spread.of(problem, search_result, 0)
    problem.noise.refuse(spread.redundancy, problem.known)
    squares = problem.noise.sums(search_result.r[0].square(), problem.known)
    return torch.maximum((squares / spread.redundancy).sqrt(), least / problem.deviations)
