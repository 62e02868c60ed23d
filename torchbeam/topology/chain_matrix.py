"""Matrix of a chain: blocks on its diagonal and between the nodes of an element."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import zip_longest
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..math.block_chain import BlockChain
from ..math.shapes import broadcast_shapes
from .chain_sums import at_i, at_j, spread
from .chain_system import ChainSystem
from .chain_unknowns import ChainUnknowns, coupled
from .midside import condensed


@dataclass(frozen=True)
class ChainMatrix:
    """See `protocols.Matrix`. diagonal (..., nodes, w, w); couplings, none where nodes have nothing
    in common: upper and lower (..., nodes - 1, w, w), from a node to the next and back; of order 2
    also far upper and far lower (..., N, w, w), from an element's first node to its third and back.
    """

    order: int
    diagonal: Tensor
    couplings: tuple[Tensor, ...] = ()

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        return self.diagonal, *self.couplings

    def __add__(self, other: ChainMatrix) -> ChainMatrix:
        pairs = zip_longest(self.couplings, other.couplings)
        couplings = tuple(a if b is None else b if a is None else a + b for a, b in pairs)
        return ChainMatrix(self.order, self.diagonal + other.diagonal, couplings)

    def plus(self, blocks: Tensor) -> ChainMatrix:
        return ChainMatrix(self.order, self.diagonal + blocks, self.couplings)

    def minus(self, blocks: Tensor) -> ChainMatrix:
        return ChainMatrix(self.order, self.diagonal - blocks, self.couplings)

    def each(self, function: Callable[[Tensor], Tensor]) -> ChainMatrix:
        return ChainMatrix(
            self.order, function(self.diagonal), tuple(map(function, self.couplings))
        )

    def between(
        self, function: Callable[..., Tensor], rows: Tensor, columns: Tensor
    ) -> ChainMatrix:
        couplings = ()
        if self.couplings:
            pairs = coupled(self.order, rows, 2)[0], coupled(self.order, columns, 2)[1]
            couplings = tuple(map(function, self.couplings, *pairs))
        return ChainMatrix(self.order, function(self.diagonal, rows, columns), couplings)

    def times(self, x: Tensor) -> Tensor:
        product = (self.diagonal @ x[..., None])[..., 0]
        if not self.couplings:
            return product
        parts = zip(self.couplings, coupled(self.order, x)[1], strict=True)
        ahead, behind, *far = ((A @ column[..., None])[..., 0] for A, column in parts)
        product = product + at_i(ahead) + at_j(behind)
        return product + spread(far[0], torch.zeros_like(far[0]), far[1]) if far else product

    def dense(self) -> Tensor:
        nodes, w = self.diagonal.shape[-3:-1]
        shape = broadcast_shapes(*(x.shape[:-3] for x in self.tensors))
        A = self.diagonal.new_zeros(*shape, nodes, nodes, w, w)
        at = torch.arange(nodes, device=A.device)
        rows, columns = coupled(self.order, at, 0)
        for block, row, column in zip(self.tensors, (at, *rows), (at, *columns), strict=False):
            A[..., row, column, :, :] = block.expand(*shape, len(row), w, w)
        return A.transpose(-3, -2).flatten(-4, -3).flatten(-2)

    def rows(self, nodes: tuple[int, ...]) -> ChainRows:
        D, (U, L, *far), parts = self.diagonal, self._couplings(), []
        for i in nodes:
            zero = torch.zeros_like(D[..., i, :, :])
            before = L[..., i - 1, :, :] if i > 0 else zero
            after = U[..., i, :, :] if i < D.shape[-3] - 1 else zero
            row = before, D[..., i, :, :], after
            if far:
                own, last = i % 2 == 0, D.shape[-3] - 1
                row = (
                    far[1][..., i // 2 - 1, :, :] if own and i > 0 else zero,
                    *row,
                    far[0][..., i // 2, :, :] if own and i < last else zero,
                )
            parts.append(torch.cat(torch.broadcast_tensors(*row), -1))
        return ChainRows(nodes, torch.stack(parts, -3)) if parts else ChainRows((), D.new_zeros(0))

    def grouped(self, unknowns: ChainUnknowns, held: float) -> BlockChain:
        """Of order 2, of groups of an end and the midside node before it, of which the first has
        none.
        """
        size = held * self.diagonal.diagonal(dim1=-2, dim2=-1).abs().amax((-1, -2))[..., None, None]
        D, U, L, *far = unknowns.masked(self.diagonal, *self._couplings(), held=size)
        if not far:
            return BlockChain(D, U, L)
        batch = broadcast_shapes(*(x.shape[:-3] for x in (D, U, L, *far)))
        D, U, L, *far = (x.expand(*batch, *x.shape[-3:]) for x in (D, U, L, *far))
        eye = torch.eye(D.shape[-1], dtype=D.dtype, device=D.device)
        none = torch.zeros_like(D[..., :1, :, :])
        middle, ahead, back = (
            torch.cat(both, -3)
            for both in (
                (none + size[..., None] * eye, D[..., 1::2, :, :]),
                (none, U[..., 1::2, :, :]),
                (none, L[..., 1::2, :, :]),
            )
        )
        upper = torch.cat((U[..., ::2, :, :], far[0]), -1)
        lower = torch.cat((L[..., ::2, :, :], far[1]), -2)
        return BlockChain(
            blocks(middle, ahead, back, D[..., ::2, :, :]),
            torch.cat((torch.zeros_like(upper), upper), -2),
            torch.cat((torch.zeros_like(lower), lower), -1),
        )

    def restricted(self, unknowns: ChainUnknowns) -> ChainSystem:
        D, U, L, *far = unknowns.masked(self.diagonal, *self._couplings())
        if not far:
            return ChainSystem(unknowns, D, L, U)
        return ChainSystem(unknowns, *condensed(D, L, U, *far))

    def _couplings(self) -> tuple[Tensor, ...]:
        """Zeros where there are none."""
        if self.couplings:
            return self.couplings
        near = torch.zeros_like(self.diagonal[..., 1:, :, :])
        return (
            (near, near)
            if self.order == 1
            else (near, near, near[..., ::2, :, :], near[..., ::2, :, :])
        )


def blocks(a: Tensor, b: Tensor, c: Tensor, d: Tensor) -> Tensor:
    """[a, b; c, d]"""
    a, b, c, d = torch.broadcast_tensors(a, b, c, d)
    return torch.cat((torch.cat((a, b), -1), torch.cat((c, d), -1)), -2)


class ChainRows(NamedTuple):
    """Rows of some nodes (..., K, w, m w), by the moves of the node before, the node and the next;
    of order 2 by those of the two nodes before and after.
    """

    nodes: tuple[int, ...]
    blocks: Tensor

    def times(self, x: Tensor) -> Tensor:
        reach = self.blocks.shape[-1] // (2 * x.shape[-1])
        wide = pad(x, (0, 0, reach, reach))
        near = torch.stack(
            [wide[..., i : i + 2 * reach + 1, :].flatten(-2) for i in self.nodes], -2
        )
        return (self.blocks @ near[..., None])[..., 0]

    def detach(self) -> ChainRows:
        return ChainRows(self.nodes, self.blocks.detach())
