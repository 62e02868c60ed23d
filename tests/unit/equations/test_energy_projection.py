"""`conserve`: what the energy of a step is off goes into motions without momentum."""

from dataclasses import replace

import pytest
import torch

import torchbeam as tb
from torchbeam.nodal.discretise import discretise

T = torch.tensor([0.0, 0.1], dtype=torch.float64)


def momenta(scene, state, rows=slice(None)):
    """Momentum and angular momentum (2, 3) of some nodes after their definition, from those of the
    nodes.
    """
    model = discretise(scene)
    space, inertia, x = model.space, model.inertia, model.space.to_reduced(state)
    linear = inertia.momenta(
        x.rotation, inertia.centre_velocity(x.rotation, x.velocity, x.spin), x.spin
    ).linear
    linear = space.public_vector(linear)
    spin = space.public_spin(space.to_frame(x.rotation, inertia.rotary.section_momentum(x.spin)))
    moment = torch.linalg.cross(space.public_position(x.position), linear)
    angular = moment if isinstance(spin, float) else moment + spin
    return torch.stack((linear[rows].sum(0), angular[rows].sum(0)))


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


def test_what_the_ground_holds_is_no_free_motion():
    """A beam on a hinge of the ground falls: its pin stays, energy is kept, and native code takes
    it. Its rigid motion by itself would leave the hinge.
    """
    section = tb.Section.from_stiffness(EA=1e3, GA=5e2, GJ=0.7, EI=1.0, mass=0.3, inertia=1e-3)
    parts = {"arm": tb.Beam.straight(1.0, 3, section)}
    hinge = tb.Hinge(None, ("arm", 0), axis=(0, 1, 0))
    scene = tb.Scene(parts, [tb.Gravity((0, 0, -9.81))], joints=[hinge])
    t = torch.linspace(0, 0.5, 6, dtype=torch.float64)
    for engine in ("eager", "compiled"):
        run = tb.simulate(scene, t, step=0.01, conserve=True, engine=engine)
        energy = run.energy.kinetic + run.energy.strain - run.energy.work
        assert energy.abs().max() < 1e-10 * run.energy.kinetic.max()
        assert run.state[-1].velocity[0].abs().max() < 1e-12


INERTIA = dict(EA=1e3, GA=5e2, GJ=0.7, EI=1.0, mass=0.3, inertia=1e-3)
LAW = dict(radius=0.02, thickness=5e-3, force=50.0, points=4)


def rods(*effects, **options):
    """Two rods of four elements, one across the other, which bend, fly and tumble, and a ball that
    hangs on the second by a tendon.
    """
    section = tb.Section.from_stiffness(**INERTIA)
    parts = {
        "a": tb.Beam.straight(1.0, 4, section),
        "b": tb.Beam.straight(1.0, 4, section, root=(0.5, -0.5, 0.06), direction=(0, 1, 0)),
        "c": tb.Body(0.2, 1e-3, position=(0.5, 0.9, 0.06)),
    }
    rope = tb.Tendon([(("b", -1), (0, 0, 0)), ("c", (0, 0, 0))], length=0.35, stiffness=50.0)
    scene = tb.Scene(parts, [rope, *effects], **options)
    start = tb.rest(scene)
    x, y, _ = start.position.unbind(-1)
    velocity = torch.stack((0.3 + 0.5 * y, 2 * x, 12 * (x - 0.4) ** 2 - 3 * y), -1)
    return scene, replace(start, velocity=velocity)


@pytest.mark.parametrize("case", ["both free", "one is held", "one is braked", "they collide"])
def test_each_free_piece_keeps_its_momenta(case):
    """Of two rods, the second with a ball on a tendon, to what Newton's method leaves, beside the
    energy of all: by themselves, and where one is held, or braked; and together, where they may
    collide. They traded 1e-8 to 1e-6 kg m/s.
    """
    effects, options = [], dict(supports=())
    if case == "one is held":
        options = dict(supports=[tb.Support(("a", 0))])
    if case == "one is braked":
        effects = [tb.MassDamping(0.5, on="a")]
    if case == "they collide":
        effects = [tb.Contact("a", "b", **LAW)]
    scene, start = rods(*effects, **options)
    away = 0 * start.velocity
    away[5:, 2] = -4.0 if case == "they collide" else 4.0
    start = replace(start, velocity=start.velocity + away)
    start.velocity[: 5 * (case == "one is held")] *= 0.0
    few = dict(step=2e-3, conserve=True, engine="eager", tolerance=1e-13)
    run = tb.simulate(scene, T.new_tensor([0.0, 0.02]), initial=start, **few)
    assert (run.status == 0).all()
    energy = run.energy.kinetic + run.energy.strain - run.energy.work
    assert (energy / energy[0] - 1).abs().max() < (1e-12 if case == "both free" else 1e-9)
    pieces = [slice(0, 5), slice(5, None)]
    pieces = [slice(None)] if case == "they collide" else pieces["one" in case :]
    for rows in pieces:
        before, after = (momenta(scene, run.state[k], rows) for k in (0, -1))
        torch.testing.assert_close(after, before, rtol=0, atol=1e-11)


def test_parts_that_are_not_joined_do_not_trade_momentum():
    """Of two beams that fly apart, the one that goes straight stays in its plane."""
    section = tb.Section.from_stiffness(EA=1e3, GA=5e2, GJ=0.7, EI=1.0, mass=0.3)
    parts = {
        name: tb.Beam.straight(1.0, 3, section, root=(0, y, 0)) for name, y in (("a", 0), ("b", 5))
    }
    scene = tb.Scene(parts, supports=())
    start = tb.rest(scene)
    x = start.position[..., 0]
    side = torch.where(start.position[..., 1] > 1, 3.0, 0.0).to(x)
    velocity = torch.stack((0 * x, side, 12 * (x - 0.4) ** 2), -1)
    run = tb.simulate(scene, T, initial=replace(start, velocity=velocity), step=0.02, conserve=True)
    assert run.state[-1]["a"].velocity[..., 1].abs().max() < 1e-12
