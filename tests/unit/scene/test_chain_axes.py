"""Section axes of `Beam.from_nodes` without frames: carried from element to element without twist,
at corners too.
"""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.nodal_cases import orders
from torchbeam.math import quaternions as quat

ROUND = tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=0.8, EI=1.0, mass=0.2, inertia=0.01)
FLAT = tb.Section.from_stiffness(
    EA=1e3, GA=(4e2, 3e2), GJ=0.8, EI=(1.0, 2.5), mass=0.2, inertia=(0.01, 0.02)
)
X, Y, Z = torch.eye(3)
TURN = quat.exponential(torch.tensor([0.7, -1.1, 0.4]))


def corner(n, a, b):
    """Nodes of two legs of 1 m along a and b, n/2 elements each."""
    s = torch.linspace(0, 1, n // 2 + 1)[:, None]
    return torch.cat((s * a, a + s[1:] * b))


def bent(n, a, b, order=1, **kind):
    """The tip of a corner under a force in its plane, which bends it by a third of its length."""
    beam = tb.Beam.from_nodes(corner(n, a, b), ROUND, order=order)
    return tb.equilibrium(tb.Scene(beam, [tb.TipLoad(force=-0.4 * b)], **kind)).tip.position


@pytest.mark.parametrize(
    "a, b, plane",
    [(X, Y, "xy"), (X, Z, "xz"), (Z, X, "xz"), (X, (Z - X) / 2**0.5, "xz"), (Y, Z, None)],
)
def test_a_corner_in_any_plane(a, b, plane):
    """It stays in its plane, to rounding; errors fall with the square of the element, against four
    times as many; the plane's three unknowns a node give the same answer, found by "auto" too.
    """
    tips = [bent(n, a, b) for n in (4, 8, 32)]
    normal = torch.linalg.cross(a, b)
    assert max(abs((tip @ normal).item()) for tip in tips) < 1e-12
    first, second = ((tip - tips[-1]).norm().item() for tip in tips[:2])
    assert first > 3.5 * second and second < 3e-3
    for kind in ({} if plane is None else dict(plane=plane), dict(plane="auto")):
        assert_close(bent(8, a, b, **kind), tips[1], rtol=0, atol=1e-9)


def test_the_same_corner_in_two_planes():
    """An isotropic section knows no direction: the answer in x-z is that in x-y, of elements of
    order 2 too.
    """
    for order in (1, 2):
        xy, xz = bent(8, X, Y, order), bent(8, X, Z, order)
        assert_close(xz, xy[[0, 2, 1]], rtol=0, atol=1e-10)


@pytest.mark.parametrize("order", [1, 2])
def test_turning_nodes_and_up_turns_the_answer(order):
    """Of a chain in space whose sections differ in y and z: nodes, `up` and load turned, and the
    answer is.
    """
    t = torch.linspace(0, 2, 9)
    nodes = torch.stack((t, torch.sin(t), 0.4 * t**2), -1)
    up, force = torch.tensor([0.1, -0.3, 1.0]), torch.tensor([0.2, 0.1, -0.15])

    def tip(turn):
        beam = tb.Beam.from_nodes(turn(nodes), FLAT, order=order, up=turn(up))
        return tb.equilibrium(
            tb.Scene(beam, [tb.TipLoad(force=turn(force))]), tolerance=1e-12
        ).tip.position

    assert_close(
        tip(lambda x: quat.rotate(TURN, x)), quat.rotate(TURN, tip(lambda x: x)), rtol=0, atol=1e-9
    )


def test_no_twist_along_a_helix():
    """Of radius r and pitch c axes without twist turn back about the tangent, from the normal, by
    tau = c/(r^2 + c^2) per metre (Bishop 1975): the error falls with the square of the element.
    """
    r, c, errors = 1.0, 0.5, []
    size = math.hypot(r, c)
    for n in (16, 32, 64):
        angle = torch.linspace(0, 4.0, n + 1)
        nodes = torch.stack((r * torch.cos(angle), r * torch.sin(angle), c * angle), -1)
        middle = (angle[1:] + angle[:-1]) / 2
        normal = torch.stack((-torch.cos(middle), -torch.sin(middle), 0 * middle), -1)
        beam = tb.Beam.from_nodes(nodes, FLAT, up=normal[0])
        _, y, z = quat.matrix(beam.elements).unbind(-1)
        # of the normal about the tangent, from z
        turned = torch.atan2((normal * y).sum(-1), (normal * z).sum(-1))
        wanted = -(middle - middle[0]) * c / size
        errors.append(
            (torch.remainder(turned - wanted + math.pi, 2 * math.pi) - math.pi).abs().max().item()
        )
    assert errors[-1] < 1e-3 and min(orders(errors)) > 1.9


def test_a_batch_and_its_gradient():
    """Each chain of a batch as alone; axes against differences in the nodes and in `up`."""
    torch.manual_seed(3)
    nodes = torch.tensor([[0.0, 0, 0], [1, 0, 0], [1, 0, 1], [1, 1, 1.2]]) + 0.1 * torch.randn(
        3, 4, 3
    )
    up = torch.tensor([0.2, 0.1, 1.0])
    batch = tb.Beam.from_nodes(nodes, ROUND, up=up)
    for k in range(3):
        assert_close(
            batch.frames[k], tb.Beam.from_nodes(nodes[k], ROUND, up=up).frames, rtol=0, atol=1e-14
        )
    torch.autograd.gradcheck(
        lambda nodes, up: quat.matrix(tb.Beam.from_nodes(nodes, ROUND, up=up).frames),
        (nodes[0].requires_grad_(), up.requires_grad_()),
    )


def test_refused():
    """What has no axes without twist, and two answers to one question."""
    with pytest.raises(ValueError, match="turns back on itself"):
        tb.Beam.from_nodes([[0.0, 0, 0], [1, 0, 0], [0.5, 0, 0]], ROUND)
    with pytest.raises(ValueError, match="frames and up"):
        tb.Beam.from_nodes(
            [[0.0, 0, 0], [1, 0, 0]], ROUND, frames=torch.eye(3)[None], up=(0.0, 0, 1)
        )
    with pytest.raises(ValueError, match="parallel to the beam's direction"):
        tb.Beam.from_nodes([[0.0, 0, 0], [1, 0, 0]], ROUND, up=(1.0, 0, 0))


def test_a_beam_along_z_without_up():
    """Its section's z axis is frame a's y, as it is of `from_nodes`; of a batch, in each sample
    that runs along z.
    """
    section = tb.Section.rectangle(0.03, 0.002, E=69e9, nu=0.33, rho=2700.0)
    both = tb.Beam.straight(1.0, 2, section, direction=torch.tensor([[0.0, 0, -2], [1.0, 0, -2]]))
    for k, up in enumerate(((0.0, 1, 0), (0.0, 0, 1))):
        alone = tb.Beam.straight(1.0, 2, section, direction=((0.0, 0, -2), (1.0, 0, -2))[k], up=up)
        torch.testing.assert_close(both.frames[k], alone.frames, rtol=0, atol=1e-15)
