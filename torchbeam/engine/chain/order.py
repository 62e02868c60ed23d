"""Order in which the unknowns of a structure are eliminated: those of the interface, the nodes that
joints and tendons hold, with the forces of joints; and the runs of nodes between two of these.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

from ...nodal.between_nodes import BetweenNodes
from ...nodal.model import Model
from ...topology.cut import Cut, Joints, Run
from ...topology.framework import Framework
from .layout import INTERFACE

# how nodes are eliminated, see `manners_of`
MANNERS = (
    *("backward", "bordered", "following backward", "following forward", "forward"),
    INTERFACE,
)
Couplings = list[tuple[int, int]]


class Stretch(NamedTuple):
    """Of a tendon: its two nodes, None = the ground; the tendon's number; whether it is its first,
    and its last; whether its tension depends on the others.
    """

    nodes: tuple[int | None, int | None]
    tendon: int
    first: bool
    last: bool
    coupled: bool


class Connectivity(NamedTuple):
    """What the order follows from: the framework, the nodes that supports hold, how much each joint
    holds, the stretches of tendons, the nodes of pairs that touch, how many of the last nodes
    cells share, and the nodes of couplings.
    """

    framework: Framework
    supports: tuple[int, ...] = ()
    held: tuple[int, ...] = ()
    stretches: tuple[Stretch, ...] = ()
    pairs: tuple[tuple[int, ...], ...] = ()
    shared: int = 0
    couplings: tuple[tuple[int, ...], ...] = ()


class Order(NamedTuple):
    """Units are the nodes of the interface, the joints behind them, and then the stretches of
    tendons that are coupled (`own_units`, by stretch).

    couplings  pairs of units, without those by runs
    groups     of units, in the order in which they are eliminated
    following  runs between two nodes, each with the place of the one that is eliminated first, and
               couples to nothing but the run by then: it goes on from there; in order
    bordered   the other ones: they are eliminated before their nodes, and couple them
    own_groups how many of the groups come before those of what cells share, see `Cells`; None =
               these are not apart
    """

    couplings: tuple[tuple[int, int], ...]
    own_units: dict[int, int]
    groups: tuple[tuple[int, ...], ...]
    following: tuple[tuple[Run, int], ...]
    bordered: tuple[Run, ...]
    own_groups: int | None


def connectivity_of(model: Model) -> Connectivity:
    """Of a whole model."""
    joints = model.joints
    held = tuple(map(int, joints.held.sum(-1))) if joints.count else ()
    pairs = getattr(model.touching, "nodes", ())
    supports, stretches = model.constraints.nodes, stretches_of(model.tendons)
    couplings = tuple(one.nodes for one in model.scene.interactions)
    return Connectivity(model.topology, supports, held, stretches, pairs, couplings=couplings)


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


def stretches_of(tendons: BetweenNodes) -> tuple[Stretch, ...]:
    """Of all tendons, one after the other."""
    stretches, pairs = [], tendons.stretches
    for s, (k, e) in enumerate(pairs):
        first, last = s == 0 or pairs[s - 1][0] < k, s + 1 == len(pairs) or pairs[s + 1][0] > k
        rope = tendons.ropes[k]
        coupled = rope.stiffness is not None or rope.friction is not None
        stretches.append(Stretch(tendons.nodes[e : e + 2], k, first, last, coupled))
    return tuple(stretches)


@lru_cache(maxsize=64)
def order_of(connectivity: Connectivity) -> Order:
    """The order of a structure."""
    framework, supports, held, stretches, pairs, shared, couplings_of = connectivity
    how, ends = framework.cut, framework.ends
    nodes = [ends[end] for end in how.interface]
    couplings = _of_joints(how)
    own_units, units = {}, len(nodes) + len(how.joints)
    for s, stretch in enumerate(stretches):
        there = [nodes.index(node) for node in stretch.nodes if node is not None]
        couplings += [(there[0], there[1])] if len(there) == 2 else []
        if stretch.coupled:
            own_units[s] = unit = units + len(own_units)
            couplings += [(place, unit) for place in there]
            couplings += [] if stretch.first else [(unit - 1, unit)]
    place = {node: k for k, node in enumerate(nodes)}
    touching = {frozenset(place[node] for node in own) for own in (*pairs, *couplings_of)}
    couplings += sorted({pair for own in touching for pair in combinations(sorted(own), 2)})
    fixed = frozenset(k for k, node in enumerate(nodes) if node in supports)
    between = [run for runs in how.runs for run in runs if run.manner == "between"]
    places = tuple((run.before, run.after) for run in between)
    last = frozenset(range(len(nodes) - shared, len(nodes)))
    groups, following = ordered(
        len(nodes), how.joints, held, fixed, couplings, places, len(own_units), last
    )
    common = last | {
        len(nodes) + k for k, pair in enumerate(how.joints) if {*pair} <= {*last, None}
    }
    of_common = [bool(common & {*group}) for group in groups]
    apart = of_common == sorted(of_common) and all(
        common >= {*group} for group, own in zip(groups, of_common, strict=True) if own
    )
    return Order(
        tuple(couplings),
        own_units,
        groups,
        tuple((between[k], place) for k, place in following.items()),
        tuple(run for k, run in enumerate(between) if k not in following),
        of_common.count(False) if apart else None,
    )


def _of_joints(how: Cut) -> Couplings:
    """Couplings by joints, and by elements between two nodes of the interface."""
    couplings = [(i, j) for _, i, j in how.direct]
    for k, pair in enumerate(how.joints):
        there = [place for place in pair if place is not None]
        couplings += [(place, len(how.interface) + k) for place in there]
        couplings += [(there[0], there[1])] if len(there) == 2 else []
    return couplings


def ordered(
    nodes: int,
    joints: Joints,
    held: tuple[int, ...],
    fixed: frozenset[int],
    couplings: Couplings,
    runs: tuple[tuple[int, int], ...] = (),
    stretches: int = 0,
    last: frozenset[int] = frozenset(),
) -> tuple[tuple[tuple[int, ...], ...], dict[int, int]]:
    """Groups of units, the nodes of the interface and behind them the joints, in the order in which
    they are eliminated where every node has inertia, or a joint that keeps it from turning; and of
    the runs, between pairs of nodes, those that follow one of them, by number, in order. Units of
    stretches, which come last, are each a group.

    Joints make trees, whose roots are the ground and what supports hold. A node and the joint by
    which it hangs on its tree are one group, behind those that hang on it: whatever is fixed
    elsewhere, they have a solution. Joints that close loops come last, together. Of what may come
    next, what couples to the least does: a run counts as one, and where a group couples to nothing
    else, it is eliminated behind the group; else it has coupled its two nodes before. Nodes that
    come `last` do so.
    """
    parent = _trees(nodes, joints, held, fixed, () if last else runs, last)
    hanging = {joint: node for node, joint in parent.items()}
    behind = {
        node: (node,) + ((nodes + parent[node],) if node in parent else ()) for node in range(nodes)
    }
    units = nodes + len(joints) + stretches
    alone = range(nodes + len(joints), units)
    behind |= {unit: (unit,) for unit in alone}
    waits: dict[int, set[int]] = {node: set() for node in (*range(nodes), *alone)}
    for node in last:
        waits[node] |= {*range(nodes)} - last
    for joint, node in hanging.items():
        other = next((x for x in joints[joint] if x is not None and x != node), None)
        if other is not None:
            waits[other].add(node)
    loops = tuple(nodes + k for k in range(len(joints)) if k not in hanging)
    near: dict[int, set[int]] = {unit: set() for unit in range(units + len(runs))}
    of_runs = [(end, units + k) for k, pair in enumerate(runs) for end in pair]
    for one, other in (*couplings, *of_runs):
        near[one].add(other)
        near[other].add(one)
    groups, following, left = [], {}, {*range(nodes), *alone}

    owner = {unit: node for node in left for unit in behind[node]}
    known: dict[int, set[int]] = {}

    def reach(node: int) -> set[int]:
        if node not in known:
            own = behind[node]
            known[node] = set().union(*(near[unit] for unit in own)).difference(own)
        return known[node]

    def couple(unit: int, others: Iterable[int], gone: Iterable[int] = ()) -> None:
        near[unit] = near[unit].union(others).difference(gone, (unit,))
        known.pop(owner.get(unit, unit), None)

    def forget(run: int) -> tuple[int, int]:
        ends = runs[run - units]
        for end in ends:
            couple(end, (), (run,))
        return ends

    while left:
        node = min(
            (node for node in left if not waits[node] & left),
            key=lambda node: (len(reach(node)), node),
        )
        crossed = [unit for unit in reach(node) if unit >= units]
        if crossed and len(reach(node)) == 1:
            following[crossed[0] - units] = node
            forget(crossed[0])
        else:
            for run in crossed:
                a, b = forget(run)
                couple(a, (b,))
                couple(b, (a,))
        around = reach(node)
        for unit in around:
            couple(unit, around, behind[node])
        groups.append(behind[node])
        left.remove(node)
    return (*groups, *((loops,) if loops else ())), following


def _trees(
    nodes: int,
    joints: Joints,
    held: tuple[int, ...],
    fixed: frozenset[int],
    runs: tuple[tuple[int, int], ...],
    last: frozenset[int],
) -> dict[int, int]:
    """By which joint a node hangs on the tree that it is in: those that hold more come first. A
    tree that is reached along a run has its root there, so that what lies beyond is eliminated
    before the run; one with nodes that come `last`, if the ground is not in it, one of them.
    """
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
    across: dict[int, list[int]] = {k: [] for k in range(nodes + 1)}
    for a, b in runs:
        across[a].append(b)
        across[b].append(a)
    parent: dict[int, int] = {}
    seen, done = {*fixed}, set()
    others = sorted(range(nodes), key=lambda node: (node not in last, -len(tree[node])))
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
            for other, k in tree[node]:
                if other not in seen:
                    seen.add(other)
                    parent[other] = k
                    todo.append(other)
    return parent
