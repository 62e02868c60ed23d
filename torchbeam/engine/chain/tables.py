"""Tables of a structure: which runs of nodes its code eliminates, from which end, and where what
they leave is put into the system of the interface.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from itertools import accumulate, pairwise
from typing import Any

import numpy as np

from ...nodal.model import Model
from ...topology.cut import Run
from ...topology.framework import Framework
from ..compiler.block_pattern import BlockPattern
from .cells import Cells
from .interaction_sorts import INTERACTIONS
from .layout import ELEMENT_PLACES, ENTRIES, INTERFACE, MULTIPLIERS, NODE_PLACES, SIGNS
from .order import Connectivity, Order, connectivity_of, order_of
from .sorts import LAST, OWN, Edge, Edges, Sort

# tables of integers that code reads, and numbers, by name
LISTS = (
    *("bases", "node_kinds", "element_kinds", "held", "support_of", "support_nodes"),
    *(f"{sort.constants}_{what}" for sort in INTERACTIONS for what in ("kinds", "table")),
    *("element_nodes", "left_elements", "right_elements", "node_places", "element_places"),
    *("kept_nodes", "kept_elements", "interface", "direct", "elimination", "substitution"),
    "multipliers",
    *("forward", "backward", "bordered", "following"),
)
COUNTS = (
    *("nodes", "kept_node_count", "kept_element_count", "interface_count", "direct_count"),
    *("forward_count", "backward_count", "bordered_count", "following_count"),
    *(*(f"{sort.constants}_count" for sort in INTERACTIONS), "entry_count", "group_count"),
    *(*(f"{sort.of}_count" for sort in INTERACTIONS if sort.of), "multipliers_count"),
    *("first_groups", "last_groups", "last_table"),
    *("shared_groups", "shared_table", "shared_first", "shared_size"),
    *("own_nodes", "own_interface", "own_edges"),
)
# integers of an entry
WIDTH = {
    "interface": 6,
    "direct": 6,
    "forward": 7,
    "backward": 7,
    "bordered": 16,
    "following": 20,
    "multipliers": 1,
    **{sort.constants: sort.width for sort in INTERACTIONS},
}
NONE = (-1, -1)  # the place of a block that is not there
BYTES = 4  # of a number, at least
ELEMENT_TURNS = 2  # places of elements along a run


@dataclass(frozen=True)
class Tables:
    """rows: how many there are of a structure's records; lists: tables of integers; numbers: how
    many entries they have.
    """

    rows: dict[str, int]
    lists: dict[str, Sequence[int] | np.ndarray]
    numbers: dict[str, int]

    @staticmethod
    def of(model: Model, cells: Cells | None = None) -> Tables:
        """Of a model, or of one of its cells with what all share."""
        w = model.space.unknowns
        return _tables(w, connectivity_of(model) if cells is None else cells.connectivity)


def flat(rows: Iterable[Iterable[int]]) -> list[int]:
    """One row after the other."""
    return [x for row in rows for x in row]


@lru_cache(maxsize=64)
def _tables(w: int, connectivity: Connectivity) -> Tables:
    return _Builder(w, connectivity).tables()


class _Builder:
    """Makes the tables of a structure whose nodes have w unknowns."""

    def __init__(self, w: int, connectivity: Connectivity) -> None:
        self.w, (self.framework, _, self.edges, self.shared) = w, connectivity
        self.order = order = order_of(connectivity)
        self.how, self.ends = self.framework.cut, self.framework.ends
        self.nodes = [self.ends[end] for end in self.how.interface]
        self.at_nodes = {node: k for k, node in enumerate(self.nodes)}
        self.multipliers = {unit: k for k, unit in enumerate(order.constraints)}
        self.groups, moves, self.equation = _equations(order, len(self.nodes), w)
        equation, units = self.equation, len(self.equation)
        couplings = [*order.couplings, *((run.before, run.after) for run in order.bordered)]
        blocks = [(equation[a], b) for pair in couplings for a, b in (pair, pair[::-1])]
        blocks += [(equation[node], node) for node in range(len(self.nodes))]
        # what a following run goes on from, also where the node's equation stands elsewhere
        self.outer = tuple(range(units, units + len(order.following)))
        for unit, (_, place) in zip(self.outer, order.following, strict=True):
            blocks += [(place, unit), (equation[place], unit)]
        self.pattern = BlockPattern(w, self.groups, blocks, self.outer, moves)
        self.between = cache(lambda row, column: self.pattern.place(equation[row], column))

    def tables(self) -> Tables:
        places = _places(self.framework)
        lists = places | self._of_runs() | self._of_interactions()
        lists["elimination"] = np.concatenate((np.empty(0, int), *self.pattern.elimination))
        lists["substitution"] = flat(self.pattern.substitution)
        numbers = self._numbers() | {
            f"kept_{what}_count": len(places[f"kept_{what}s"]) for what in ("node", "element")
        }
        for table, width in WIDTH.items():
            own = lists.get(f"{table}_table", lists.get(table, ()))
            numbers[f"{table}_count"] = len(own) // width
        rows = self._rows() | {
            NODE_PLACES: self.framework.order + 1 + len(places["kept_nodes"]),
            ELEMENT_PLACES: ELEMENT_TURNS + len(places["kept_elements"]),
        }
        numbers |= {f"{sort.of}_count": rows[sort.of] for sort in INTERACTIONS if sort.of}
        return Tables(rows, lists, numbers)

    def _rows(self) -> dict[str, int]:
        """How many there are of what acts between nodes, and of the system's numbers."""
        size = self.pattern.size
        flags = size // BYTES + 1  # one a number, in bytes
        rows = {
            INTERFACE: len(self.nodes),
            ENTRIES: size + flags,
            MULTIPLIERS: len(self.multipliers),
        }
        for sort, own_edges in zip(INTERACTIONS, self.edges, strict=True):
            rows[sort.rows] = len(own_edges)
            if sort.of is not None:
                rows[sort.of] = len({edge.more[-1] for edge in own_edges})
        rows[SIGNS] = max((self.w * len(group) for group in self.groups), default=0) ** 2
        return rows

    # Runs of nodes

    def _of_runs(self) -> dict[str, Any]:
        """Tables of the interface's nodes, and of runs between them."""
        how, ends, order = self.how, self.ends, self.order
        own, between, solution = self._own, self.between, self.pattern.solution
        runs = [run for runs in how.runs for run in runs]
        forward, backward = (
            [run for run in runs if run.manner == manner] for manner in ("forward", "backward")
        )
        parts, back = self._parts
        return {
            "interface": flat((node, *own(k), solution(k)) for k, node in enumerate(self.nodes)),
            "direct": flat((i, j, *between(i, j), *between(j, i)) for _, i, j in how.direct),
            "forward": flat(
                (ends[x.first], x.count, -1 if x.after is None else x.after, *own(x.after))
                for x in forward
            ),
            "backward": flat(
                (ends[x.first + x.count - 1], x.count, x.before, *own(x.before)) for x in backward
            ),
            "bordered": flat(map(self._border, order.bordered)),
            "following": flat(
                (*self._follow(self.outer[k], run, place), *parts[k + 1], *back[k])
                for k, (run, place) in enumerate(order.following)
            ),
        }

    def _own(self, place: int | None) -> tuple[int, ...]:
        if place is None:
            return (*NONE, *NONE)
        return (*self.between(place, place), *self.pattern.right(self.equation[place]))

    def _follow(self, unit: int, run: Run, place: int) -> list[int]:
        """A run that goes on from a node which is eliminated, to the other one."""
        pattern, onwards, last = self.pattern, place == run.before, run.first + run.count - 1
        other = run.after if onwards else run.before
        first = self.ends[run.first if onwards else last]
        table = [first, run.count, 1 if onwards else -1, place, *self.between(place, unit)]
        table += [*pattern.place(place, unit), pattern.right(place).first, other]
        return [*table, *self._own(other), pattern.solution(other), pattern.solution(unit)]

    def _border(self, run: Run) -> tuple[int, ...]:
        pair, between = (run.before, run.after), self.between
        both = (*self._own(run.before), *self._own(run.after), *between(*pair))
        return self.ends[run.first], run.count, *pair, *both, *between(*pair[::-1])

    # What acts between nodes

    def _of_interactions(self) -> dict[str, Any]:
        """Tables of interactions, and of multipliers."""
        tables: dict[str, Any] = {
            f"{sort.constants}_table": self._table(sort, edges, units) if edges else []
            for sort, edges, units in zip(INTERACTIONS, self.edges, self.order.own, strict=True)
        }
        solutions = [self.pattern.solution(unit) for unit in self.order.constraints]
        return tables | {"multipliers": solutions}

    def _table(
        self, sort: Sort, edges: Edges, units: tuple[int | None, ...]
    ) -> Sequence[int] | np.ndarray:
        """Row by row, or, of edges that have nothing but nodes, all at once."""
        if sort.unknowns or any(len(edge.nodes) < len(sort.sides) for edge in edges):
            pairs = zip(edges, units, strict=True)
            return flat(self._row(sort, edge, unit) for edge, unit in pairs)
        at = np.array([[self.at_nodes[node] for node in edge.nodes] for edge in edges], int)
        at = at.reshape(len(edges), len(sort.sides))
        rows = np.array([self.equation[node] for node in range(len(self.nodes))], int)[at]
        blocks = self.pattern.places(rows[:, :, None], at[:, None]).reshape(len(edges), -1)
        return np.concatenate((np.array(self.nodes, int)[at], blocks), -1).ravel()

    def _row(self, sort: Sort, edge: Edge, unit: int | None) -> list[int]:
        """own: the unit of its unknowns."""
        pattern, units = self.pattern, dict.fromkeys(sort.sides)
        units |= {OWN: unit, LAST: unit - 1 if edge.chained else None}
        units |= zip(sort.sides, map(self.at_nodes.get, edge.nodes), strict=False)
        table = [0 if units[side] is None else self.nodes[units[side]] for side in sort.sides]
        table += edge.more
        for block in sort.blocks:
            at = [units[name] for name in block]
            # a weld has none
            there = None not in at and (block != "oo" or self.equation[unit] == unit)
            table += self.between(*at) if there else NONE
        if unit is None:
            return [*table, *NONE, -1, -1] if sort.unknowns else table
        table += *pattern.right(self.equation[unit]), pattern.solution(unit)
        return [*table, self.multipliers.get(unit, -1)]

    # Groups

    @cached_property
    def _common(self) -> set[int]:
        """Units that cells share."""
        nodes = {*range(len(self.nodes) - self.shared, len(self.nodes))}
        constraints = self.order.constraints.items()
        return nodes | {k for k, constraint in constraints if {*constraint.ends} <= {*nodes, None}}

    @cached_property
    def _own_groups(self) -> int:
        return sum(not self._common & {*group} for group in self.pattern.groups)

    @cached_property
    def _parts(self) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
        """Groups between following runs, and of what cells share, forth and back: how many, and
        where their tables begin.
        """
        groups, equation = self.pattern.groups, self.equation
        cuts = [
            1 + max(g for g, group in enumerate(groups) if {place, equation[place]} & {*group})
            for _, place in self.order.following
        ]
        cuts = [0, *cuts, self._own_groups, len(groups)]
        begins = [0, *accumulate(map(len, self.pattern.elimination))]
        ends_of = [0, *accumulate(map(len, self.pattern.substitution))]
        parts = [(b - a, begins[a]) for a, b in pairwise(cuts)]
        return parts, [(b - a, ends_of[len(groups) - b]) for a, b in pairwise(cuts)]

    def _numbers(self) -> dict[str, int]:
        """How many entries, groups and rows there are, where tables do not say so."""
        pattern, (parts, back), nodes = self.pattern, self._parts, len(self.nodes)
        edges, begin = self.order.constraints, pattern.begin(self._own_groups)
        return {
            "entry_count": pattern.size,
            "group_count": len(pattern.groups),
            "first_groups": parts[0][0],
            "last_groups": back[-2][0],
            "last_table": back[-2][1],
            "shared_groups": parts[-1][0],
            "shared_table": parts[-1][1],
            "shared_first": begin,
            "shared_size": pattern.begin(len(pattern.groups)) - begin,
            "own_nodes": self.framework.node_count - self.shared,
            "own_interface": nodes - self.shared,
            "own_edges": len(edges) - len(self._common & {*edges}),
        }


def _places(framework: Framework) -> dict[str, list[int]]:
    """Which nodes and elements are next to each other; where what they give is held, and which have
    a place of their own: those at the interface, and what else is next to it. The others take turns
    along a run, the node between an element's ends in the last of these.
    """
    how, ends, turns = framework.cut, framework.ends, framework.order + 1
    at_interface = {ends[end] for end in how.interface}
    all_ends = zip(framework.elements[0], framework.elements[-1], strict=True)
    kept_elements = [e for e, pair in enumerate(all_ends) if at_interface & {*pair}]
    next_to = {nodes[e] for nodes in framework.elements[:: framework.order] for e in kept_elements}
    kept_nodes = sorted(at_interface | next_to)
    node_places = [framework.order] * framework.node_count
    for k, node in enumerate(ends):
        node_places[node] = k % 2
    element_places = [e % ELEMENT_TURNS for e in range(framework.element_count)]
    for k, node in enumerate(kept_nodes):
        node_places[node] = turns + k
    for k, e in enumerate(kept_elements):
        element_places[e] = ELEMENT_TURNS + k
    left, right = ([-1] * framework.node_count for _ in range(2))
    for e, (first, *_, last) in enumerate(zip(*framework.elements, strict=True)):
        right[first], left[last] = e, e
    return {
        "element_nodes": list(framework.elements[0]),
        "left_elements": left,
        "right_elements": right,
        "node_places": node_places,
        "element_places": element_places,
        "kept_nodes": kept_nodes,
        "kept_elements": kept_elements,
    }


def _equations(
    order: Order, nodes: int, w: int
) -> tuple[list[tuple[int, ...]], list[int], dict[int, int]]:
    """Groups of unknowns, how many of each are moves (see `BlockPattern`), and whose equation
    stands in the row of each unit. A weld's constraints give the moves of the node that hangs by
    it, the node's balance the weld's force: two groups in the place of one, whose signs are always
    as they should be. Those of forces alone are not looked at.
    """
    parts, moves = [], []
    equation = {unit: unit for group in order.groups for unit in group}
    for group in order.groups:
        if group[0] < nodes and [order.constraints[unit].firm for unit in group[1:]] == [True]:
            node, weld = group
            equation |= {node: weld, weld: node}
            parts += [(node,), (weld,)]
            moves += [-1, -1]
        else:
            parts.append(group)
            moves.append(w if group[0] < nodes else -1)
    return parts, moves, equation
