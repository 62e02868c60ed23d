"""Newton's method, controlled by convergence, per sample; and its gradient by the implicit function theorem."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import torch
from torch import Tensor

from .checks import concrete
from .rows import Rows, Whole

TOLERANCE = {torch.float64: 1e-8, torch.float32: 1e-4}  # of the scaled residual after the last update
LIMIT = 25  # iterations
QUADRATIC = 0.01  # a residual that falls by this factor falls quadratically

SUCCESS, DIVERGED, BROKEN, FAILED = range(4)
STATUS = {
    SUCCESS: "success",
    DIVERGED: "Newton's method did not converge; a smaller step may help",
    BROKEN: "a parameter, a load or the state is infinite or not a number",
    FAILED: "the explicit method failed: its step shrank to nothing, or the rates were not finite",
}


class Outcome(NamedTuple):
    """x: the solution (or the last iterate); reaction (..., 6); status (...) int, see `STATUS`; iterations (...) int."""

    x: Any
    reaction: Tensor
    status: Tensor
    iterations: Tensor


def newton(problem: Any, x: Any, active: Tensor | None = None, tolerance: float | None = None, limit: int = LIMIT) -> Outcome:
    """Solve problem.residual(x) = 0. Samples that have converged stop changing, so that none depends on its neighbours;
    those outside of `active` (...) never start. Once few are left, those alone go on (see `Rows.few`), to the same bits.

    A sample has converged once its scaled residual is below `tolerance`, or sure to be after the update that is at hand:
    from r to s, the next is s (s/r)^2 where convergence is quadratic, and this is trusted once s < r/100. The update is made
    either way. A sample whose residual stops being finite has failed and is left alone.
    """
    with no_derivatives():
        return _iterate(problem, x, active, None, tolerance or TOLERANCE[problem.model.S.dtype], limit)


def _iterate(problem: Any, x: Any, active: Tensor | None, before: Tensor | None, tolerance: float, limit: int) -> Outcome:
    """`before` (...): the scaled residual of the iteration before; None = there was none."""
    first = before is None
    for k in range(limit):
        residual, *about = problem.residual(x)
        size = residual.measure()
        if k == 0:
            over = torch.zeros_like(size, dtype=torch.bool) if active is None else ~active.expand(size.shape)
            done = over
            status = torch.where(torch.isfinite(size) | (not first), DIVERGED, BROKEN)
            iterations = torch.zeros_like(status)
            before = torch.zeros_like(size) if first else before
            reaction = size.new_zeros(*size.shape, *problem.model.held.fixed.shape)
            x = type(x)(*(v.expand(*size.shape, *v.shape[-2:]) for v in x))
            rows = None if active is None else Rows.few(~over)
            part = None if rows is None else _part(problem, rows)
            if part is not None:
                rest = _iterate(part, rows.of(x, 2), None, None, tolerance, limit)
                return _joined(rows, Outcome(x, reaction, torch.where(over, SUCCESS, status), iterations), rest)
        *change, root = problem.linearise(x, *about).solve(residual.nodes, residual.strain)
        keep = over[..., None, None]
        x = type(x)(*(torch.where(keep, a, b) for a, b in zip(x, problem.moved(x, *change), strict=True)))
        reaction = torch.where(keep, reaction, root)
        iterations = iterations + ~over
        drop = size / before
        done = done | (~over & ((size <= tolerance) | ((drop < QUADRATIC) & (size * drop**2 <= tolerance))))
        over = done | ~torch.isfinite(size)
        before = size
        if concrete(over).all():
            break
        rows = Rows.few(~over) if k < limit - 1 else None
        part = None if rows is None else _part(problem, rows)
        if part is not None:
            rest = _iterate(part, rows.of(x, 2), None, rows.of(before, 0), tolerance, limit - 1 - k)
            return _joined(rows, Outcome(x, reaction, torch.where(done, SUCCESS, status), iterations), rest)
    return Outcome(x, reaction, torch.where(done, SUCCESS, status), iterations)


def _part(problem: Any, rows: Rows) -> Any:
    """The problem of some samples alone; None where it cannot be told."""
    try:
        return rows.of(problem)
    except Whole:
        return None


def _joined(rows: Rows, whole: Outcome, rest: Outcome) -> Outcome:
    """The outcome of all, where some went on by themselves."""
    x = type(whole.x)(*(rows.put(a, b, 2) for a, b in zip(whole.x, rest.x, strict=True)))
    return Outcome(x, rows.put(whole.reaction, rest.reaction, 2), rows.put(whole.status, rest.status, 0),
                   whole.iterations.index_add(0, rows.index, rest.iterations))


def attach(problem: Any, x: Any, good: Tensor) -> tuple[Any, Tensor]:
    """The solution x and the reaction there, with their derivatives.

    By the implicit function theorem dx = -K^-1 dg: one residual with gradient and one linear solve, whatever the number of
    iterations. First derivatives only. Samples that are not `good` (...) are constants, whatever is not a number in them.
    """
    residual, *about = problem.residual(x)
    with no_derivatives():
        tangent = problem.linearise(x, *(_detached(a) for a in about)).detach()
    good = good[..., None, None]
    *change, reaction = tangent.solve(*(torch.where(good, r, 0.0) for r in (residual.nodes, residual.strain)))
    return problem.moved(x, *(torch.where(good, c - c.detach(), 0.0) for c in change)), reaction


@contextmanager
def no_derivatives() -> Iterator[None]:
    """No backward graph and no forward tangents."""
    with torch.no_grad(), torch.autograd.forward_ad._set_fwd_grad_enabled(False):
        yield


def wants_gradient(*tensors: Any) -> bool:
    """Whether any derivative, backward or forward, is being recorded for these."""
    return any(
        isinstance(x, Tensor) and ((x.requires_grad and torch.is_grad_enabled())
                                   or torch.autograd.forward_ad.unpack_dual(x).tangent is not None)
        for x in tensors
    )


def dependencies(problem: Any, x: Any) -> list[Any]:
    """Everything a problem depends on: its inputs and its start, its model, what the scene's effects and motions hold; and
    where those are functions, what comes of them.
    """
    model, start = problem.model, getattr(problem, "start", None)
    scene = model.scene
    owners = (*scene.effects, *scene.supports, scene.frame, scene.root)
    held = [v for owner in owners if owner is not None for v in vars(owner).values()]
    known = [*held, *vars(model).values(), *vars(model.inertia).values(), *vars(model.space).values(), *problem.inputs.values(),
             *(() if start is None else vars(start).values())]
    recording = torch.is_grad_enabled() or torch.autograd.forward_ad._current_level >= 0
    if recording and any(callable(v) and not isinstance(v, Tensor) for v in held):
        residual = problem.residual(x)[0]
        known += [residual.nodes, residual.strain]
    return known


def _detached(x: Any) -> Any:
    """A tensor, None, or a named tuple of such."""
    if isinstance(x, tuple):
        return type(x)(*map(_detached, x))
    return None if x is None else x.detach()
