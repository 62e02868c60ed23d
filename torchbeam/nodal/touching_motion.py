"""How beams move that may touch each other; and what is asked of a scene where none does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from torch import Tensor

from ..core.leaves import Tree


class TouchingMotion(NamedTuple):
    """Nodes (..., N+1, 3), frame a: position m where forces act; half m by which they move on
    either side of it over a step of dt (...) s, None = at an instant; velocity m/s and spin rad/s
    there, absolute, None = at rest. by: derivatives by the nodes' moves, see `loads`, and by
    `ROTATION` of the last axes' spin, where that is not the moves' own; secant (...), see
    `LoadPoint`; axes (..., N+1, 3, 3) of the nodes before and after a step, at an instant once,
    None = nothing reads them.
    """

    position: Tensor
    half: Tensor | None
    velocity: Tensor | None
    spin: Tensor | None
    dt: Tensor | None
    by: Callable[[], dict[str, Tensor]]
    secant: Tensor | None = None
    axes: tuple[Tensor, ...] | None = None


class NoTouching(Tree):
    """None: balances and tangents are those of all else alone."""

    present = False
    lossy = False
    reads: frozenset[str] = frozenset()

    def loaded(self, nodes: Tensor, motion: Callable[[], TouchingMotion]) -> Tensor:
        """The nodes' balances (..., nodes, w), with the forces of these."""
        return nodes

    def matrix(self, matrix: Any, motion: Callable[[], TouchingMotion]) -> Any:
        """Their tangent, with that of these."""
        return matrix

    def damping(self, matrix: Any, position: Tensor, axes: Tensor) -> Any:
        """A damping matrix, None = none, with that of these at rest, nodes at (..., N+1, 3), with
        axes (..., N+1, 3, 3).
        """
        return matrix

    def work(self, motion: Callable[[], TouchingMotion]) -> Tensor | float:
        """(...) J over a step."""
        return 0.0

    def near_enough(self, motion: Callable[[], TouchingMotion]) -> Tensor | None:
        """(...) bool: whether beams may touch each other over the step; None = there are none."""
        return None

    def passed(self, motion: Callable[[], TouchingMotion]) -> Tensor | None:
        """(...) bool: whether beams pass through each other over the step; None = there are
        none.
        """
        return None
