"""Derivatives of a solution by the implicit function theorem."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.leaves import Tree, detached, is_function, recorded, values, wants_gradient
from ..core.validation import concrete
from .problem import Problem


def implicit_gradient(problem: Problem, x: Any, good: Tensor) -> tuple[Any, Tensor]:
    """The solution x and the reaction there, with their derivatives.

    By the implicit function theorem dx = -K^-1 dg: one residual with gradient and one linear solve,
    whatever the number of iterations. Where the tangent has given an impossible strain a small
    flexibility, a second of both takes the error that this leaves, as another iteration would.
    First derivatives only. Samples that are not `good` (...) are constants, whatever is not a
    number in them.
    """
    residual, *about = problem.residual(x)
    with no_derivatives():
        tangent = problem.linearise(x, *(_detached(a) for a in about)).detach()
    good = good[..., None, None]
    for last in (True,) if concrete(tangent.exact).all() else (False, True):
        *change, reaction = tangent.solve(
            *(torch.where(good, r, 0.0) for r in (residual.nodes, residual.strain))
        )
        x = problem.update(x, *(torch.where(good, c - c.detach(), 0.0) for c in change))
        if not last:
            residual = problem.residual(x)[0]
    return x, reaction


def differentiated(problem: Problem, x: Any) -> bool:
    """Whether a derivative is being recorded for anything that a problem depends on: its tensors,
    and, where it has functions, what comes of them.
    """
    found = values(problem)
    if recorded(found):
        return True
    recording = torch.is_grad_enabled() or torch.autograd.forward_ad._current_level >= 0
    if not (recording and any(map(is_function, found))):
        return False
    residual = problem.residual(x)[0]
    return wants_gradient(residual.nodes, residual.strain)


def _detached(x: Any) -> Any:
    """A tensor, a tree, None, or a named tuple of such."""
    if isinstance(x, tuple):
        return type(x)(*map(_detached, x))
    return detached(x) if isinstance(x, Tree) else x if x is None else x.detach()
