"""Cells of a structure: parts of it that are alike and meet in bodies alone, as the fingers of a
hand. Each has a lane of its own; what all share is computed in every lane.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

from ...topology.framework import Framework
from .interaction_sorts import INTERACTIONS
from .kinds import Kinds
from .layout import ELEMENTS, MULTIPLIERS, NODES, SUPPORTS
from .order import Connectivity, manners_by, order_of

LEAST, MOST = 3, 16  # cells: two of them win a tenth; more than 16 numbers need many registers


class Cells(NamedTuple):
    """count: how many there are; connectivity: of one of them with the bodies that all share, which
    come last; kinds: of its rows; rows: by sort, of each of its rows the number in the structure of
    that of the first cell, and how far that of the next is.
    """

    count: int
    connectivity: Connectivity
    kinds: Kinds
    rows: dict[str, list[tuple[int, int]]]


def cells_of(connectivity: Connectivity, kinds: Kinds) -> Cells | None:
    """The most cells that a structure is made of, None = it is not, or something couples them, or
    closes a loop within a cell. kinds: of all rows.
    """
    framework = connectivity.framework
    others = [
        rows
        for sort, rows in zip(INTERACTIONS, connectivity.edges, strict=True)
        if rows and not sort.celled
    ]
    if framework.ties or others or any(kinds.possible):
        return None
    chains = len(framework.chains)
    starts = [*framework.starts, framework.node_count - framework.singles]
    nodes = [range(a, b) for a, b in pairwise(starts)]
    nodes += [range(a, a + 1) for a in range(starts[-1], framework.node_count)]
    part_of = {node: part for part, part_nodes in enumerate(nodes) for node in part_nodes}
    joined = [
        {part_of[node] for node in edge.nodes if node is not None}
        for rows in connectivity.edges
        for edge in rows
    ]
    degree = {part: sum(part in pair for pair in joined) for part in range(chains, len(nodes))}
    candidates = []
    for least in {*degree.values(), max(degree.values(), default=0) + 1}:
        shared = tuple(part for part, count in degree.items() if count >= least)
        groups = _components([k for k in range(len(nodes)) if k not in shared], joined)
        if LEAST <= len(groups) <= MOST:
            candidates.append((len(groups), groups, shared))
    for _, groups, shared in sorted(candidates, reverse=True):
        cells = _alike(connectivity, kinds, nodes, groups, shared)
        if cells is not None:
            return cells
    return None


def _components(parts: list[int], joined: list[set[int]]) -> list[list[int]]:
    """Of these parts, by what couples them."""
    root = {part: part for part in parts}
    for pair in joined:
        there = [part for part in pair if part in root]
        for one in there[1:]:
            a, b = root[there[0]], root[one]
            root = {part: a if top == b else top for part, top in root.items()}
    return [[p for p in parts if root[p] == top] for top in dict.fromkeys(root.values())]


def _alike(
    connectivity: Connectivity,
    kinds: Kinds,
    nodes: list[range],
    groups: list[list[int]],
    shared: tuple[int, ...],
) -> Cells | None:
    """Of these parts, if they are alike."""
    framework, supports, every, _ = connectivity
    (which,) = (k for k, sort in enumerate(INTERACTIONS) if sort.celled)
    edges, sorts = every[which], (NODES, ELEMENTS, INTERACTIONS[which].rows)
    chains, order = len(framework.chains), framework.order
    common = [node for part in shared for node in nodes[part]]
    firsts = [sum(framework.chains[:k]) for k in range(chains)]
    cells = []
    for group in groups:
        of_group = [node for part in group for node in nodes[part]]
        own_nodes, beams = {*of_group}, [part for part in group if part < chains]
        place = {node: k for k, node in enumerate((*of_group, *common))}
        inner = [k for k, edge in enumerate(edges) if own_nodes & {*edge.nodes}]
        inner += [k for k, edge in enumerate(edges) if {*edge.nodes} <= {*common, None}]
        held_nodes = [k for k, node in enumerate(supports) if node in place]
        rows = {
            NODES: [*of_group, *common],
            ELEMENTS: [firsts[k] + e for k in beams for e in range(framework.chains[k])],
            sorts[-1]: inner,
            MULTIPLIERS: inner,
            SUPPORTS: sorted(held_nodes, key=lambda k: place[supports[k]]),
        }
        place[None] = None
        own_edges = tuple(
            edges[k]._replace(nodes=tuple(place[node] for node in edges[k].nodes)) for k in inner
        )
        own_framework = Framework(
            order,
            tuple(framework.chains[k] for k in beams),
            len(group) - len(beams) + len(common),
            tuple(edge.nodes for edge in own_edges),
        )
        of_rows = zip((*kinds[:2], kinds.between[which]), sorts, strict=True)
        *of_beams, of_edges = (tuple(there[k] for k in rows[sort]) for there, sort in of_rows)
        between = tuple(of_edges if k == which else () for k in range(len(INTERACTIONS)))
        own_kinds = Kinds(*of_beams, between)
        own_supports = tuple(place[supports[k]] for k in rows[SUPPORTS])
        celled = tuple(own_edges if k == which else () for k in range(len(INTERACTIONS)))
        alone = Connectivity(own_framework, own_supports, celled, len(common))
        cells.append((alone, own_kinds, rows))
    (first, own_kinds, first_rows), (_, _, next_rows) = cells[:2]
    if not first.framework.chains or any(cell[:2] != (first, own_kinds) for cell in cells):
        return None
    rows = {
        sort: [(a, b - a) for a, b in zip(first_rows[sort], next_rows[sort], strict=True)]
        for sort in first_rows
    }
    for k, (_, _, own_rows) in enumerate(cells):
        if any(own_rows[sort] != [a + k * step for a, step in rows[sort]] for sort in rows):
            return None
    order = order_of(first)
    if order.own_groups is None:
        return None
    own_kinds = own_kinds._replace(runs=manners_by(first.framework, order))
    return Cells(len(cells), first, own_kinds, rows)
