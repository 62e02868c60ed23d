"""Tables of a structure: which runs of nodes its code eliminates, from which end, and where what
they leave is put into the system of the interface.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import accumulate, pairwise

import numpy as np

from ...nodal.model import Model
from ...topology.cut import Run
from ...topology.framework import Framework
from ..compiler.block_pattern import BlockPattern
from .cells import Cells
from .interaction import INTERACTIONS, LAST, OWN, Edge, Edges, Interaction
from .layout import ELEMENT_PLACES, ENTRIES, INTERFACE, MULTIPLIERS, NODE_PLACES, SIGNS
from .order import Connectivity, Order, connectivity_of, order_of

# tables of integers that code reads, and numbers, by name
LISTS = (
    *("bases", "kinds", "element_kinds", "held", "support_of", "support_nodes"),
    *(f"{one.constants}_{what}" for one in INTERACTIONS for what in ("kinds", "table")),
    *("element_nodes", "left_elements", "right_elements", "node_places", "element_places"),
    *("kept_nodes", "kept_elements", "interface", "direct", "elimination", "substitution"),
    "multipliers",
    *("forward", "backward", "bordered", "following"),
)
COUNTS = (
    *("nodes", "kept_node_count", "kept_element_count", "interface_count", "direct_count"),
    *("forward_count", "backward_count", "bordered_count", "following_count"),
    *(*(f"{one.constants}_count" for one in INTERACTIONS), "entry_count", "group_count"),
    *(*(f"{one.of}_count" for one in INTERACTIONS if one.of), "multipliers_count"),
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
    **{one.constants: one.width for one in INTERACTIONS},
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
    framework, _, edges, shared = connectivity
    order = order_of(connectivity)
    how, ends = framework.cut, framework.ends
    nodes = [ends[end] for end in how.interface]
    runs = [run for runs in how.runs for run in runs]
    forward, backward = (
        [run for run in runs if run.manner == manner] for manner in ("forward", "backward")
    )
    couplings = [*order.couplings, *((run.before, run.after) for run in order.bordered)]
    groups, moves, equation = _equations(order, len(nodes), w)
    units = len(equation)
    at_nodes = {node: k for k, node in enumerate(nodes)}
    multipliers = {unit: k for k, unit in enumerate(order.constraints)}
    blocks = [(equation[a], b) for pair in couplings for a, b in (pair, pair[::-1])]
    blocks += [(equation[node], node) for node in range(len(nodes))]
    # what a following run goes on from, also where the node's equation stands elsewhere
    outer = tuple(range(units, units + len(order.following)))
    for unit, (_, place) in zip(outer, order.following, strict=True):
        blocks += [(place, unit), (equation[place], unit)]
    pattern = BlockPattern(w, groups, blocks, outer, moves)

    def own(place: int | None) -> tuple[int, ...]:
        if place is None:
            return (*NONE, *NONE)
        return (*between(place, place), *pattern.right(equation[place]))

    @cache
    def between(row: int, column: int) -> tuple[int, int]:
        return pattern.place(equation[row], column)

    def row(one: Interaction, edge: Edge, own: int | None) -> list[int]:
        """Of an interaction; own: the unit of its unknowns."""
        units = dict.fromkeys(one.sides) | {OWN: own, LAST: own - 1 if edge.chained else None}
        units |= zip(one.sides, map(at_nodes.get, edge.nodes), strict=False)
        table = [0 if units[side] is None else nodes[units[side]] for side in one.sides]
        table += edge.more
        for block in one.blocks:
            at = [units[name] for name in block]
            there = None not in at and (block != "oo" or equation[own] == own)  # a weld has none
            table += between(*at) if there else NONE
        if own is None:
            return [*table, *NONE, -1, -1] if one.unknowns else table
        table += *pattern.right(equation[own]), pattern.solution(own)
        return [*table, multipliers.get(own, -1)]

    def follow(unit: int, run: Run, place: int) -> list[int]:
        """A run that goes on from a node which is eliminated, to the other one."""
        onwards, last = place == run.before, run.first + run.count - 1
        other = run.after if onwards else run.before
        table = [ends[run.first if onwards else last], run.count, 1 if onwards else -1, place]
        table += [*between(place, unit), *pattern.place(place, unit), pattern.right(place).first]
        return [*table, other, *own(other), pattern.solution(other), pattern.solution(unit)]

    def border(run: Run) -> tuple[int, ...]:
        pair = run.before, run.after
        both = (*own(run.before), *own(run.after), *between(*pair), *between(*pair[::-1]))
        return ends[run.first], run.count, *pair, *both

    def table(one: Interaction, own: Edges, units: tuple[int | None, ...]) -> Sequence[int]:
        """Of an interaction, row by row, or, of edges that have nothing but nodes, all at once."""
        if one.unknowns or any(len(edge.nodes) < len(one.sides) for edge in own):
            return flat(row(one, edge, unit) for edge, unit in zip(own, units, strict=True))
        at = np.array([[at_nodes[node] for node in edge.nodes] for edge in own], int)
        at = at.reshape(len(own), len(one.sides))
        rows = np.array([equation[node] for node in range(len(nodes))], int)[at]
        blocks = pattern.places(rows[:, :, None], at[:, None]).reshape(len(own), -1)
        return np.concatenate((np.array(nodes, int)[at], blocks), -1).ravel()

    common = {*range(len(nodes) - shared, len(nodes))}
    of_common = [k for k, one in order.constraints.items() if {*one.ends} <= {*common, None}]
    common |= {*of_common}
    # groups between following runs, and of what cells share: how many, and where their tables begin
    cuts = [
        1 + max(g for g, group in enumerate(pattern.groups) if {place, equation[place]} & {*group})
        for _, place in order.following
    ]
    own_groups = sum(not common & {*group} for group in pattern.groups)
    cuts = [0, *cuts, own_groups, len(pattern.groups)]
    begins = [0, *accumulate(map(len, pattern.elimination))]
    ends_of = [0, *accumulate(map(len, pattern.substitution))]
    parts = [(b - a, begins[a]) for a, b in pairwise(cuts)]
    back = [(b - a, ends_of[len(pattern.groups) - b]) for a, b in pairwise(cuts)]

    node_places, element_places, kept_nodes, kept_elements = _places(framework)
    left, right = ([-1] * framework.node_count for _ in range(2))
    for e, (first, *_, last) in enumerate(zip(*framework.elements, strict=True)):
        right[first], left[last] = e, e
    lists = {
        "element_nodes": list(framework.elements[0]),
        "left_elements": left,
        "right_elements": right,
        "node_places": node_places,
        "element_places": element_places,
        "kept_nodes": kept_nodes,
        "kept_elements": kept_elements,
        "interface": flat((node, *own(k), pattern.solution(k)) for k, node in enumerate(nodes)),
        "direct": flat((i, j, *between(i, j), *between(j, i)) for _, i, j in how.direct),
        "forward": flat(
            (ends[x.first], x.count, -1 if x.after is None else x.after, *own(x.after))
            for x in forward
        ),
        "backward": flat(
            (ends[x.first + x.count - 1], x.count, x.before, *own(x.before)) for x in backward
        ),
        "bordered": flat(map(border, order.bordered)),
        "following": flat(
            (*follow(outer[k], run, place), *parts[k + 1], *back[k])
            for k, (run, place) in enumerate(order.following)
        ),
        **{
            f"{one.constants}_table": table(one, own_edges, units) if own_edges else []
            for one, own_edges, units in zip(INTERACTIONS, edges, order.own, strict=True)
        },
        "multipliers": [pattern.solution(unit) for unit in order.constraints],
        "elimination": np.concatenate((np.empty(0, int), *pattern.elimination)),
        "substitution": flat(pattern.substitution),
    }
    numbers = {
        "kept_node_count": len(kept_nodes),
        "kept_element_count": len(kept_elements),
        "entry_count": pattern.size,
        "group_count": len(pattern.groups),
        "first_groups": parts[0][0],
        "last_groups": back[-2][0],
        "last_table": back[-2][1],
        "shared_groups": parts[-1][0],
        "shared_table": parts[-1][1],
        "shared_first": pattern.begin(own_groups),
        "shared_size": pattern.begin(len(pattern.groups)) - pattern.begin(own_groups),
        "own_nodes": framework.node_count - shared,
        "own_interface": len(nodes) - shared,
        "own_edges": len(order.constraints) - len(of_common),
    }
    for table, width in WIDTH.items():
        numbers[f"{table}_count"] = len(lists.get(f"{table}_table", lists.get(table, ()))) // width
    flags = pattern.size // BYTES + 1  # one a number, in bytes
    rows = {INTERFACE: len(nodes), ENTRIES: pattern.size + flags, MULTIPLIERS: len(multipliers)}
    for one, own_edges in zip(INTERACTIONS, edges, strict=True):
        rows[one.rows] = len(own_edges)
        if one.of is not None:
            rows[one.of] = len({edge.more[-1] for edge in own_edges})
            numbers[f"{one.of}_count"] = rows[one.of]
    rows[SIGNS] = max((w * len(group) for group in groups), default=0) ** 2
    rows |= {NODE_PLACES: framework.order + 1 + len(kept_nodes)}
    rows |= {ELEMENT_PLACES: ELEMENT_TURNS + len(kept_elements)}
    return Tables(rows, lists, numbers)


def _places(framework: Framework) -> tuple[list[int], list[int], list[int], list[int]]:
    """Where what nodes and elements give is held, and which have a place of their own: those at the
    interface, and what else is next to it. The others take turns along a run, the node between an
    element's ends in the last of these.
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
    return node_places, element_places, kept_nodes, kept_elements


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
