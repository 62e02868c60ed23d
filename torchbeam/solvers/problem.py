"""What Newton's method and the implicit function theorem ask of a problem.

The unknowns x are a named tuple of tensors (..., m, n), with two axes of their own behind the
batch's. Where a problem is a `Tree`, samples that have converged stop costing (`BatchSubset`), and
its tensors tell whether a derivative is wanted.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from torch import Tensor


class Balance(Protocol):
    """A residual: nodes (..., N+1, w) and strain (..., N, k)."""

    @property
    def nodes(self) -> Tensor: ...

    @property
    def strain(self) -> Tensor: ...

    def measure(self) -> Tensor:
        """(...) its size, scaled; not finite where anything in it is not."""
        ...


class Tangent(Protocol):
    """The derivative of a residual, factored or not."""

    @property
    def exact(self) -> Tensor:
        """(...) bool: whether it is the derivative of the residual, without what makes an iteration
        more robust.
        """
        ...

    def solve(self, nodes: Tensor, strain: Tensor) -> tuple[Tensor, ...]:
        """What a residual asks for: the arguments of `Problem.update`, and last the reaction
        (..., K, w) after it.
        """
        ...


class ConstantTangent(Tangent, Protocol):
    """A tangent by which a solution can be differentiated."""

    def detach(self) -> ConstantTangent:
        """The same without gradient."""
        ...


class Problem(Protocol):
    """residual(x) = 0, by steps update(x, *linearise(x).solve(residual)). Properties that depend on
    tensors are `cached`.
    """

    def residual(self, x: Any) -> tuple[Any, ...]:
        """The `Balance` at x, and after it whatever `linearise` takes beside x: tensors, named
        tuples of tensors, None.
        """
        ...

    def linearise(self, x: Any, *about: Any) -> Tangent:
        """The tangent at x."""
        ...

    def update(self, x: Any, *change: Tensor) -> Any:
        """x after a change."""
        ...

    def merit(self, residual: Any) -> Tensor | None:
        """(...) what no Newton step is to raise, see `step_length`; None = steps are whole."""
        ...

    @property
    def patient(self) -> bool:
        """Whether some whole steps may raise it, of a problem that has a merit."""
        ...

    def near(self, x: Any) -> Tensor:
        """(...) bool: whether anything is near enough to touch, of a problem that has a merit."""
        ...

    def between(self, last: Any, x: Any, share: Tensor) -> Any:
        """A share (...) of the way from the unknowns `last` to x, of a problem with a merit."""
        ...

    @property
    def told(self) -> Mapping[str, Tensor] | None:
        """What the last iteration has told this one, (..., m, n) by name; else zeros."""
        ...

    def telling(self, *about: Any) -> Mapping[str, Tensor]:
        """What this iteration tells the next one, by which that has its tangent; about: what
        `residual` gives beside the balance.
        """
        ...

    def after(self, told: Mapping[str, Tensor]) -> Problem:
        """The same, told this."""
        ...
