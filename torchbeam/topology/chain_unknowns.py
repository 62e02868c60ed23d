"""Unknowns of a chain: what supports leave free, and how its matrix is restricted to that."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..math.quadratic import threes


@dataclass(frozen=True)
class ChainUnknowns:
    """Of the nodes from `first` to `last` (excluded): of order 1, nodes at either end that are held
    whole have none.

    moving  (n, w) bool: what is free of them; free: the same as numbers, None = all is
    """

    order: int
    nodes: int
    first: int
    last: int
    moving: Tensor
    free: Tensor | None

    @classmethod
    def of(cls, chain: Any, moving: Tensor, like: Tensor) -> ChainUnknowns:
        """See `protocols.Topology.unknowns`."""
        nodes, first, last = chain.node_count, 0, chain.node_count
        if chain.order == 1:
            some = moving.any(-1).tolist()
            first = next((k for k in range(nodes) if some[k]), nodes - 1)
            last = next((k for k in range(nodes, first, -1) if some[k - 1]), first + 1)
        inside = moving[first:last]
        return cls(
            chain.order, nodes, first, last, inside, None if bool(inside.all()) else inside.to(like)
        )

    @property
    def grouped(self) -> Tensor:
        """Which of the numbers of a vector of `ChainMatrix.symmetric` are free moves, a mask."""
        return pad(self.moving, (0, 0, self.order - 1, 0)).flatten()

    def __len__(self) -> int:
        return self.last - self.first

    def of_nodes(self, x: Tensor, axes: int = 1) -> Tensor:
        """All nodes (..., nodes, *) -> those with unknowns."""
        return x if len(self) == self.nodes else x.narrow(-1 - axes, self.first, len(self))

    def select(self, x: Tensor) -> Tensor:
        x = self.of_nodes(x)
        return x if self.free is None else x * self.free

    def whole(self, x: Tensor) -> Tensor:
        """The nodes with unknowns (..., n, w) -> all, zeros in the others."""
        return x if len(self) == self.nodes else pad(x, (0, 0, self.first, self.nodes - self.last))

    def masked(
        self, D: Tensor, *couplings: Tensor, held: Tensor | None = None
    ) -> tuple[Tensor, ...]:
        """Blocks of all nodes -> of those with unknowns; what is held has `held`
        (..., 1, 1), None = 1, on the diagonal and nothing beside it.
        """
        D = self.of_nodes(D, 2)
        if len(self) < self.nodes:
            couplings = tuple(x.narrow(-3, self.first, len(self) - 1) for x in couplings)
        return (
            (D, *couplings)
            if self.free is None
            else masked(self.order, self.free, D, *couplings, held=held)
        )


def masked(
    order: int, free: Tensor, D: Tensor, *couplings: Tensor, held: Tensor | None = None
) -> tuple[Tensor, ...]:
    """A chain's blocks with `held` (..., 1, 1), None = 1, on the diagonal and nothing beside
    it where `free` (nodes, w) is 0.
    """
    rows, columns = coupled(order, free)
    others = (
        x * row[..., None] * column[..., None, :]
        for x, row, column in zip(couplings, rows, columns, strict=False)
    )
    return D * free[..., None] * free[..., None, :] + torch.diag_embed(
        1 - free if held is None else held * (1 - free)
    ), *others


def coupled(order: int, x: Tensor, axes: int = 1) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Nodes (..., nodes, *) -> their values at the rows and at the columns of a chain's couplings,
    see `ChainMatrix`.
    """
    n = x.shape[-1 - axes] - 1
    i, j = x.narrow(-1 - axes, 0, n), x.narrow(-1 - axes, 1, n)
    if order == 1:
        return (i, j), (j, i)
    far_i, _, far_j = threes(x, axes)
    return (i, j, far_i, far_j), (j, i, far_j, far_i)
