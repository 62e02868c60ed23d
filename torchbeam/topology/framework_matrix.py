"""Matrix of a framework: blocks on the diagonal, between the nodes of an element, of joints and of
ties.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..math.block_chain import BlockChain
from ..math.shapes import broadcast_shapes
from .chain_matrix import ChainMatrix
from .chain_unknowns import ChainUnknowns
from .cut import added, places
from .framework_system import FrameworkSystem
from .framework_unknowns import FrameworkUnknowns


class JointBlocks(NamedTuple):
    """Of J joints, each of two ends, of which one that is the ground has zeros; a joint has as many
    constraints and forces as a node has unknowns, of which it uses those that it holds.

    held        (J, w) 1 where there is a constraint, else 0
    stiffness   (..., J, 2, 2, w, w): the ends' balances by their moves, at fixed joint forces
    force       (..., J, 2, w, w): the ends' balances by the joint forces
    constraint  (..., J, 2, w, w): the constraints by the ends' moves
    """

    held: Tensor
    stiffness: Tensor
    force: Tensor
    constraint: Tensor


@dataclass(frozen=True)
class FrameworkMatrix:
    """See `protocols.Matrix`. diagonal (..., nodes, w, w); couplings (..., elements, w, w) between
    two of an element's nodes i and j, in the order of `itertools.permutations`; none where nodes
    have nothing in common; tied (..., n, w, w): of all pairs of the nodes of each tie, see
    `Framework.tied`, None = there are none.

    With joints, vectors have a row (w) of each joint behind those of the nodes: its forces, or its
    constraints.
    """

    framework: Any
    diagonal: Tensor
    couplings: tuple[Tensor, ...] = ()
    joints: JointBlocks | None = None
    tied: Tensor | None = None

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        joints = () if self.joints is None else self.joints[1:]
        return self.diagonal, *self.couplings, *joints, *(() if self.tied is None else (self.tied,))

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Of an element's nodes, those of the couplings."""
        return tuple(permutations(range(self.framework.order + 1), 2))

    def __add__(self, other: FrameworkMatrix) -> FrameworkMatrix:
        couplings = self.couplings or other.couplings
        if self.couplings and other.couplings:
            couplings = tuple(a + b for a, b in zip(self.couplings, other.couplings, strict=True))
        joints = other.joints if self.joints is None else self.joints
        tied = other if self.tied is None else self
        diagonal = self.diagonal + other.diagonal
        return FrameworkMatrix(tied.framework, diagonal, couplings, joints, tied.tied)

    def joined(self, joints: JointBlocks) -> FrameworkMatrix:
        """With the joints."""
        return replace(self, joints=joints)

    def with_ties(self, tied: Tensor) -> FrameworkMatrix:
        """With the ties."""
        return replace(self, tied=tied)

    def tied_too(self, nodes: tuple[int, ...], blocks: Tensor) -> FrameworkMatrix:
        """With one more tie, of these nodes: blocks (..., n^2, w, w) of all their pairs."""
        ties, every = (nodes,), (blocks,)
        if self.tied is not None:
            ties, every = (*self.framework.ties, nodes), (self.tied, blocks)
        framework = replace(self.framework, ties=ties)
        shape = broadcast_shapes(*(x.shape[:-3] for x in every))
        tied = torch.cat([x.expand(*shape, *x.shape[-3:]) for x in every], -3)
        return replace(self, framework=framework, tied=tied)

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
            at, by = self.framework.gather(rows, 2), self.framework.gather(columns, 2)
            couplings = tuple(
                function(A, at[i], by[j])
                for A, (i, j) in zip(self.couplings, self.pairs, strict=True)
            )
        return FrameworkMatrix(self.framework, function(self.diagonal, rows, columns), couplings)

    def times(self, x: Tensor) -> Tensor:
        nodes = x.narrow(-2, 0, self.framework.node_count)
        y = (self.diagonal @ nodes[..., None])[..., 0]
        if self.couplings:
            ends = self.framework.gather(nodes)
            parts: list[Any] = [0.0] * len(ends)
            for A, (i, j) in zip(self.couplings, self.pairs, strict=True):
                parts[i] = parts[i] + (A @ ends[j][..., None])[..., 0]
            y = y + self.framework.scatter(tuple(parts))
        if self.tied is not None:
            rows, columns = zip(*self.framework.tied, strict=True)
            moves = nodes.index_select(-2, places(columns, x.device))
            y = added(y, rows, (self.tied @ moves[..., None])[..., 0], y.shape[-2], 1)
        return y if self.joints is None else self._with_joints(x, y)

    def _with_joints(self, x: Tensor, y: Tensor) -> Tensor:
        _, stiffness, force, constraint = self.joints
        ends = self.framework.at_joints(x)  # (..., J, 2, w)
        forces = x.narrow(-2, self.framework.node_count, len(self.framework.joints))
        push = (
            torch.einsum("...abij,...bj->...ai", stiffness, ends)
            + (force @ forces[..., None, :, None])[..., 0]
        )
        closed = (constraint @ ends[..., None])[..., 0].sum(-2)
        y = self.framework.from_joints(push, y)
        return torch.cat((y, closed.expand(*y.shape[:-2], *closed.shape[-2:])), -2)

    def dense(self) -> Tensor:
        """Of the nodes, with the joints' stiffness."""
        nodes, ends = tuple(range(self.framework.node_count)), self.framework.elements
        parts = [(self.diagonal, nodes, nodes)]
        parts += [
            (A, ends[i], ends[j]) for A, (i, j) in zip(self.couplings, self.pairs, strict=False)
        ]
        if self.tied is not None:
            parts.append((self.tied, *zip(*self.framework.tied, strict=True)))
        for i, j in product((0, 1), (0, 1)) if self.joints is not None else ():
            there = [
                k
                for k, pair in enumerate(self.framework.joints)
                if pair[i] is not None and pair[j] is not None
            ]
            rows, columns = (tuple(self.framework.joints[k][end] for k in there) for end in (i, j))
            parts.append((self.joints.stiffness[..., there, i, j, :, :], rows, columns))
        return _dense(len(nodes), len(nodes), parts)

    def constraints(self) -> Tensor:
        """(..., m, w nodes): those of the joints, of which there are m, by the nodes' moves."""
        parts = []
        for i in (0, 1):
            there = [k for k, pair in enumerate(self.framework.joints) if pair[i] is not None]
            columns = tuple(self.framework.joints[k][i] for k in there)
            parts.append((self.joints.constraint[..., there, i, :, :], tuple(there), columns))
        whole = _dense(len(self.framework.joints), self.framework.node_count, parts)
        return whole.index_select(-2, self.joints.held.flatten().nonzero()[:, 0])

    def rows(self, nodes: tuple[int, ...]) -> FrameworkRows:
        return FrameworkRows(self, nodes)

    def grouped(self, unknowns: FrameworkUnknowns, held: float) -> BlockChain | None:
        """As that of a chain where it is one: a line of elements of order 1, in order, in which
        nothing is joined or tied.
        """
        count, ends = self.framework.node_count, self.framework.elements
        line = tuple(tuple(range(k, count - 1 + k)) for k in (0, 1))
        if tuple(map(tuple, ends)) != line or self.joints is not None or self.tied is not None:
            return None
        chain = ChainUnknowns(1, count, 0, count, unknowns.moving, unknowns.free)
        return ChainMatrix(1, self.diagonal, self.couplings).grouped(chain, held)

    def restricted(self, unknowns: FrameworkUnknowns) -> FrameworkSystem:
        D, couplings, joints, tied = self.diagonal, self.couplings, self.joints, self.tied
        if not couplings:
            none = torch.zeros_like(D[..., :1, :, :]).expand(
                *D.shape[:-3], self.framework.element_count, *D.shape[-2:]
            )
            couplings = (none,) * len(self.pairs)
        if unknowns.free is not None:
            free = unknowns.free[..., None]
            ends = self.framework.gather(free, 2)
            D = D * free * free.mT + torch.diag_embed(1 - unknowns.free)
            couplings = tuple(
                A * ends[i] * ends[j].mT for A, (i, j) in zip(couplings, self.pairs, strict=True)
            )
            if joints is not None:
                at = self.framework.at_joints(unknowns.free)[..., None]  # (J, 2, w, 1)
                joints = JointBlocks(
                    joints.held,
                    joints.stiffness * at[..., :, None, :, :] * at[..., None, :, :, :].mT,
                    joints.force * at,
                    joints.constraint * at.mT,
                )
            if tied is not None:
                own = unknowns.free[..., None]
                rows, columns = (
                    own.index_select(-3, places(side, own.device))
                    for side in zip(*self.framework.tied, strict=True)
                )
                tied = tied * rows * columns.mT
        return FrameworkSystem.of(self.framework, unknowns, D, couplings, joints, tied)


class FrameworkRows(NamedTuple):
    """See `protocols.MatrixRows`."""

    matrix: FrameworkMatrix
    nodes: tuple[int, ...]

    def times(self, x: Tensor) -> Tensor:
        return self.matrix.times(x)[..., list(self.nodes), :]

    def detach(self) -> FrameworkRows:
        matrix = self.matrix
        joints = (
            matrix.joints
            if matrix.joints is None
            else JointBlocks(*(x.detach() for x in matrix.joints))
        )
        couplings = tuple(A.detach() for A in matrix.couplings)
        return FrameworkRows(
            FrameworkMatrix(
                matrix.framework,
                matrix.diagonal.detach(),
                couplings,
                joints,
                None if matrix.tied is None else matrix.tied.detach(),
            ),
            self.nodes,
        )


def _dense(
    rows: int, columns: int, parts: list[tuple[Tensor, tuple[int, ...], tuple[int, ...]]]
) -> Tensor:
    """(..., w rows, w columns) of blocks (..., K, w, w), each with the places of its rows and
    columns, added up.
    """
    shape, total = broadcast_shapes(*(blocks.shape[:-3] for blocks, *_ in parts)), None
    w = parts[0][0].shape[-1]
    for blocks, row, column in parts:
        at = places(tuple(r * columns + c for r, c in zip(row, column, strict=True)), blocks.device)
        total = blocks.new_zeros(*shape, rows * columns, w, w) if total is None else total
        total = total.index_add(-3, at, blocks.expand(*shape, *blocks.shape[-3:]))
    return total.unflatten(-3, (rows, columns)).transpose(-3, -2).flatten(-4, -3).flatten(-2)
