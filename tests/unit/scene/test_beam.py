"""Beam: where the constructors put nodes, axes and lengths; gradients. Bad input: test_refusals."""

import math
import warnings

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.math import quaternions as quat
from torchbeam.nodal.element import kinematics, strains

SECTION = tb.Section.from_stiffness(EA=10.0, GA=4.0, GJ=0.5, EI=1.0, mass=0.3, inertia=0.01)


def test_straight():
    """2 m along (0, 3, 4), up z: nodes on the line, x of the section along it, y = z x x, element
    length 0.5 m.
    """
    beam = tb.Beam.straight(2.0, 4, SECTION, direction=(0, 3.0, 4), root=(1.0, 0, 0))
    assert_close(beam.nodes[-1], torch.tensor([1.0, 1.2, 1.6]))
    assert_close(beam.length, torch.full((4,), 0.5))
    axes = quat.matrix(beam.frames[2])
    assert_close(axes, torch.tensor([[0, -1, 0], [0.6, 0, -0.8], [0.8, 0, 0.6]]))
    assert_close(quat.matrix(beam.elements[0]), axes)


def test_straight_in_batches():
    """Lengths (3,), directions (2, 1, 3): a batch of (2, 3) beams, each as alone."""
    lengths, directions = torch.tensor([1.0, 2, 3]), torch.tensor([[[1.0, 0, 0]], [[0.0, 1, 0]]])
    beam = tb.Beam.straight(lengths, 2, SECTION, direction=directions)
    assert beam.batch_shape == (2, 3) and beam.station_count == 2
    for i in range(2):
        for j in range(3):
            alone = tb.Beam.straight(lengths[j], 2, SECTION, direction=directions[i, 0])
            assert_close(beam.nodes[i, j], alone.nodes)


@pytest.mark.parametrize("count", [4, 5, 9])
def test_values_along_a_beam_are_no_batch_without_a_word(count):
    """As many twists or curvatures as elements or nodes, and nothing else with a batch."""
    angles = torch.linspace(0, 1, count)
    order = 2 if count == 9 else 1
    with pytest.warns(RuntimeWarning, match=f"a twist with {count} values .* a batch of {count}"):
        assert tb.Beam.straight(1.0, 4, SECTION, twist=angles, order=order).batch_shape == (count,)
    with pytest.warns(RuntimeWarning, match=f"a curvature with {count} values"):
        tb.Beam.curve(1.0, 4, SECTION, torch.outer(angles, torch.ones(3)), order=order)


def test_what_is_a_batch_beyond_doubt_is_not_warned_of():
    of = tb.Section.from_stiffness(EA=1.0, GA=1.0, GJ=1.0, EI=torch.ones(5), mass=1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tb.Beam.straight(1.0, 4, SECTION, twist=torch.linspace(0, 1, 6))
        tb.Beam.straight(torch.ones(5), 4, SECTION, twist=torch.linspace(0, 1, 5))
        tb.Beam.straight(1.0, 4, SECTION, root=torch.ones(5, 3), twist=torch.linspace(0, 1, 5))
        tb.Beam.straight(1.0, 4, of, twist=torch.linspace(0, 1, 5))
        tb.Beam.straight(1.0, 4, SECTION, twist=torch.linspace(0, 1, 5)[:, None])
        tb.Beam.straight(1.0, 1, SECTION, twist=torch.ones(1))
        tb.Beam.straight(1.0, 4, SECTION, twist=tb.Table((0.0, 1.0), (0.0, 0.3)))


def test_arc():
    """Radius 2, quarter turn about z from x: ends at (2, 2, 0) along y; nodes on the circle, length
    R angle/N; its own curvature 1/R is the strain it starts from.
    """
    beam = tb.Beam.arc(2.0, math.pi / 2, 5, SECTION)
    assert_close(beam.nodes[-1], torch.tensor([2.0, 2, 0]))
    assert_close((beam.nodes - torch.tensor([0, 2.0, 0])).norm(dim=-1), torch.full((6,), 2.0))
    assert_close(quat.matrix(beam.frames[-1])[:, 0], torch.tensor([0.0, 1, 0]))
    assert_close(beam.length, torch.full((5,), math.pi / 5))
    h = beam.length[..., None]
    curvature = strains(
        kinematics(*beam.topology.gather(beam.nodes), *beam.topology.gather(beam.frames), h), h
    )[..., 3:]
    assert_close(curvature, torch.tensor([0, 0, 0.5]).expand(5, 3))


def test_from_nodes():
    """A right angle: elements along the chords, the corner's axes half way; section z is frame a's
    z, y where it is steep.
    """
    beam = tb.Beam.from_nodes([[0.0, 0, 0], [1, 0, 0], [1, 2, 0]], SECTION)
    assert_close(beam.length, torch.tensor([1.0, 2]))
    assert_close(quat.matrix(beam.elements)[:, :, 0], torch.tensor([[1.0, 0, 0], [0, 1, 0]]))
    assert_close(quat.matrix(beam.frames[1])[:, 0], torch.tensor([1.0, 1, 0]) / 2**0.5)
    upright = tb.Beam.from_nodes([[0.0, 0, 0], [0, 0, 1]], SECTION)
    assert_close(quat.matrix(upright.elements[0])[:, 2], torch.tensor([0.0, 1, 0]))


def test_from_nodes_given_by_tensors():
    """A list of points or of rows with tensors in it is what it is without them, and carries their
    gradient, whatever their dtypes.
    """
    rows = [[0.0, 0, 0], [1, 0.5, 0], [1, 2, 0.25]]
    wanted = tb.Beam.from_nodes(rows, SECTION).nodes
    x = torch.tensor(0.5, requires_grad=True)
    points = [torch.tensor(row, dtype=x.dtype) for row in rows]
    for given in (points, [rows[0], points[1], rows[2]], [rows[0], [1, x, 0], rows[2]]):
        torch.testing.assert_close(tb.Beam.from_nodes(given, SECTION).nodes, wanted, rtol=0, atol=0)
    length = tb.Beam.from_nodes([rows[0], [1, x, 0], rows[2]], SECTION).length
    (slope,) = torch.autograd.grad(length[0], x)
    assert slope.item() == pytest.approx(0.5 / 1.25**0.5, rel=1e-6)
    tall = tb.Beam.from_nodes(
        [rows[0], [1, torch.tensor([0.5, 0.6, 0.7, 0.8]), 0], rows[2]], SECTION
    )
    assert tall.nodes.shape == (4, 3, 3)
    mixed = [points[0].float(), points[1].double(), points[2].float()]
    torch.testing.assert_close(tb.Beam.from_nodes(mixed, SECTION).nodes, wanted, rtol=0, atol=0)


def test_from_nodes_with_frames():
    """The given axes come back."""
    R = quat.matrix(quat.exponential(torch.tensor([0.3, 0, 0])))
    beam = tb.Beam.from_nodes([[0.0, 0, 0], [1, 0, 0]], SECTION, frames=R[None])
    assert_close(quat.matrix(beam.elements[0]), R)


def test_one_section_each():
    """A sequence of sections is stacked along the elements."""
    stiff = tb.Section.from_stiffness(EA=10.0, GA=4.0, GJ=0.5, EI=7.0, mass=0.3)
    beam = tb.Beam.straight(1.0, 2, [SECTION, stiff])
    assert_close(1 / beam.compliance[:, 4, 4], torch.tensor([1.0, 7]))
    assert beam.rotary and not beam.coupled


@pytest.mark.parametrize("kind", ["straight", "arc"])
def test_beams_carry_gradient(kind):
    """Nodes, frames and lengths against central differences in every number."""
    size = tuple(
        torch.tensor(x, requires_grad=True) for x in ((2.0,) if kind == "straight" else (2.0, 1.0))
    )
    direction = torch.tensor([1.0, 0.2, 0.1], requires_grad=True)

    def build(*x):
        *x, direction = x
        beam = getattr(tb.Beam, kind)(*x, 3, SECTION, direction=direction)
        return beam.nodes, beam.frames, beam.length

    assert torch.autograd.gradcheck(build, (*size, direction), check_forward_ad=True)
