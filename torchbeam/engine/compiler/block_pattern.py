"""Block pattern: which blocks a matrix has, in which order they are eliminated, and where they lie.

The unknowns, and the equations, come in units of the same size, of which groups are eliminated
together, with exchange of rows within the group. What a group couples to behind it, fill-in
included, follows from the pattern alone: it is worked out once.

In memory, for each group of n rows, with m unknowns and l rows behind it

    panel (n, n + m + 1)   its rows, the columns of the group first, then those behind it, then the
                           right-hand side
    below (l, n)           the columns of the group in the rows behind it

and behind all groups the solution, unit by unit.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from itertools import accumulate
from typing import NamedTuple

import numpy as np


class Place(NamedTuple):
    """Where a block lies: its first number, and how far its rows are apart."""

    first: int
    stride: int


class BlockPattern:
    """Of units of w unknowns; groups: in the order in which they are eliminated, each unit in one
    of them; blocks: (row, column) units of those that there are, beside those within a group;
    outer: units that are solved elsewhere, before the groups that couple to them, and have no rows
    here. moves: how many unknowns of each group are moves, see `BlockSigns`, None = all; -1 = its
    signs are not looked at.
    """

    def __init__(
        self,
        w: int,
        groups: Iterable[tuple[int, ...]],
        blocks: Iterable[tuple[int, int]],
        outer: tuple[int, ...] = (),
        moves: Iterable[int] | None = None,
    ) -> None:
        self.w, self.groups = w, tuple(groups)
        self.moves = [w * len(group) for group in self.groups] if moves is None else [*moves]
        order = [unit for group in (*self.groups, outer) for unit in group]
        at = {unit: k for k, unit in enumerate(order)}
        self._group = {unit: g for g, group in enumerate((*self.groups, outer)) for unit in group}
        # sets of units are integers, of which bit k stands for order[k]; those behind each group
        behind = [-1 << end for end in accumulate(map(len, (*self.groups, outer)))]
        rows, columns = [0] * len(self.groups), [0] * (1 + len(self.groups))

        def units(bits: int) -> list[int]:
            found = []
            while bits:
                found.append(order[(bits & -bits).bit_length() - 1])
                bits &= bits - 1
            return found

        for row, column in blocks:
            g, other = self._group[row], self._group[column]
            if g < other:
                columns[g] |= 1 << at[column]
            elif g > other:
                rows[other] |= 1 << at[row]
        self.rows, self.columns = [], []
        for g in range(len(self.groups)):  # each couples those that are left to each other
            self.rows.append(tuple(units(rows[g])))
            self.columns.append(tuple(units(columns[g])))
            for other in {self._group[unit] for unit in self.rows[g]}:
                columns[other] |= columns[g] & behind[other]
            for other in {self._group[unit] for unit in self.columns[g]} - {len(self.groups)}:
                rows[other] |= rows[g] & behind[other]
        self._panels, first = [], 0
        self._place, self._right = (np.full((*(len(order),) * k, 2), -1) for k in (2, 1))
        for group, down, across in zip(self.groups, self.rows, self.columns, strict=True):
            n, stride = w * len(group), w * (len(group) + len(across)) + 1
            self._panels.append(first)
            here, below, panel = (np.array(x, int) for x in (group, down, (*group, *across)))
            at, row, k = w * np.arange(len(panel)), here[:, None], np.arange(len(here))[:, None]
            self._place[row, panel, 0] = first + w * stride * k + at
            self._place[row, panel, 1] = stride
            self._right[row, 0] = first + w * stride * k + stride - 1
            self._right[row, 1] = stride
            first += n * stride
            row, k = below[:, None], np.arange(len(below))[:, None]
            self._place[row, here, 0] = first + w * n * k + at[: len(here)]
            self._place[row, here, 1] = n
            first += n * w * len(down)
        self._solution, self.size = first, first + w * len(order)

    def begin(self, g: int) -> int:
        """Where the first number of group g lies; of one more than there are, the solution."""
        return [*self._panels, self._solution][g]

    def place(self, row: int, column: int) -> Place:
        """Of the block of two units. Raises KeyError where there is none."""
        first, stride = self._place[row, column].tolist()
        if first < 0:
            raise KeyError((row, column))
        return Place(first, stride)

    def places(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """(..., 2), the same of many blocks that are there."""
        return self._place[rows, columns]

    def right(self, row: int) -> Place:
        """Of the right-hand side of a unit."""
        return Place(*self._right[row].tolist())

    def solution(self, unit: int) -> int:
        """Where the unknowns of a unit are put."""
        return self._solution + self.w * unit

    @cached_property
    def elimination(self) -> list[np.ndarray]:
        """Table of `block_elimination.eliminate`, by group: its rows, its columns, where its panel
        lies, how many units have rows behind it, how many products are subtracted from these, and
        how many of its unknowns are moves; of each of these units where its first factor lies, and
        of each product there where it is subtracted from and how far the rows there are apart,
        which columns of the panel are the second factor, and how many.
        """
        table = []
        for g, group in enumerate(self.groups):
            n, m = self.w * len(group), len(self.columns[g]) + 1
            down, across = (np.array(x[g], int) for x in (self.rows, self.columns))
            rows = np.empty((len(down), 1 + 4 * m), int)
            rows[:, 0] = self._place[down, group[0], 0]
            products = rows[:, 1:].reshape(len(down), m, 4)
            products[:, :-1, :2] = self.places(down[:, None], across)
            products[:, -1, :2] = self._right[down]
            products[..., 2] = n + self.w * np.arange(m)
            products[:, :-1, 3], products[:, -1, 3] = self.w, 1
            head = [n, self.right(group[0]).stride, self._panels[g], len(down), m, self.moves[g]]
            table.append(np.concatenate((head, rows.ravel())))
        return table

    @cached_property
    def substitution(self) -> list[list[int]]:
        """Table of `block_elimination.substitute`, by group, from the last to the first: its rows,
        its columns, where its panel lies, how many units there are behind it, of each row of the
        group where its solution goes, and where those of the units behind it are.
        """
        table: list[list[int]] = []
        for g in reversed(range(len(self.groups))):
            group, units = self.groups[g], self.columns[g]
            head = [self.w * len(group), self.right(group[0]).stride, self._panels[g], len(units)]
            head += [self.solution(unit) + k for unit in group for k in range(self.w)]
            table.append(head + [self.solution(unit) for unit in units])
        return table
