"""`conserve`: what the energy of a step is off goes into motions without momentum."""

from dataclasses import replace

import pytest
import torch

import torchbeam as tb
from torchbeam.nodal.discretise import discretise

T = torch.tensor([0.0, 0.1], dtype=torch.float64)


def momenta(scene, state):
    """Momentum and angular momentum (2, 3) after their definition, from those of the nodes."""
    model = discretise(scene)
    space, inertia, x = model.space, model.inertia, model.space.to_reduced(state)
    linear = inertia.momenta(
        x.rotation, inertia.centre_velocity(x.rotation, x.velocity, x.spin), x.spin
    ).linear
    linear = space.public_vector(linear)
    spin = space.public_spin(space.to_frame(x.rotation, inertia.rotary.section_momentum(x.spin)))
    moment = torch.linalg.cross(space.public_position(x.position), linear)
    angular = moment if isinstance(spin, float) else moment + spin
    return torch.stack((linear.sum(0), angular.sum(0)))


@pytest.mark.parametrize(
    "inertia", [{}, {"inertia": 1e-3}], ids=["no rotary inertia", "rotary inertia"]
)
@pytest.mark.parametrize("shape", ["beam", "plane", "structure"])
def test_what_floats_keeps_its_momenta(shape, inertia):
    """A bending beam that flies and tumbles, by itself or hinged to a body, in no field: energy,
    momentum and angular momentum to what Newton's method leaves. Scaling all velocities gave
    4e-5 kg m/s here.
    """
    section = tb.Section.from_stiffness(EA=1e3, GA=5e2, GJ=0.7, EI=1.0, mass=0.3, **inertia)
    beam = tb.Beam.straight(1.0, 4, section)
    if shape == "structure":
        parts = {"a": beam, "b": tb.Body(0.2, 1e-3, position=(1.0, 0, 0))}
        joints = [tb.Hinge(("a", -1), "b", axis=(0, 1, 0))]
        scene = tb.Scene(parts, joints=joints, supports=())
    else:
        scene = tb.Scene(beam, supports=(), plane="xz" if shape == "plane" else None)
    start = tb.rest(scene)
    x = start.position[..., 0]
    side = 0.0 if shape == "plane" else 0.2
    velocity = torch.stack((0.3 + 0 * x, side + 0 * x, 12 * (x - 0.4) ** 2 + 5 * x - 1), -1)
    start = replace(start, velocity=velocity)
    options = dict(step=0.02, conserve=True, engine="eager", tolerance=1e-12)
    run = tb.simulate(scene, T, initial=start, **options)
    energy = run.energy.kinetic + run.energy.strain
    assert (energy / energy[0] - 1).abs().max() < 1e-12
    before, after = (momenta(scene, run.state[k]) for k in (0, -1))
    torch.testing.assert_close(after, before, rtol=0, atol=1e-11)
