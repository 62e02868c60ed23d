"""Essential boundary conditions: constrained degrees of freedom, and restriction of vectors and matrices to the free ones."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..scene.scene import Scene
from . import assembly, quadratic_assembly
from .coordinates.spatial import Space


@dataclass(frozen=True)
class Constraints:
    """Supports of a chain of nodes, constants of a scene.

    nodes  of the supports
    first  the first node with unknowns: a clamp at node 0 leaves none there
    fixed  (K, w) 1 where a support holds, 0 elsewhere
    moving (N+1, w) bool: the unknowns
    free   (N+1-first, w) 1 where a node is free, 0 where it is held; None = all are free
    slide  (N+1, p) and turn (N+1, 1): 0 where a support holds the position, or all rotation, else 1
    hinges (node, axis) of those that hold some of the rotations: a mask (3,) of the axis of frame a that is left
    """

    nodes: tuple[int, ...]
    first: int
    fixed: Tensor
    moving: Tensor
    free: Tensor | None
    slide: Tensor
    turn: Tensor
    hinges: tuple[tuple[int, Tensor], ...]

    @classmethod
    def of(cls, scene: Scene, space: Space) -> Constraints:
        like = scene.beam.nodes
        rows = [space.constrained(s.held) for s in scene.supports]
        fixed = torch.tensor(rows, dtype=like.dtype, device=like.device).reshape(len(rows), space.unknowns)
        nodes = tuple(s.node for s in scene.supports)
        first = int(0 in nodes and all(rows[nodes.index(0)]))
        free = torch.ones(scene.beam.count + 1, space.unknowns, dtype=like.dtype, device=like.device)
        free[list(nodes)] = 1 - fixed
        slide, turn = free[:, :space.position], free[:, space.position:].amax(-1, keepdim=True)
        about = [(node, 1 - row[space.position:]) for node, row in zip(nodes, fixed, strict=True)]
        hinges = tuple((node, axis) for node, axis in about if 0 < axis.sum() < space.spin)
        return cls(nodes, first, fixed, free > 0, free[first:] if len(nodes) > first else None, slide, turn, hinges)

    @property
    def count(self) -> int:
        """How many unknowns there are."""
        return int(self.moving.sum())

    def unknown(self, x: Tensor) -> Tensor:
        """(..., N+1, w) of all nodes -> of those with unknowns, zero where held."""
        x = x[..., self.first:, :]
        return x if self.free is None else x * self.free

    def matrix(self, D: Tensor, L: Tensor, U: Tensor, *far: Tensor) -> tuple[Tensor, ...]:
        """Blocks of all nodes -> of those with unknowns; what is held has a 1 on the diagonal and nothing beside it. With parts
        `far`, see `masked`, of all nodes, those without unknowns too.
        """
        if far:
            return masked(self.moving.to(D), D, L, U, *far)
        D, L, U = (x[..., self.first:, :, :] for x in (D, L, U))
        return (D, L, U) if self.free is None else masked(self.free, D, L, U)

    def rows(self, D: Tensor, L: Tensor, U: Tensor, *far: Tensor) -> Tensor:
        """(..., K, w, 3 w): the rows of the supports' nodes, by the moves of the node before, the node and the next; with parts
        `far` (upper, lower) (..., K, w, 5 w), by those of the two nodes before and after.
        """
        parts = []
        for i in self.nodes:
            zero = torch.zeros_like(D[..., i, :, :])
            before = L[..., i - 1, :, :] if i > 0 else zero
            after = U[..., i, :, :] if i < D.shape[-3] - 1 else zero
            row = before, D[..., i, :, :], after
            if far:
                own, last = i % 2 == 0, D.shape[-3] - 1
                row = (far[1][..., i // 2 - 1, :, :] if own and i > 0 else zero, *row,
                       far[0][..., i // 2, :, :] if own and i < last else zero)
            parts.append(torch.cat(torch.broadcast_tensors(*row), -1))
        return torch.stack(parts, -3) if parts else D.new_zeros(*D.shape[:-3], 0, D.shape[-1], (5 if far else 3) * D.shape[-1])

    def reaction(self, rows: Tensor, balance: Tensor, move: Tensor) -> Tensor:
        """(..., K, w): the balance (..., N+1, w) at the supports after the moves (..., N+1, w)."""
        if not self.nodes:
            return balance[..., :0, :]
        reach = rows.shape[-1] // (2 * move.shape[-1])
        wide = torch.nn.functional.pad(move, (0, 0, reach, reach))
        near = torch.stack([wide[..., i:i + 2 * reach + 1, :].flatten(-2) for i in self.nodes], -2)
        at = torch.stack([balance[..., i, :] for i in self.nodes], -2)
        return self.fixed * (at + (rows @ near[..., None])[..., 0])


def masked(free: Tensor, D: Tensor, L: Tensor, U: Tensor, *far: Tensor) -> tuple[Tensor, ...]:
    """A chain's matrix, `far` its parts (upper, lower) between the ends of elements of three nodes if it has any, with a 1 on
    the diagonal and nothing beside it where `free` (N+1, w) is 0.
    """
    rows, columns = (quadratic_assembly if far else assembly).coupled(free)
    U, L, *far = (x * row[..., None] * column[..., None, :] for x, row, column in zip((U, L, *far), rows, columns, strict=True))
    return D * free[..., None] * free[..., None, :] + torch.diag_embed(1 - free), L, U, *far
