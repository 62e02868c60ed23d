"""Order in which the unknowns of a structure are eliminated: a hypergraph, whose units are the
nodes at which something acts, and own unknowns, and whose edges are interactions; and the runs of
nodes between two of these.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

from ...nodal.model import Model
from ...topology.cut import Run
from ...topology.framework import Framework
from ...topology.order import Constraint, Elimination, Groups
from .interaction_sorts import INTERACTIONS
from .layout import INTERFACE
from .sorts import Edges

# how nodes are eliminated, see `manners_of`
MANNERS = (
    *("backward", "bordered", "following backward", "following forward", "forward"),
    INTERFACE,
)


class Connectivity(NamedTuple):
    """What the order follows from: the framework, the nodes that supports hold, the edges of each
    of `INTERACTIONS`, and how many of the last nodes cells share.
    """

    framework: Framework
    supports: tuple[int, ...] = ()
    edges: tuple[Edges, ...] = ((),) * len(INTERACTIONS)
    shared: int = 0


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
    edges = tuple(sort.functions.edges(model) for sort in INTERACTIONS)
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
    return tuple(sorted(manners | {name for name, runs in more.items() if runs}))


@lru_cache(maxsize=64)
def order_of(connectivity: Connectivity) -> Order:
    """The order of a structure."""
    framework, supports, edges, shared = connectivity
    how, ends = framework.cut, framework.ends
    nodes = [ends[end] for end in how.interface]
    fixed = frozenset(k for k, node in enumerate(nodes) if node in supports)
    last = frozenset(range(len(nodes) - shared, len(nodes)))
    owned, constraints, together = _units(nodes, edges)
    direct = {(i, j) for _, i, j in how.direct}
    couplings = tuple(sorted(direct.union(*(combinations(sorted(x), 2) for x in together))))
    between = [run for runs in how.runs for run in runs if run.manner == "between"]
    runs = tuple((run.before, run.after) for run in between)
    units = len(nodes) + sum(unit is not None for units in owned for unit in units)
    groups, following = Elimination(len(nodes), units, constraints, couplings, runs).ordered(
        fixed, last
    )
    common = last | {unit for unit, tie in constraints.items() if {*tie.ends} <= {*last, None}}
    of_common = [bool(common & {*group}) for group in groups]
    apart = of_common == sorted(of_common) and all(
        common >= {*group} for group, shared in zip(groups, of_common, strict=True) if shared
    )
    return Order(
        couplings,
        owned,
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
        owned: list[int | None] = []
        for edge in own_edges:
            there = [place[node] for node in edge.nodes if node is not None]
            has_own = edge.alone or edge.held is not None
            owned.append(unit if has_own else None)
            together.add(frozenset([*there, unit] if has_own else there))
            together |= {frozenset((unit - 1, unit))} if edge.chained else set()
            if edge.held is not None:
                ends = tuple(map(place.get, edge.nodes))
                constraints[unit] = Constraint(ends, edge.held, edge.firm)
            unit += has_own
        every.append(tuple(owned))
    return tuple(every), constraints, together
