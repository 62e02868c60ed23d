"""Which cells of a structure go through lanes; what comes of it: properties/test_parity.py."""

import torchbeam as tb
from tests.cases import parity_scenes
from torchbeam.engine.chain.cells import cells_of
from torchbeam.engine.chain.interaction_sorts import INTERACTIONS
from torchbeam.engine.chain.kinds import kinds_of
from torchbeam.engine.chain.order import Connectivity, connectivity_of, order_of
from torchbeam.engine.chain.sorts import Edge
from torchbeam.nodal.discretise import discretise
from torchbeam.topology.framework import Framework


def hand(**options):
    scene, _ = parity_scenes.hand(parity_scenes.Draw(), **options)
    return scene


def cells(scene):
    model = discretise(scene)
    return cells_of(connectivity_of(model), kinds_of(model, ()))


def test_what_has_cells():
    """Links of a finger are one cell; what is unlike, or joins cells, or nodes of a cell twice, is
    none; and two are too few to pay.
    """
    stepper = tb.Stepper(hand(), 0.02, engine="compiled")
    assert stepper.compiled.structure.by_cells.cells.count == 3
    own = cells(hand())
    alone = own.connectivity
    assert own.count == 3 and alone.framework.chains == (2, 1) and alone.shared == 1
    assert len(alone.edges[0]) == 3 and sum(step != 0 for _, step in own.rows["joints"]) == 2
    assert cells(hand(held=True)).connectivity.supports == (5,)
    assert cells(hand(fingers=2)) is None
    ties = [tb.Weld(("a0", 1), ("a1", 1))]
    assert cells(hand(joints=ties)) is None
    stays = [tb.Distance((f"a{k}", 1), (f"b{k}", -1)) for k in range(3)]
    assert cells(hand(joints=stays)).count == 3
    twice = Framework(1, (1, 1), 1, ((1, 2), (2, 1), (0, 4)))  # nodes of a cell, joined twice
    edges = tuple(map(Edge, twice.joints, (5, 1, 6))), *((),) * (len(INTERACTIONS) - 1)
    assert order_of(Connectivity(twice, edges=edges, shared=1)).own_groups is None
    floor = tb.Contact(tb.Plane((0.0, -0.12, 0), (0, 1.0, 0)), thickness=0.1, force=0.5)
    for unlike in (tb.Drag(1.0, 0.1, on="b0"), floor):  # of an obstacle each part has a piece
        stepper = tb.Stepper(hand(effects=[unlike]), 0.02, engine="compiled")
        assert stepper.compiled.structure.by_cells is None
