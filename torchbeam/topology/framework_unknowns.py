"""Unknowns of a framework: what supports leave free, and how its matrix is restricted to that."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad


@dataclass(frozen=True)
class FrameworkUnknowns:
    """See `protocols.Unknowns`. Of order 1, nodes at either end of a line that are held whole have
    none, one of a line apart.

    nodes    how many there are; of them, those from `first` to `last` (excluded) are not all held
             whole
    held     those that have no unknowns
    fixed    of those inside no element which supports hold, wholly or in part
    moving   (n, w) bool: what is free of the nodes from first to last
    free     the same as numbers, None = all is
    mask     (nodes, w) of all nodes, None = all is free
    partial  whether something is held of nodes that have unknowns
    """

    order: int
    nodes: int
    first: int
    last: int
    held: tuple[int, ...]
    fixed: tuple[int, ...]
    moving: Tensor
    free: Tensor | None
    mask: Tensor | None
    partial: bool

    @classmethod
    def of(cls, framework: Any, moving: Tensor, like: Tensor) -> FrameworkUnknowns:
        """See `protocols.Topology.unknowns`."""
        nodes, held = framework.node_count, []
        if not framework.midside:
            some = moving.any(-1).tolist()
            joined = {*framework.cut.interface}
            fixed = [not some[k] and k not in joined for k in range(nodes)]
            for start, N in zip(framework.starts, framework.chains, strict=True):
                before = [*takewhile(fixed.__getitem__, range(start, start + N))]
                after = range(start + N, start + len(before), -1)
                held += (*before, *takewhile(fixed.__getitem__, after))
        kept = [k for k in range(nodes) if k not in held]
        first, last = kept[0], kept[-1] + 1
        whole, inside, free = bool(moving.all()), moving[first:last], moving.all(-1).tolist()
        return cls(
            framework.order,
            nodes,
            first,
            last,
            tuple(held),
            tuple(k for k, node in enumerate(framework.ends) if not free[node]),
            inside,
            None if whole or bool(inside.all()) else inside.to(like),
            None if whole else moving.to(like),
            not (whole or bool(moving[kept].all())),
        )

    @property
    def grouped(self) -> Tensor:
        """Which of the numbers of a vector of `FrameworkMatrix.grouped` are free moves, a mask."""
        return pad(self.moving, (0, 0, self.order - 1, 0)).flatten()

    def __len__(self) -> int:
        return self.last - self.first

    def of_nodes(self, x: Tensor, axes: int = 1) -> Tensor:
        """All nodes (..., nodes, *) -> those from first to last."""
        return x if len(self) == self.nodes else x.narrow(-1 - axes, self.first, len(self))

    def select(self, x: Tensor) -> Tensor:
        x = self.of_nodes(x)
        return x if self.free is None else x * self.free


def masked(
    framework: Any, free: Tensor, D: Tensor, *couplings: Tensor, held: Tensor | None = None
) -> tuple[Tensor, ...]:
    """A matrix's blocks with `held` (..., 1, 1), None = 1, on the diagonal and nothing beside it
    where `free` (nodes, w) is 0.
    """
    rows, columns = framework.coupled(free)
    others = (
        x * row[..., None] * column[..., None, :]
        for x, row, column in zip(couplings, rows, columns, strict=False)
    )
    return D * free[..., None] * free[..., None, :] + torch.diag_embed(
        1 - free if held is None else held * (1 - free)
    ), *others
