"""Order in which units are eliminated: nodes, and own unknowns behind them, some of which are the
forces of constraints.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

Groups = tuple[tuple[int, ...], ...]


class Constraint(NamedTuple):
    """Forces of one edge: the units that it holds, None = the ground, and how many there are;
    whether it is firm, see `Edge`.
    """

    ends: tuple[int | None, ...]
    held: int
    firm: bool = False


class Elimination:
    """Of units, the nodes of the interface first, behind them own unknowns, some of which are
    forces of constraints; couplings: pairs of units; runs: pairs of nodes.

    near   of each unit, and of each run behind them, what it couples to
    behind of each that is eliminated, all that is together with it
    around of each group, in order, what it couples to when it is eliminated
    """

    def __init__(
        self,
        nodes: int,
        units: int,
        constraints: dict[int, Constraint],
        couplings: Iterable[tuple[int, int]],
        runs: tuple[tuple[int, int], ...] = (),
    ) -> None:
        self.nodes, self.units, self.constraints, self.runs = nodes, units, constraints, runs
        alone = [unit for unit in range(nodes, units) if unit not in constraints]
        self.behind = {unit: (unit,) for unit in (*range(nodes), *alone)}
        self.near: dict[int, set[int]] = {unit: set() for unit in range(units + len(runs))}
        of_runs = [(end, units + k) for k, pair in enumerate(runs) for end in pair]
        for one, other in (*couplings, *of_runs):
            self.near[one].add(other)
            self.near[other].add(one)
        self._reach: dict[int, set[int]] = {}
        self.around: list[set[int]] = []

    def ordered(
        self, fixed: frozenset[int], last: frozenset[int] = frozenset()
    ) -> tuple[Groups, dict[int, int]]:
        """Groups of units in the order in which they are eliminated where every node has inertia,
        or a constraint that keeps it from turning; and of the runs those that follow one of their
        nodes, by number, in order.

        Constraints of two nodes, or of one and the ground, make trees, whose roots are the ground
        and the nodes that are `fixed`. A node and the constraint by which it hangs on its tree are
        one group, behind those that hang on it: whatever is fixed elsewhere, they have a solution.
        The other constraints, which close loops, come last, together. Of what may come next, what
        couples to the least does: a run counts as one, and where a group couples to nothing else,
        it is eliminated behind the group; else it has coupled its two nodes before. Nodes that come
        `last` do so.
        """
        waits = self._hang(fixed, last)
        hanging = {unit for group in self.behind.values() for unit in group[1:]}
        self._owner = {unit: head for head, group in self.behind.items() for unit in group}
        groups, following, left = [], {}, {*self.behind}
        while left:
            free = (head for head in left if not waits[head] & left)
            head = min(free, key=lambda head: (len(self._around(head)), head))
            crossed = [unit for unit in self._around(head) if unit >= self.units]
            if crossed and len(self._around(head)) == 1:
                following[crossed[0] - self.units] = head
                self._forget(crossed[0])
            else:
                for run in crossed:
                    a, b = self._forget(run)
                    self._couple(a, (b,))
                    self._couple(b, (a,))
            around = self._around(head)
            for unit in around:
                self._couple(unit, around, self.behind[head])
            groups.append(self.behind[head])
            self.around.append(around)
            left.remove(head)
        if loops := tuple(unit for unit in self.constraints if unit not in hanging):
            groups.append(loops)
            self.around.append(set())
        return tuple(groups), following

    def _hang(self, fixed: frozenset[int], last: frozenset[int]) -> dict[int, set[int]]:
        """Constraints with the nodes that hang by them; and what each waits for."""
        waits: dict[int, set[int]] = {head: set() for head in self.behind}
        for node in last:
            waits[node] |= {*range(self.nodes)} - last
        for node, unit in self._trees(fixed, last).items():
            self.behind[node] = (node, unit)
            for other in self.constraints[unit].ends:
                if other is not None and other != node:
                    waits[other].add(node)
        return waits

    def _around(self, head: int) -> set[int]:
        """What a group couples to."""
        if head not in self._reach:
            units = self.behind[head]
            self._reach[head] = set().union(*(self.near[unit] for unit in units)).difference(units)
        return self._reach[head]

    def _couple(self, unit: int, others: Iterable[int], gone: Iterable[int] = ()) -> None:
        self.near[unit] = self.near[unit].union(others).difference(gone, (unit,))
        self._reach.pop(self._owner.get(unit, unit), None)

    def _forget(self, run: int) -> tuple[int, int]:
        ends = self.runs[run - self.units]
        for end in ends:
            self._couple(end, (), (run,))
        return ends

    def _trees(self, fixed: frozenset[int], last: frozenset[int]) -> dict[int, int]:
        """By which constraint a node hangs on the tree that it is in: those that hold more come
        first. A tree that is reached along a run has its root there, so that what lies beyond is
        eliminated before the run; one with nodes that come `last`, if the ground is not in it, one
        of them.
        """
        ground = self.nodes
        tree = self._spanned(fixed)
        across: dict[int, list[int]] = {k: [] for k in range(self.nodes + 1)}
        for a, b in () if last else self.runs:
            across[a].append(b)
            across[b].append(a)
        parent: dict[int, int] = {}
        seen, done = {*fixed}, set()
        others = sorted(range(ground), key=lambda node: (node not in last, -len(tree[node])))
        roots = deque([ground, *fixed, *others])
        while roots:
            start = roots.popleft()
            if start in done or (start in seen and start not in fixed):
                continue
            seen.add(start)
            todo = [start]
            while todo:
                node = todo.pop()
                done.add(node)
                roots.extendleft(across[node])
                for other, unit in tree[node]:
                    if other not in seen:
                        seen.add(other)
                        parent[other] = unit
                        todo.append(other)
        return parent

    def _spanned(self, fixed: frozenset[int]) -> dict[int, list[tuple[int, int]]]:
        """Of each node, and of the ground behind them, its neighbours in trees and constraints."""
        ground, tree = self.nodes, {k: [] for k in range(self.nodes + 1)}
        root = {k: ground if k in fixed else k for k in tree}

        def rooted(k: int) -> int:
            return k if root[k] == k else rooted(root[k])

        pairs = {unit: tie for unit, tie in self.constraints.items() if len(tie.ends) == 2}
        for unit in sorted(pairs, key=lambda unit: -pairs[unit].held):
            a, b = (ground if x is None or x in fixed else x for x in pairs[unit].ends)
            if rooted(a) != rooted(b):
                root[rooted(a)] = rooted(b)
                tree[a].append((b, unit))
                tree[b].append((a, unit))
        return tree
