"""Conditions of rows: where a load acts is data, not what the load says of a beam."""

from dataclasses import replace

import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.nodal_cases import scene, state
from torchbeam.nodal.conditions import conditions
from torchbeam.nodal.discretise import discretise
from torchbeam.nodal.loads import Nodes, external, tangent


def test_a_load_acts_on_the_row_that_it_is_given():
    """A follower load of the tip, handed to row 1: forces and tangent of one at node 1, to the bit; the supports' rows stay."""
    of, t = scene(3), torch.tensor(0.2)
    force = {"force": (0.3, -0.2, 0.5), "moment": (0.1, 0.2, -0.1), "follower": True}
    tip, other = (discretise(tb.Scene(of.beam, [load])) for load in (tb.TipLoad(**force), tb.PointLoad(node=1, **force)))
    start = state(of)
    nodes = Nodes(start.position, start.rotation, start.velocity, start.spin)
    now = conditions(tip, t, {})
    moved = replace(now, loads=tuple(one._replace(node=1) for one in now.loads))
    wanted = conditions(other, t, {})
    assert_close(external(tip, nodes, moved), external(other, nodes, wanted), rtol=0, atol=0)
    assert_close(tangent(tip, nodes, moved), tangent(other, nodes, wanted), rtol=0, atol=0)
    assert external(tip, nodes, moved)[1].abs().max() > 0.1 > external(tip, nodes, moved)[-1].abs().max()


def test_loads_alone_ask_for_nothing_else():
    """Conditions of one load evaluate no other effect: an eigenstrain's input is not asked for, which all of them want."""
    scene_ = tb.Scene(scene(3).beam, [tb.TipLoad(force=(0, 0, 1.0)), tb.Actuation(curvature=tb.Input("k", 3))])
    model, t = discretise(scene_), torch.tensor(0.0)
    alone = conditions(model, t, {}, loads=scene_.loads)
    assert alone.eigenstrain == 0.0 and len(alone.loads) == 1
    whole = conditions(model, t, {"k": torch.ones(3)})
    assert_close(whole.eigenstrain[..., 3:], torch.ones(3).expand(whole.eigenstrain[..., 3:].shape), rtol=0, atol=0)
