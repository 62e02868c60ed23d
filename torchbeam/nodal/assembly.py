"""Assembly: from nodes to the stations of elements, and from these back to nodes. Which nodes an
element has is the topology's to say; how its motion follows from theirs, its interpolation's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from ..topology.protocols import Matrix, Topology


@dataclass(frozen=True)
class Assembly:
    """interpolation: `LinearInterpolation`, or `QuadraticInterpolation`; p: numbers of a node's
    position. Stations are as many as elements, or, of order 2, twice as many.
    """

    topology: Topology
    interpolation: Any
    p: int

    def ends(self, x: Tensor, axes: int = 1) -> tuple[Tensor, ...]:
        """Nodes (..., nodes, *) -> their values (..., stations, *) at the nodes of each station."""
        return self.interpolation.at_stations(self.topology.gather(x, axes), axes)

    def poses(self, position: Tensor, rotation: Tensor) -> Any:
        """Positions and rotations of all nodes -> those of the nodes of each station."""
        return self.interpolation.poses(*self.ends(position), *self.ends(rotation))

    def shared(self, parts: tuple[Tensor, ...], axes: int = 1) -> Tensor:
        """What stations stand for, as seen by each of their nodes (..., stations, *), at the nodes
        (..., nodes, *).
        """
        return self.topology.scatter(self.interpolation.shares(parts, axes), axes)

    def to_elements(self, moves: Tensor) -> Tensor:
        """Moves of the nodes (..., nodes, w) -> numbers of the stations (..., stations, m), see the
        interpolation.
        """
        return self.interpolation.numbers(self.topology.gather(moves), self.p)

    def to_nodes(self, load: Tensor) -> Tensor:
        """What does work on these numbers (..., stations, m) -> summed at nodes (..., nodes, w)."""
        return self.topology.scatter(self.interpolation.loads(load, self.p))

    def to_matrix(self, Y: Tensor) -> Matrix:
        """Its derivative by these numbers (..., stations, m, m) -> by the nodes' moves."""
        return self.topology.matrix(self.interpolation.blocks(Y, self.p))
