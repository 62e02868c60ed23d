"""Newton's method, controlled by convergence, per sample; and its gradient by the implicit function theorem."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import torch
from torch import Tensor

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
    those outside of `active` (...) never start.

    A sample has converged once its scaled residual is below `tolerance`, or sure to be after the update that is at hand:
    from r to s, the next is s (s/r)^2 where convergence is quadratic, and this is trusted once s < r/100. The update is made
    either way. A sample whose residual stops being finite has failed and is left alone.
    """
    tolerance = tolerance or TOLERANCE[problem.model.S.dtype]
    with no_derivatives():
        for k in range(limit):
            residual, *about = problem.residual(x)
            size = residual.measure()
            *change, root = problem.linearise(x, *about).solve(residual.nodes, residual.strain)
            moved = problem.moved(x, *change)
            if k == 0:
                done = torch.zeros_like(size, dtype=torch.bool) if active is None else ~active.expand(size.shape)
                status = torch.where(torch.isfinite(size), DIVERGED, BROKEN)
                reaction, iterations, before = root, torch.zeros_like(status), torch.zeros_like(size)
            keep = done[..., None, None]
            x = type(x)(*(torch.where(keep, old, new) for old, new in zip(x, moved, strict=True)))
            reaction = torch.where(keep, reaction, root)
            iterations = iterations + ~done
            drop = size / before
            done = done | (size <= tolerance) | ((drop < QUADRATIC) & (size * drop**2 <= tolerance))
            before = size
            if (done | ~torch.isfinite(size)).all():
                break
        return Outcome(x, reaction, torch.where(done, SUCCESS, status), iterations)


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
    held = [v for owner in (*scene.effects, *scene.supports, scene.frame) if owner is not None for v in vars(owner).values()]
    known = [*held, *vars(model).values(), *vars(model.inertia).values(), *problem.inputs.values(),
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
