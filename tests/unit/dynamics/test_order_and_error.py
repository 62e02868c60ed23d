"""Order in the step, by halving it, of every effect, law of joints, tendon and contact, against
what adaptive steps take it for; and the error that these state against the true one.
"""

from itertools import pairwise

import pytest
import torch

import torchbeam as tb
from torchbeam.dynamics.stepper import Stepper

SECTION = tb.Section.from_stiffness(EA=200.0, GA=80.0, GJ=0.015, EI=0.02, mass=0.3, inertia=1e-3)
BODIES, RODS = (0.16, 16), (0.03, 24)  # s, and steps
RUBS = dict(friction=0.3, slip_speed=0.2)
PAIRS = dict(friction=(0.3, 0.2), slip_speed=(0.2, 0.2))


def bodies(effects=(), **joints):
    """A swinging body on each joint, all in one scene; names of the joints."""
    parts, held = {}, []
    for k, (name, (kind, laws)) in enumerate(joints.items()):
        parts[name] = tb.Body(0.5, 0.02, position=(0.0, 10.0 * k, 0.0))
        held.append(kind(None, (name, (-0.3, 0.0, 0.0)), **laws))
    push = [tb.PointLoad(name, force=(1.0, 0.5, -4.0), moment=(0.2, 0.1, 0.1)) for name in parts]
    return tb.Scene(parts, [*push, *effects], joints=held, supports=())


def rods(**effects):
    """A cantilever under a load with each effect, all in one scene."""
    parts = {
        name: tb.Beam.straight(0.4, 2, SECTION, root=(0, k, 0)) for k, name in enumerate(effects)
    }
    push = [tb.PointLoad((name, -1), force=(0, 0.01, -0.02)) for name in parts]
    acting = [effect(name) for name, effect in effects.items()]
    return tb.Scene(parts, push + acting, supports=[tb.Support((name, 0)) for name in parts])


def sine(t):
    return 0.3 * torch.sin(9 * t)


def bending(t):
    return torch.stack((0 * t, sine(t) / 50, 0 * t))


def pull(t):
    return 0.1 + sine(t) / 9


def brake(position, rotation, v, spin, t):
    return -0.2 * v * v.norm(dim=-1, keepdim=True), None


def sliding():
    """A ball that rolls and slides on floors, one that rubs."""
    floor = tb.Plane((0, 0, 0), (0, 0, 1.0))
    law = dict(radius=0.05, thickness=0.02, force=40.0)
    parts = {name: tb.Body(1.0, 5e-3, position=(0, k, 0.062)) for k, name in enumerate("abc")}
    laws = {}, dict(friction=0.5, slip_speed=0.2), dict(damping=0.02)
    floors = [tb.Contact(name, floor, **law, **own) for name, own in zip("abc", laws, strict=True)]
    return tb.Scene(parts, [tb.Gravity((3.0, 0, -9.81)), *floors], supports=())


def tendon(name, **given):
    return tb.Tendon([((name, k), (0, 0, 0.05)) for k in (0, 1, 2)], **given)


AXIS = dict(axis=(0, 1, 0))
SCENES = {  # the order that they have, how long they move
    "effects": (
        2,
        RODS,
        lambda: rods(
            gravity=lambda n: tb.Gravity((0, 0, -9.81)),
            follower=lambda n: tb.PointLoad((n, -1), force=(0, 0, 0.02), follower=True),
            line=lambda n: tb.LineLoad(force=(0, 0, 0.1), on=n),
            pulse=lambda n: tb.PointLoad((n, -1), moment=bending),
            drag=lambda n: tb.Drag(1.0, 0.05, 1.2, on=n),
            mass_damping=lambda n: tb.MassDamping(2.0, on=n),
            damping=lambda n: tb.Damping(0.01, on=n),
            spring=lambda n: tb.Spring((n, -1), 3.0, (0.4, 0.0, 0.3), damping=0.1),
            mass=lambda n: tb.PointMass(0.05, node=(n, -1)),
            load=lambda n: tb.Load(brake, node=(n, -1)),
        ),
    ),
    "joints": (
        2,
        BODIES,
        lambda: bodies(
            hinge=(tb.Hinge, dict(**AXIS, stiffness=2.0, damping=0.1)),
            limits=(tb.Hinge, dict(**AXIS, limits=(-9.0, 9.0), limit_stiffness=20.0)),
            motor=(tb.Hinge, dict(**AXIS, torque=sine)),
            slider=(tb.Slider, dict(**AXIS, stiffness=20.0, damping=0.2, force=sine)),
            sleeve=(tb.Cylindrical, dict(**AXIS, stiffness=(1.0, 20.0), damping=(0.1, 0.2))),
            cross=(
                tb.Universal,
                dict(**AXIS, second=(0, 0, 1), stiffness=(1.0, 2.0), damping=(0.1, 0.1)),
            ),
            ball=(tb.Ball, dict(stiffness=1.0, damping=0.1)),
        ),
    ),
    "joints that rub": (
        1,
        BODIES,
        lambda: bodies(
            hinge=(tb.Hinge, AXIS | RUBS),
            slider=(tb.Slider, AXIS | RUBS),
            sleeve=(tb.Cylindrical, AXIS | PAIRS),
            cross=(tb.Universal, AXIS | PAIRS | dict(second=(0, 0, 1))),
            ball=(tb.Ball, RUBS),
        ),
    ),
    "tendons": (
        2,
        RODS,
        lambda: rods(
            pulled=lambda n: tendon(n, tension=pull),
            elastic=lambda n: tendon(n, length=0.39, stiffness=5.0),
        ),
    ),
    "a tendon that rubs": (
        1,
        RODS,
        lambda: rods(pulled=lambda n: tendon(n, tension=pull, friction=0.5, slip_speed=0.05)),
    ),
    "contact": (2, BODIES, sliding),
}


def places(scene, T, **options):
    run = tb.simulate(scene, torch.tensor([0.0, T]), **options)
    assert (run.status == 0).all()
    return run.state.position[-1], run.stats


@pytest.mark.steps
@pytest.mark.parametrize("name", SCENES)
def test_error_is_as_stated(name):
    """Each part's order is no lower than the one taken, but for what steps of this length leave;
    the error that is stated is at least half of the true one.
    """
    order, (T, count), made = SCENES[name]
    scene = made()
    stepper = Stepper(scene, T)
    assert stepper.method.order(stepper.model) == order
    runs = [places(scene, T, step=T / (count * 2**k))[0] for k in (1, 2, 3)]
    changes = [(a - b).norm(dim=-1) for a, b in pairwise(runs)]
    found = (changes[0] / changes[1])[changes[0] > 1e-10].log2()
    assert found.min() > order - 0.35
    true = runs[2] + (runs[2] - runs[1]) / (2**order - 1)
    last, stats = places(scene, T, rtol=1e-3)
    assert (last - true).norm(dim=-1).max() <= 2 * stats.error
