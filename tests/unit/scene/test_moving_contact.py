"""A ball on an obstacle that turns: the same whether the obstacle moves as functions of t say,
stands in a frame that turns, or is the surface of a body that a joint turns.
"""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.extend import quaternions as quat

RATE, T, STEPS, RADIUS, GAP = 8.0, 1e-3, 2, 0.03, 1e-3
LAW = dict(thickness=4e-3, force=4.0, friction=0.6, slip_speed=5.0)  # friction tells the slip
BAR, CENTRE = (1.0, -0.8, 0.6), (0.1, 0.05, 0.0)


def tensor(x):
    return torch.as_tensor(x, dtype=torch.float64)


def plane(move, spin):
    return tb.Plane(move((0.1, 0.0, 0.0)), move((0.3, 0.0, 1.0)))


def sphere(move, spin):
    return tb.Sphere(move(CENTRE), 0.08, spin=spin)


def bar(move, spin):
    along = tensor(BAR) / tensor(BAR).norm()
    own = None if spin is None else spin @ along
    return tb.Cylinder(move((0.0, 0.0, 0.0)), move(BAR), 0.06, spin=own)


def tube(move, spin):
    return replace(bar(move, spin), radius=0.1, inside=True)


def capsule(move, spin):
    return tb.Capsule(move((-0.1, 0.02, 0.0)), move((0.2, 0.02, 0.0)), 0.05)


def box(move, spin):
    return tb.Box(move(CENTRE), (0.2, 0.1, 0.1), 0.02, rotation=(0.1, 0.2, 0.3))


# the obstacle; about which axis through the origin it turns; a place over which the ball is; how
SHAPES = {
    "plane": (plane, (0, 1, 0), (0.05, 0.02, 0.3), ("moves", "frame")),
    "sphere": (sphere, (0.2, -0.3, 0.9), (0.12, 0.04, 0.3), ("moves", "frame", "body")),
    "bar": (bar, (0.1, 0.5, 0.8), (0.05, 0.03, 0.3), ("moves", "frame", "body")),
    "tube": (tube, (0.1, 0.5, 0.8), (0.01, 0.0, 0.02), ("moves", "frame")),
    "capsule": (capsule, (0, 0.6, 0.8), (0.05, 0.03, 0.3), ("moves", "frame", "body")),
    "capsule's end": (capsule, (0, 0.6, 0.8), (0.25, 0.03, 0.1), ("moves", "frame", "body")),
    "box": (box, (0.2, -0.3, 0.9), (0.12, 0.04, 0.3), ("frame", "body")),
}


def change(shape, how):
    """By how much the ball's velocity (3) m/s and spin (3) rad/s have changed, inertial axes; the
    speed (1) m/s at which it slips.
    """
    obstacle, axis, over, _ = SHAPES[shape]
    omega = RATE * tensor(axis) / tensor(axis).norm()
    still = obstacle(lambda x: x, None)
    place = tensor(over)[None]
    gap = obstacle(tensor, None).distance(place) - RADIUS - GAP
    start = (place - gap * obstacle(tensor, None).gradient(place))[0]
    parts = {"ball": tb.Body(0.1, 4e-5, position=start)}
    options = dict(supports=())
    if how == "moves":

        def move(x):
            return lambda t: quat.rotate(quat.exponential(omega * t), tensor(x))

        contact = tb.Contact("ball", obstacle(move, omega), radius=RADIUS, **LAW)
    elif how == "frame":
        options["frame"] = tb.Frame(angular_velocity=omega)
        contact = tb.Contact("ball", still, radius=RADIUS, **LAW)
    else:
        surface = still if shape != "sphere" else replace(still, spin=None)
        parts["solid"] = tb.Body(1.0, 1.0, surface=surface)
        hinge = tb.Hinge(None, "solid", axis=tuple(axis), angle=lambda t: RATE * t)
        options["joints"] = [hinge]
        contact = tb.Contact("ball", "solid", radius=RADIUS, **LAW)
    scene = tb.Scene(parts, [contact], **options)
    first = tb.rest(scene)
    velocity, spin = torch.zeros_like(first.velocity), torch.zeros_like(first.spin)
    velocity[0], spin[0] = tensor((0.3, -0.2, 0.1)), tensor((3.0, 5.0, -4.0))
    if how == "body":
        spin[1] = omega
    first = replace(first, velocity=velocity, spin=spin)
    stepper = tb.Stepper(scene, T / STEPS, engine="eager")
    last = first
    for _ in range(STEPS):
        last = stepper(last)
    assert (last.status == 0).all()
    turn = quat.exponential(omega * T if how == "frame" else 0 * omega)
    after = torch.stack((last.velocity[0], quat.rotate(last.rotation[0], last.spin[0])))
    before = torch.stack((velocity[0], quat.rotate(first.rotation[0], spin[0])))
    return *(quat.rotate(turn, after) - before), tb.sensors.ContactSlip(scene)(last)[:1]


@pytest.mark.parametrize("shape", SHAPES)
def test_a_turning_obstacle_drags_by_its_surface(shape):
    """By the slip where surfaces meet, whatever is said to turn, up to what a step leaves; what is
    read is that slip.
    """
    first, *others = [change(shape, how) for how in SHAPES[shape][-1]]
    assert all(x.norm() > 0.01 for x in first)
    for other in others:
        for a, b in zip(other, first, strict=True):
            assert_close(a, b, rtol=0, atol=1e-3 * float(b.norm()))


def test_a_contact_of_a_scene_is_copied_with_other_numbers():
    """Of a body's surface, from which the scene took the radius; another radius is refused."""
    ball = tb.Body(0.1, 4e-5, position=(0.0, 0, 0.3), surface=tb.Sphere((0, 0, 0), 0.1))
    contact = tb.Contact(tb.Plane((0, 0, 0), (0, 0, 1)), on="ball", **LAW)
    scene = tb.Scene({"ball": ball}, [contact], supports=())
    (taken,) = scene.effects
    copied = replace(scene, effects=[replace(taken, thickness=2e-3)])
    assert copied.effects[0].thickness == 2e-3
    assert_close(copied.effects[0].radius, taken.radius, rtol=0, atol=0)
    with pytest.raises(ValueError, match="Contact with the radius of 'ball', which has a surface"):
        replace(scene, effects=[replace(taken, radius=0.2)])
