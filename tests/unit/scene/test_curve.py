"""States made from curves: the axes of nodes by parallel transport."""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.nodal_cases import orders
from torchbeam.math import quaternions as quat
from torchbeam.scene.curve import tangents

SECTION = tb.Section.from_stiffness(
    EA=60.0, GA=40.0, GJ=1.2, EI=(1.0, 1.7), mass=1.0, inertia=(0.02, 0.03)
)
FREE = dict(supports=())


def straight(N, **options):
    return tb.Scene(tb.Beam.straight(1.0, N, SECTION), **options)


def circle(N, angle=2.0):
    """Nodes on an arc in the x-y plane that starts along x."""
    s = torch.linspace(0, angle, N + 1)
    return torch.stack((torch.sin(s), 1 - torch.cos(s), 0 * s), -1) / angle, s


@pytest.mark.parametrize(
    "beam",
    [
        tb.Beam.straight(1.0, 5, SECTION, direction=(1.0, 2.0, -0.5), twist=0.7),
        tb.Beam.curve(1.0, 5, SECTION, (1.0, 2.0, 3.0)),
        tb.Beam.from_nodes(
            torch.tensor([[0.0, 0, 0], [0.3, 0, 0.1], [0.5, 0.2, 0.3], [0.9, 0.1, 0.3]]), SECTION
        ),
        tb.Beam.straight(1.0, 1, SECTION),
    ],
)
def test_undeformed_nodes_give_the_undeformed_state(beam):
    """And nodes that turn as a whole, not about the root's tangent, turn the axes as a whole,
    whatever they are at rest.
    """
    scene = tb.Scene(beam, **FREE)
    state, rest = tb.State.from_nodes(scene, beam.nodes), tb.rest(scene)
    for name in ("position", "rotation", "velocity", "spin"):
        assert_close(getattr(state, name), getattr(rest, name), rtol=0, atol=1e-14)
    q = quat.exponential(
        torch.linalg.cross(tangents(beam.nodes, beam.length)[0], torch.tensor([0.3, -0.5, 0.9]))
    )
    turned = tb.State.from_nodes(scene, quat.rotate(q, beam.nodes))
    assert_close(turned.axes, quat.matrix(q) @ rest.axes, rtol=0, atol=1e-13)


def test_a_wave_to_second_order():
    """Axes of y = 0.2 sin(3 x) against the exact ones, ends included: the error falls by four as
    the elements are halved; no twist out of the plane.
    """
    errors = []
    for N in (16, 32, 64):
        x = torch.linspace(0, 1, N + 1)
        state = tb.State.from_nodes(
            straight(N, **FREE), torch.stack((x, 0.2 * torch.sin(3 * x), 0 * x), -1)
        )
        angle = torch.atan(0.6 * torch.cos(3 * x))
        errors.append(
            (state.axes - quat.matrix(quat.exponential(torch.stack((0 * x, 0 * x, angle), -1))))
            .abs()
            .max()
        )
        assert_close(state.axes[..., 2], torch.eye(3)[2].expand(N + 1, 3), rtol=0, atol=1e-14)
    assert_close(orders(torch.stack(errors)), torch.full((2,), 2.0), rtol=0, atol=0.2)
    nodes, _ = circle(8)
    # the clamp's own
    assert_close(tb.State.from_nodes(straight(8), nodes).axes[0], torch.eye(3), rtol=0, atol=0)


def test_a_helix_has_no_twist():
    """Parallel transport: curvature of every element stays square to it, up to h^2, on a curve with
    torsion.
    """
    s = torch.linspace(0, 1, 65)
    nodes = torch.stack((0.8 * s, 0.1 * torch.sin(6 * s), 0.1 * torch.cos(6 * s)), -1)
    axes = tb.State.from_nodes(straight(64, **FREE), nodes).axes
    turn = quat.logarithm(quat.from_matrix(axes[:-1].mT @ axes[1:])) * 64
    assert turn[:, 1:].norm(dim=-1).min() > 3.0 and turn[:, 0].abs().max() < 3e-3


def test_twist_frames_and_elements():
    """A number is the twist of the tip, a function that of the nodes; frames of the nodes or of the
    elements, as in a beam.
    """
    scene = straight(4)
    even = tb.State.from_nodes(scene, scene.beam.nodes, twist=0.8)
    same = tb.State.from_nodes(scene, scene.beam.nodes, twist=lambda s: 0.8 * s)
    assert_close(even.axes[-1, :, 2], torch.tensor([0.0, -math.sin(0.8), math.cos(0.8)]))
    assert_close(even.rotation, same.rotation)
    again = tb.State.from_nodes(scene, scene.beam.nodes, even.axes)
    assert_close(again.axes, even.axes)
    nodes, _ = circle(4)
    chain = tb.Beam.from_nodes(nodes, SECTION)
    state = tb.State.from_nodes(scene, nodes, quat.matrix(chain.elements))
    assert_close(state.rotation, chain.frames)
    assert state.element_axes.shape == (4, 3, 3)
    bent = tb.equilibrium(tb.Scene(scene.beam, [tb.TipLoad(force=(0.0, 0.3, 0.2))]))
    strains = bent.element_axes.mT @ bent.nodes.diff(dim=0)[..., None] * 4
    assert_close(
        strains[..., 0] - torch.eye(3)[0],
        bent.stress[:, :3] / torch.tensor([60.0, 40, 40]),
        rtol=0,
        atol=1e-9,
    )


def test_axes_follow_the_velocity():
    """Without spin: that of the axes of nodes which move on, by differences; batches; the
    derivative by the nodes.
    """
    scene, e = straight(4, **FREE), 1e-6
    nodes = torch.stack([circle(4, a)[0] for a in (0.5, 2.0)])
    velocity = torch.randn(4, 2, 5, 3, generator=torch.Generator().manual_seed(0))[0]
    state = tb.State.from_nodes(scene, nodes, velocity=velocity)
    low, high = (tb.State.from_nodes(scene, nodes + h * velocity).rotation for h in (-e, e))
    spin = quat.logarithm(quat.multiply(quat.conjugate(low), high)) / (2 * e)
    assert_close(state.spin, spin, rtol=0, atol=1e-8)
    assert state.batch_shape == (2,) and state.velocity.equal(velocity)
    assert torch.autograd.gradcheck(
        lambda x: tb.State.from_nodes(scene, x, velocity=velocity).spin, nodes.requires_grad_()
    )


def test_in_frames_and_planes_and_to_start_from():
    """At rest in a frame that turns; a curve in the plane starts a planar motion; a sagging one
    starts an equilibrium.
    """
    turning = tb.Frame(angular_velocity=(0.0, 0.0, 2.0))
    scene = straight(8, frame=turning)
    nodes, _ = circle(8, 0.5)
    state = tb.State.from_nodes(scene, nodes)
    assert_close(state.velocity, 2 * torch.stack((-nodes[:, 1], nodes[:, 0], 0 * nodes[:, 0]), -1))
    assert_close(state.spin, torch.tensor([0.0, 0, 2]).expand(9, 3))
    same = tb.State.from_nodes(scene, nodes, velocity=state.velocity)
    assert_close(same.spin, state.spin, rtol=0, atol=1e-13)
    tb.simulate(scene, [0.0, 0.01], state, step=0.01)
    flat = straight(8, plane="xy")
    ends = [
        tb.simulate(x, [0.0, 0.02], tb.State.from_nodes(x, nodes), step=0.01).nodes
        for x in (flat, straight(8))
    ]
    assert_close(*ends, rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match="leaves the plane 'xy'"):
        tb.simulate(flat, [0.0, 0.02], tb.State.from_nodes(flat, nodes, twist=0.1))


@pytest.mark.parametrize(
    "said, options",
    [
        ("nodes of shape (4, 3) were given; (..., 5, 3) is wanted", dict(nodes=torch.zeros(4, 3))),
        ("(..., 5, 3, 3) or (..., 4, 3, 3) is wanted", dict(frames=torch.eye(3))),
        ("frames that are not orthonormal", dict(frames=2 * torch.eye(3).expand(5, 3, 3))),
        ("frames with left-handed axes", dict(frames=-torch.eye(3).expand(5, 3, 3))),
        ("frames and a twist were given", dict(frames=torch.eye(3).expand(5, 3, 3), twist=1.0)),
        ("a twist of shape (1,) was given; (..., 5) is wanted", dict(twist=lambda s: s[:1])),
        ("velocity of shape (3,) were given", dict(velocity=(0.0, 0.0, 0.0))),
        (
            "a curve that turns back on itself",
            dict(nodes=torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 0, 0], [1, 0, 0], [0, 0, 0]])),
        ),
    ],
)
def test_what_is_no_curve_is_refused(said, options):
    with pytest.raises(ValueError) as raised:
        tb.State.from_nodes(straight(4), **{"nodes": straight(4).beam.nodes, **options})
    assert said in str(raised.value)
