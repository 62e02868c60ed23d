"""Frames that turn: where they have turned to at an instant, and what starts there."""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.math import quaternions as quat
from torchbeam.scene.prescribed_motion import turn_between

SECTION = tb.Section.from_stiffness(EA=1e3, GA=1e3, GJ=0.8, EI=(1.0, 1.2), mass=0.2, inertia=1e-3)
BEAM = tb.Beam.straight(1.0, 3, SECTION)
G = torch.tensor([1.0, -3.0, 2.0])
WEIGHT = tb.Gravity(G)
N_1, N_2 = torch.tensor([0.6, 0.0, 0.8]), torch.tensor([0.0, 1.0, 0.0])


def angles(t, rate=1.0):
    """Of two turns, and their rates: exp(a ~n_1) exp(b ~n_2)."""
    return rate * torch.sin(2 * t), 3 * t + t**2 / 2, 2 * rate * torch.cos(2 * t), 3 + t


def coning(t, rate=1.0):
    """Angular velocity in the axes that turn, of `turned`."""
    _, b, a_rate, b_rate = (x[..., None] for x in angles(t, rate))
    return b_rate * N_2 + quat.rotate(quat.exponential(-b * N_2), a_rate * N_1)


def turned(t, rate=1.0):
    """Its rotation at t, quaternion."""
    a, b, _, _ = (x[..., None] for x in angles(t, rate))
    return quat.multiply(quat.exponential(a * N_1), quat.exponential(b * N_2))


def same(q, wanted, atol):
    """Rotations, of either sign."""
    assert_close(quat.nearer(q, wanted), wanted.expand_as(q), rtol=0, atol=atol)


def test_the_rotation_of_a_coning_frame():
    """To rounding, for instants before and after 0, 100 rad away, and from one to another."""
    t = torch.tensor([0.0, 1e-3, 1.3, -2.0, 11.0])
    zero = torch.zeros(())
    same(turn_between(coning, zero, t), turned(t), 1e-11)
    a, b = torch.tensor([[0.3], [2.0]]), torch.tensor([1.0, -0.5, 4.0])
    same(turn_between(coning, a, b), quat.multiply(quat.conjugate(turned(a)), turned(b)), 1e-11)


def test_kinks_and_jumps():
    """Spun up along a ramp that ends between output times, then stopped at once: the angles that
    are their areas.
    """

    def omega(t):
        w = torch.where(t < 0.777, torch.clamp(t / 0.123, max=1.0) * 20.0, torch.zeros_like(t))
        return w[..., None] * N_1

    t = torch.tensor([0.1, 0.5, 3.0])
    angle = torch.tensor([20 * 0.1**2 / 0.246, 20 * (0.5 - 0.0615), 20 * (0.777 - 0.0615)])
    same(turn_between(omega, torch.zeros(()), t), quat.exponential(angle[:, None] * N_1), 1e-11)


def test_gradient_of_the_rotation():
    """By the instant, and by what omega is made of."""
    t, rate = torch.tensor([0.0, 0.7], requires_grad=True), torch.tensor(1.2, requires_grad=True)
    torch.autograd.gradcheck(
        lambda t, rate: turn_between(lambda now: coning(now, rate), torch.zeros(()), t), (t, rate)
    )


@pytest.mark.parametrize("omega", [(0.4, -0.3, 1.5), coning], ids=["constant", "function"])
def test_a_start_at_another_instant(omega):
    """Who starts at t = 1.3 sees the weight from where the frame has turned to since t = 0: `rest`,
    `equilibrium` by both engines, `State.from_nodes`, `simulate` and a state of t = 0 that is taken
    there, as with a clock that begins at 1.3 and a weight that was turned by hand. In a batch of
    instants each has its own.
    """
    instant = 1.3
    whole = tb.Scene(BEAM, [WEIGHT], frame=tb.Frame(angular_velocity=omega))
    turn = (
        turned(torch.tensor(instant))
        if callable(omega)
        else quat.exponential(instant * torch.tensor(omega))
    )
    seen = quat.rotate(quat.conjugate(turn), G)
    later = (lambda t: omega(t + instant)) if callable(omega) else omega
    shifted = tb.Scene(BEAM, [tb.Gravity(seen)], frame=tb.Frame(angular_velocity=later))
    for state in (
        tb.rest(whole, t=instant),
        tb.State.from_nodes(whole, BEAM.nodes, t=instant),
        tb.equilibrium(whole, t=instant),
    ):
        same(state.frame, turn, 1e-11)
    for engine in ("eager", "compiled"):
        a = tb.equilibrium(whole, t=instant, engine=engine)
        b = tb.equilibrium(shifted, engine="eager")
        assert_close(a.position, b.position, rtol=0, atol=1e-9)
        assert_close(a.reaction, b.reaction, rtol=0, atol=1e-7)
    t = torch.tensor([0.0, 0.02, 0.04])
    exact = dict(step=0.01, tolerance=1e-12)
    wanted = tb.simulate(shifted, t, **exact)
    for start in (
        None,
        tb.rest(whole, t=instant),
        replace(
            tb.rest(whole),
            velocity=tb.rest(whole, t=instant).velocity,
            spin=tb.rest(whole, t=instant).spin,
        ),
    ):
        found = tb.simulate(whole, instant + t, start, **exact)
        assert_close(found.state.position, wanted.state.position, rtol=0, atol=1e-10)
    same(found.state[-1].frame, quat.multiply(turn, wanted.state[-1].frame), 1e-9)
    # a restart goes on from the frame it has
    again = tb.simulate(whole, instant + t[1:], found.state[1], **exact)
    assert_close(again.state[-1].position, found.state[-1].position, rtol=0, atol=1e-12)
    batch = tb.rest(whole, t=torch.tensor([0.0, instant]))
    same(batch.frame, torch.stack((quat.identity((), torch.float64), turn)), 1e-11)


def test_gravity_of_an_offset_mass_at_another_instant():
    """A moment that turns with the section is a load of the motion: both engines see it in the axes
    of the instant.
    """
    frame = tb.Frame(angular_velocity=(0.0, 0.0, 0.9))
    body = tb.PointMass(0.3, offset=(0.0, 0.1, 0.05))
    whole = tb.Scene(BEAM, [WEIGHT, body], frame=frame)
    seen = quat.rotate(quat.exponential(torch.tensor([0.0, 0, -1.8])), G)
    wanted = tb.equilibrium(tb.Scene(BEAM, [tb.Gravity(seen), body], frame=frame))
    for engine in ("eager", "compiled"):
        found = tb.equilibrium(whole, t=2.0, engine=engine)
        assert_close(found.position, wanted.position, rtol=0, atol=1e-9)
    a, b = (
        tb.modes(x, s, t=now, count=2).frequency
        for x, s, now in (
            (whole, found, 2.0),
            (replace(whole, effects=[tb.Gravity(seen), body]), wanted, 0.0),
        )
    )
    assert_close(a, b, rtol=1e-9, atol=0)


def test_a_plane_frame_in_its_plane():
    """In a plane as in space."""
    scenes = [
        tb.Scene(
            BEAM,
            [tb.Gravity((1.0, -3.0, 0.0))],
            frame=tb.Frame(angular_velocity=(0.0, 0.0, 2.0)),
            plane=plane,
        )
        for plane in (None, "xy")
    ]
    a, b = (tb.simulate(x, [1.0, 1.05], step=0.01).state[-1] for x in scenes)
    assert_close(a.position, b.position, rtol=0, atol=1e-9)
    same(b.frame, a.frame, 1e-12)
    a, b = (tb.equilibrium(x, t=1.0) for x in scenes)
    assert_close(a.position, b.position, rtol=0, atol=1e-9)
    same(b.frame, a.frame, 1e-12)
