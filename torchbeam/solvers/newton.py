"""Newton's method, controlled by convergence, per sample."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.batch_subset import BatchSubset, NotSeparable
from ..core.derivatives import no_derivatives
from ..core.leaves import Tree
from ..core.status import BROKEN, DIVERGED, SUCCESS
from ..core.validation import concrete
from .problem import Problem

TOLERANCE = {torch.float64: 1e-8, torch.float32: 1e-4}  # of the scaled residual
LIMIT = 25  # iterations
# whole steps that may pass before one is below the best; a step is shortened by factors between
# these two, to no less than this share
WAIT, SHORTER, LEAST = 5, (0.1, 0.5), 0.01
TRUSTED = 0.01  # a residual that falls by this factor goes on to fall at the order of convergence


class Outcome(NamedTuple):
    """x: the solution (or the last iterate); reaction (..., K, w); status (...) int, see
    `core.status.STATUS`; iterations (...) int.
    """

    x: Any
    reaction: Tensor
    status: Tensor
    iterations: Tensor


def newton(
    problem: Problem,
    x: Any,
    active: Tensor | None = None,
    tolerance: float | None = None,
    limit: int = LIMIT,
    trust_start: bool = True,
    foresee: Tensor | None = None,
) -> Outcome:
    """Solve problem.residual(x) = 0. Samples that have converged stop changing, so that none
    depends on its neighbours; those outside of `active` (...) never start. Once few are left, those
    alone go on (see `BatchSubset`): the same answers, but that products of another shape may round
    differently.

    A sample has converged once its scaled residual is below `tolerance`, or foreseen to be after
    the update that is at hand: from r to s, the next is s (s/r)^2 where convergence is quadratic,
    and s (s/r) where the tangent is not exact; this is trusted once s < r/100. The update is made
    either way, and not measured: what is left can be larger than foreseen (of 1200 equilibria of
    cantilevers under tip forces, with 1e-8, one in twenty was above it, the worst at 2e-6). A
    sample whose residual stops being finite has failed and is left alone.

    What an iteration tells the next one (`Problem.telling`) is told again where that goes back.

    Where a contact begins, or what sticks begins to slip, tangents tell little of what is beyond:
    of a problem with a merit, a step that raises it is shortened until it does not, see
    `step_length`; with patience not before some whole steps, none of which leads below the best, as
    those that go deep into an obstacle come back by themselves. Each time counts as an iteration.
    Steps are whole where nothing is near enough to touch, and the last one is, which is foreseen to
    converge.

    trust_start  whether r may be the residual of x; not where that is the size of a step to come,
                 whatever the balance lacks
    foresee      (...) whether what is foreseen counts, None = of all; where it does not, as in
                 equilibria, one below `tolerance` has to be measured
    """
    with no_derivatives():
        control = Control(tolerance, limit, trust_start, foresee)
        return _iterate(problem, x, active, None, control)


class Search(NamedTuple):
    """Where steps may be shortened: the best unknowns so far and what was told there, the merit
    there, the share of the step from there that has been taken, and `Length.waited`.
    """

    best: Any
    told: Mapping[str, Tensor]
    merit: Tensor
    share: Tensor
    waited: Tensor


class Control(NamedTuple):
    """Options of `newton`."""

    tolerance: float | None
    limit: int
    trust_start: bool
    foresee: Tensor | None


def _iterate(
    problem: Problem,
    x: Any,
    active: Tensor | None,
    before: Tensor | None,
    control: Control,
    search: Search | None = None,
) -> Outcome:
    """`before` (...): the scaled residual of the iteration before; None = there was none;
    search: of the last step, None = there was none.
    """
    first, (tolerance, limit, trust_start, foresee) = before is None, control
    for k in range(limit):
        residual, *about = problem.residual(x)
        size = residual.measure()
        if k == 0:
            tolerance = tolerance or TOLERANCE[size.dtype]
            none = torch.zeros_like(size, dtype=torch.bool)
            over = none if active is None else ~active.expand(size.shape)
            done = over
            status = torch.where(torch.isfinite(size) | (not first), DIVERGED, BROKEN)
            iterations = torch.zeros_like(status)
            before = torch.zeros_like(size) if first else before
            x = type(x)(*(v.expand(*size.shape, *v.shape[-2:]) for v in x))
            few = None if active is None else BatchSubset.worthwhile(~over)
            control = Control(tolerance, limit, trust_start, foresee)
            rest = _of_some(few, problem, x, None, control, None)
            if rest is not None:
                reaction = size.new_zeros(*size.shape, *rest.reaction.shape[-2:])
                still = torch.where(over, SUCCESS, status)
                return _joined(few, Outcome(x, reaction, still, iterations), rest)
        tangent = problem.linearise(x, *about)
        if k == 0:
            exact = tangent.exact
        ends = ~over & converged(size, before, exact, tolerance, foresee)
        length, search = _searched(problem, residual, x, search, ~over & ~ends)
        *change, root = tangent.solve(residual.nodes, residual.strain)
        keep = over[..., None, None]
        after = problem.update(x, *change)
        told = problem.telling(*about)
        if length is not None:
            after, told, search = _shortened(problem, length, search, x, after, told)
        x = type(x)(*(torch.where(keep, a, b) for a, b in zip(x, after, strict=True)))
        reaction = torch.where(keep, size.new_zeros(()) if k == 0 else reaction, root)
        iterations = iterations + ~over
        done = done | ends
        over = done | ~torch.isfinite(size)
        if trust_start or not first or k:
            before = size if length is None else length.before(before, size)
        if concrete(over).all():
            break
        problem = problem.after(told) if told else problem
        few = BatchSubset.worthwhile(~over) if k < limit - 1 else None
        control = Control(tolerance, limit - 1 - k, True, foresee)
        rest = _of_some(few, problem, x, before, control, search)
        if rest is not None:
            whole = Outcome(x, reaction, torch.where(done, SUCCESS, status), iterations)
            return _joined(few, whole, rest)
    return Outcome(x, reaction, torch.where(done, SUCCESS, status), iterations)


def _of_some(
    few: BatchSubset | None,
    problem: Problem,
    x: Any,
    before: Tensor | None,
    control: Control,
    search: Search | None,
) -> Outcome | None:
    """`_iterate` of some samples alone; None where there are none, or they cannot be parted."""
    try:
        part = few.gather(problem) if few is not None and isinstance(problem, Tree) else None
    except NotSeparable:
        return None
    if part is None:
        return None
    foresee = None if control.foresee is None else few.take(control.foresee, 0)
    if search is not None:
        told = {name: few.take(v, 2) for name, v in search.told.items()}
        search = Search(_taken(few, search.best), told, *(few.take(v, 0) for v in search[2:]))
    before = None if before is None else few.take(before, 0)
    return _iterate(part, _taken(few, x), None, before, control._replace(foresee=foresee), search)


def _shortened(
    problem: Problem, length: Length, search: Search, x: Any, after: Any, told: Mapping[str, Tensor]
) -> tuple[Any, Mapping[str, Tensor], Search]:
    """What comes after x, what is told there, and the search, where steps have these lengths."""
    after = _where(length.back, problem.between(search.best, x, length.ratio), after)
    last = problem.told or {}
    best = _told(length.worse, search.told, last)
    told = _told(length.back, _told(length.ratio > 0, last, best), told)
    return after, told, search._replace(best=_where(length.worse, search.best, x), told=best)


class Length(NamedTuple):
    """worse (...) bool: where the last step has led above the best; back (...) bool: whether it is
    taken back, to which ratio of it, 0 = to the best; merit (...): of the best; share (...): of the
    step to come; waited (...): whole steps since the best, WAIT + 1 = at it again, then WAIT + 2.
    """

    worse: Tensor
    back: Tensor
    ratio: Tensor
    merit: Tensor
    share: Tensor
    waited: Tensor

    def before(self, before: Tensor, size: Tensor) -> Tensor:
        """(...) the scaled residual that the next one is measured by, 0 = by none."""
        return torch.where(self.back, torch.where(self.ratio > 0, before, 0.0), size)


def first_wait(patient: bool) -> int:
    """`Length.waited` of the best: without patience a step that leads above it is shortened."""
    return 0 if patient else WAIT + 2


def step_length(
    merit: Tensor, best: Tensor, share: Tensor, waited: Tensor, free: Tensor, patient: bool
) -> Length:
    """What becomes of the step that has led to a merit (...), a sum of squares, where the best is
    `best`, a share of it having been taken; free (...): samples in which it may be shortened.

    With patience steps stay whole until so many have not led below the best (the watchdog of
    Chamberlain, Powell, Lemarechal and Pedersen 1982); then that is gone back to, and the step from
    there shortened. The ratio is where a parabola that falls at first as Newton's step promises has
    its least value (Dennis and Schnabel 1983, 6.3.2), within bounds.
    """
    again = waited == WAIT + 1
    worse = free & ~again & (merit > best) & (share > LEAST)
    back = worse & (waited >= WAIT)
    returns = worse & (waited == WAIT)
    ratio = (best / (best + merit)).clamp(*SHORTER)
    one = torch.ones_like(ratio)
    searched = torch.where(worse, waited, first_wait(patient))
    return Length(
        worse,
        back,
        torch.where(returns, 0.0, torch.where(back, ratio, one)),
        torch.where(worse, best, merit),
        torch.where(back & ~returns, ratio * share, one),
        torch.where(again | worse & (waited <= WAIT), waited + 1, searched),
    )


def converged(
    size: Tensor,
    before: Tensor,
    exact: Tensor,
    tolerance: float | Tensor,
    foresee: Tensor | None = None,
) -> Tensor:
    """Whether a scaled residual (...), with that of the iteration before, is small enough, see
    `newton`; exact (...): whether the tangent is.
    """
    drop = size / before
    coming = size * drop * torch.where(exact, drop, 1.0)
    foreseen = (drop < TRUSTED) & (coming <= tolerance)
    return (size <= tolerance) | (foreseen if foresee is None else foreseen & foresee)


def _searched(
    problem: Problem, residual: Any, x: Any, search: Search | None, free: Tensor
) -> tuple[Length | None, Search | None]:
    """What becomes of the last step, and the search after that; None, where steps are whole."""
    merit = problem.merit(residual)
    if merit is None:
        return None, None
    if search is None:
        one = torch.ones_like(merit)
        search = Search(x, {}, torch.inf * one, one, first_wait(problem.patient) * one)
    if concrete(free & (merit > search.merit)).any():
        free = free & (problem.near(x) | problem.near(search.best))
    length = step_length(merit, *search[2:], free, problem.patient)
    return length, Search(*search[:2], length.merit, length.share, length.waited)


def _where(which: Tensor, a: Any, b: Any) -> Any:
    return type(a)(*(torch.where(which[..., None, None], v, w) for v, w in zip(a, b, strict=True)))


def _told(which: Tensor, a: Mapping[str, Tensor], b: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
    """What is told in one way and the other; nothing is zeros."""
    some = which[..., None, None]
    parts = {name: (a.get(name), b.get(name)) for name in {**a, **b}}
    return {
        name: torch.where(some, 0.0 if v is None else v, 0.0 if w is None else w)
        for name, (v, w) in parts.items()
    }


def _taken(few: BatchSubset, x: Any) -> Any:
    return type(x)(*(few.take(v, 2) for v in x))


def _joined(few: BatchSubset, whole: Outcome, rest: Outcome) -> Outcome:
    """The outcome of all, where some went on by themselves."""
    x = type(whole.x)(*(few.put(a, b, 2) for a, b in zip(whole.x, rest.x, strict=True)))
    return Outcome(
        x,
        few.put(whole.reaction, rest.reaction, 2),
        few.put(whole.status, rest.status, 0),
        whole.iterations.index_add(0, few.index, rest.iterations),
    )
