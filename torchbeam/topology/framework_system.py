"""System of a framework: chains are cut at the nodes that joints sit at, the runs of nodes between these are eliminated, and a
small dense system of the interface is left: of those nodes, single ones, and the forces of joints.

A run of nodes a .. b between the interface nodes l and r, with its block tridiagonal matrix A, D_l the balance of l:

    A x + c_l x_l + c_r x_r = y        D_l x_l + u_l x_a + ... = y_l        ->      (D_l - u_l (A^-1 c_l)_a) x_l - ... = y_l - u_l (A^-1 y)_a

Runs of the same length are eliminated side by side.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..math.block_tridiagonal import block_tridiagonal_columns, recorded
from ..math.first_derivative import first_only
from ..math.shapes import broadcast_shapes
from .framework_unknowns import FrameworkUnknowns


class Run(NamedTuple):
    """Nodes between two of the interface: the first of them, how many, the interface's places of the nodes before and after
    (None = the chain ends), and the first element, which is before the first node unless the chain begins there.
    """

    first: int
    count: int
    before: int | None
    after: int | None
    element: int


class Cut(NamedTuple):
    """How a framework, of order 1, is cut. interface: nodes; runs: by their length; direct: elements between two of the
    interface, with their places; joints: places of their ends, None = the ground.
    """

    interface: tuple[int, ...]
    runs: tuple[tuple[Run, ...], ...]
    direct: tuple[tuple[int, int, int], ...]
    joints: tuple[tuple[int | None, int | None], ...]


@lru_cache(maxsize=64)
def cut(chains: tuple[int, ...], singles: int, joints: tuple[tuple[int | None, int | None], ...]) -> Cut:
    """Of chains of so many elements, joined at these nodes."""
    total = sum(N + 1 for N in chains)
    joined = {node for pair in joints for node in pair if node is not None}
    interface = tuple(sorted(joined | set(range(total, total + singles))))
    place = {node: k for k, node in enumerate(interface)}
    runs, direct, start = [], [], 0
    for k, N in enumerate(chains):
        stops = [start - 1, *(node for node in interface if start <= node <= start + N), start + N + 1]
        for before, after in zip(stops, stops[1:], strict=False):
            first, count, element = before + 1, after - before - 1, before - k
            if count:
                runs.append(Run(first, count, place.get(before) if before >= start else None,
                                place.get(after) if after <= start + N else None, element))
            elif start <= before and after <= start + N:
                direct.append((element, place[before], place[after]))
        start += N + 1
    lengths = sorted({run.count for run in runs})
    ends = tuple(tuple(None if node is None else place[node] for node in pair) for pair in joints)
    return Cut(interface, tuple(tuple(run for run in runs if run.count == n) for n in lengths), tuple(direct), ends)


@dataclass(frozen=True)
class FrameworkSystem:
    """See `protocols.System`. Of the elements' end nodes: D (..., n, w, w), up and down (..., N, w, w) from an element's first
    node to its last and back; joints: `JointBlocks`, None = there are none.
    """

    framework: Any
    unknowns: FrameworkUnknowns
    D: Tensor
    up: Tensor
    down: Tensor
    joints: Any | None
    midside: Any | None = None

    @classmethod
    def of(cls, framework: Any, unknowns: FrameworkUnknowns, D: Tensor, couplings: tuple[Tensor, ...], joints: Any | None
           ) -> FrameworkSystem:
        if framework.order == 1:
            return cls(framework, unknowns, D, *couplings, joints)
        raise NotImplementedError

    @property
    def cut(self) -> Cut:
        return cut(self.framework.chains, self.framework.singles, self.framework.joints)

    def solve(self, b: Tensor, constant: bool = True) -> Tensor:
        """b (..., nodes + J, w): where there are joints, with what their constraints are to change by."""
        nodes = self.framework.node_count
        b = torch.cat((self.unknowns.select(b[..., :nodes, :]), b[..., nodes:, :]), -2) if self.joints else self.unknowns.select(b)
        parts = self.D, self.up, self.down, *(() if self.joints is None else self.joints)
        if constant and recorded():
            return FrameworkSolve.apply(self.cut, b, *parts)
        return solve(self.cut, b, *parts)

    def detach(self) -> FrameworkSystem:
        joints = None if self.joints is None else type(self.joints)(*(x.detach() for x in self.joints))
        return FrameworkSystem(self.framework, self.unknowns, self.D.detach(), self.up.detach(), self.down.detach(), joints)


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
            g = solve(ctx.how, grad, *transposed(*parts)).sum_to_size(b.shape)
        return None, first_only(g, grad, b), *(None for _ in parts)

    @staticmethod
    def jvp(ctx: Any, _how: None, b_t: Tensor, *_: Any) -> Tensor:
        b, *parts = ctx.saved_tensors
        return first_only(solve(ctx.how, b_t, *parts), b_t, b)


def transposed(D: Tensor, up: Tensor, down: Tensor, *joints: Tensor) -> tuple[Tensor, ...]:
    """The parts of the transposed matrix."""
    if not joints:
        return D.mT, down.mT, up.mT
    held, stiffness, force, constraint = joints
    return D.mT, down.mT, up.mT, held, stiffness.transpose(-4, -3).mT, constraint.mT, force.mT


def solve(how: Cut, b: Tensor, D: Tensor, up: Tensor, down: Tensor, held: Tensor | None = None,
          stiffness: Tensor | None = None, force: Tensor | None = None, constraint: Tensor | None = None) -> Tensor:
    """The solution (..., n + J, w)."""
    w, n = D.shape[-1], D.shape[-3]
    blocks = (x for x in (D, up, down) )
    shape = broadcast_shapes(b.shape[:-2], D.shape[:-3], up.shape[:-3],
                             *(() if held is None else (stiffness.shape[:-5], force.shape[:-4], constraint.shape[:-4])))
    D, up, down = (x.expand(*shape, *x.shape[-3:]) for x in (D, up, down))
    b = b.expand(*shape, *b.shape[-2:])
    system = Interface(len(how.interface) + len(how.joints), w, shape, D)
    if how.interface:
        system.add(D[..., list(how.interface), :, :], range(len(how.interface)), range(len(how.interface)))
        system.load(b[..., list(how.interface), :], range(len(how.interface)))
    if how.direct:
        elements, i, j = (list(x) for x in zip(*how.direct, strict=True))
        system.add(up[..., elements, :, :], i, j)
        system.add(down[..., elements, :, :], j, i)
    done = [eliminated(runs, system, b, D, up, down) for runs in how.runs]
    if how.joints:
        _joints(how, system, b[..., n:, :], held, stiffness, force, constraint)
    x = b.new_zeros(*shape, n + len(how.joints), w)
    if len(how.interface) + len(how.joints):
        inner = system.solution()
        x = x.index_copy(-2, torch.tensor([*how.interface, *range(n, n + len(how.joints))], device=x.device), inner)
    else:
        inner = None
    for runs, columns in zip(how.runs, done, strict=True):
        at = [node for run in runs for node in range(run.first, run.first + run.count)]
        x = x.index_copy(-2, torch.tensor(at, device=x.device), restored(runs, columns, inner).flatten(-3, -2))
    return x


class Interface:
    """The dense system of the interface: blocks added up, then solved."""

    def __init__(self, rows: int, w: int, shape: torch.Size, like: Tensor) -> None:
        self.rows, self.w = rows, w
        self.blocks, self.at, self.right, self.right_at = [], [], [], []
        self.matrix = like.new_zeros(*shape, rows * rows, w, w)
        self.b = like.new_zeros(*shape, rows, w)

    def add(self, blocks: Tensor, rows: Any, columns: Any) -> None:
        """(..., K, w, w) at K places."""
        at = torch.tensor([r * self.rows + c for r, c in zip(rows, columns, strict=True)], device=blocks.device)
        self.matrix = self.matrix.index_add(-3, at, blocks.expand(*self.matrix.shape[:-3], *blocks.shape[-3:]))

    def load(self, b: Tensor, rows: Any) -> None:
        """(..., K, w) at K places."""
        self.b = self.b.index_add(-2, torch.tensor(list(rows), device=b.device), b.expand(*self.b.shape[:-2], *b.shape[-2:]))

    def solution(self) -> Tensor:
        """(..., rows, w)"""
        A = self.matrix.unflatten(-3, (self.rows, self.rows)).transpose(-3, -2).flatten(-4, -3).flatten(-2)
        return torch.linalg.solve_ex(A, self.b.flatten(-2)[..., None])[0].view(self.b.shape)


def eliminated(runs: tuple[Run, ...], system: Interface, b: Tensor, D: Tensor, up: Tensor, down: Tensor) -> Tensor:
    """A^-1 [y, c_l, c_r] (..., runs, n, w, 1 + 2 w), whose share is taken from the interface's system."""
    n, w = runs[0].count, D.shape[-1]
    at = [node for run in runs for node in range(run.first, run.first + n)]
    inner = [run.element + 1 + k for run in runs for k in range(n - 1)]
    A, right = D[..., at, :, :].unflatten(-3, (-1, n)), b[..., at, :].unflatten(-2, (-1, n))
    U, L = (x[..., inner, :, :].unflatten(-3, (len(runs), n - 1)) for x in (up, down))
    zero = torch.zeros_like(A[..., :1, 0, :, :])
    left = _picked(down, zero, [run.element if run.before is not None else None for run in runs])
    last = _picked(up, zero, [run.element + n if run.after is not None else None for run in runs])
    from_left = _picked(up, zero, [run.element if run.before is not None else None for run in runs])
    from_right = _picked(down, zero, [run.element + n if run.after is not None else None for run in runs])
    none = torch.zeros_like(A)
    c_l, c_r = none.clone(), none.clone()
    c_l = torch.cat((left[..., None, :, :], none[..., 1:, :, :]), -3)
    c_r = torch.cat((none[..., 1:, :, :], last[..., None, :, :]), -3)
    found = block_tridiagonal_columns(A, L, U, torch.cat((right[..., None], c_l, c_r), -1))
    for rows, places, column in ((from_left, [run.before for run in runs], found[..., 0, :, :]),
                                 (from_right, [run.after for run in runs], found[..., -1, :, :])):
        there = [k for k, place in enumerate(places) if place is not None]
        if not there:
            continue
        push = -(rows[..., there, :, :] @ column[..., there, :, :])
        own = [places[k] for k in there]
        system.load(push[..., 0], own)
        for side, block in (("before", push[..., 1:w + 1]), ("after", push[..., w + 1:])):
            some = [k for k, run in enumerate(there) if getattr(runs[run], side) is not None]
            if some:
                system.add(block[..., some, :, :], [own[k] for k in some], [getattr(runs[there[k]], side) for k in some])
    return found


def restored(runs: tuple[Run, ...], columns: Tensor, interface: Tensor | None) -> Tensor:
    """x (..., runs, n, w) of runs, from what `eliminated` has left, and the interface's solution (..., rows, w)."""
    w = columns.shape[-2]
    x, by_left, by_right = columns.split((1, w, w), -1)
    for by, side in ((by_left, "before"), (by_right, "after")):
        if any(getattr(run, side) is not None for run in runs):  # columns of a run that ends there are zero
            ends = interface[..., [getattr(run, side) or 0 for run in runs], :]
            x = x - by @ ends[..., None, :, None]
    return x[..., 0]


def _picked(x: Tensor, zero: Tensor, elements: list[int | None]) -> Tensor:
    """Blocks (..., K, w, w) of elements, zero where there is none."""
    found = x[..., [0 if e is None else e for e in elements], :, :]
    if all(e is not None for e in elements):
        return found
    there = torch.tensor([e is not None for e in elements], device=x.device)[:, None, None]
    return torch.where(there, found, zero)


def _joints(how: Cut, system: Interface, b: Tensor, held: Tensor, stiffness: Tensor, force: Tensor, constraint: Tensor) -> None:
    rows = range(len(how.interface), len(how.interface) + len(how.joints))
    for i in (0, 1):
        there = [k for k, pair in enumerate(how.joints) if pair[i] is not None]
        if not there:
            continue
        own, own_rows = [how.joints[k][i] for k in there], [rows[k] for k in there]
        system.add(force[..., there, i, :, :], own, own_rows)
        system.add(constraint[..., there, i, :, :], own_rows, own)
        for j in (0, 1):
            both = [k for k in there if how.joints[k][j] is not None]
            if both:
                system.add(stiffness[..., both, i, j, :, :], [how.joints[k][i] for k in both], [how.joints[k][j] for k in both])
    system.add(torch.diag_embed(1 - held), rows, rows)
    system.load(b * held, rows)
