"""Joints' forces, gaps and tangents against their derivatives, at random poses."""

import pytest
import torch
from torch.func import jacrev
from torch.testing import assert_close

import torchbeam as tb
from cases.rows import ENDS, joined
from torchbeam.math import quaternions as quat
from torchbeam.nodal.between_nodes import NodeMotion
from torchbeam.nodal.discretise import discretise
from torchbeam.scene.joint import Joint

SECTION = tb.Section.from_stiffness(EA=30.0, GA=10.0, GJ=0.7, EI=1.0, mass=0.3, inertia=1e-3)
AXIS, ACROSS = (0.6, 0.0, 0.8), (0.8, 0.0, -0.6)
JOINTS = {
    "weld": lambda a, b: tb.Weld(a, b),
    "ball": lambda a, b: tb.Ball(a, b, at=(0.9, 0.2, 0.1)),
    "hinge": lambda a, b: tb.Hinge(a, b, axis=AXIS, at=(0.9, 0.2, 0.1)),
    "universal": lambda a, b: tb.Universal(a, b, axis=AXIS, second=ACROSS, at=(0.9, 0.2, 0.1)),
    "slider": lambda a, b: tb.Slider(a, b, axis=AXIS),
    "cylindrical": lambda a, b: tb.Cylindrical(a, b, axis=AXIS),
    "distance": lambda a, b: tb.Distance(a, b),
}
PAIRS = {
    "beam and body": (("arm", -1), "hub"),
    "body and beam": ("hub", ("arm", 1)),
    "ground": (None, "hub"),
}


def joints(kind, pair):
    a, b = PAIRS[pair]
    joint = (
        tb.Distance(a, b, at=(0.9, 0.2, 0.1))
        if kind == "distance" and a is None
        else JOINTS[kind](a, b)
    )
    parts = {
        "arm": tb.Beam.straight(1.0, 2, SECTION),
        "hub": tb.Body(0.2, 0.01, position=(1.2, 0.3, -0.1)),
    }
    return discretise(tb.Scene(parts, joints=[joint], supports=[tb.Support(("arm", 0))]))


def random(*shape):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(sum(shape)))


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("kind", JOINTS)
def test_tangent_is_the_derivative(kind, pair):
    """Of the forces of a step, which act at the mean of its two ends, and of the gaps at its end,
    by mid-step moves: the spin s of R_mid turns the end by (I + R_mid R_n^T) s. Forces do the work
    of the multipliers on the gaps' increments.
    """
    model = joints(kind, pair)
    own, n = model.joints, model.node_count
    start = (random(n, 3), quat.normalize(random(n, 4)))
    u, m, force = random(n, 3), quat.exponential(0.3 * random(n, 3)), random(1, 6)

    def end(move):
        turned = quat.multiply(quat.exponential(move[:, 3:]), quat.multiply(start[1], m))
        half = quat.multiply(quat.conjugate(start[1]), turned)
        return start[0] + 2 * (u + move[:, :3]), quat.multiply(turned, half)

    def half():
        R, R_n = (quat.matrix(q) for q in (quat.multiply(start[1], m), start[1]))
        return (torch.eye(3) + R @ R_n.mT) / 2

    def step(move):
        return NodeMotion(None, None, None, end(move), start, mean=True, half=half)

    def loaded(move):
        return own.balance(none, torch.zeros(0, 6), force, step(move))[0]

    none = torch.zeros(n, 6)
    load = jacrev(loaded)(none)
    gap = jacrev(lambda move: own.gap(own.pose(*end(move))))(none)
    blocks = own.blocks(step(none), force)
    matrix = own.tied(model.topology.diagonal(torch.zeros(n, 6, 6)), blocks, own.held)
    assert_close(matrix.dense().view(n, 6, n, 6), load, rtol=0, atol=1e-12)
    held = own.held.flatten() > 0
    assert_close(matrix.constraints().view(-1, n, 6), gap[0][held], rtol=0, atol=1e-12)
    steady = own.blocks(NodeMotion(None, None, None, start), force)
    moved = jacrev(
        lambda move: own.gap(
            own.pose(start[0] + move[:, :3], quat.multiply(quat.exponential(move[:, 3:]), start[1]))
        )
    )
    matrix = own.tied(model.topology.diagonal(torch.zeros(n, 6, 6)), steady, own.held)
    assert_close(matrix.constraints().view(-1, n, 6), moved(none)[0][held], rtol=0, atol=1e-12)
    after = end(none)
    turn = quat.multiply(after[1], quat.conjugate(start[1]))
    theta = 2 * turn[:, 1:] / turn[:, :1]
    work = (loaded(none) * torch.cat((after[0] - start[0], theta), -1)).sum()
    increment = own.gap(own.pose(*after)) - own.gap(own.pose(*start))
    assert_close(work, (force * increment).sum(), rtol=0, atol=1e-10)


@pytest.mark.parametrize("kind", JOINTS)
def test_holds_as_many_as_it_says_where_it_is_drawn(kind):
    """Closed as drawn; as many independent constraints as the joint holds."""
    for pair in ("beam and body", "ground"):
        model = joints(kind, pair)
        own, beam = model.joints, model.scene.beam
        drawn = beam.nodes, beam.frames
        pose = own.pose(*drawn)
        assert_close(own.gap(pose), torch.zeros(1, 6), rtol=0, atol=1e-15)
        blocks = own.blocks(NodeMotion(None, None, None, drawn), torch.zeros(1, 6))
        none = model.topology.diagonal(torch.zeros(model.node_count, 6, 6))
        G = own.tied(none, blocks, own.held).constraints()
        assert int(torch.linalg.matrix_rank(G)) == model.scene.joints[0].holds == len(G)


class InPlane(Joint):
    """b stays in a plane of a, and turns about its normal alone."""

    position, rotation, meets = "z", "xy", False


@pytest.mark.parametrize("engine", ["eager", "compiled"])
@torch.no_grad()
def test_a_joint_that_holds_other_letters_is_its_class_alone(engine):
    """Nothing else knows it, in either engine; it holds what it says, and leaves the rest."""
    scene = joined(InPlane(*ENDS))
    end = tb.simulate(scene, torch.linspace(0, 0.05, 3), step=0.025, engine=engine).state[-1]
    axes, hub = end.axes[2], end.position[3]
    apart, turn = axes.mT @ (hub - end.position[2]), axes.mT @ end.axes[3]
    assert abs(apart[2]) < 1e-14 and turn[2, :2].abs().max() < 1e-14
    assert apart[:2].abs().min() > 1e-3 and turn[1, 0] > 1e-2
