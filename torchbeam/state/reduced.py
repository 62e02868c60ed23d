"""Reduced states: in the coordinates in which they were solved for, public as far as they are asked for."""

from __future__ import annotations

from typing import Any, NamedTuple

from torch import Tensor

from ..core.leaves import with_values
from .instant import Point, Reaction

AT_NODES = ("position", "rotation", "velocity", "spin")


class ReducedStates(NamedTuple):
    """States (time first) in the coordinates of a space (see `torchbeam.nodal.coordinates`): of a plane they are half the
    numbers, and of the tip a few.
    """

    state: Any
    space: Any

    def public(self) -> Any:
        """All of them."""
        return self.space.to_public(self.state)

    def node(self, index: int) -> Point:
        """As `State.node`."""
        nodes = self.state.position.shape[-2]
        if not -nodes <= index < nodes:
            raise IndexError(f"node {index} was asked for; the beam has the nodes 0 to {nodes - 1}")
        at = slice(index % nodes, index % nodes + 1)
        return self._part(dict.fromkeys(AT_NODES, at), at).node(0)

    @property
    def nodes(self) -> Tensor:
        """(..., N+1, 3) m, frame a."""
        return self._part({"position": slice(None)}).position

    @property
    def root(self) -> Reaction:
        """As `State.root`."""
        return self._part({"reaction": slice(None)}).root

    @property
    def status(self) -> Tensor:
        return self.state.status

    def _part(self, rows: dict[str, slice], nodes: slice = slice(0)) -> Any:
        """With these rows of these fields, and none of the others."""
        cut = {name: getattr(self.state, name)[..., rows.get(name, slice(0)), :] for name in (*AT_NODES, "stress", "reaction")}
        return self.space.of_nodes(nodes).to_public(with_values(self.state, **cut))
