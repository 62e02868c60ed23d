"""Searches in turn with the noise of each channel, until the weights are those of the noise."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ...solvers.least_squares import CONVERGED, FAILED, LEFT, UNFINISHED, Found
from .covariance import Spread
from .problem import Problem

ROUNDS = 30
SAME = 1e-3  # of the logarithm of a deviation, from one round to the next: a thousandth of it
Run = Callable[[Problem, Tensor, Tensor], Found]  # of coordinates (N, p) of the starts (N,)


def search_by_channel(problem: Problem, x: Tensor, run: Run) -> tuple[Problem, Found]:
    """The problem with weights of the noise, and what is found from coordinates x (S, p): the deviation of each channel is the
    root of its squares over its redundancy, which at the end is restricted maximum likelihood (Foerstner 1979, Zeitschrift fuer
    Vermessungswesen 104, 149; Patterson and Thompson 1971, Biometrika 58, 545). The best start goes through the rounds, the
    others follow with the last weights.

    Raises ValueError where the parameters leave a channel no reading to know its noise by.
    """
    every = torch.arange(len(x), device=x.device)
    begun, first, least = problem, run(problem, x, every), problem.deviations * torch.finfo(x.dtype).eps**0.5
    best = _best(begun, first)
    found = first.of(every[best:best + 1])
    for _ in range(ROUNDS):
        factor = _factor(problem, found, least)
        problem, settled = problem.reweighted(factor), bool(factor.log().abs().max() < SAME)
        found = run(problem, found.x, every[best:best + 1])
        if settled:
            break
    last = found if len(x) == 1 else run(problem, first.x.index_put((every[best],), found.x[0]), every)
    status = last.status if settled else torch.where(last.status == CONVERGED, UNFINISHED, last.status)
    start = None if first.first is None else (first.first + begun.target) / begun.weight * problem.weight - problem.target
    history = torch.cat((first.history, last.history[1:]))
    return problem, Found(last.x, last.r, last.J, status, history, first.raised + last.raised, start)


def _best(problem: Problem, found: Found) -> int:
    total = found.r.square().sum(-1) + 2 * problem.prior(found.x)[0]
    good = torch.isfinite(total) & (found.status != FAILED) & (found.status != LEFT)
    return int(torch.where(good, total, torch.inf).argmin())


def _factor(problem: Problem, found: Found, least: Tensor) -> Tensor:
    """(channels,) by which deviations are to be larger, of what one start found; they are `least` at least."""
    spread = Spread.of(problem, found, 0)
    problem.noise.refuse(spread.redundancy, problem.known)
    squares = problem.noise.sums(found.r[0].square(), problem.known)
    return torch.maximum((squares / spread.redundancy).sqrt(), least / problem.deviations)
