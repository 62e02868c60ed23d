"""Lanes of the cells of a structure: steps and gradients are the eager ones.

Tolerances are those of `test_structures`, for the same reasons.
"""

import math

import pytest
import torch

import torchbeam as tb
from torchbeam.engine.chain.cells import cells_of
from torchbeam.engine.chain.layout import JOINTS
from torchbeam.engine.chain.node_kinds import kinds_of
from torchbeam.engine.chain.order import Connectivity, connectivity_of, order_of
from torchbeam.nodal.discretise import discretise
from torchbeam.topology.framework import Framework

FIELDS = "position", "rotation", "velocity", "spin", "stress", "reaction", "joints"


def hand(stiffness=0.5, held=False, fingers=3, unlike=(), elements=(2, 1), more=()):
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
        laws = dict(axis=(0, 0, 1), stiffness=stiffness * (1 + k), damping=0.01)
        joints.append(tb.Hinge("palm", (f"a{k}", 0), at=begins[0] * way, **laws))
        joints.append(tb.Hinge((f"a{k}", -1), (f"b{k}", 0), torque=tb.Input(f"m{k}", 1), **laws))
    supports = [tb.Support("palm")] if held else []
    if not held:
        joints.append(tb.Hinge(None, "palm", axis=(0, 0, 1), at=(0, 0, 0), stiffness=0.1))
    return tb.Scene(parts, loads, joints=joints, supports=supports, plane="xy")


def run(scene, engine):
    inputs = {name: (lambda t, k=k: 0.01 * k + t) for k, name in enumerate(scene.inputs)}
    t = torch.linspace(0, 0.06, 4)
    return tb.simulate(scene, t, step=0.02, tolerance=1e-12, engine=engine, inputs=inputs)


def fields(solution):
    pairs = {name: getattr(solution.state, name) for name in FIELDS}
    return {name: x for name, x in pairs.items() if x is not None and x.numel()}


def cells(scene):
    model = discretise(scene)
    return cells_of(connectivity_of(model), kinds_of(model, ()))


@pytest.mark.parametrize("held", [False, True])
def test_as_eagerly(held):
    """On a hub that turns, and one that is held, whose reaction is of all cells; three cells in
    four lanes. The same status and iterations; the work is counted once.
    """
    scene = hand(held=held)
    stepper = tb.Stepper(scene, 0.02, engine="compiled")
    assert stepper.compiled.structure.by_cells.cells.count == 3
    found, expected = run(scene, "compiled"), run(scene, "eager")
    for (name, a), b in zip(fields(found).items(), fields(expected).values(), strict=True):
        assert float((a - b).abs().max()) <= 1e-11 * max(1.0, float(b.abs().max())), name
    torch.testing.assert_close(found.state.work, expected.state.work, rtol=1e-11, atol=1e-13)
    assert torch.equal(found.stats.iterations, expected.stats.iterations)


def test_gradients_are_the_eager_ones():
    """By a number that all cells read, of a functional of all fields; 1e-9."""

    def gradient(engine):
        stiffness, loss = torch.tensor(0.5, requires_grad=True), 0.0
        generator = torch.Generator().manual_seed(1)
        for x in fields(run(hand(stiffness), engine)).values():
            loss = loss + (x * torch.randn(x.shape, generator=generator)).sum()
        return torch.autograd.grad(loss, stiffness)[0]

    torch.testing.assert_close(gradient("compiled"), gradient("eager"), rtol=1e-9, atol=0)


def test_alone_and_in_a_batch():
    """A sample alone, cell by cell, and a lane in a batch that fills the lanes: to rounding."""
    stiffness = 0.5 + 0.1 * torch.arange(9.0)
    batch, alone = (run(hand(x), "compiled") for x in (stiffness, stiffness[4]))
    for (name, a), b in zip(fields(batch).items(), fields(alone).values(), strict=True):
        torch.testing.assert_close(a[:, 4], b, rtol=1e-10, atol=1e-10, msg=name)


def test_what_has_cells():
    """Links of a finger are one cell; what is unlike, or joins cells, or nodes of a cell twice, is
    none; and two are too few to pay.
    """
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
