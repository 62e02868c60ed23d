"""System of a framework: the runs of nodes between interface nodes are eliminated, and a small
dense system is left, of the interface's moves and the joints' forces.

With A the block tridiagonal matrix of a run, c_l and c_r its couplings to the interface nodes l and
r before and after it,

    A x + c_l x_l + c_r x_r = y      ->      x = A^-1 y - A^-1 c_l x_l - A^-1 c_r x_r

which goes into the rows of l and r. Runs of the same length are eliminated side by side. The dense
system is solved with exchange of rows: it does not ask whether joints make trees or loops.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..math.block_tridiagonal import (
    block_tridiagonal_columns,
    finite_pivots,
    in_unit,
    positive_definite,
    recorded,
)
from ..math.first_derivative import first_only
from ..math.shapes import broadcast_shapes
from .cut import Cut, Run, places
from .framework_midside import FrameworkMidside, condensed
from .framework_unknowns import FrameworkUnknowns


@dataclass(frozen=True)
class FrameworkSystem:
    """See `protocols.System`. Of the elements' end nodes: D (..., n, w, w), up and down
    (..., N, w, w) from an element's first end to its last and back; joints: `JointBlocks`, tied
    (..., n, w, w) of ties, None = there are none.
    """

    framework: Any
    unknowns: FrameworkUnknowns
    D: Tensor
    up: Tensor
    down: Tensor
    joints: Any | None
    midside: FrameworkMidside | None = None
    tied: Tensor | None = None

    @classmethod
    def of(
        cls,
        framework: Any,
        unknowns: FrameworkUnknowns,
        D: Tensor,
        couplings: tuple[Tensor, ...],
        joints: Any | None,
        tied: Tensor | None = None,
    ) -> FrameworkSystem:
        if framework.order == 1:
            return cls(framework, unknowns, D, *couplings, joints, tied=tied)
        D, up, down, midside = condensed(framework, D, *couplings)
        return cls(framework, unknowns, D, up, down, joints, midside, tied)

    @property
    def cut(self) -> Cut:
        return self.framework.cut

    @property
    def _parts(self) -> tuple[Tensor | None, ...]:
        """As `solve` and `condense` take them."""
        joints = (None,) * 4 if self.joints is None else self.joints
        return self.D, self.up, self.down, *joints, self.tied

    def solve(self, b: Tensor, constant: bool = True) -> Tensor:
        """b (..., nodes + J, w): with joints, behind the nodes what their constraints are to change
        by; their forces then.
        """
        nodes, forces = b.split(
            (self.framework.node_count, b.shape[-2] - self.framework.node_count), -2
        )
        nodes, own = self.unknowns.select(nodes), None
        if self.midside is not None:
            nodes, own = self.midside.condense(nodes)
        b = torch.cat((nodes, forces.expand(*nodes.shape[:-2], *forces.shape[-2:])), -2)
        n = nodes.shape[-2]
        x = (
            FrameworkSolve.apply(self.cut, b, *self._parts)
            if constant and recorded()
            else solve(self.cut, b, *self._parts)
        )
        if self.midside is None:
            return x
        return torch.cat((self.midside.restore(x[..., :n, :], own), x[..., n:, :]), -2)

    def pivots(self, unit: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Of midside nodes, of the runs, and of the interface where joints leave it free."""
        pivots, sound = [], torch.ones((), dtype=torch.bool, device=self.D.device)
        matrices = [_chain(runs, self.D, self.up, self.down) for runs in self.cut.runs]
        interface = self._free_interface(unit)
        for k, matrix in enumerate((*matrices, *interface)):
            blocks, well = finite_pivots(*matrix)
            own = unit if k < len(matrices) else None
            pivots.append(in_unit(blocks.flatten(-4, -3), own))
            sound = sound & well.all(-1)
        if self.midside is not None:
            first = torch.isfinite(self.midside.D)
            pivots.insert(0, in_unit(torch.where(first, self.midside.D, 0.0), unit))
            sound = sound & first.all(-1).all(-1).all(-1)
        shape = broadcast_shapes(*(x.shape[:-3] for x in pivots))
        return torch.cat([x.expand(*shape, *x.shape[-3:]) for x in pivots], -3), sound

    def positive_definite(self) -> Tensor:
        matrices = [_chain(runs, self.D, self.up, self.down) for runs in self.cut.runs]
        well = [
            positive_definite(*matrix).all(-1) for matrix in (*matrices, *self._free_interface())
        ]
        if self.midside is not None:
            well.append(
                (torch.linalg.cholesky_ex(self.midside.D + self.midside.D.mT).info == 0).all(-1)
            )
        return torch.stack(torch.broadcast_tensors(*well)).all(0)

    def _free_interface(self, unit: Tensor | None = None) -> list[tuple[Tensor, Tensor, Tensor]]:
        """The pivots of the interface's matrix Z^T K Z, of the moves Z, measured in `unit`, that
        independent constraints leave, as those of a chain (D, L, U) without couplings; none where
        there is no interface.
        """
        how, w = self.cut, self.D.shape[-1]
        if not how.interface:
            return []
        dense, n = condense(how, None, *self._parts)[0].dense(), len(how.interface) * w
        # a run is singular: so is this
        dense = torch.where(torch.isfinite(dense).all(-1).all(-1)[..., None, None], dense, 0.0)
        K, G = dense[..., :n, :n], dense[..., n:, :n]
        if unit is not None:
            own = unit.repeat(*(1,) * (unit.ndim - 1), len(how.interface))
            K, G = own[..., :, None] * K * own[..., None, :], G * own[..., None, :]
        if how.joints:
            Z = torch.linalg.svd(G).Vh[..., int(self.joints.held.sum()) :, :].mT
            K = Z.mT @ K @ Z
        more = -K.shape[-1] % w if K.shape[-1] else w
        K = pad(K, (0, more, 0, more)) + torch.diag_embed(
            pad(K.new_zeros(K.shape[-1]), (0, more), value=1.0)
        )
        return [_block_pivots(K, w)]

    def detach(self) -> FrameworkSystem:
        joints = (
            None if self.joints is None else type(self.joints)(*(x.detach() for x in self.joints))
        )
        midside = None if self.midside is None else self.midside.detach()
        tied = None if self.tied is None else self.tied.detach()
        own = (x.detach() for x in (self.D, self.up, self.down))
        return FrameworkSystem(self.framework, self.unknowns, *own, joints, midside, tied)


class FrameworkSolve(torch.autograd.Function):
    """`solve` with a matrix that is a constant, in the right-hand side; see `ChainSolve`."""

    generate_vmap_rule = True

    @staticmethod
    def forward(how: Cut, b: Tensor, *parts: Tensor) -> Tensor:
        return solve(how, b, *parts)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
        how, b, *parts = inputs
        ctx.how = how
        ctx.save_for_backward(b, *parts)
        ctx.save_for_forward(b, *parts)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Any:
        b, *parts = ctx.saved_tensors
        with torch.no_grad(), torch.autocast(grad.device.type, enabled=False):
            g = solve(ctx.how, grad, *transposed(ctx.how, *parts)).sum_to_size(b.shape)
        return None, first_only(g, grad, b), *(None for _ in parts)

    @staticmethod
    def jvp(ctx: Any, _how: None, b_t: Tensor, *_: Any) -> Tensor:
        b, *parts = ctx.saved_tensors
        return first_only(solve(ctx.how, b_t, *parts), b_t, b)


def transposed(
    how: Cut,
    D: Tensor,
    up: Tensor,
    down: Tensor,
    held: Tensor | None,
    stiffness: Tensor | None,
    force: Tensor | None,
    constraint: Tensor | None,
    tied: Tensor | None,
) -> tuple[Tensor | None, ...]:
    """The parts of the transposed matrix."""
    joints = (None,) * 4
    if held is not None:
        joints = held, stiffness.transpose(-4, -3).mT, constraint.mT, force.mT
    if tied is not None:
        tied = tied.index_select(-3, places(how.tied_back, tied.device)).mT
    return D.mT, down.mT, up.mT, *joints, tied


def solve(how: Cut, b: Tensor, *parts: Tensor) -> Tensor:
    """The solution (..., n + J, w)."""
    system, runs = condense(how, b, *parts)
    n, forces = parts[0].shape[-3], len(how.joints)
    x, inner = system.b.new_zeros(*system.b.shape[:-2], n + forces, system.b.shape[-1]), None
    if system.count:
        inner = system.solution()
        x = x.index_copy(-2, places((*how.interface, *range(n, n + forces)), x.device), inner)
    for own, columns in zip(how.runs, runs, strict=True):
        at = tuple(node for run in own for node in run.nodes)
        x = x.index_copy(-2, places(at, x.device), _restored(own, columns, inner).flatten(-3, -2))
    return x


class Interface:
    """The interface's system: blocks and right-hand sides added up at places, then solved. count:
    places; w: their size.
    """

    def __init__(self, count: int, w: int, shape: torch.Size, like: Tensor) -> None:
        self.count = count
        self.blocks, self.b = (
            like.new_zeros(*shape, count * count, w, w),
            like.new_zeros(*shape, count, w),
        )

    def add(self, blocks: Tensor, rows: Any, columns: Any) -> None:
        """(..., K, w, w) at K places."""
        at = tuple(row * self.count + column for row, column in zip(rows, columns, strict=True))
        if at:
            blocks = blocks.expand(*self.blocks.shape[:-3], *blocks.shape[-3:])
            self.blocks = self.blocks.index_add(-3, places(at, blocks.device), blocks)

    def load(self, b: Tensor, rows: Any) -> None:
        """(..., K, w) at K places."""
        self.b = self.b.index_add(
            -2, places(tuple(rows), b.device), b.expand(*self.b.shape[:-2], *b.shape[-2:])
        )

    def dense(self) -> Tensor:
        """(..., count w, count w)"""
        return (
            self.blocks.unflatten(-3, (self.count, self.count))
            .transpose(-3, -2)
            .flatten(-4, -3)
            .flatten(-2)
        )

    def solution(self) -> Tensor:
        """(..., count, w)"""
        return torch.linalg.solve_ex(self.dense(), self.b.flatten(-2)[..., None])[0].unflatten(
            -2, self.b.shape[-2:]
        )[..., 0]


def condense(
    how: Cut,
    b: Tensor | None,
    D: Tensor,
    up: Tensor,
    down: Tensor,
    held: Tensor | None = None,
    stiffness: Tensor | None = None,
    force: Tensor | None = None,
    constraint: Tensor | None = None,
    tied: Tensor | None = None,
) -> tuple[Interface, list[Tensor]]:
    """The interface's system, and of each group of runs A^-1 [y, c_l, c_r]
    (..., runs, n, w, 1 + 2 w). b: None = zeros.
    """
    n, w, J = D.shape[-3], D.shape[-1], len(how.joints)
    shapes = [D.shape[:-3], up.shape[:-3], down.shape[:-3], *(() if b is None else (b.shape[:-2],))]
    if J:
        shapes += [stiffness.shape[:-5], force.shape[:-4], constraint.shape[:-4]]
    if tied is not None:
        shapes.append(tied.shape[:-3])
    shape = broadcast_shapes(*shapes)
    b = D.new_zeros(n + J, w) if b is None else b
    b, D, up, down = (
        b.expand(*shape, *b.shape[-2:]),
        *(x.expand(*shape, *x.shape[-3:]) for x in (D, up, down)),
    )
    system, own = Interface(len(how.interface) + J, w, shape, D), range(len(how.interface))
    if how.interface:
        system.add(D[..., list(how.interface), :, :], own, own)
        system.load(b[..., list(how.interface), :], own)
    if how.direct:
        elements, i, j = (list(x) for x in zip(*how.direct, strict=True))
        system.add(up[..., elements, :, :], i, j)
        system.add(down[..., elements, :, :], j, i)
    if tied is not None:
        system.add(tied, *zip(*how.tied, strict=True))
    columns = [_eliminated(runs, system, b, D, up, down) for runs in how.runs]
    if J:
        _join(how, system, b[..., n:, :], held, stiffness, force, constraint)
    return system, columns


def _chain(
    runs: tuple[Run, ...], D: Tensor, up: Tensor, down: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """D, L, U of runs of the same length (..., runs, n, w, w)."""
    n = runs[0].count
    at, inner = [node for run in runs for node in run.nodes], [e for run in runs for e in run.inner]
    L, U = (x[..., inner, :, :].unflatten(-3, (len(runs), n - 1)) for x in (down, up))
    return D[..., at, :, :].unflatten(-3, (len(runs), n)), L, U


def _eliminated(
    runs: tuple[Run, ...], system: Interface, b: Tensor, D: Tensor, up: Tensor, down: Tensor
) -> Tensor:
    """A^-1 [y, c_l, c_r], whose share is taken from the interface's system."""
    A, L, U = _chain(runs, D, up, down)
    w = A.shape[-1]
    before = [None if run.before is None else run.element for run in runs]
    after = [None if run.after is None else run.element + run.count for run in runs]
    c_l, c_r = _picked(down, before), _picked(up, after)
    none = torch.zeros_like(A[..., 1:, :, :])
    y = b[..., [node for run in runs for node in run.nodes], :].unflatten(-2, A.shape[-4:-2])
    right = (
        y[..., None],
        torch.cat((c_l[..., None, :, :], none), -3),
        torch.cat((none, c_r[..., None, :, :]), -3),
    )
    columns = block_tridiagonal_columns(A, L, U, torch.cat(right, -1))
    sides = {
        "before": (_picked(up, before), columns[..., 0, :, :]),
        "after": (_picked(down, after), columns[..., -1, :, :]),
    }
    for side, (row, column) in sides.items():
        there = [k for k, run in enumerate(runs) if getattr(run, side) is not None]
        if there:
            push = -(row @ column)
            system.load(push[..., there, :, 0], [getattr(runs[k], side) for k in there])
            for other, block in (("before", push[..., 1 : w + 1]), ("after", push[..., w + 1 :])):
                some = [k for k in there if getattr(runs[k], other) is not None]
                system.add(
                    block[..., some, :, :],
                    *([getattr(runs[k], name) for k in some] for name in (side, other)),
                )
    return columns


def _restored(runs: tuple[Run, ...], columns: Tensor, interface: Tensor | None) -> Tensor:
    """x (..., runs, n, w), from A^-1 [y, c_l, c_r] and the interface's solution (..., count, w)."""
    x, *by = columns.split((1, *(columns.shape[-2],) * 2), -1)
    for column, side in zip(by, ("before", "after"), strict=True):
        # where there is none, the column is zero
        if any(getattr(run, side) is not None for run in runs):
            ends = interface[..., [getattr(run, side) or 0 for run in runs], :]
            x = x - column @ ends[..., None, :, None]
    return x[..., 0]


def _picked(x: Tensor, elements: list[int | None]) -> Tensor:
    """Blocks (..., K, w, w) of elements, zero where there is none."""
    there = torch.tensor([e is not None for e in elements], device=x.device)
    return torch.where(there[:, None, None], x[..., [e or 0 for e in elements], :, :], 0.0)


def _join(
    how: Cut,
    system: Interface,
    b: Tensor,
    held: Tensor,
    stiffness: Tensor,
    force: Tensor,
    constraint: Tensor,
) -> None:
    """What joints add to the interface's system. Forces that a joint has not are zero."""
    rows = range(len(how.interface), system.count)
    for i in (0, 1):
        there = [k for k, pair in enumerate(how.joints) if pair[i] is not None]
        ends, own = [how.joints[k][i] for k in there], [rows[k] for k in there]
        system.add(force[..., there, i, :, :], ends, own)
        system.add(constraint[..., there, i, :, :], own, ends)
        for j in (0, 1):
            both = [k for k in there if how.joints[k][j] is not None]
            system.add(
                stiffness[..., both, i, j, :, :],
                *([how.joints[k][end] for k in both] for end in (i, j)),
            )
    system.add(torch.diag_embed(1 - held), rows, rows)
    system.load(b * held, rows)


def _block_pivots(K: Tensor, w: int) -> tuple[Tensor, Tensor, Tensor]:
    """Pivot blocks (..., 1, n, w, w) of a dense matrix, as a chain without couplings."""
    pivots = []
    while K.shape[-1]:
        A, B, C = K[..., :w, :w], K[..., :w, w:], K[..., w:, :w]
        pivots.append(A)
        K = K[..., w:, w:] - C @ torch.linalg.solve_ex(A, B)[0]
    D = torch.stack(pivots, -3)[..., None, :, :, :]
    none = torch.zeros_like(D[..., 1:, :, :])
    return D, none, none
