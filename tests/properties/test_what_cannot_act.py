"""What is there and cannot act changes nothing: each scene is the same scene without it, thrown on
a support that moves, and at rest, in both engines.
"""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

SECTION = tb.Section.rectangle(0.02, 0.005, E=2e9, nu=0.3, rho=1000.0)
N, STEP, STEPS = 3, 2e-3, 3
LAW = dict(thickness=1e-3, force=50.0)
ROD, BALL = dict(**LAW, radius=0.003), dict(**LAW, radius=0.05)
RUBS = dict(friction=0.3, slip_speed=0.01)
DOWN, UP, AWAY = (0, 0, -10.0), (0, 0, 1.0), (0, 10.0, 0)
SLIDES = dict(axis=(1, 0, 0), stiffness=3.0)


def tendon(**given):
    return tb.Tendon([(("arm", k), (0.0, 0.0, 0.01)) for k in (0, 2, N)], **given)


def moving(t):
    return torch.stack((t, t, t - 10.0))


# of each: the parts beside the arm; effects that cannot act; joints that hold these parts, with
# what cannot act in them, and without
FREE = {"other": tb.Body(0.3, 0.01, position=AWAY)}
BOX = {"other": tb.Body(0.3, 0.01, position=AWAY, surface=tb.Box((0, 0, 0), (1, 1, 1), 0.1))}
HELD = [tb.Slider(None, "other", **SLIDES)]
# fmt: off
CASES = {
    "plane": ({}, [tb.Contact(tb.Plane(DOWN, UP), **ROD)], [], []),
    "plane that rubs": ({}, [tb.Contact(tb.Plane(DOWN, UP), **ROD, **RUBS, damping=1e-3)], [], []),
    "plane that moves": ({}, [tb.Contact(tb.Plane(moving, UP), **ROD)], [], []),
    "sphere": ({}, [tb.Contact(tb.Sphere(DOWN, 1.0), **ROD)], [], []),
    "bar": ({}, [tb.Contact(tb.Cylinder(DOWN, (0, 1, 0), 1.0), **ROD)], [], []),
    "tube": ({}, [tb.Contact(tb.Cylinder(DOWN, (1, 0, 0), 20.0, inside=True), **ROD)], [], []),
    "capsule": ({}, [tb.Contact(tb.Capsule(DOWN, (0, 1, -10.0), 1.0), **ROD)], [], []),
    "box": ({}, [tb.Contact(tb.Box(DOWN, (1, 1, 1), 0.1), **ROD)], [], []),
    "itself": ({}, [tb.SelfContact("arm", **ROD)], [], []),
    "a ball": (FREE, [tb.Contact("arm", "other", **ROD, other_radius=0.05)], HELD, HELD),
    "a surface": (BOX, [tb.Contact("arm", "other", **ROD)], HELD, HELD),
    "a body over a plane": (FREE, [tb.Contact("other", tb.Plane(DOWN, UP), **BALL)], HELD, HELD),
    "corners over a plane": (BOX, [tb.Contact("other", tb.Plane(DOWN, UP), **LAW)], HELD, HELD),
    "a slack tendon": ({}, [tendon(length=2.0, stiffness=100.0)], [], []),
    "a slack tendon that rubs": ({}, [tendon(length=2.0, stiffness=100.0, **RUBS)], [], []),
    "a tendon without tension": ({}, [tendon(tension=0.0)], [], []),
    "limits of a travel": (FREE, [], [tb.Slider(None, "other", **SLIDES, limits=(-9, 9),
        limit_stiffness=1e5)], HELD),
    "limits of an angle": (FREE, [], [tb.Hinge(None, "other", stiffness=1.0, limits=(-3, 3),
        limit_stiffness=1e5)], [tb.Hinge(None, "other", stiffness=1.0)]),
    "the limit of a ball": (FREE, [], [tb.Ball(None, "other", stiffness=1.0, limit=3.0,
        limit_stiffness=1e5)], [tb.Ball(None, "other", stiffness=1.0)]),
}
# fmt: on
NATIVE = "plane", "a surface", "corners over a plane"  # forces of elements, of pairs, of nodes


def pair(name, displacement=None):
    """The scene with what cannot act, and without."""
    parts, effects, joints, bare = CASES[name]
    parts = {"arm": tb.Beam.straight(1.0, N, SECTION), **parts}
    root = tb.Support(("arm", 0), displacement=displacement)
    push = tb.PointLoad(("arm", -1), force=(0.3, 0.2, -0.4))
    return (
        tb.Scene(parts, [push, *more], joints=held, supports=[root])
        for more, held in ((effects, joints), ([], bare))
    )


def shaken(t):
    return torch.stack((0 * t, 0.02 * torch.sin(20 * t), 0.1 * t))


def motion(scene, engine, tolerance):
    """The last state of one that is thrown at some 2 m/s."""
    first, draw = tb.rest(scene), torch.Generator().manual_seed(3)
    velocity, spin = (
        2 * torch.randn(x.shape, generator=draw, dtype=x.dtype)
        for x in (first.velocity, first.spin)
    )
    for x in (velocity, spin):  # the root, and another part, as they are
        x[0], x[N + 1 :] = 0, 0
    stepper = tb.Stepper(scene, STEP, engine=engine, tolerance=tolerance)
    state = replace(first, velocity=first.velocity + velocity, spin=first.spin + spin)
    for _ in range(STEPS):
        state = stepper(state)
    assert (state.status == 0).all()
    return state


def same(a, b):
    for name in ("position", "rotation", "velocity", "spin", "work"):
        x, y = getattr(a, name), getattr(b, name)
        assert_close(
            x, y, rtol=0, atol=1e-12 * max(1.0, float(y.abs().max())),
            msg=lambda m, n=name: f"{n}: {m}",
        )  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_thrown(name):
    """By default steps of the same iterations; where friction or limits ask for one more, to the
    last digits.
    """
    tolerance = 1e-14 if "rubs" in name or "limit" in name else None
    with_it, without = pair(name, shaken)
    wanted = motion(without, "eager", tolerance)
    same(motion(with_it, "eager", tolerance), wanted)
    if name in NATIVE:
        same(motion(with_it, "compiled", tolerance), motion(without, "compiled", tolerance))


@pytest.mark.parametrize("name", [name for name in CASES if name != "plane that rubs"])
def test_at_rest(name):
    """Where friction of contacts is refused."""
    with_it, without = pair(name)
    a, b = (tb.equilibrium(one, engine="eager") for one in (with_it, without))
    assert_close(a.position, b.position, rtol=0, atol=1e-12)
    assert_close(a.rotation, b.rotation, rtol=0, atol=1e-12)
