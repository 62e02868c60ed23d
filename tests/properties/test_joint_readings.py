"""What joints read is what a free-body cut gives: force and moment on the second part, about the
point that is documented, b's own (the ground's place `at`), of every kind, in space and in a plane,
with the body as the first or the second part, at rest and in motion.

The body is rigid, so that its momentum is that of a state: the cut shares nothing with the joints.
"""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

STRIP = tb.Section.from_stiffness(EA=2e3, GA=1e3, GJ=3.0, EI=(4.0, 6.0), mass=0.3, inertia=1e-3)
CENTRE = torch.tensor([1.3, 0.0, -0.2])
POINT = (-0.3, 0.0, 0.2)  # of the hub, where the arm ends
J = torch.tensor([0.02, 0.03, 0.025])
MASS, G = 1.5, torch.tensor([0.0, 0.0, -9.81])
Y, X = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)
KINDS = {
    "weld": lambda a, b, **at: tb.Weld(a, b, **at),
    "ball": lambda a, b, **at: tb.Ball(a, b, **at),
    "hinge": lambda a, b, **at: tb.Hinge(a, b, Y, stiffness=40.0, damping=0.1, **at),
    "hinge with a torque": lambda a, b, **at: tb.Hinge(a, b, Y, torque=1.5, **at),
    "hinge that is driven": lambda a, b, **at: tb.Hinge(a, b, Y, angle=lambda t: t + t * t, **at),
    "slider": lambda a, b, **at: tb.Slider(a, b, X, stiffness=90.0, damping=0.3, **at),
    "slider that is driven": lambda a, b, **at: tb.Slider(a, b, X, travel=lambda t: t * t, **at),
    "cylindrical": lambda a, b, **at: tb.Cylindrical(a, b, X, stiffness=(30.0, 80.0), **at),
    "distance": lambda a, b, **at: tb.Distance(a, b, **at),
    "universal": lambda a, b, **at: tb.Universal(a, b, X, Y, stiffness=(30.0, 40.0), **at),
}
SPATIAL = "cylindrical", "universal"
SWINGS = "ball", "distance", "hinge with a torque"  # have no rest nearby
PLACES = {
    "after an arm": (("arm", -1), ("hub", POINT), {}),
    "before an arm": (("hub", POINT), ("arm", -1), {}),
    "on the ground": (None, ("hub", POINT), {}),
    "under the ground": (("hub", POINT), None, {}),
}


APART = {  # of what keeps a distance
    "after an arm": (("arm", -1), ("hub", (0.1, 0.0, 0.0)), {}),
    "before an arm": (("hub", (0.1, 0.0, 0.0)), ("arm", -1), {}),
    "on the ground": (None, ("hub", POINT), {"at": (1.3, 0.0, 1.0)}),
    "under the ground": (("hub", POINT), None, {"at": (1.3, 0.0, 1.0)}),
}


def ends(kind, place):
    return (APART if kind == "distance" else PLACES)[place]


def scene_of(kind, place, plane):
    a, b, at = ends(kind, place)
    arm = tb.Beam.straight(1.0, 4, STRIP)
    hub = tb.Body(MASS, J, position=CENTRE)
    across = 0.0 if plane else 0.7
    push = torch.tensor([0.4, across, -0.3]), torch.tensor([across / 3, 0.2, across / 2])
    return tb.Scene(
        {"arm": arm, "hub": hub},
        [tb.Gravity(G), tb.PointLoad("hub", force=push[0], moment=push[1])],
        joints=[KINDS[kind](a, b, **at)],
        supports=[tb.Support(("arm", 0))],
        plane=plane,
    ), push


def hub(state):
    """Place, axes, momentum and angular momentum of the hub, frame a."""
    part = state["hub"]
    R = part.rotation.reshape(3, 3)
    return (
        part.position.reshape(3),
        R,
        MASS * part.velocity.reshape(3),
        R @ (J * part.spin.reshape(3)),
    )


def cut(kind, place, before, after, push, dt):
    """Force and moment on the second part about its point, by the hub's change of momentum less
    what else acts on it; in mid step.
    """
    second = ends(kind, place)[1]
    force, moment, middle, points = -(MASS * G + push[0]), -push[1], 0.0, 0.0
    for state, sign in ((before, -1), (after, 1)):
        centre, R, p, h = hub(state)
        middle = middle + centre / 2
        force, moment = force + sign * p / dt, moment + sign * h / dt
        if second is None:
            points = points + torch.tensor(ends(kind, place)[2].get("at", (1.0, 0.0, 0.0))) / 2
        elif second[0] == "arm":
            points = points + state["arm"].position[-1] / 2
        else:
            points = points + (centre + R @ torch.tensor(second[1])) / 2
    sign = 1.0 if second is not None and second[0] == "hub" else -1.0
    return sign * force, sign * (moment - torch.linalg.cross(points - middle, force))


CASES = [
    (kind, place, plane)
    for kind in KINDS
    for place in PLACES
    for plane in (None, "xz")
    if not (plane and kind in SPATIAL)
]


def same(kind, place, before, after, push, dt, tolerance):
    read = after.joint[0]
    force, moment = cut(kind, place, before, after, push, dt)
    assert_close(read.force, force, rtol=tolerance, atol=tolerance)
    assert_close(read.moment, moment, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("kind, place, plane", CASES)
def test_readings_are_those_of_a_cut(kind, place, plane):
    """At rest, to what an equilibrium leaves; in the fifth step of half a millisecond from where it
    is drawn, by what the hub's momentum has changed, to the square of its turn in a step.
    """
    scene, push = scene_of(kind, place, plane)
    if kind not in SWINGS:
        state = tb.equilibrium(scene)
        same(kind, place, state, state, push, 1.0, 1e-6)
    stepper = tb.Stepper(scene, 5e-4, engine="eager")
    state = tb.rest(scene)
    for _ in range(5):
        before, state = state, stepper(state)
    assert int(state.status) == 0
    same(kind, place, before, state, push, 5e-4, 1e-4)
