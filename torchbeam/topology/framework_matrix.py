"""Matrix of a framework: blocks on the diagonal, between the nodes of an element, and of ties."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..math.block_tridiagonal import BlockChain
from ..math.concrete import concrete
from ..math.shapes import broadcast_shapes
from .framework_system import FrameworkSystem
from .framework_unknowns import FrameworkUnknowns, masked
from .midside_nodes import condensed
from .places import Places, added, even, index, take


@dataclass(frozen=True)
class FrameworkMatrix:
    """See `protocols.Matrix`. diagonal (..., nodes, w, w); couplings, none where nodes have nothing
    in common: upper and lower (..., links, w, w), from each node of an element to the next one and
    back; of order 2 also far upper and far lower (..., N, w, w), from an element's first node to
    its third and back; tied (..., n, w, w): of all pairs of the rows of each tie, see
    `Framework.tied`, None = there are none.

    held (J, w): vectors have J rows behind those of the nodes, of multipliers, or constraints, of
    which those are there where it is 1, else 0; None = there are no such rows.
    """

    framework: Any
    diagonal: Tensor
    couplings: tuple[Tensor, ...] = ()
    tied: Tensor | None = None
    held: Tensor | None = None

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        return self.diagonal, *self.couplings, *(() if self.tied is None else (self.tied,))

    def __add__(self, other: FrameworkMatrix) -> FrameworkMatrix:
        couplings = self.couplings or other.couplings
        if self.couplings and other.couplings:
            couplings = tuple([a + b for a, b in zip(self.couplings, other.couplings, strict=True)])
        whole = replace(self, diagonal=self.diagonal + other.diagonal, couplings=couplings)
        if other.tied is None:
            return whole
        return whole.tied_too(other.framework.ties, other.tied, other.held)

    def tied_too(
        self, ties: tuple[tuple[int, ...], ...], blocks: Tensor, held: Tensor | None = None
    ) -> FrameworkMatrix:
        """With more ties, of these rows: blocks (..., n, w, w) of all pairs of each."""
        if self.tied is not None:
            ties, every = (*self.framework.ties, *ties), (self.tied, blocks)
            shape = broadcast_shapes(*(x.shape[:-3] for x in every))
            blocks = torch.cat([x.expand(*shape, *x.shape[-3:]) for x in every], -3)
        framework, held = _with_ties(self.framework, ties), self.held if held is None else held
        return replace(self, framework=framework, tied=blocks, held=held)

    def plus(self, blocks: Tensor) -> FrameworkMatrix:
        return replace(self, diagonal=self.diagonal + blocks)

    def minus(self, blocks: Tensor) -> FrameworkMatrix:
        return replace(self, diagonal=self.diagonal - blocks)

    def each(self, function: Callable[[Tensor], Tensor]) -> FrameworkMatrix:
        return FrameworkMatrix(
            self.framework, function(self.diagonal), tuple(map(function, self.couplings))
        )

    def between(
        self, function: Callable[..., Tensor], rows: Tensor, columns: Tensor
    ) -> FrameworkMatrix:
        couplings = ()
        if self.couplings:
            at, by = self.framework.coupled(rows, 2)[0], self.framework.coupled(columns, 2)[1]
            couplings = tuple(map(function, self.couplings, at, by))
        return FrameworkMatrix(self.framework, function(self.diagonal, rows, columns), couplings)

    def times(self, x: Tensor) -> Tensor:
        of = self.framework
        nodes = x.narrow(-2, 0, of.node_count)
        y = (self.diagonal @ nodes[..., None])[..., 0]
        if self.couplings:
            parts = zip(self.couplings, of.coupled(nodes)[1], strict=True)
            ahead, behind, *far = ((A @ column[..., None])[..., 0] for A, column in parts)
            y = y + of.links.scatter((ahead, behind))
            if far:
                y = y + of.scatter((far[0], torch.zeros_like(far[0]), far[1]))
        if self.tied is not None:
            rows, columns = of.tied
            y = y if self.held is None else pad(y, (0, 0, 0, len(self.held)))
            push = (self.tied @ take(x, columns)[..., None])[..., 0]
            y = added(y, rows, push, y.shape[-2], 1)
        return y

    def dense(self) -> Tensor:
        """Of the nodes."""
        nodes = tuple(range(self.framework.node_count))
        parts = [(self.diagonal, nodes, nodes)]
        pairs = zip(self.couplings, self.framework.pairs, strict=False)
        parts += [(A, *pair) for A, pair in pairs]
        if self.tied is not None:
            at, *pair = _tied_at(self.framework, False)
            parts.append((take(self.tied, at, 2), *pair))
        return dense_of(len(nodes), len(nodes), parts)

    def constraints(self) -> Tensor:
        """(..., m, w nodes): of those that are held, of which there are m, by the nodes' moves."""
        at, *pair = _tied_at(self.framework, True)
        blocks = take(self.tied, at, 2), *pair
        whole = dense_of(len(self.held), self.framework.node_count, [blocks])
        return whole.index_select(-2, self.held.flatten().nonzero()[:, 0])

    @property
    def yields(self) -> bool:
        """Whether a constraint reads its own force, or another's."""
        n, pairs = self.framework.node_count, enumerate(zip(*self.framework.tied, strict=True))
        at_forces = [(k, i - n) for k, (i, j) in pairs if i >= n and j >= n]
        at, rows = zip(*at_forces, strict=True)
        blocks = take(self.tied, at, 2) * self.held[list(rows)][:, :, None]
        return bool(concrete(blocks.detach() != 0).any())

    def rows(self, nodes: tuple[int, ...]) -> FrameworkRows:
        if self.tied is not None:
            return FrameworkRows(nodes, None, self)
        parts, blocks = [], self.tensors
        for places, columns in _row_places(self.framework, nodes, bool(self.couplings)):
            row = torch.broadcast_tensors(*[blocks[k][..., n, :, :] for k, n in places])
            parts.append((torch.cat(row, -1), columns))
        return FrameworkRows(nodes, tuple(parts), None)

    def grouped(self, unknowns: FrameworkUnknowns, held: float) -> BlockChain | None:
        """Where it is one line, in which nothing is tied: of nodes, or of order 2 of
        groups of an end and the midside node before it, of which the first has none.
        """
        if not self.framework.is_line or self.tied is not None:
            return None
        size = held * self.diagonal.diagonal(dim1=-2, dim2=-1).abs().amax((-1, -2))[..., None, None]
        D, *couplings = self.diagonal, *self._couplings()
        if unknowns.free is not None:
            D, *couplings = masked(self.framework, unknowns.mask, D, *couplings, held=size)
        if len(unknowns) < unknowns.nodes:
            couplings = [x.narrow(-3, unknowns.first, len(unknowns) - 1) for x in couplings]
        D = unknowns.of_nodes(D, 2)
        if not self.framework.midside:
            return BlockChain(D, *couplings)
        return _paired(size, D, *couplings)

    def _couplings(self) -> tuple[Tensor, ...]:
        """Zeros where there are none."""
        if self.couplings:
            return self.couplings
        of, none = self.framework, torch.zeros_like(self.diagonal[..., :1, :, :])
        counts = [of.links.element_count] * 2 + [of.element_count] * 2 * (of.order - 1)
        return tuple([none.expand(*none.shape[:-3], n, *none.shape[-2:]) for n in counts])

    def restricted(self, unknowns: FrameworkUnknowns) -> FrameworkSystem:
        of, D, couplings = self.framework, self.diagonal, self._couplings()
        cut, tied = of.cut_without(unknowns.held, unknowns.fixed), self.tied
        if unknowns.partial or cut.holds(unknowns.held):
            free = unknowns.mask
            D, *couplings = masked(of, free, D, *couplings)
            if tied is not None:
                if self.held is not None:
                    free = torch.cat((free, torch.ones_like(self.held)))
                rows, columns = (take(free, side)[..., None] for side in of.tied)
                tied = tied * rows * columns.mT
        midside = None
        if of.midside:
            D, *couplings, midside = condensed(of, D, *couplings)
        return FrameworkSystem(of, unknowns, cut, D, *couplings, midside, tied, self.held)


@lru_cache(maxsize=64)
def _tied_at(framework: Any, behind: bool) -> tuple[tuple[int, ...], ...]:
    """Which of the ties' blocks are by moves of nodes, of balances of nodes, or of the rows
    `behind` them; the rows and columns there.
    """
    n, pairs = framework.node_count, enumerate(zip(*framework.tied, strict=True))
    there = [(k, i - n * behind, j) for k, (i, j) in pairs if j < n and (i >= n) == behind]
    return tuple(zip(*there, strict=True))


@lru_cache(maxsize=64)
def _with_ties(framework: Any, ties: tuple[tuple[int, ...], ...]) -> Any:
    return framework if framework.ties == ties else replace(framework, ties=ties)


def _paired(size: Tensor, D: Tensor, U: Tensor, L: Tensor, *far: Tensor) -> BlockChain:
    """See `FrameworkMatrix.grouped`; size (..., 1, 1): on the diagonal of what is not there."""
    batch = broadcast_shapes(*(x.shape[:-3] for x in (D, U, L, *far)))
    D, U, L, *far = (x.expand(*batch, *x.shape[-3:]) for x in (D, U, L, *far))
    eye = torch.eye(D.shape[-1], dtype=D.dtype, device=D.device)
    none = torch.zeros_like(D[..., :1, :, :])
    middle, ahead, back = (
        torch.cat((first, x[..., 1::2, :, :]), -3)
        for first, x in ((none + size[..., None] * eye, D), (none, U), (none, L))
    )
    upper = torch.cat((U[..., ::2, :, :], far[0]), -1)
    lower = torch.cat((L[..., ::2, :, :], far[1]), -2)
    above, below = torch.cat((middle, ahead), -1), torch.cat((back, D[..., ::2, :, :]), -1)
    return BlockChain(
        torch.cat((above, below), -2),
        torch.cat((torch.zeros_like(upper), upper), -2),
        torch.cat((torch.zeros_like(lower), lower), -1),
    )


class FrameworkRows(NamedTuple):
    """See `protocols.MatrixRows`. parts: of each node its row's blocks (w, m w), and of which m
    nodes they are; None = those of the matrix, which ties have a part in.
    """

    nodes: tuple[int, ...]
    parts: tuple[tuple[Tensor, Places], ...] | None
    matrix: FrameworkMatrix | None

    def times(self, x: Tensor) -> Tensor:
        if self.parts is None:
            return take(self.matrix.times(x), self.nodes)
        rows = [row @ take(x, columns).flatten(-2)[..., None] for row, columns in self.parts]
        shape = *x.shape[:-2], 0, x.shape[-1]
        return torch.cat(torch.broadcast_tensors(*rows), -1).mT if rows else x.new_zeros(shape)

    def detach(self) -> FrameworkRows:
        if self.parts is not None:
            parts = tuple([(row.detach(), columns) for row, columns in self.parts])
            return self._replace(parts=parts)
        A = self.matrix
        couplings, tied = tuple([x.detach() for x in A.couplings]), A.tied
        tied = None if tied is None else tied.detach()
        matrix = FrameworkMatrix(A.framework, A.diagonal.detach(), couplings, tied, A.held)
        return self._replace(matrix=matrix)


@lru_cache(maxsize=64)
def _row_places(
    framework: Any, nodes: tuple[int, ...], coupled: bool
) -> tuple[tuple[tuple[tuple[int, int], ...], Places], ...]:
    """Of rows of a matrix without ties: the numbers and the places of their blocks, see
    `FrameworkMatrix.tensors`, and the nodes of their columns.
    """
    there: dict[int, list[tuple[int, int, int]]] = {node: [(node, 0, node)] for node in nodes}
    for k, (rows, columns) in enumerate(framework.pairs if coupled else (), 1):
        for place, (row, column) in enumerate(zip(rows, columns, strict=True)):
            if row in there:
                there[row].append((column, k, place))
    return tuple(
        (tuple(at[1:] for at in sorted(there[node])), even(at[0] for at in sorted(there[node])))
        for node in nodes
    )


def dense_of(
    rows: int, columns: int, parts: list[tuple[Tensor, tuple[int, ...], tuple[int, ...]]]
) -> Tensor:
    """(..., w rows, w columns) of blocks (..., K, w, w), each with the places of its rows and
    columns, added up.
    """
    shape, total = broadcast_shapes(*(blocks.shape[:-3] for blocks, *_ in parts)), None
    w = parts[0][0].shape[-1]
    for blocks, row, column in parts:
        at = index(tuple(r * columns + c for r, c in zip(row, column, strict=True)), blocks.device)
        total = blocks.new_zeros(*shape, rows * columns, w, w) if total is None else total
        total = total.index_add(-3, at, blocks.expand(*shape, *blocks.shape[-3:]))
    return total.unflatten(-3, (rows, columns)).transpose(-3, -2).flatten(-4, -3).flatten(-2)
