"""Searches in turn with the noise that the one before left: deviations by channel, correlations
from reading to reading, weights of a loss.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from ...solvers.least_squares import CONVERGED, FAILED, LEFT, UNFINISHED, Found
from . import losses
from .covariance import Spread
from .problem import FitProblem

ROUNDS = 30
LINEAR_ROUNDS = 300  # without the model
SAME = 1e-3  # of the logarithm of a deviation, from one round to the next: a thousandth of it
Run = Callable[[FitProblem, Tensor, Tensor], Found]  # of coordinates (N, p) of the starts (N,)


def search_in_rounds(problem: FitProblem, x: Tensor, run: Run) -> tuple[FitProblem, Found]:
    """The problem with weights of the noise, and what is found from coordinates x (S, p): the
    deviation of each channel is the root of its squares over its redundancy, which at the end is
    restricted maximum likelihood (Foerstner 1979, Zeitschrift fuer Vermessungswesen 104, 149;
    Patterson and Thompson 1971, Biometrika 58, 545), and so is the correlation of noise that
    remembers; weights of a loss are those of its misfits (iteratively reweighted least squares).
    The best start goes through the rounds, the others follow with the last weights.

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
    last = search_result
    if len(x) > 1:
        last = run(problem, first.x.index_put((every[best],), search_result.x[0]), every)
    status, start = last.status, first.first
    if not settled:
        status = torch.where(status == CONVERGED, UNFINISHED, status)
    if start is not None:
        start = problem.white(begun.white.inverse(start + begun.target)) - problem.target
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
    region, white = problem.region(search_result.x), problem.white
    if not torch.isfinite(search_result.r).all():
        return problem, True
    r, J = white.inverse(search_result.r), white.inverse(search_result.J.mT).mT
    for k in range(LINEAR_ROUNDS):
        changed, change = _next(problem, search_result, r[0], J[0], least)
        if change < SAME:
            return problem, k == 0
        problem, x = changed, search_result.x
        search_result = replace(search_result, r=problem.white(r), J=problem.white(J.mT).mT)
        free = Spread.of(problem, search_result, 0).white
        pull = (search_result.J.mT @ search_result.r[..., None])[..., 0] + problem.prior(x)[1]
        moved = region.cut(x, x - (free @ pull[..., None])[..., 0])
        r = r + (J @ (moved - x)[..., None])[..., 0]
        search_result = replace(search_result, x=moved, r=problem.white(r))
    return problem, False


def _next(
    problem: FitProblem, search_result: Found, r: Tensor, J: Tensor, least: Tensor
) -> tuple[FitProblem, float]:
    """The problem with the noise of what one start found, of misfits r (T,) and J (T, p) without
    weights, and by how much that has changed.
    """
    change = 0.0
    if problem.memory is not None:
        _, pull, bend = (part[0] for part in problem.prior(search_result.x))
        memory = problem.memory.found(problem, r, J, bend, pull)
        left = 1 - problem.memory.rho.square()
        change = ((memory.rho - problem.memory.rho) / left).abs().max().item()
        problem = problem.whitened(memory.in_(problem.white), memory)
        search_result = replace(
            search_result, r=problem.white(r)[None], J=problem.white(J.mT).mT[None]
        )
    spread = Spread.of(problem, search_result, 0)
    if problem.noise.names and problem.sigma_given:
        factor = _factor(problem, search_result, spread, least)
        change = max(change, factor.log().abs().max().item())
        problem = problem.reweighted(factor)
    if problem.loss.any():
        white = replace(problem.white, share=torch.ones_like(problem.white.share))
        share = losses.weights(problem.loss, white(r) / (spread.scale or 1)).sqrt()
        change = max(change, (share - problem.white.share).abs().max().item())
        problem = problem.whitened(replace(white, share=share))
    return problem, change


def _best(problem: FitProblem, search_result: Found) -> int:
    total = search_result.r.square().sum(-1) + 2 * problem.prior(search_result.x)[0]
    good = torch.isfinite(total) & (search_result.status != FAILED) & (search_result.status != LEFT)
    return int(torch.where(good, total, torch.inf).argmin())


def _factor(problem: FitProblem, search_result: Found, spread: Spread, least: Tensor) -> Tensor:
    """(channels,) factors of deviations, of what one start found; these are at least `least`."""
    problem.noise.refuse(spread.redundancy, problem.known)
    squares = losses.squares(problem.loss, problem.white.share, search_result.r[0])
    squares = problem.noise.sums(squares, problem.known)
    return torch.maximum((squares / spread.redundancy).sqrt(), least / problem.deviations)
