"""Arc-length problem: the balance with the load factor as one more unknown and one more equation
that says how far to go.

Both are found by two solves with the same tangent (Batoz and Dhatt 1979): K a = -g, K
b = -dg/d(factor), the move is a + b d(factor), and the other equation gives d(factor).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from ..core.derivatives import cached, vjp
from ..core.functions_of_time import rate_along
from ..core.leaves import Tree, leaf
from ..engine.chain.path_balance import native_balance
from ..equations.steady import Configuration, Past, SteadyProblem
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


Answer = tuple[Tensor, Tensor, Tensor]  # move, dstress, reaction: see `Linearisation.solve`


class PointBalance(Protocol):
    """The balance at a point of a path, and what its tangent gives: for the residual, for the
    residual's slope by the factor, and its pivots (see `System.pivots`).
    """

    @property
    def residual(self) -> Any: ...
    @property
    def exact(self) -> Tensor: ...
    @property
    def by_residual(self) -> Answer: ...
    @property
    def by_factor(self) -> Answer: ...
    def pivots(self, unit: Tensor | None = None) -> tuple[Tensor, Tensor]: ...


@dataclass(frozen=True)
class LoadedProblem(Tree):
    """The balance as a function of the load factor (...): of all loads, or of the input `load`
    beside loads that stay; braces: see `mechanism`, None = there are none; native: finds it at a
    point of the path by (position, rotation, stress, factor), None = eagerly; past: what is
    remembered there, None = nothing is; resisting: see `SteadyProblem`.
    """

    model: Model
    t: Tensor = leaf(0)
    inputs: Inputs = leaf(1)
    load: str | None = None
    braces: Tensor | None = leaf(3, default=None)
    native: Callable[..., PointBalance] | None = leaf(None, default=None)
    past: Past | None = leaf(2, default=None)
    resisting: bool = False

    def __call__(self, factor: Tensor) -> SteadyProblem:
        of, how = (self.model, self.t, self.inputs), dict(past=self.past, resisting=self.resisting)
        problem = SteadyProblem(*of, factor, **how)
        return with_braces(problem.under(factor, self.load), self.braces)

    def braced(self, start: Configuration) -> LoadedProblem:
        """The same with braces for rigid motions that the whole load does not hold either."""
        whole = self(self.t.new_ones(()))
        start, driven = stressed(whole, start)
        braces = None if driven is None else getattr(braced(whole, start), "braces", None)
        return replace(self, braces=braces)

    def by(self, engine: str) -> LoadedProblem:
        """The same by an engine, see `native_balance`."""
        still = replace(self, load=None)(self.t.new_zeros(()))
        return replace(self, native=native_balance(still, self.load, engine))

    def at(self, x: PathPoint) -> SteadyProblem:
        """The same at a point of the path, with laws of internal states linearised where these come
        to rest there.
        """
        still = self(x.factor[..., 0, 0])
        return linearised(still, x.shape) if self.model.internal_states else still

    def balance(self, x: PathPoint) -> PointBalance:
        """At a point of the path."""
        if self.native is None:
            return EagerPoint(self, x)
        return self.native(*x.shape, x.factor[..., 0, 0])


@dataclass(frozen=True)
class EagerPoint:
    """See `PointBalance`: what is not asked for is not computed."""

    loaded: LoadedProblem
    x: PathPoint

    @cached
    def problem(self) -> SteadyProblem:
        return self.loaded.at(self.x)

    @cached
    def _balance(self) -> tuple[Any, ...]:
        return self.problem.residual(self.x.shape)

    @property
    def residual(self) -> Residual:
        return self._balance[0]

    @cached
    def tangent(self) -> Linearisation:
        return self.problem.linearise(self.x.shape, *self._balance[1:])

    @property
    def exact(self) -> Tensor:
        return self.tangent.exact

    @cached
    def by_residual(self) -> Answer:
        return self.tangent.solve(self.residual.nodes, self.residual.strain)

    @cached
    def by_factor(self) -> Answer:
        return self.tangent.solve(*load_slope(self.loaded, self.problem, self.x))

    def pivots(self, unit: Tensor | None = None) -> tuple[Tensor, Tensor]:
        return self.tangent.system.pivots(unit)


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

    def residual(self, x: PathPoint) -> tuple[Balance, PointBalance, Tensor, Tensor]:
        point = self.loaded.balance(x)
        if self.control is None:
            row = self.row
            said = (self.row * x.way).sum((-1, -2)) + self.by_factor * (
                x.factor[..., 0, 0] - self.start
            )
        else:
            said, row = gradient(self.loaded(x.factor[..., 0, 0]), x.shape, self.control)
        missing = self.goal - said
        return Balance(point.residual, missing, self.size), point, row, missing

    def linearise(
        self, x: PathPoint, point: PointBalance, row: Tensor, missing: Tensor
    ) -> ArcLengthTangent:
        return ArcLengthTangent(point, row, self.by_factor, missing)

    def update(self, x: PathPoint, move: Tensor, dstress: Tensor, dfactor: Tensor) -> PathPoint:
        shape = self.loaded(x.factor[..., 0, 0]).update(x.shape, move, dstress)
        return PathPoint(*shape, x.factor + dfactor, x.way + move)

    def merit(self, residual: Balance) -> None:
        """Steps along a path are whole."""

    def telling(self, *about: Any) -> dict[str, Tensor]:
        """Nothing: paths refuse friction."""
        return {}


class ArcLengthTangent(NamedTuple):
    """At a point, for the residual there."""

    point: PointBalance
    row: Tensor
    by_factor: Tensor
    missing: Tensor

    @property
    def exact(self) -> Tensor:
        return self.point.exact

    def solve(self, g: Tensor, g_strain: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        move, dstress, root = self.point.by_residual
        by_move, by_dstress, by_root = self.point.by_factor
        pivot = (self.row * by_move).sum((-1, -2)) + self.by_factor
        change = (self.missing - (self.row * move).sum((-1, -2))) / pivot
        wide = change[..., None, None]
        ends = change[(...,) + (None,) * (root.ndim - change.ndim)]
        return move + wide * by_move, dstress + wide * by_dstress, wide, root + ends * by_root


def where(mask: Tensor, a: Any, b: Any) -> Any:
    """Tensors, or tuples of tensors, by sample."""
    if a is None:
        return None
    if isinstance(a, Tensor):
        return torch.where(mask[(...,) + (None,) * (a.ndim - mask.ndim)], a, b)
    parts = [where(mask, x, y) for x, y in zip(a, b, strict=True)]
    return type(a)(*parts) if hasattr(a, "_fields") else tuple(parts)


def load_slope(
    loaded: LoadedProblem, problem: SteadyProblem, x: PathPoint
) -> tuple[Tensor, Tensor]:
    """Derivatives of the residual, nodes (..., N+1, w) and strain (..., N, k), by the factor: with
    it go loads, eigenstrain and the motion of supports.
    """

    def residual(factor: Tensor) -> tuple[Tensor, Tensor]:
        balance = replace(loaded(factor), near=problem.near).residual(x.shape)[0]
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
        value, back = vjp(
            read, x.position.new_zeros(*x.position.shape[:-1], still.model.space.unknowns)
        )
        return value, back(torch.ones_like(value))[0]
