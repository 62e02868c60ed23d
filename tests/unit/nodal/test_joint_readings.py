"""Readings of joints against the balance of the part that they hold, cut free: the force and the
moment on the second part, about the joint's point there, of every joint, with the ground or another
part, in both orders.
"""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.extend import quaternions as quat

POINT, PLACE = (0.1, 0.2, -0.3), (0.4, -0.1, 0.2)  # of the hub: in its axes; where it is drawn
AXIS, SECOND = (0.6, 0.0, 0.8), (0.0, 1.0, 0.0)
FORCE, MOMENT = torch.tensor([7.0, -4.0, 5.0]), torch.tensor([0.8, 0.5, -0.6])
MASS, INERTIA = 0.7, 0.02
STEP = 0.02
TURN = quat.exponential(torch.tensor([0.3, -0.4, 0.9]))
MET = torch.tensor(PLACE) + quat.rotate(TURN, torch.tensor(POINT))  # the hub's point, as drawn

# of each what it resists by, so that it holds the hub; none where a distance leaves it to turn
JOINTS = {
    tb.Weld: {}, tb.Ball: dict(stiffness=6.0), tb.Hinge: dict(axis=AXIS, stiffness=3.0),
    tb.Universal: dict(axis=AXIS, second=SECOND, stiffness=(3.0, 4.0)),
    tb.Slider: dict(axis=AXIS, stiffness=20.0),
    tb.Cylindrical: dict(axis=AXIS, stiffness=(3.0, 20.0)), tb.Distance: {},
}  # fmt: skip
OTHERS = "ground", "base"


def scene(kind, other, second):
    """The hub, pushed, held by a joint whose second part it is, or not; with where the joint's
    point on its second part is drawn (3).
    """
    apart = kind in (tb.Weld, tb.Slider, tb.Cylindrical, tb.Distance)
    off = torch.tensor([0.2, 0.1, -0.15]) if apart and other == "base" else torch.zeros(3)
    parts = {"hub": tb.Body(MASS, INERTIA, position=PLACE, rotation=quat.matrix(TURN))}
    hub, there, options = ("hub", POINT), None, dict(JOINTS[kind])
    joints = []
    if other == "base":
        parts["base"] = tb.Body(1.0, 0.1, position=(1.0, 0.3, 0.0))
        there = ("base", MET + off - torch.tensor([1.0, 0.3, 0.0]))
        joints = [tb.Weld("base", None)]
    point = MET if other == "ground" or second else MET + off
    if kind is tb.Distance and other == "ground":
        options["at"] = MET + torch.tensor([0.2, 0.1, -0.15])
        point = MET if second else options["at"]
    ends = (there, hub) if second else (hub, there)
    joint = kind(*ends, **options)
    push = tb.PointLoad("hub", force=FORCE, moment=MOMENT)
    return tb.Scene(parts, [push], joints=[joint, *joints], supports=()), point


def cases(kinds):
    return pytest.mark.parametrize(
        "kind, other, second",
        [(kind, other, second) for kind in kinds for other in OTHERS for second in (True, False)],
        ids=lambda x: x if isinstance(x, str) else getattr(x, "__name__", f"second={x}"),
    )


def followed(state, name, point):
    """(3) m, where a point (3) of a part, as drawn, has come; name: None = the ground."""
    if name is None:
        return point
    first, now = state
    arm = first[name].rotation.mT @ (point - first[name].position)
    return now[name].position + now[name].rotation @ arm


def part(other, second):
    return "hub" if second else None if other == "ground" else "base"


@cases([kind for kind in JOINTS if kind is not tb.Distance])
def test_at_rest(kind, other, second):
    made, point = scene(kind, other, second)
    first, now = tb.rest(made), tb.equilibrium(made, engine="eager")
    p = followed((first, now), part(other, second), point)
    read, sign = now.joint[0], 1.0 if second else -1.0
    assert_close(sign * read.force, -FORCE, rtol=0, atol=1e-6)
    arm = p - now["hub"].position
    assert_close(
        sign * (read.moment + torch.linalg.cross(arm, read.force)), -MOMENT, rtol=0, atol=1e-6
    )


@cases(JOINTS)
def test_in_motion(kind, other, second):
    """Momentum, and that about the origin, over a step, of which readings are the mean."""
    made, point = scene(kind, other, second)
    stepper = tb.Stepper(made, STEP, engine="eager")
    states = [tb.rest(made)]
    for _ in range(3):
        states.append(stepper(states[-1]))
    first, before, now = states[0], *states[-2:]
    p = sum(followed((first, x), part(other, second), point) for x in (before, now)) / 2
    read, sign = now.joint[0], 1.0 if second else -1.0
    hubs = [x["hub"] for x in (before, now)]
    rise = MASS * (hubs[1].velocity - hubs[0].velocity) / STEP
    assert_close(sign * read.force + FORCE, rise, rtol=0, atol=1e-6)
    L = [torch.linalg.cross(x.position, MASS * x.velocity) + INERTIA * x.spin for x in hubs]
    middle = (hubs[0].position + hubs[1].position) / 2
    moment = sign * (read.moment + torch.linalg.cross(p, read.force)) + MOMENT
    moment = moment + torch.linalg.cross(middle, FORCE)
    assert_close(moment, (L[1] - L[0]) / STEP, rtol=0, atol=1e-6)
