"""Essential boundary conditions: constrained degrees of freedom, and restriction of vectors and
matrices to the free ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..core.remembered import remembered
from ..scene.scene import Scene
from ..topology.protocols import MatrixRows, Topology, Unknowns
from .coordinates.spatial import Spatial


@dataclass(frozen=True)
class Constraints:
    """Supports of nodes, constants of a scene.

    nodes  of the supports
    fixed  (K, w) 1 where a support holds, 0 elsewhere
    moving (N+1, w) bool: what is free; unknowns: the same as the topology has them
    slide  (N+1, p) and turn (N+1, 1): 0 where a support holds the position, or all rotation, else 1
    hinges (node, axis) of those that hold some of the rotations: a mask (3,) of the axis of frame a
    that is left
    """

    nodes: tuple[int, ...]
    fixed: Tensor
    moving: Tensor
    unknowns: Unknowns
    slide: Tensor
    turn: Tensor
    hinges: tuple[tuple[int, Tensor], ...]

    @classmethod
    def of(cls, scene: Scene, space: Spatial, topology: Topology) -> Constraints:
        rows = tuple(
            (int(support.node), tuple(map(float, space.constrained(support.held))))
            for support in scene.supports
        )
        like = scene.beam.nodes
        return remembered(
            cls._of, rows, space.dims.position, space.unknowns, topology, like.dtype, like.device
        )

    @classmethod
    def _of(
        cls,
        rows: tuple[tuple[int, tuple[float, ...]], ...],
        p: int,
        w: int,
        topology: Topology,
        dtype: torch.dtype,
        device: torch.device,
    ) -> Constraints:
        """rows: of each support its node and `fixed`; p of a node's w unknowns are of position."""
        nodes = tuple(node for node, _ in rows)
        fixed = torch.tensor([row for _, row in rows], dtype=dtype, device=device).reshape(
            len(rows), w
        )
        free = torch.ones(topology.node_count, w, dtype=dtype, device=device)
        free[list(nodes)] = 1 - fixed
        slide, turn = free[:, :p], free[:, p:].amax(-1, keepdim=True)
        about = [(node, 1 - row[p:]) for node, row in zip(nodes, fixed, strict=True)]
        hinges = tuple((node, axis) for node, axis in about if 0 < axis.sum() < w - p)
        return cls(nodes, fixed, free > 0, topology.unknowns(free > 0, free), slide, turn, hinges)

    @property
    def count(self) -> int:
        """How many unknowns there are."""
        return int(self.moving.sum())

    def reaction(self, rows: MatrixRows, balance: Tensor, move: Tensor) -> Tensor:
        """(..., K, w): the balance (..., N+1, w) at the supports after the moves (..., N+1, w)."""
        if not self.nodes:
            return balance[..., :0, :]
        at = torch.stack([balance[..., i, :] for i in self.nodes], -2)
        return self.fixed * (at + rows.times(move))
