"""Equilibria from a shape that is given: what it lacks in balance is taken away, in as many steps
as that takes, and no load is lowered.
"""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

SOFT = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.7, EI=1.0, mass=1.0, inertia=1e-3)
ENGINES = pytest.mark.parametrize("engine", ["eager", "compiled"])


def along(k, x):
    return torch.stack([x if i == k else 0 * x for i in range(3)], -1)


def shaft(moment):
    """Clamped at one end, free to turn about its axis at the other."""
    load = tb.TipLoad(moment=along(0, moment))
    return tb.Scene(tb.Beam.straight(1.0, 8, SOFT), [load])


@ENGINES
def test_any_turn_further(engine):
    """Of a shaft twisted by 3 rad, each sample its own turn. What the tangent foresees as 1.0 to
    1.2 rad is tried in one step, which is refused; its halves led back towards no load, and there
    was "no equilibrium". Twist M L/GJ.
    """
    begun = tb.equilibrium(shaft(torch.tensor(0.7 * 3.0)))
    more = torch.tensor([0.0, 0.4, 0.99, 1.01, 1.1, 1.19, 1.3, 2.6, 7.0, -0.8, -1.1, -3.0, -9.0])
    state = tb.equilibrium(shaft(0.7 * (3.0 + more)), initial=begun, engine=engine, throw=False)
    assert state.status.tolist() == [0] * len(more)
    stress = state.stress[..., 0, 3]
    assert_close(stress, 0.7 * (3.0 + more), rtol=0, atol=1e-9)
    turn = 8 * 2 * torch.arctan(torch.linalg.vector_norm(element_turn(state), dim=-1))
    assert_close(turn, (3.0 + more).abs(), rtol=0.02, atol=1e-9)


def element_turn(state):
    """Tangent of half the angle between the first two nodes, about the axis."""
    a, b = state.rotation[..., 0, :], state.rotation[..., 1, :]
    cosine = (a * b).sum(-1, keepdim=True)
    return (1 - cosine.square()).clamp(min=0).sqrt() / cosine.abs()


def cantilever(load, **options):
    return tb.Scene(tb.Beam.straight(1.0, 6, options.pop("of", SOFT)), load, **options)


def hinged(x):
    """Two rods in a hinge whose angle is led."""
    arms = {
        "a": tb.Beam.straight(0.5, 3, SOFT),
        "b": tb.Beam.straight(0.5, 3, SOFT, root=(0.5, 0, 0)),
    }
    hinge = tb.Hinge(("a", -1), ("b", 0), axis=(0, 1, 0), angle=x)
    held = [tb.Support(("a", 0))]
    return tb.Scene(arms, [tb.Gravity((0, 0, -1.0))], supports=held, joints=[hinge])


def pulled(x):
    """By a tendon above the axis."""
    eyelets = [(k, (0.0, 0.0, 0.05)) for k in range(0, 7, 2)]
    return cantilever([tb.Tendon(eyelets, tension=10.0 * x.abs())])


SCENES = {
    "a force": lambda x: cantilever([tb.TipLoad(force=along(2, 2 * x))]),
    "a follower": lambda x: cantilever([tb.TipLoad(force=along(2, x), follower=True)]),
    "in a plane": lambda x: cantilever([tb.TipLoad(force=along(2, 2 * x))], plane="xz"),
    "without stretch": lambda x: cantilever(
        [tb.TipLoad(force=along(2, 2 * x))],
        of=tb.Section.from_stiffness(EA=math.inf, GA=math.inf, GJ=0.7, EI=1.0, mass=1.0),
    ),
    "a curvature": lambda x: cantilever([tb.Actuation(curvature=along(1, x))]),
    "a support that turns": lambda x: cantilever(
        [tb.Gravity((0, 0, -1.0))], supports=[tb.Support(0, turn=along(1, x))]
    ),
    "a frame that turns": lambda x: cantilever(
        [tb.Gravity((0, 0, -1.0))], frame=tb.Frame(angular_velocity=along(2, x))
    ),
    "a joint's angle": hinged,
    "a tendon": pulled,
}


@ENGINES
@pytest.mark.parametrize("name", SCENES)
def test_the_same_as_from_no_load(engine, name):
    """Where there is one equilibrium alone, each way leads to it: loads, strains, supports, frames,
    gaps of joints, of six samples.
    """
    make = SCENES[name]
    first, then = (
        torch.tensor([0.0, 1.0, 1.5, -1.2, 2.0, 0.8]),
        torch.tensor([1.4, -0.6, 1.6, 1.3, 2.0, -2.0]),
    )
    begun, wanted = tb.equilibrium(make(first)), tb.equilibrium(make(then))
    state = tb.equilibrium(make(then), initial=begun, engine=engine)
    for field in ("position", "reaction"):
        x, y = getattr(state, field), getattr(wanted, field)
        assert_close(x, y, rtol=0, atol=1e-6 * max(float(y.abs().max()), 1e-6))
