"""Rows of a beam: how many nodes, elements and stations there are, and which of them are meant; a
`Structure` has several parts among them.
"""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from torch import Tensor

from ..core.leaves import Tree, batch_shapes
from ..core.validation import shown
from ..math.shapes import broadcast_shapes
from .parts import Part, Span


class BeamRows(Tree):
    """What the fields of a `Beam` say of its rows.

    parts   beams and bodies by their names; none in a scene of one beam
    masses  of the bodies, on their nodes
    joined  pairs of rows that joints connect
    """

    parts: ClassVar[tuple[Part, ...]] = ()
    masses: ClassVar[tuple[Any, ...]] = ()
    joined: ClassVar[tuple[Any, ...]] = ()

    @property
    def node_count(self) -> int:
        """The number of nodes."""
        return self.nodes.shape[-2]

    @property
    def station_count(self) -> int:
        """The number of stations of stress, of intervals between neighbouring nodes: N order."""
        return self.length.shape[-1]

    @property
    def element_count(self) -> int:
        """N, the number of elements."""
        return self.station_count // self.order

    @property
    def extent(self) -> Tensor:
        """(...) m, the size by which lengths and rotations are judged: the beam's length."""
        return self.length.sum(-1)

    @property
    def stress_count(self) -> int:
        """How many rows a state's stress has: of stations and, behind them, of joints' forces."""
        return self.station_count + len(self.joined)

    @property
    def batch_shape(self) -> torch.Size:
        return broadcast_shapes(*batch_shapes(self))

    def row(self, node: Any, name: str = "node") -> int:
        """A node's row. Raises ValueError where there is none such."""
        N = self.node_count - 1
        if isinstance(node, (str, tuple)):
            raise ValueError(
                f"{name} = {shown(node)} was given in a scene of one beam, which has no names; 0 "
                f"to {N} is wanted"
            )
        if not -(N + 1) <= node <= N:
            raise ValueError(
                f"{name} = {node} was given for a beam with the nodes 0 to {N}; -1 is the tip"
            )
        return node

    def named(self, on: str | None, effect: Any) -> None:
        """ValueError where an effect acts on a part that there is none of."""
        if on is not None:
            raise ValueError(
                f"{effect.called} with on = {shown(on)} was given in a scene of one beam, which "
                "has no names; on = None is wanted"
            )

    def spans(self, effect: Any) -> tuple[Span, ...] | None:
        """The rows along which an effect acts, in one piece or several; None = along all."""
        return None

    def rows_along(self, effect: Any) -> int:
        """How many nodes an effect along the beam acts on."""
        return sum(span.nodes.stop - span.nodes.start for span in self._spans(effect))

    def element_counts(self, effect: Any) -> list[int]:
        """The numbers of elements of the pieces along which an effect acts."""
        return [span.element_count for span in self._spans(effect)]

    def _spans(self, effect: Any) -> tuple[Span, ...]:
        nodes, spans = slice(0, self.node_count), self.spans(effect)
        whole = Span(nodes, slice(0, self.station_count), self.element_count)
        return (whole,) if spans is None else spans

    def at_stations(self, x: Tensor, axes: int) -> Tensor:
        """Values of elements, (..., N or 1, *) with `axes` axes of their own, at their stations."""
        alike = self.element_count == self.station_count or x.shape[-1 - axes] == 1
        return x if alike else x.repeat_interleave(self.order, -1 - axes)
