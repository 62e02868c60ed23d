"""System of a chain: its matrix restricted to what is free, block tridiagonal over the nodes; of
order 2 over the ends of the elements, with their midside nodes condensed.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..math.block_tridiagonal import (
    ChainSolve,
    block_tridiagonal,
    finite_pivots,
    in_unit,
    positive_definite,
    recorded,
)
from .chain_unknowns import ChainUnknowns
from .midside import Midside


class ChainSystem(NamedTuple):
    """See `protocols.System`. D (..., n, w, w) on the diagonal, L below and U above it
    (..., n - 1, w, w).
    """

    unknowns: ChainUnknowns
    D: Tensor
    L: Tensor
    U: Tensor
    midside: Midside | None = None

    def solve(self, b: Tensor, constant: bool = True) -> Tensor:
        solve = ChainSolve.apply if constant and recorded() else block_tridiagonal
        b = self.unknowns.select(b)
        if self.midside is None:
            return self.unknowns.whole(solve(self.D, self.L, self.U, b))
        right, own = self.midside.condense(b)
        return self.midside.restore(solve(self.D, self.L, self.U, right), own)

    def pivots(self, unit: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Those of midside nodes first."""
        blocks, sound = finite_pivots(self.D, self.L, self.U)
        if self.midside is None:
            return in_unit(blocks, unit), sound
        first = torch.isfinite(self.midside.D)
        middle = torch.where(first, self.midside.D, 0.0)
        blocks = torch.cat((middle.expand(*blocks.shape[:-3], *middle.shape[-3:]), blocks), -3)
        return in_unit(blocks, unit), sound & first.all(-1).all(-1).all(-1)

    def positive_definite(self) -> Tensor:
        definite = positive_definite(self.D, self.L, self.U)
        if self.midside is None:
            return definite
        return definite & (
            torch.linalg.cholesky_ex(self.midside.D + self.midside.D.mT).info == 0
        ).all(-1)

    def detach(self) -> ChainSystem:
        midside = None if self.midside is None else self.midside.detach()
        return ChainSystem(self.unknowns, *(x.detach() for x in self[1:4]), midside)
