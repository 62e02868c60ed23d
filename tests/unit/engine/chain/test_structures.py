"""The order in which native code eliminates a structure's nodes and joints; what comes of it:
properties/test_parity.py.
"""

import random

from torchbeam.engine.chain.interaction_sorts import INTERACTIONS
from torchbeam.engine.chain.order import Connectivity, order_of
from torchbeam.engine.chain.sorts import Edge
from torchbeam.topology.cut import cut
from torchbeam.topology.framework import Framework
from torchbeam.topology.order import Constraint, Elimination


def test_order_of_elimination():
    """A tree of two welds on a supported node goes leaf by leaf, each node with its joint; a third
    weld closes a loop and comes last.
    """
    pairs, held = ((0, 1), (2, 3), (3, 0)), (6, 6, 5)
    joints = {4 + k: Constraint(*one) for k, one in enumerate(zip(pairs, held, strict=True))}
    tree = {unit: joints[unit] for unit in (4, 5)}
    couplings = [(1, 2), (0, 4), (1, 4), (0, 1), (2, 5), (3, 5), (2, 3)]
    groups, _ = Elimination(4, 6, tree, couplings).ordered(frozenset({0}))
    assert sorted(unit for group in groups for unit in group) == list(range(6))
    assert (1, 4) in groups and any({2, 3} & set(group) and 5 in group for group in groups)
    loop = Elimination(4, 7, joints, [*couplings, (3, 6), (0, 6)])
    closed, _ = loop.ordered(frozenset({0, 1}))
    assert closed[-1] == (4,) and not any(4 in group for group in closed[:-1])


def test_a_constraint_of_three_nodes_comes_last():
    """And what couples in no order has no place in a tree."""
    three = {3: Constraint((0, 1, 2), 1), 4: Constraint((None, 0), 6)}
    couplings = [(0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3), (0, 4)]
    groups, _ = Elimination(3, 6, three, [*couplings, (2, 5)]).ordered(frozenset())
    assert groups[-1] == (3,) and (0, 4) in groups and (5,) in groups


def welded(chains, pairs):
    """Beams of so many elements, welded at pairs of nodes."""
    edges = tuple(
        tuple(Edge(pair, 6) for pair in pairs) if one.celled else () for one in INTERACTIONS
    )
    return Connectivity(Framework(1, chains, joints=pairs), edges=edges)


def test_trees_have_no_borders():
    """However their beams are listed and welded at their ends and in their middles, runs of trees
    go on from nodes that are eliminated before; of a loop, some do not.
    """
    draw = random.Random(4)
    for beams in (2, 3, 6, 9):
        numbers = draw.sample(range(beams), beams)  # of each beam in the list
        chains = tuple(draw.randint(2, 4) for _ in range(beams))
        starts = Framework(1, chains).starts

        def node(k, starts=starts, chains=chains, numbers=numbers):
            beam = numbers[k]
            return starts[beam] + draw.choice((0, 1, chains[beam]))

        joints = tuple((node(draw.randrange(k)), node(k)) for k in range(1, beams))
        order = order_of(welded(chains, joints))
        assert not order.bordered
        between = sum(
            run.manner == "between" for runs in cut(chains, 0, joints).runs for run in runs
        )
        assert len(order.following) == between
    ring = tuple((3 * k + 2, 3 * (k + 1) % 12) for k in range(4))
    assert order_of(welded((2,) * 4, ring)).bordered
