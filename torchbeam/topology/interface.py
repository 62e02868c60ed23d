"""System of the interface: of the moves of its nodes and of the multipliers.

A small one is solved densely, with exchange of rows: it does not ask whether ties make trees or
loops. Of a large one most blocks are zero. Its units are eliminated group by group, in the order of
native code (see `order`), rows being exchanged within a group alone; a sample whose solution does
not fulfil its equations to rounding (backward error by rows: Oettli and Prager 1964) is solved
densely.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cached_property, lru_cache
from itertools import chain, combinations, product
from typing import NamedTuple

import torch
from torch import Tensor

from ..math.concrete import concrete, is_vmapped
from ..math.dense import solve_unchecked
from ..math.shapes import broadcast_shapes
from .cut import Cut
from .order import Constraint, Elimination
from .places import index

DENSE = 5e5  # cubes of units, of all samples: up to there a dense system is as quick
EXACT = 1e5  # eps: backward error that is rounding


class Groups(NamedTuple):
    """Groups of as many units, and of as many `near` that they couple to by then, which are
    eliminated side by side: of vectors the numbers of both (groups, units w), of the matrix those
    of their rows, of the columns of the former in the rows of the latter, and of what the latter
    have among themselves (groups, rows, columns).
    """

    own: Tensor
    near: Tensor
    rows: Tensor
    columns: Tensor
    rest: Tensor


class Pattern(NamedTuple):
    """Blocks that are not zero, or become so: the place of each, by its row and column; groups in
    the order of elimination.
    """

    place: dict[tuple[int, int], int]
    groups: tuple[Groups, ...]


@lru_cache(maxsize=64)
def pattern_of(how: Cut, w: int, device: torch.device) -> Pattern:
    """Of an interface with blocks (w, w)."""
    n, units = len(how.interface), len(how.interface) + how.multipliers
    ends = (zip(line.back, line.towards, strict=True) for line in how.lines if line.back)
    together = *how.ties, *(pair for _, *pair in how.direct), *chain.from_iterable(ends)
    couplings = {pair for tie in together for pair in combinations(sorted(tie), 2)}
    held: dict[int, list[int]] = {unit: [] for unit in range(n, units)}
    for node, unit in sorted(couplings):
        if node < n <= unit:
            held[unit].append(node)
    constraints = {unit: _constraint(nodes) for unit, nodes in held.items()}
    order = Elimination(n, units, constraints, couplings)
    groups, _ = order.ordered(how.fixed)
    place, level = {(unit, unit): unit for unit in range(units)}, [0] * units
    alike: dict[tuple[int, int, int], list[tuple[list[int], list[int]]]] = {}
    for group, around in zip(groups, order.around, strict=True):
        now = max(level[unit] for unit in group)
        for unit in around:
            level[unit] = max(level[unit], now + 1)
        alike.setdefault((now, len(group), len(around)), []).append((list(group), sorted(around)))

    def numbers(rows: list[int], columns: list[int]) -> Tensor:
        """Of a matrix (rows w, columns w)."""
        pairs = product(rows, columns)
        at = torch.tensor([place.setdefault(pair, len(place)) for pair in pairs], dtype=torch.long)
        blocks = w * w * at.view(len(rows), 1, len(columns), 1) + torch.arange(w * w).view(w, 1, w)
        return blocks.reshape(len(rows) * w, len(columns) * w)

    def side_by_side(groups: list[tuple[list[int], list[int]]]) -> Groups:
        each = (
            [numbers(group, group + around) for group, around in groups],
            [numbers(around, group) for group, around in groups],
            [numbers(around, around) for _, around in groups],
        )
        units = (torch.tensor(side)[..., None] * w for side in zip(*groups, strict=True))
        parts = [(at + torch.arange(w)).flatten(1).long() for at in units]
        return Groups(*(x.to(device) for x in (*parts, *map(torch.stack, each))))

    return Pattern(place, tuple(side_by_side(alike[key]) for key in sorted(alike)))


def _constraint(nodes: list[int]) -> Constraint:
    """Of a multiplier that couples to these."""
    return Constraint((*nodes, None) if len(nodes) == 1 else tuple(nodes), 1)


class Interface:
    """Blocks and right-hand sides added up at places, then solved. w: a block's size."""

    def __init__(self, how: Cut, w: int) -> None:
        self.how, self.w = how, w
        self.count = len(how.interface) + how.multipliers
        self.blocks: list[Tensor] = []
        self.at: list[tuple[int, int]] = []
        self.loads: list[Tensor] = []
        self.rows: list[int] = []

    def add(self, blocks: Tensor, rows: Iterable[int], columns: Iterable[int]) -> None:
        """(..., K, w, w) at K places."""
        at = list(zip(rows, columns, strict=True))
        if at:
            self.blocks.append(blocks)
            self.at += at

    def load(self, b: Tensor, rows: Iterable[int]) -> None:
        """(..., K, w) at K places."""
        self.loads.append(b)
        self.rows += rows

    def dense(self) -> Tensor:
        """(..., count w, count w)"""
        n = self.count
        at = [row * n + column for row, column in self.at]
        total = _sum(self.blocks, at, n * n, 2).unflatten(-3, (n, n))
        return total.transpose(-3, -2).flatten(-4, -3).flatten(-2)

    def solution(self) -> Tensor:
        """(..., count, w)"""
        b = _sum(self.loads, self.rows, self.count, 1)
        if not self.large:
            return self._densely(b)
        x, exact = self._by_groups(b)
        if concrete(exact).all():
            return x
        return torch.where(exact[..., None, None], x, self._densely(b))

    def definite(self, constraints: int) -> Tensor:
        """(...) bool: whether as many eigenvalues of pivots are negative as there are constraints:
        a symmetric matrix is then positive definite where these leave it free (Haynsworth 1968).
        """
        whole = self._matrix()
        none = whole.new_zeros(*whole.shape[:-3], self.count * self.w)
        _, solved, pivots = self._eliminated(whole, none)
        finite = [torch.where(torch.isfinite(A), A, 0.0) for A in pivots]  # a singular one is not
        values = [torch.linalg.eigvalsh(equilibrated(A + A.mT)).flatten(-2) for A in finite]
        sound = torch.stack([torch.isfinite(x).all(-1).all(-1).all(-1) for x in solved]).all(0)
        return sound & ((torch.cat(values, -1) <= 0).sum(-1) == constraints)

    @property
    def large(self) -> bool:
        """Whether it is quicker not to solve it densely, and what derivatives want leaves that."""
        shape = broadcast_shapes(*(x.shape[:-3] for x in self.blocks))
        return math.prod(shape) * self.count**3 > DENSE and not any(
            x.requires_grad or is_vmapped(x) for x in (*self.loads, *self.blocks)
        )

    def _densely(self, b: Tensor) -> Tensor:
        A, b = self.dense(), b.flatten(-2)
        shape = broadcast_shapes(A.shape[:-2], b.shape[:-1])
        A, b = A.expand(*shape, *A.shape[-2:]), b.expand(*shape, b.shape[-1])
        return solve_unchecked(A, b[..., None]).unflatten(-2, (self.count, self.w))[..., 0]

    def _matrix(self) -> Tensor:
        """(..., blocks, w, w), see `Pattern`."""
        place = self._pattern.place
        return _sum(self.blocks, [place[pair] for pair in self.at], len(place), 2)

    @cached_property
    def _pattern(self) -> Pattern:
        return pattern_of(self.how, self.w, self.blocks[0].device)

    def _eliminated(self, whole: Tensor, b: Tensor) -> tuple[Tensor, list[Tensor], list[Tensor]]:
        """Of b (..., count w) what is left in each group's turn; by groups, side by side, what the
        units near them add to their own, and the right-hand side; and their pivots.
        """
        A, y = whole.flatten(-3).clone(), b.clone()
        solved, pivots = [], []
        for units, near, rows, columns, rest in self._pattern.groups:
            here, right = _at(A, rows), _at(y, units)[..., None]
            k = units.shape[-1]
            pivot, ahead = here[..., :k], here[..., k:]
            ahead = torch.linalg.solve_ex(pivot, torch.cat((ahead, right), -1))[0]
            solved.append(ahead)
            pivots.append(pivot)
            if near.numel():
                change = _at(A, columns) @ ahead
                A.index_add_(-1, rest.flatten(), change[..., :-1].flatten(-3), alpha=-1)
                y.index_add_(-1, near.flatten(), change[..., -1].flatten(-2), alpha=-1)
        return y, solved, pivots

    def _by_groups(self, b: Tensor) -> tuple[Tensor, Tensor]:
        """The solution, and (...) bool: whether it is one to rounding."""
        whole = self._matrix()
        shape = broadcast_shapes(whole.shape[:-3], b.shape[:-2])
        whole, b = whole.expand(*shape, *whole.shape[-3:]), b.expand(*shape, *b.shape[-2:])
        y, solved, _ = self._eliminated(whole, b.flatten(-2))
        for (units, near, *_), ahead in zip(self._pattern.groups[::-1], solved[::-1], strict=True):
            part = ahead[..., -1]
            if near.numel():
                part = part - (ahead[..., :-1] @ _at(y, near)[..., None])[..., 0]
            y.index_copy_(-1, units.flatten(), part.flatten(-2))
        x = y.unflatten(-1, (self.count, self.w))
        return x, self._exact(whole, x, b)

    def _exact(self, A: Tensor, x: Tensor, b: Tensor) -> Tensor:
        """(...) bool: whether A x = b to rounding, of nodes and of multipliers, by positions and by
        rotations, beside the largest of these.
        """
        rows, columns = (
            index(tuple(side), x.device) for side in zip(*self._pattern.place, strict=True)
        )
        of = x.index_select(-2, columns)[..., None]
        residual = b.index_add(-2, rows, (A @ of)[..., 0], alpha=-1).abs()
        size = b.abs().index_add(-2, rows, (A.abs() @ of.abs())[..., 0])
        n, p, good = len(self.how.interface), (self.w + 1) // 2, []
        for units, kinds in product((slice(0, n), slice(n, None)), (slice(0, p), slice(p, None))):
            off, most = (v[..., units, kinds].flatten(-2) for v in (residual, size))
            if most.shape[-1]:
                rounding = EXACT * torch.finfo(x.dtype).eps * most.amax(-1, keepdim=True)
                good.append((off <= rounding).all(-1))
        return torch.stack(good).all(0)


def equilibrated(A: Tensor) -> Tensor:
    """A symmetric matrix (..., n, n), its unknowns in units in which its rows are of like size
    (Ruiz 2001): as many eigenvalues are negative (Sylvester), and rounding takes none for another.
    """
    for _ in range(3):
        size = A.abs().amax(-1).sqrt()
        size = torch.where(size > 0, size, 1.0)
        A = A / size[..., :, None] / size[..., None, :]
    return A


def _at(x: Tensor, places: Tensor) -> Tensor:
    """(..., n) -> (..., *places.shape)"""
    return x.index_select(-1, places.flatten()).view(*x.shape[:-1], *places.shape)


def _sum(parts: list[Tensor], at: list[int], count: int, axes: int) -> Tensor:
    """(..., count, *) of parts (..., K, *), one after the other, added up at places."""
    shape = broadcast_shapes(*(part.shape[: -1 - axes] for part in parts))
    whole = torch.cat([x.expand(*shape, *x.shape[-1 - axes :]) for x in parts], -1 - axes)
    total = whole.new_zeros(*shape, count, *whole.shape[whole.ndim - axes :])
    return total.index_add(-1 - axes, index(tuple(at), whole.device), whole)
