"""Tables of a structure: which runs of nodes its code eliminates, from which end, and where what
they leave is put into the system of the interface.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, product
from typing import NamedTuple

from ...nodal.model import Model
from ...nodal.tendon_motion import NoTendons
from ...topology.cut import Joints
from ...topology.framework import Framework
from ..compiler.block_pattern import BlockPattern
from .joint_functions import BLOCKS
from .layout import ENTRIES, INTERFACE, JOINTS, PAIRS, STRETCHES, TENDONS

NONE = (-1, -1)  # the place of a block that is not there


class Stretch(NamedTuple):
    """Of a tendon: its two nodes, None = the ground; the tendon's number; whether it is its first,
    and its last; whether its tension depends on the others.
    """

    nodes: tuple[int | None, int | None]
    tendon: int
    first: bool
    last: bool
    coupled: bool


@dataclass(frozen=True)
class StructureTables:
    """rows: how many there are of a structure's records; lists: tables of integers; numbers: how
    many entries they have.
    """

    rows: dict[str, int]
    lists: dict[str, list[int]]
    numbers: dict[str, int]

    @staticmethod
    def of(model: Model) -> StructureTables:
        joints = model.joints
        held = tuple(map(int, joints.held.sum(-1))) if joints.count else ()
        w, supported = model.space.unknowns, model.constraints.nodes
        pairs = getattr(model.touching, "nodes", ())
        return _tables(model.topology, w, supported, held, _stretches(model.tendons), pairs)


def _stretches(tendons: NoTendons) -> tuple[Stretch, ...]:
    found, pairs = [], tendons.stretches
    for s, (k, e) in enumerate(pairs):
        first, last = s == 0 or pairs[s - 1][0] < k, s + 1 == len(pairs) or pairs[s + 1][0] > k
        rope = tendons.ropes[k]
        coupled = rope.stiffness is not None or rope.friction is not None
        found.append(Stretch(tendons.nodes[e : e + 2], k, first, last, coupled))
    return tuple(found)


@lru_cache(maxsize=64)
def _tables(
    framework: Framework,
    w: int,
    supported: tuple[int, ...],
    held: tuple[int, ...],
    stretches: tuple[Stretch, ...],
    pairs: tuple[tuple[int, ...], ...],
) -> StructureTables:
    how, ends = framework.cut, framework.ends
    nodes, J = [ends[end] for end in how.interface], len(how.joints)
    couplings = [(i, j) for _, i, j in how.direct]
    runs = [run for runs in how.runs for run in runs]
    forward, backward, bordered = (
        [run for run in runs if run.manner == manner]
        for manner in ("forward", "backward", "bordered")
    )
    couplings += [(run.before, run.after) for run in bordered]
    for k, pair in enumerate(how.joints):
        there = [place for place in pair if place is not None]
        couplings += [(place, len(nodes) + k) for place in there]
        couplings += [(there[0], there[1])] if len(there) == 2 else []
    fixed = frozenset(k for k, node in enumerate(nodes) if node in supported)
    own_units, units = {}, len(nodes) + J  # of stretches that are coupled
    for s, stretch in enumerate(stretches):
        there = [nodes.index(node) for node in stretch.nodes if node is not None]
        couplings += [(there[0], there[1])] if len(there) == 2 else []
        if stretch.coupled:
            own_units[s] = unit = units + len(own_units)
            couplings += [(place, unit) for place in there]
            couplings += [] if stretch.first else [(unit - 1, unit)]
    place = {node: k for k, node in enumerate(nodes)}
    pairs = tuple(tuple(place[node] for node in own) for own in pairs)
    for own in set(pairs):
        couplings += combinations(sorted(set(own)), 2)
    groups = ordered(len(nodes), how.joints, held, fixed, couplings, len(own_units))
    groups, equation = _equations(groups, len(nodes), held, w)
    blocks = [(equation[a], b) for pair in couplings for a, b in (pair, pair[::-1])]
    blocks += [(equation[node], node) for node in range(len(nodes))]
    pattern = BlockPattern(w, groups, blocks)

    def own(place: int | None) -> tuple[int, ...]:
        if place is None:
            return (*NONE, *NONE)
        return (*between(place, place), *pattern.right(equation[place]))

    def between(row: int, column: int) -> tuple[int, int]:
        return pattern.place(equation[row], column)

    def joint(k: int) -> list[int]:
        pair, row = how.joints[k], len(nodes) + k
        place = dict(zip("ij", pair, strict=True))
        table = [0 if place[side] is None else nodes[place[side]] for side in "ij"]
        for name in BLOCKS:
            rows, columns = (row if side == "" else place[side] for side in BLOCKS[name])
            there = rows is not None and columns is not None
            there = there and (name != "idle" or equation[row] == row)  # a weld has none
            table += between(rows, columns) if there else NONE
        return [*table, *pattern.right(equation[row]), pattern.solution(row)]

    def stretch(s: int) -> list[int]:
        own, unit = stretches[s], own_units.get(s)
        at = {
            side: None if x is None else nodes.index(x)
            for side, x in zip("ij", own.nodes, strict=True)
        }
        at[""] = unit
        table = [node or 0 for node in own.nodes]
        table += [int(own.first), int(own.last), own.tendon]
        pairs = [tuple(at[side] for side in BLOCKS[name]) for name in BLOCKS]
        before = None if unit is None or own.first else unit - 1
        pairs += [(unit, before), (before, unit)]
        for pair in pairs:
            table += NONE if None in pair else between(*pair)
        return table + (
            [*NONE, -1] if unit is None else [*pattern.right(unit), pattern.solution(unit)]
        )

    left, right = ([-1] * framework.node_count for _ in range(2))
    for e, (first, *_, last) in enumerate(zip(*framework.elements, strict=True)):
        right[first], left[last] = e, e
    lists = {
        "element_nodes": list(framework.elements[0]),
        "left_elements": left,
        "right_elements": right,
        "interface": [
            x for k, node in enumerate(nodes) for x in (node, *own(k), pattern.solution(k))
        ],
        "direct": [x for _, i, j in how.direct for x in (i, j, *between(i, j), *between(j, i))],
        "forward": [
            x
            for run in forward
            for x in (
                ends[run.first],
                run.count,
                -1 if run.after is None else run.after,
                *own(run.after),
            )
        ],
        "backward": [
            x
            for run in backward
            for x in (ends[run.first + run.count - 1], run.count, run.before, *own(run.before))
        ],
        "bordered": [
            x
            for run in bordered
            for x in (
                ends[run.first],
                run.count,
                run.before,
                run.after,
                *own(run.before),
                *own(run.after),
                *between(run.before, run.after),
                *between(run.after, run.before),
            )
        ],
        "joint_table": [x for k in range(J) for x in joint(k)],
        "stretch_table": [x for s in range(len(stretches)) for x in stretch(s)],
        "pair_table": [
            x
            for own in pairs
            for x in (
                *(nodes[at] for at in own),
                *(number for pair in product(own, own) for number in between(*pair)),
            )
        ],
        "elimination": pattern.elimination,
        "substitution": pattern.substitution,
    }
    numbers = {
        "interface_count": len(nodes),
        "direct_count": len(how.direct),
        "forward_count": len(forward),
        "backward_count": len(backward),
        "bordered_count": len(bordered),
        "joint_count": J,
        "stretch_count": len(stretches),
        "pair_count": len(pairs),
        "entry_count": pattern.size,
        "group_count": len(pattern.groups),
    }
    rows = {JOINTS: J, INTERFACE: len(nodes), ENTRIES: pattern.size}
    rows |= {STRETCHES: len(stretches), TENDONS: len({x.tendon for x in stretches})}
    rows |= {PAIRS: len(pairs)}
    return StructureTables(rows, lists, numbers)


def _equations(
    groups: tuple[tuple[int, ...], ...], nodes: int, held: tuple[int, ...], w: int
) -> tuple[list[tuple[int, ...]], dict[int, int]]:
    """Groups of unknowns, and whose equation stands in the row of each unit. A weld's constraints
    give the moves of the node that hangs by it, the node's balance the weld's force: two groups in
    the place of one.
    """
    parts, equation = [], {unit: unit for group in groups for unit in group}
    for group in groups:
        if group[0] < nodes and [held[unit - nodes] for unit in group[1:]] == [w]:
            node, weld = group
            equation |= {node: weld, weld: node}
            parts += [(node,), (weld,)]
        else:
            parts.append(group)
    return parts, equation


def ordered(
    nodes: int,
    joints: Joints,
    held: tuple[int, ...],
    fixed: frozenset[int],
    couplings: list[tuple[int, int]],
    stretches: int = 0,
) -> tuple[tuple[int, ...], ...]:
    """Groups of units, the nodes of the interface and behind them the joints, in the order in which
    they are eliminated where every node has inertia, or a joint that keeps it from turning. Units
    of stretches, which come last, are each a group.

    Joints make trees, whose roots are the ground and what supports hold. A node and the joint by
    which it hangs on its tree are one group, behind those that hang on it: whatever is fixed
    elsewhere, they have a solution. Joints that close loops come last, together. Of what may come
    next, what couples to the least does.
    """
    parent = _trees(nodes, joints, held, fixed)
    hanging = {joint: node for node, joint in parent.items()}
    behind = {
        node: (node,) + ((nodes + parent[node],) if node in parent else ()) for node in range(nodes)
    }
    alone = range(nodes + len(joints), nodes + len(joints) + stretches)
    behind |= {unit: (unit,) for unit in alone}
    waits: dict[int, set[int]] = {node: set() for node in (*range(nodes), *alone)}
    for joint, node in hanging.items():
        other = next((x for x in joints[joint] if x is not None and x != node), None)
        if other is not None:
            waits[other].add(node)
    loops = tuple(nodes + k for k in range(len(joints)) if k not in hanging)
    near: dict[int, set[int]] = {unit: set() for unit in range(nodes + len(joints) + stretches)}
    for one, other in couplings:
        near[one].add(other)
        near[other].add(one)
    groups, left = [], {*range(nodes), *alone}
    while left:

        def reach(node: int) -> set[int]:
            return set().union(*(near[unit] for unit in behind[node])) - set(behind[node])

        node = min(
            (node for node in left if not waits[node] & left),
            key=lambda node: (len(reach(node)), node),
        )
        around = reach(node)
        for unit in around:
            near[unit] = (near[unit] | around) - {unit, *behind[node]}
        groups.append(behind[node])
        left.remove(node)
    return (*groups, *((loops,) if loops else ()))


def _trees(
    nodes: int, joints: Joints, held: tuple[int, ...], fixed: frozenset[int]
) -> dict[int, int]:
    """By which joint a node hangs on the tree that it is in: those that hold more come first."""
    ground = nodes
    tree: dict[int, list[tuple[int, int]]] = {k: [] for k in range(nodes + 1)}
    root = {k: ground if k in fixed else k for k in range(nodes + 1)}

    def rooted(k: int) -> int:
        return k if root[k] == k else rooted(root[k])

    for k in sorted(range(len(joints)), key=lambda k: -held[k]):
        a, b = (ground if node is None or node in fixed else node for node in joints[k])
        if rooted(a) != rooted(b):
            root[rooted(a)] = rooted(b)
            tree[a].append((b, k))
            tree[b].append((a, k))
    parent: dict[int, int] = {}
    seen = {ground, *fixed}
    for start in (ground, *sorted(range(nodes), key=lambda node: -len(tree[node]))):
        if start in seen and start != ground:
            continue
        seen.add(start)
        todo = [start]
        while todo:
            node = todo.pop()
            for other, k in tree[node]:
                if other not in seen:
                    seen.add(other)
                    parent[other] = k
                    todo.append(other)
    return parent
