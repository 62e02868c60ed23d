"""Order in which the unknowns of a structure are eliminated: a hypergraph, whose units are the
nodes at which something acts, and own unknowns, and whose edges are interactions; and the runs of
nodes between two of these.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

from ...nodal.model import Model
from ...topology.cut import Run
from ...topology.framework import Framework
from .interaction import INTERACTIONS, Edges
from .layout import INTERFACE

# how nodes are eliminated, see `manners_of`
MANNERS = (
    *("backward", "bordered", "following backward", "following forward", "forward"),
    INTERFACE,
)
Groups = tuple[tuple[int, ...], ...]


class Connectivity(NamedTuple):
    """What the order follows from: the framework, the nodes that supports hold, the edges of each
    of `INTERACTIONS`, and how many of the last nodes cells share.
    """

    framework: Framework
    supports: tuple[int, ...] = ()
    edges: tuple[Edges, ...] = ((),) * len(INTERACTIONS)
    shared: int = 0


class Constraint(NamedTuple):
    """Forces of one edge: the units that it holds, None = the ground, and how many there are;
    whether it is firm, see `Edge`.
    """

    ends: tuple[int | None, ...]
    held: int
    firm: bool = False


class Order(NamedTuple):
    """Units are the nodes of the interface, and behind them the edges with unknowns of their own.

    couplings  pairs of units, without those by runs
    own        of each edge of each interaction its unit, None = it has none
    constraints  by unit, of those whose own unknowns are forces
    groups     of units, in the order in which they are eliminated
    following  runs between two nodes, each with the place of the one that is eliminated first, and
               couples to nothing but the run by then: it goes on from there; in order
    bordered   the other ones: they are eliminated before their nodes, and couple them
    own_groups how many of the groups come before those of what cells share, see `Cells`; None =
               these are not apart
    """

    couplings: tuple[tuple[int, int], ...]
    own: tuple[tuple[int | None, ...], ...]
    constraints: dict[int, Constraint]
    groups: Groups
    following: tuple[tuple[Run, int], ...]
    bordered: tuple[Run, ...]
    own_groups: int | None


def connectivity_of(model: Model) -> Connectivity:
    """Of a whole model."""
    edges = tuple(one.edges(model) for one in INTERACTIONS)
    return Connectivity(model.topology, model.constraints.nodes, edges)


def manners_of(model: Model) -> tuple[str, ...]:
    """How nodes are eliminated, as many as there are of: runs "forward" or "backward" from a free
    end, "following forward" or "following backward" from an end that is eliminated before,
    "bordered" otherwise; what is at the "interface".
    """
    return manners_by(model.topology, order_of(connectivity_of(model)))


def manners_by(framework: Framework, order: Order) -> tuple[str, ...]:
    """See `manners_of`."""
    manners = {run.manner for runs in framework.cut.runs for run in runs} - {"between"}
    for run, place in order.following:
        manners.add(f"following {'forward' if place == run.before else 'backward'}")
    more = {"bordered": order.bordered, INTERFACE: framework.cut.interface}
    return tuple(sorted(manners | {name for name, own in more.items() if own}))


@lru_cache(maxsize=64)
def order_of(connectivity: Connectivity) -> Order:
    """The order of a structure."""
    framework, supports, edges, shared = connectivity
    how, ends = framework.cut, framework.ends
    nodes = [ends[end] for end in how.interface]
    fixed = frozenset(k for k, node in enumerate(nodes) if node in supports)
    last = frozenset(range(len(nodes) - shared, len(nodes)))
    own, constraints, together = _units(nodes, edges)
    direct = {(i, j) for _, i, j in how.direct}
    couplings = tuple(sorted(direct.union(*(combinations(sorted(x), 2) for x in together))))
    between = [run for runs in how.runs for run in runs if run.manner == "between"]
    runs = tuple((run.before, run.after) for run in between)
    units = len(nodes) + sum(unit is not None for units in own for unit in units)
    groups, following = Elimination(len(nodes), units, constraints, couplings, runs).ordered(
        fixed, last
    )
    common = last | {unit for unit, one in constraints.items() if {*one.ends} <= {*last, None}}
    of_common = [bool(common & {*group}) for group in groups]
    apart = of_common == sorted(of_common) and all(
        common >= {*group} for group, own in zip(groups, of_common, strict=True) if own
    )
    return Order(
        couplings,
        own,
        constraints,
        groups,
        tuple((between[k], place) for k, place in following.items()),
        tuple(run for k, run in enumerate(between) if k not in following),
        of_common.count(False) if apart else None,
    )


def _units(
    nodes: list[int], edges: tuple[Edges, ...]
) -> tuple[tuple[tuple[int | None, ...], ...], dict[int, Constraint], set[frozenset[int]]]:
    """Own units of edges, constraints, and sets of units that are coupled to each other; nodes:
    those of the interface.
    """
    place: dict[int | None, int] = {node: k for k, node in enumerate(nodes)}
    unit, constraints, together, every = len(nodes), {}, set(), []
    for own_edges in edges:
        own: list[int | None] = []
        for edge in own_edges:
            there = [place[node] for node in edge.nodes if node is not None]
            has_own = edge.alone or edge.held is not None
            own.append(unit if has_own else None)
            together.add(frozenset([*there, unit] if has_own else there))
            together |= {frozenset((unit - 1, unit))} if edge.chained else set()
            if edge.held is not None:
                ends = tuple(map(place.get, edge.nodes))
                constraints[unit] = Constraint(ends, edge.held, edge.firm)
            unit += has_own
        every.append(tuple(own))
    return tuple(every), constraints, together


class Elimination:
    """Of units, the nodes of the interface first, behind them own unknowns, some of which are
    forces of constraints; couplings: pairs of units; runs: pairs of nodes.

    near   of each unit, and of each run behind them, what it couples to
    behind of each that is eliminated, all that is together with it
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
        hanging = {unit for own in self.behind.values() for unit in own[1:]}
        self._owner = {unit: one for one, own in self.behind.items() for unit in own}
        groups, following, left = [], {}, {*self.behind}
        while left:
            free = (one for one in left if not waits[one] & left)
            one = min(free, key=lambda one: (len(self._around(one)), one))
            crossed = [unit for unit in self._around(one) if unit >= self.units]
            if crossed and len(self._around(one)) == 1:
                following[crossed[0] - self.units] = one
                self._forget(crossed[0])
            else:
                for run in crossed:
                    a, b = self._forget(run)
                    self._couple(a, (b,))
                    self._couple(b, (a,))
            around = self._around(one)
            for unit in around:
                self._couple(unit, around, self.behind[one])
            groups.append(self.behind[one])
            left.remove(one)
        loops = tuple(unit for unit in self.constraints if unit not in hanging)
        return (*groups, *((loops,) if loops else ())), following

    def _hang(self, fixed: frozenset[int], last: frozenset[int]) -> dict[int, set[int]]:
        """Constraints with the nodes that hang by them; and what each waits for."""
        waits: dict[int, set[int]] = {one: set() for one in self.behind}
        for node in last:
            waits[node] |= {*range(self.nodes)} - last
        for node, unit in self._trees(fixed, last).items():
            self.behind[node] = (node, unit)
            for other in self.constraints[unit].ends:
                if other is not None and other != node:
                    waits[other].add(node)
        return waits

    def _around(self, one: int) -> set[int]:
        """What a group couples to."""
        if one not in self._reach:
            own = self.behind[one]
            self._reach[one] = set().union(*(self.near[unit] for unit in own)).difference(own)
        return self._reach[one]

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
        """Of each node, and of the ground behind them, its neighbours in trees and the constraints
        between.
        """
        ground, tree = self.nodes, {k: [] for k in range(self.nodes + 1)}
        root = {k: ground if k in fixed else k for k in tree}

        def rooted(k: int) -> int:
            return k if root[k] == k else rooted(root[k])

        pairs = {unit: one for unit, one in self.constraints.items() if len(one.ends) == 2}
        for unit in sorted(pairs, key=lambda unit: -pairs[unit].held):
            a, b = (ground if x is None or x in fixed else x for x in pairs[unit].ends)
            if rooted(a) != rooted(b):
                root[rooted(a)] = rooted(b)
                tree[a].append((b, unit))
                tree[b].append((a, unit))
        return tree
