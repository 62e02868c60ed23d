"""Which cells of a structure go through lanes; what comes of it: properties/test_parity.py."""

import math

import torch

import torchbeam as tb
from torchbeam.engine.chain.cells import cells_of
from torchbeam.engine.chain.layout import JOINTS
from torchbeam.engine.chain.node_kinds import kinds_of
from torchbeam.engine.chain.order import Connectivity, connectivity_of, order_of
from torchbeam.nodal.discretise import discretise
from torchbeam.topology.framework import Framework


def hand(held=False, fingers=3, unlike=(), elements=(2, 1), more=()):
    """Fingers of two links, hinged to each other and to a palm that turns on the ground, or is held
    there; each of a length of its own, the first with a mass at its tip and a force of its own;
    unlike: effects, more: joints beside.
    """
    section = tb.Section.from_stiffness(
        EA=1e3, GA=4e2, GJ=0.8, EI=(1.5, 1.2), mass=0.2, inertia=1e-3
    )
    parts = {"palm": tb.Body(0.1, 1e-3)}
    joints, loads = [*more], [tb.Gravity((0.5, -9.81, 0)), tb.Damping(0.01), *unlike]
    loads.append(tb.PointMass(0.01, node=("b0", -1)))
    loads.append(tb.PointLoad(("b0", -1), force=(0, 0.1, 0)))
    for k in range(fingers):
        way = torch.tensor([math.cos(2 * k), math.sin(2 * k), 0.0])
        lengths = 0.1 + 0.01 * k, 0.08
        begins = 0.05, 0.05 + lengths[0]
        for name, length, begin, count in zip("ab", lengths, begins, elements, strict=True):
            beam = tb.Beam.straight(length, count, section, root=begin * way, direction=way)
            parts[f"{name}{k}"] = beam
        laws = dict(axis=(0, 0, 1), stiffness=0.5 * (1 + k), damping=0.01)
        joints.append(tb.Hinge("palm", (f"a{k}", 0), at=begins[0] * way, **laws))
        joints.append(tb.Hinge((f"a{k}", -1), (f"b{k}", 0), torque=tb.Input(f"m{k}", 1), **laws))
    supports = [tb.Support("palm")] if held else []
    if not held:
        joints.append(tb.Hinge(None, "palm", axis=(0, 0, 1), at=(0, 0, 0), stiffness=0.1))
    return tb.Scene(parts, loads, joints=joints, supports=supports, plane="xy")


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
    assert len(alone.held) == 3 and sum(step != 0 for _, step in own.rows[JOINTS]) == 2
    assert cells(hand(held=True)).connectivity.supports == (5,)
    assert cells(hand(fingers=2)) is None
    ties = [tb.Weld(("a0", 1), ("a1", 1))]
    assert cells(hand(more=ties)) is None
    stays = [tb.Distance((f"a{k}", 1), (f"b{k}", -1)) for k in range(3)]
    assert cells(hand(more=stays)).count == 3
    twice = Framework(1, (1, 1), 1, ((1, 2), (2, 1), (0, 4)))  # nodes of a cell, joined twice
    assert order_of(Connectivity(twice, held=(5, 1, 6), shared=1)).own_groups is None
    floor = tb.Contact(tb.Plane((0.0, -0.12, 0), (0, 1.0, 0)), thickness=0.1, force=0.5)
    for unlike in (tb.Drag(1.0, 0.1, on="b0"), floor):  # of an obstacle each part has a piece
        stepper = tb.Stepper(hand(unlike=[unlike]), 0.02, engine="compiled")
        assert stepper.compiled.structure.by_cells is None
