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
from itertools import product
from typing import NamedTuple


class Place(NamedTuple):
    """Where a block lies: its first number, and how far its rows are apart."""

    first: int
    stride: int


class BlockPattern:
    """Of units of w unknowns; groups: in the order in which they are eliminated, each unit in one
    of them; blocks: (row, column) units of those that there are, beside those within a group;
    outer: units that are solved elsewhere, before the groups that couple to them, and have no rows
    here.
    """

    def __init__(
        self,
        w: int,
        groups: Iterable[tuple[int, ...]],
        blocks: Iterable[tuple[int, int]],
        outer: tuple[int, ...] = (),
    ) -> None:
        self.w, self.groups = w, tuple(groups)
        self._group = {unit: g for g, group in enumerate((*self.groups, outer)) for unit in group}
        rows: list[set[int]] = [set() for _ in self.groups]
        columns: list[set[int]] = [set() for _ in self.groups]

        def add(row: int, column: int) -> None:
            if self._group[row] < self._group[column]:
                columns[self._group[row]].add(column)
            elif self._group[row] > self._group[column]:
                rows[self._group[column]].add(row)

        for row, column in blocks:
            add(row, column)
        for g in range(len(self.groups)):  # each couples those that are left to each other
            for row, column in product(rows[g], columns[g]):
                add(row, column)
        order = [unit for group in (*self.groups, outer) for unit in group]
        self.rows, self.columns = (
            tuple(tuple(unit for unit in order if unit in units) for units in behind)
            for behind in (rows, columns)
        )
        self._panels, self._below, at = [], [], 0
        for g, group in enumerate(self.groups):
            n = w * len(group)
            self._panels.append(at)
            self._below.append(at + n * self._stride(g))
            at += n * (self._stride(g) + w * len(self.rows[g]))
        self._solution, self.size = at, at + w * len(order)
        # of each group where the blocks of units lie in its rows, and behind them
        self._across, self._down = (
            [{unit: k for k, unit in enumerate(units)} for units in own]
            for own in (
                [
                    (*group, *behind)
                    for group, behind in zip(self.groups, self.columns, strict=True)
                ],
                [(*group, *behind) for group, behind in zip(self.groups, self.rows, strict=True)],
            )
        )
        self._strides = [self._stride(g) for g in range(len(self.groups))]

    def begin(self, g: int) -> int:
        """Where the first number of group g lies; of one more than there are, the solution."""
        return [*self._panels, self._solution][g]

    def place(self, row: int, column: int) -> Place:
        """Of the block of two units."""
        g, other, w = self._group[row], self._group[column], self.w
        if g > other:
            size = len(self.groups[other])
            first = w * size * (self._down[other][row] - size) + self._across[other][column]
            return Place(self._below[other] + w * first, w * size)
        stride = self._strides[g]
        first = stride * self._down[g][row] + self._across[g][column]
        return Place(self._panels[g] + w * first, stride)

    def right(self, row: int) -> Place:
        """Of the right-hand side of a unit."""
        g = self._group[row]
        stride = self._stride(g)
        return Place(
            self._panels[g] + self.w * stride * self.groups[g].index(row) + stride - 1, stride
        )

    def solution(self, unit: int) -> int:
        """Where the unknowns of a unit are put."""
        return self._solution + self.w * unit

    def _stride(self, g: int) -> int:
        return self.w * (len(self.groups[g]) + len(self.columns[g])) + 1

    @cached_property
    def elimination(self) -> list[list[int]]:
        """Table of `block_elimination.eliminate`, by group: its rows, its columns, where its panel
        lies, how many units have rows behind it, and how many products are subtracted from these;
        of each of these units where its first factor lies, and of each product there where it is
        subtracted from and how far the rows there are apart, which columns of the panel are the
        second factor, and how many.
        """
        table: list[list[int]] = []
        for g, group in enumerate(self.groups):
            n, rows = self.w * len(group), []
            for k, row in enumerate(self.rows[g]):
                rows.append(self._below[g] + self.w * n * k)
                columns = [(self.place(row, unit), self.w) for unit in self.columns[g]]
                columns.append((self.right(row), 1))
                for i, (place, count) in enumerate(columns):
                    rows += [*place, n + self.w * i, count]
            counts = len(self.rows[g]), len(self.columns[g]) + 1
            table.append([n, self._strides[g], self._panels[g], *counts, *rows])
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
            own = [self.w * len(group), self._stride(g), self._panels[g], len(units)]
            own += [self.solution(unit) + k for unit in group for k in range(self.w)]
            table.append(own + [self.solution(unit) for unit in units])
        return table
