"""Joints as they are drawn: where they sit, on which rows, along which axes, and what they hold."""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.math import quaternions as quat

SECTION = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2)
TURN = quat.matrix(quat.exponential(torch.tensor([0.3, -0.4, 0.9])))
POINT = torch.tensor([0.1, 0.2, -0.3])
CORNER = torch.tensor([1.0, 0, 0])
HUB = torch.tensor([2.0, 0.5, 0])


def drawn(joint):
    """The joint's points and axes, in a scene of two beams with a corner and a body that is
    turned.
    """
    arm = tb.Beam.straight(1.0, 2, SECTION)
    leg = tb.Beam.straight(1.0, 2, SECTION, root=CORNER, direction=(0, 0, 1))
    scene = tb.Scene(
        {"arm": arm, "leg": leg, "hub": tb.Body(1.0, 0.1, position=HUB, rotation=TURN)},
        joints=[joint],
    )
    return scene.joints[0], scene.joints[0].drawn(scene.beam)


ON_HUB = HUB + TURN @ POINT
FAR = torch.tensor([0.3, 0.4, 0.5])
# fmt: off
PLACES = {  # joint: points on a and on b, rows
    "of two nodes that meet": (tb.Ball(("arm", -1), ("leg", 0)), CORNER, CORNER, (2, 3)),
    "at a point of a body, with the ground": (tb.Ball(("hub", POINT), None), ON_HUB, ON_HUB,
                                              (6, None)),
    "where it is said to be": (tb.Hinge(("arm", 1), "hub", at=FAR), FAR, FAR, (1, 6)),
    "a weld at the second part": (tb.Weld(("arm", 1), ("hub", POINT)), ON_HUB, ON_HUB, (1, 6)),
    "a slider at the second part": (tb.Slider("hub", ("leg", 2)), torch.tensor([1.0, 0, 1]),
                                    torch.tensor([1.0, 0, 1]), (6, 5)),
    "a distance of two points": (tb.Distance(("arm", 0), ("hub", POINT)), torch.zeros(3), ON_HUB,
                                 (0, 6)),
    "a distance from the ground": (tb.Distance(None, ("leg", -1), at=FAR), FAR,
                                   torch.tensor([1.0, 0, 1]), (None, 5)),
    "of the ends of one beam": (tb.Weld(("arm", 0), ("arm", -1)), CORNER, CORNER, (0, 2)),
}
# fmt: on


@pytest.mark.parametrize("name", PLACES)
def test_it_sits(name):
    joint, *expected, rows = PLACES[name]
    joint, (a, b, axes) = drawn(joint)
    assert_close(a, expected[0])
    assert_close(b, expected[1])
    assert joint.ends == rows
    assert_close(axes.mT @ axes, torch.eye(3), rtol=0, atol=1e-14)
    assert_close(torch.linalg.det(axes), torch.tensor(1.0))


HOLDS = {  # letters along and about the joint's axes; x and y of these axes, where they are given
    tb.Weld: ("xyz", "xyz", {}),
    tb.Ball: ("xyz", "", {}),
    tb.Hinge: ("xyz", "yz", {"axis": (0, 0, 2.0)}),
    tb.Universal: ("xyz", "z", {"axis": (0, 3.0, 0), "second": (0, 0, -1.0)}),
    tb.Slider: ("yz", "xyz", {"axis": (1.0, 1.0, 0)}),
    tb.Cylindrical: ("yz", "yz", {"axis": (0, 1.0, 1.0)}),
}


@pytest.mark.parametrize("kind", HOLDS)
def test_it_holds(kind):
    position, rotation, given = HOLDS[kind]
    joint, (_, _, axes) = drawn(kind(("arm", -1), ("leg", 0), **given))
    assert (joint.position, joint.rotation, joint.holds) == (
        position,
        rotation,
        len(position + rotation),
    )
    for column, name in enumerate(("axis", "second")):
        if name in given:
            assert_close(
                axes[:, column], torch.nn.functional.normalize(torch.tensor(given[name]), dim=0)
            )
    assert str(joint) == f"{kind.__name__} of ('arm', -1) and ('leg', 0)"


def test_a_distance_holds_one_number_along_its_line():
    joint, (a, b, axes) = drawn(tb.Distance(("arm", 0), "hub"))
    assert joint.holds == 1
    assert_close(axes[:, 0], (b - a) / torch.linalg.vector_norm(b - a))


def test_places_keep_gradients():
    """By the place of a joint, a point in a body and an axis."""

    def f(at, point, axis):
        return torch.cat(
            [
                torch.cat((a, b, axes.flatten()))
                for a, b, axes in (
                    drawn(tb.Hinge(("arm", 1), "hub", axis=axis, at=at))[1],
                    drawn(tb.Weld(("arm", 1), ("hub", point)))[1],
                )
            ]
        )

    given = tuple(x.clone().requires_grad_() for x in (FAR, POINT, torch.tensor([0.3, 0.2, 0.9])))
    assert torch.autograd.gradcheck(f, given)


@pytest.mark.parametrize("joint", [tb.Hinge, tb.Slider, tb.Cylindrical, tb.Universal, tb.Ball])
def test_no_axis(joint):
    """(It ended in a TypeError of the scene, or of its solve.)"""
    with pytest.raises(ValueError, match="None was given; numbers or a tensor are wanted"):
        joint(("arm", -1), None, axis=None)
    with pytest.raises(ValueError, match="None was given; numbers or a tensor are wanted"):
        tb.Body(1.0, position=None)


@pytest.mark.parametrize("form", [lambda x: x, lambda x: [x], lambda x: iter((x,))])
def test_a_support_keeps_a_body_without_inertia_from_turning(form):
    scene = tb.Scene({"hub": tb.Body(0.1)}, supports=form(tb.Support("hub")))
    assert [support.clamp for support in scene.supports] == [True]


def test_what_is_no_support_of_a_body_without_inertia_is_refused():
    with pytest.raises(ValueError, match="without inertia was given"):
        tb.Scene({"hub": tb.Body(0.1)}, supports=[3])
