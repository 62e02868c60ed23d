"""NodeAcceleration beside the change of velocity over a short step, with each effect: it knows its
forces, or refuses the scene.
"""

import inspect
from dataclasses import replace

import pytest
import torch

import torchbeam as tb

SECTION = tb.Section.from_stiffness(EA=100.0, GA=80.0, GJ=1.0, EI=1.0, mass=0.5, inertia=0.01)
BEAM = tb.Beam.straight(1.0, 3, SECTION)
SOFT = dict(thickness=0.3, force=1.0, radius=0.1)
PUSH = (0.0, 0.3, 0.4)


def user(position, rotation, velocity, spin, t):
    return -0.5 * position - 0.2 * velocity, -0.1 * spin


EFFECTS = (
    tb.Gravity((0.0, 0.0, -9.81)),
    tb.TipLoad(force=PUSH, moment=PUSH),
    tb.PointLoad(node=1, force=PUSH, follower=True),
    tb.LineLoad(force=PUSH),
    tb.Damping(0.01),
    tb.Viscoelastic((0.3,), (0.01,)),
    tb.MassDamping(0.5),
    tb.Drag(2.0, 0.1, tangential=0.3, added_mass=1.0),
    tb.PointMass(0.3, (0.01, 0.02, 0.02), offset=(0.0, 0.05, 0.0)),
    tb.Actuation(curvature=(0.1, 0.3, 0.2)),
    tb.Spring(-1, 2.0, (0.5, 0.5, 0.5), length=0.2, damping=0.3),
    tb.RootSpring((10.0, 10.0)),
    tb.Contact(tb.Plane((0.0, 0.0, -0.1), (0.0, 0.1, 1.0)), **SOFT),
    tb.Load(user, node=-1),
    tb.StripAir(0.1, axis=0.4, wind=(0.2, -3.0, 0.5)),
    tb.Tendon([(None, (0.0, 0.0, 0.3)), (-1, (0.0, 0.0, 0.1))], tension=2.0),
    tb.SelfContact(thickness=0.1, force=10.0, radius=0.02),
)
REFUSED = tb.Tendon, tb.SelfContact  # forces between nodes


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: type(effect).__name__)
def test_acceleration_is_the_change_of_velocity(effect):
    """Over a step of 1e-6 s the mean of both ends, to second order: less than 1e-6 of some 10 m/s^2
    is left."""
    pushed = [effect]  # what relaxes pushes nothing by itself
    pushed += [tb.Gravity((0.0, 0.0, -9.81))] if isinstance(effect, tb.Viscoelastic) else []
    scene, spring = tb.Scene(BEAM, pushed), isinstance(effect, tb.RootSpring)
    if isinstance(effect, REFUSED):
        with pytest.raises(ValueError, match=f"a scene with a {type(effect).__name__}"):
            tb.sensors.NodeAcceleration(-1, scene)
        return
    wave = torch.sin(torch.arange(1.0, 13.0)).reshape(4, 3)
    free = torch.ones(4, 1) if spring else torch.tensor([0.0, 1, 1, 1])[:, None]
    start = replace(tb.rest(scene), velocity=free * wave, spin=free * wave.flip(-1)).broadcast()
    end = tb.Stepper(scene, 1e-6, tolerance=1e-12, engine="eager")(start)
    change = (end.velocity - start.velocity) / 1e-6
    for node in (1, -1):
        sensor = tb.sensors.NodeAcceleration(node, scene)
        mean = (sensor(start) + sensor(end)) / 2
        assert (mean - change[node]).abs().max() < 1e-6 * change.abs().max()


def test_every_effect_is_there():
    known = (getattr(tb, name) for name in tb.__all__)
    kinds = {kind for kind in known if inspect.isclass(kind) and hasattr(kind, "kind")}
    assert kinds == {type(effect) for effect in EFFECTS}
