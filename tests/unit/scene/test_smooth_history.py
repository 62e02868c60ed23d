"""Smooth histories of recorded motions, and rotation vectors of recorded rotations."""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.math import quaternions

N, AMPLITUDE, FREQUENCY = 201, 0.05, 1.5  # readings over 2 s; m, Hz
T = torch.linspace(0, 2, N)
AXES = torch.tensor([0.0, 0.6, 0.8])


def swing(t):
    return AMPLITUDE * torch.sin(2 * math.pi * FREQUENCY * t) * torch.exp(-t)


ACCELERATION = torch.func.vmap(torch.func.grad(torch.func.grad(swing)))(T)


def recorded(noise, seed=0):
    random = torch.Generator().manual_seed(seed)
    return swing(T)[:, None] * AXES + noise * torch.randn(N, 3, generator=random)


def test_a_parabola_is_kept():
    t = torch.cat((torch.linspace(0, 1, 20), torch.linspace(1.4, 1.5, 10)))  # and a gap
    parabola = 3 - t[:, None] + 2 * t[:, None].square() * AXES
    history = tb.SmoothHistory(t, parabola, sigma=1e-3)
    assert_close(history.rate(0), parabola, rtol=0, atol=2e-6)
    assert_close(history.rate(2), 4 * AXES.expand(30, 3), rtol=0, atol=1e-3)


@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize("noise", [1e-5, 2e-4, 2e-3])
def test_deviations_hold(noise, given):
    """Of a swing, over 12 records: errors of place, velocity and acceleration are 0.6 to 1.4 times
    the stated ones (RMS), the noise is found to a tenth, and 95 % of accelerations lie within 1.96
    deviations.
    """
    rate = torch.func.vmap(torch.func.grad(swing))(T)
    truth, off, inside, found = (swing(T), rate, ACCELERATION), torch.zeros(3, 12), 0.0, 0.0
    for k in range(12):
        history = tb.SmoothHistory(T, recorded(noise, k), noise if given else None)
        for order in range(3):
            error = history.rate(order) - truth[order][:, None] * AXES
            stated = history.deviation(order)
            off[order, k] = error.square().mean() / stated.square().mean()
        inside += (error.abs() < 1.96 * stated[:, None]).double().mean() / 12
        found += history.noise / 12
    assert ((off.mean(-1).sqrt() > 0.6) & (off.mean(-1).sqrt() < 1.4)).all(), off.mean(-1).sqrt()
    assert inside > 0.92, inside
    assert_close(found, noise, rtol=0.1, atol=0)


def test_share_says_what_reaches_the_forces():
    """Within a factor of two of what accelerations are off by, and said where it is most of it."""
    history = tb.SmoothHistory(T, recorded(2e-4))
    size = ACCELERATION.square().mean().sqrt()
    error = (history.rate(2) - ACCELERATION[:, None] * AXES)[10:-10]
    off = error.square().sum(-1).mean().sqrt() / size
    assert off / 2 < history.share < 2 * off
    assert f"known to {100 * history.share:.2g} %" in repr(history)
    with pytest.warns(UserWarning, match="a noise of 0.0[0-9]* reaches the forces"):
        tb.SmoothHistory(T, recorded(2e-2))


def test_accelerations_are_continuous_and_ends_are_held():
    history = tb.SmoothHistory(T, recorded(2e-4))
    breaks = history._breaks[1:-1]
    for order in range(3):
        before, after = history.rate(order, breaks - 1e-9), history.rate(order, breaks + 1e-9)
        assert_close(before, after, rtol=0, atol=1e-5)
    at = history.rate(0, T[37:38])[0]
    assert_close(history(T[37]), at)
    (_, rate) = torch.func.jvp(history, (T[37],), (torch.tensor(1.0),))
    assert_close(rate, history.rate(1, T[37:38])[0])
    assert_close(history(torch.tensor(-1.0)), history(T[0]))
    assert_close(history(torch.tensor(9.0)), history(T[-1]))


def test_gradient_and_batch_and_missing():
    values = recorded(2e-4)[:21]
    values = torch.stack((values, 2 * values)).requires_grad_()
    t = T[:21]

    def place(values):
        return tb.SmoothHistory(t, values, sigma=2e-4)(torch.tensor(0.033))

    assert place(values).shape == (2, 3)
    weight = torch.randn(2, 3, generator=torch.Generator().manual_seed(0))
    (slope,) = torch.autograd.grad((weight * place(values)).sum(), values)
    # linear, as smooth as it is
    assert_close((slope * values).sum(), (weight * place(values)).sum())
    missing = recorded(2e-4)
    missing[40:44, 1] = torch.nan
    history = tb.SmoothHistory(T, missing, sigma=2e-4)
    assert_close(history.rate(0)[40:44], (swing(T)[:, None] * AXES)[40:44], rtol=0, atol=1e-3)


@pytest.mark.parametrize("kind", ["matrices", "quaternions", "vectors"])
def test_rotations_over_many_turns(kind):
    """Nearly five turns about an axis that leans, from another start; quaternions of any sign."""
    angle = torch.linspace(0.3, 10 * math.pi, 200)
    axis = torch.nn.functional.normalize(torch.tensor([0.2, -0.3, 1.0]), dim=0)
    phi = angle[:, None] * axis
    start = quaternions.exponential(torch.tensor([0.4, 0.1, -0.2]))
    q = quaternions.multiply(quaternions.exponential(phi), start.expand(200, 4))
    form = {
        "matrices": quaternions.matrix,
        "quaternions": lambda q: q * (1 - 2 * (torch.arange(len(q)) % 2))[:, None],
        "vectors": quaternions.logarithm,
    }[kind]
    t = torch.linspace(0, 1, 200)
    turned = tb.SmoothRotation(t, form(q), 1e-6, reference=form(start[None])[0])
    assert_close(
        turned.rate(1)[5:-5], (angle[-1] - angle[0]) * axis.expand(190, 3), rtol=0, atol=1e-2
    )
    for k in (0, 40, 111, 199):
        R = quaternions.matrix(quaternions.exponential(turned(t[k])))
        assert_close(R, quaternions.matrix(quaternions.exponential(phi[k])), rtol=0, atol=1e-6)


def test_a_clamp_that_turns():
    """A clamp that was recorded as it turned three times about z, with its centre on a circle: a
    rigid beam's tip is where these put it, in both engines.
    """
    t = torch.linspace(0, 3, 301)
    angle = 2 * math.pi * t**2 * (3 - t) / 6 * (3 / 3)
    random = torch.Generator().manual_seed(0)
    q = torch.stack((torch.cos(angle / 2), 0 * t, 0 * t, torch.sin(angle / 2)), -1)
    noise = 1e-4 * torch.randn(301, 3, generator=random)
    q = quaternions.multiply(quaternions.exponential(noise), q)
    turn = tb.SmoothRotation(t, q)
    place = tb.SmoothHistory(t, 0.1 * torch.stack((angle.cos() - 1, angle.sin(), 0 * t), -1), 1e-6)
    section = tb.Section.from_stiffness(EA=1e5, GA=1e5, GJ=50.0, EI=50.0, mass=0.1, inertia=1e-5)
    beam = tb.Beam.straight(0.5, 2, section)
    scene = tb.Scene(beam, [tb.Damping(1e-3)], root=tb.RootMotion(place, turn))
    tips = [
        tb.simulate(scene, [0.0, 0.1, 0.2], step=0.02, engine=engine).tip.position
        for engine in ("eager", "compiled")
    ]
    assert_close(*tips, rtol=0, atol=1e-10)
    end = 2 * math.pi * 0.2**2 * 2.8 / 6
    where = torch.tensor([0.6 * math.cos(end) - 0.1, 0.6 * math.sin(end), 0.0])
    assert_close(tips[0][-1], where, rtol=0, atol=3e-4)


def test_root_force_of_a_shaken_clamp():
    """0.2 mm of noise on a swing of 50 mm: the force that a rigid mass of 1 kg takes, m a, is known
    to a fifth; by straight lines between the readings it would be off by more than its size.
    """
    record = recorded(2e-4)
    history = tb.SmoothHistory(T, record)
    size = ACCELERATION.square().mean().sqrt()
    inner = slice(10, -10)
    smooth = (history.rate(2) - ACCELERATION[:, None] * AXES)[inner].square().mean().sqrt()
    raw = record.diff(n=2, dim=0) / (T[1] - T[0]) ** 2
    lines = (raw - ACCELERATION[1:-1, None] * AXES).square().mean().sqrt()
    assert smooth * 3**0.5 < 0.2 * size
    assert lines * 3**0.5 > 1.5 * size


def test_refusals():
    with pytest.raises(ValueError, match="8 at least are wanted"):
        tb.SmoothHistory(T[:5], torch.zeros(5, 3))
    with pytest.raises(ValueError, match=r"\(..., n, k\) are wanted"):
        tb.SmoothHistory(T, torch.zeros(5, 3))
    with pytest.raises(ValueError, match="0, 1 or 2 is wanted"):
        tb.SmoothHistory(T, recorded(1e-4)).rate(3)
    with pytest.raises(ValueError, match="a quarter of a turn apart"):
        tb.SmoothRotation(T[:9], torch.outer(torch.arange(9.0), torch.tensor([0.0, 0, 2.0])))
    with pytest.raises(ValueError, match="rotation vectors are wanted"):
        tb.SmoothRotation(T[:9], torch.zeros(9, 2))


@pytest.mark.parametrize("kind", [tb.SmoothHistory, tb.History])
def test_its_first_and_last_instant_have_the_rate_of_the_record(kind):
    """Of 2 t: a run from the first reading to the last begins and ends with that velocity."""
    t = torch.linspace(0, 1, 12)
    record = kind(t, 2 * t[:, None] * AXES)
    for now in (0.0, 0.5, 1.0):
        at = torch.tensor(now, dtype=torch.float64)
        (rate,) = torch.func.jvp(record, (at,), (torch.ones_like(at),))[1:]
        assert_close(rate, 2 * AXES, rtol=0, atol=1e-9)
