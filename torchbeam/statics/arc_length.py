"""Arc-length problem: the balance with the load factor as one more unknown and one more equation
that says how far to go.

Both are found by two solves with the same tangent (Batoz and Dhatt 1979): K a = -g, K
b = -dg/d(factor), the move is a + b d(factor), and the other equation gives d(factor).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.functions_of_time import rate_along
from ..core.leaves import Tree, leaf
from ..equations.steady import Configuration, SteadyProblem
from ..nodal.balance import Linearisation, Residual
from ..nodal.model import Model
from ..scene.effects import Inputs
from .internal_states import linearised
from .mechanism import braced, stressed, with_braces


class PathPoint(NamedTuple):
    """A point of the path and the way to it since the step began: way (..., N+1, 6), factor
    (..., 1, 1).
    """

    position: Tensor
    rotation: Tensor
    stress: Tensor
    factor: Tensor
    way: Tensor

    @property
    def shape(self) -> Configuration:
        return Configuration(self.position, self.rotation, self.stress)


@dataclass(frozen=True)
class LoadedProblem(Tree):
    """The balance as a function of the load factor (...): of all loads, or of the input `load`
    beside loads that stay; braces: see `mechanism`, None = there are none.
    """

    model: Model
    t: Tensor = leaf(0)
    inputs: Inputs = leaf(1)
    load: str | None = None
    braces: Tensor | None = leaf(3, default=None)

    def __call__(self, factor: Tensor) -> SteadyProblem:
        inputs, raised = self.inputs, factor
        if self.load is not None:
            inputs = {**inputs, self.load: factor[..., None] * inputs[self.load]}
            raised = torch.ones_like(factor)
        return with_braces(SteadyProblem(self.model, self.t, inputs, raised), self.braces)

    def braced(self, start: Configuration) -> LoadedProblem:
        """The same with braces for rigid motions that the whole load does not hold either."""
        whole = self(self.t.new_ones(()))
        braces = braced(whole, stressed(whole, start)[0])
        return replace(self, braces=getattr(braces, "braces", None))

    def at(self, x: PathPoint) -> SteadyProblem:
        """The same at a point of the path, with laws of internal states linearised where these come
        to rest there.
        """
        still = self(x.factor[..., 0, 0])
        return linearised(still, x.shape) if self.model.internal_states else still


class Balance(NamedTuple):
    """The residual, and what is missing (...) in the other equation, out of size (...)."""

    inner: Residual
    missing: Tensor
    size: Tensor

    @property
    def nodes(self) -> Tensor:
        return self.inner.nodes

    @property
    def strain(self) -> Tensor:
        return self.inner.strain

    def measure(self) -> Tensor:
        return torch.maximum(self.inner.measure(), self.missing.abs() / self.size)


@dataclass(frozen=True)
class ArcLengthProblem(Tree):
    """Balance and one more equation: sum(row * way) + by_factor (factor - start) = goal, or
    q(state) = goal.
    """

    loaded: LoadedProblem
    row: Tensor = leaf(2)  # (..., N+1, w)
    by_factor: Tensor = leaf(0)
    start: Tensor = leaf(0)
    goal: Tensor = leaf(0)
    size: Tensor = leaf(0)  # what `goal` is measured against
    control: Callable[[Configuration], Tensor] | None = leaf(None, default=None)

    def residual(self, x: PathPoint) -> tuple[Any, ...]:
        still = self.loaded.at(x)
        residual, *about = still.residual(x.shape)
        if self.control is None:
            row = self.row
            said = (self.row * x.way).sum((-1, -2)) + self.by_factor * (
                x.factor[..., 0, 0] - self.start
            )
        else:
            said, row = gradient(still, x.shape, self.control)
        return Balance(residual, self.goal - said, self.size), row, self.goal - said, *about

    def linearise(
        self, x: PathPoint, row: Tensor, missing: Tensor, *about: Any
    ) -> ArcLengthTangent:
        inner = self.loaded.at(x).linearise(x.shape, *about)
        return ArcLengthTangent(inner, *load_slope(self.loaded, x), row, self.by_factor, missing)

    def update(self, x: PathPoint, move: Tensor, dstress: Tensor, dfactor: Tensor) -> PathPoint:
        shape = self.loaded(x.factor[..., 0, 0]).update(x.shape, move, dstress)
        return PathPoint(*shape, x.factor + dfactor, x.way + move)


class ArcLengthTangent(NamedTuple):
    inner: Linearisation
    load: Tensor
    load_strain: Tensor
    row: Tensor
    by_factor: Tensor
    missing: Tensor

    @property
    def exact(self) -> Tensor:
        return self.inner.exact

    def solve(self, g: Tensor, g_strain: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        move, dstress, root = self.inner.solve(g, g_strain)
        by_move, by_dstress, by_root = self.inner.solve(self.load, self.load_strain)
        pivot = (self.row * by_move).sum((-1, -2)) + self.by_factor
        change = (self.missing - (self.row * move).sum((-1, -2))) / pivot
        wide = change[..., None, None]
        ends = change[(...,) + (None,) * (root.ndim - change.ndim)]
        return move + wide * by_move, dstress + wide * by_dstress, wide, root + ends * by_root


def where(mask: Tensor, a: Any, b: Any) -> Any:
    """Tensors, or tuples of tensors, by sample."""
    if isinstance(a, Tensor):
        return torch.where(mask[(...,) + (None,) * (a.ndim - mask.ndim)], a, b)
    parts = [where(mask, x, y) for x, y in zip(a, b, strict=True)]
    return type(a)(*parts) if hasattr(a, "_fields") else tuple(parts)


def load_slope(loaded: LoadedProblem, x: PathPoint) -> tuple[Tensor, Tensor]:
    """Derivatives of the residual, nodes (..., N+1, w) and strain (..., N, k), by the factor: with
    it go loads, eigenstrain and the motion of supports.
    """
    near = loaded.at(x).near

    def residual(factor: Tensor) -> tuple[Tensor, Tensor]:
        balance = replace(loaded(factor), near=near).residual(x.shape)[0]
        return balance.nodes, balance.strain

    factor = x.factor[..., 0, 0].contiguous()
    return rate_along(residual, (factor,), (torch.ones_like(factor),))[1]


def gradient(
    still: SteadyProblem, x: Configuration, control: Callable[[Configuration], Tensor]
) -> tuple[Tensor, Tensor]:
    """A quantity (...) and its slope (..., N+1, 6) by moves."""

    def read(move: Tensor) -> Tensor:
        return control(still.update(x, move, torch.zeros_like(x.stress)))

    with torch.enable_grad():
        value, back = torch.func.vjp(
            read, x.position.new_zeros(*x.position.shape[:-1], still.model.space.unknowns)
        )
        return value, back(torch.ones_like(value))[0]
