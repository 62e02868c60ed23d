"""observe: polynomials exactly, fourth order, delays, missing times, derivatives, batches; a beam's
motion; refusals.
"""

import math
from types import SimpleNamespace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals

T = torch.tensor([0.0, 0.1, 0.15, 0.3, 0.4, 0.55, 0.6, 0.8, 0.9, 1.0])  # irregular
TIMES = torch.tensor([0.93, 0.0, 0.31, math.nan, 0.05, 1.0, 0.3])  # in any order


def motion(values, t=T):
    """A solution whose one number at its instants is `values` (time, ...)."""
    times = t.reshape(-1, *(1,) * (values.ndim - 1)).expand(values.shape)
    return SimpleNamespace(t=t, state=SimpleNamespace(t=times, y=values))


def number(state):
    return state.y


def cubic(t):
    return 1 + 2 * t - 3 * t**2 + 4 * t**3


def test_cubics_are_exact():
    """Readings and rates, at and between instants; NaN where the time is."""
    known = ~TIMES.isnan()
    read, rate = (tb.observe(motion(cubic(T)), number, TIMES, rate=r) for r in (False, True))
    assert read[3].isnan() and rate[3].isnan()
    assert_close(read[known], cubic(TIMES)[known], rtol=1e-12, atol=0)
    assert_close(rate[known], (2 - 6 * TIMES + 12 * TIMES**2)[known], rtol=1e-12, atol=1e-12)


def test_order():
    """Half the interval, a sixteenth of the error of a reading and an eighth of a rate's, to the
    ends; away from them h^4/384 and h^3/125 of the fourth derivative, to 10 %.
    """
    errors, within, at = [], [], torch.linspace(0, 1, 1001)
    for n in (41, 81):
        t = torch.linspace(0, 1, n)
        scale = torch.tensor([384 * (n - 1) ** 4, 125 * (n - 1) ** 3]) / 6**4
        sine = motion(torch.sin(6 * t), t)
        off = (
            torch.stack(
                (
                    tb.observe(sine, number, at) - torch.sin(6 * at),
                    tb.observe(sine, number, at, rate=True) - 6 * torch.cos(6 * at),
                ),
                -1,
            ).abs()
            * scale
        )
        errors.append(off.amax(0))
        within.append(off[100:-100].amax(0))
    assert (errors[1] < 1.3 * errors[0]).all()
    assert_close(within[1], torch.ones(2), rtol=0.1, atol=0)


def test_delay_and_what_lies_outside():
    """The motion of s - delay; before the first instant the reading there, behind the last NaN."""
    times = torch.tensor([0.0, 0.4, 0.95])
    late = tb.observe(motion(cubic(T)), number, times, delay=0.2)
    assert_close(
        late,
        torch.stack((cubic(T[0]), cubic(torch.tensor(0.2)), cubic(torch.tensor(0.75)))),
        rtol=1e-12,
        atol=0,
    )
    early = tb.observe(motion(cubic(T)), number, times, delay=-0.1)
    assert early[2].isnan() and not early[:2].isnan().any()
    # at rest before, 2 at once
    rate = tb.observe(motion(cubic(T)), number, times, delay=torch.tensor([0.2, 0.0]), rate=True)
    assert_close(rate[0], torch.tensor([0.0, 2.0]), rtol=1e-12, atol=0)


def test_each_sample_has_its_own():
    """Times (times, samples) and delays (samples,): what each sample alone gives; readings of
    several numbers.
    """
    rise = torch.tensor([1.0, -2.0, 0.5])
    solution = motion(cubic(T)[:, None] * rise)
    times, delay = torch.rand(4, 3) * 0.7 + 0.3, torch.tensor([0.1, 0.0, 0.25])
    both = tb.observe(
        solution, lambda state: torch.stack((state.y, 2 * state.y), -1), times, delay=delay
    )
    assert both.shape == (4, 3, 2)
    assert_close(both[..., 0], cubic(times - delay) * rise, rtol=1e-12, atol=1e-12)
    assert_close(both[..., 1], 2 * both[..., 0])
    assert_close(
        tb.observe(motion(cubic(T)), number, times, delay=delay),
        cubic(times - delay),
        rtol=1e-12,
        atol=1e-12,
    )


@pytest.mark.parametrize("delays", [2, 3, 4])
def test_delays_of_more_axes_than_times(delays):
    """Times (3, 2), one of them missing, and delays (delays, 1), as many as there are times or not:
    what each delay alone gives.
    """
    solution = motion(cubic(T)[:, None] * torch.tensor([1.0, -2.0]))
    times = torch.tensor([[0.5, 0.6], [math.nan, 0.7], [0.8, 0.9]])
    delay = 0.1 * torch.arange(delays)[:, None]
    found = tb.observe(solution, number, times, delay=delay)
    alone = torch.stack([tb.observe(solution, number, times, delay=one) for one in delay], 1)
    assert_close(found, alone, rtol=1e-12, atol=0, equal_nan=True)


def test_derivatives():
    """By values, delay and times, both modes, against differences."""
    y, delay = torch.rand(10, 2, requires_grad=True), torch.tensor([0.02, 0.07], requires_grad=True)
    times = torch.tensor([0.22, 0.51, 0.88], requires_grad=True)

    def read(y, times, delay):
        return tb.observe(motion(y), number, times, delay=delay)

    assert torch.autograd.gradcheck(read, (y, times, delay), check_forward_ad=True)
    inputs = tuple(x.detach() for x in (y, times, delay))
    forward = torch.func.jacfwd(read, (0, 2))(*inputs)
    backward = torch.func.jacrev(read, (0, 2))(*inputs)
    for a, b in zip(forward, backward, strict=True):
        assert_close(a, b)


@pytest.mark.steps
def test_a_beam():
    """Every step of a motion read from every fourth instant of it: displacement, and, as the rate
    of velocity, acceleration, within what the interpolation leaves of the fastest mode that moves.
    """
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=1.0, EI=1.0, mass=0.2)
    force = torch.tensor([[0.0, 0, 1.0], [0, 0, 2.0]])
    ramp = lambda t: force * torch.sin(math.pi * t / 0.4) ** 4  # noqa: E731
    scene = tb.Scene(
        tb.Beam.straight(1.0, 4, section), [tb.TipLoad(force=ramp), tb.Damping(5e-3)], plane="xz"
    )
    t = torch.linspace(0, 0.4, 161)
    fine = tb.simulate(scene, t, step=2.5e-3)
    coarse = SimpleNamespace(t=t[::4], state=fine.state[::4])
    tip = tb.sensors.TipPosition()["z"]
    assert tb.observe(coarse, tip, t).shape == (161, 2, 1)
    size = tip(fine.state).abs().max()
    assert_close(tb.observe(coarse, tip, t), tip(fine.state), rtol=0, atol=2e-4 * size.item())
    speed = tb.sensors.TipVelocity()["z"]
    rates = tb.observe(coarse, speed, t, rate=True), tb.observe(fine, speed, t, rate=True)
    assert_close(rates[0], rates[1], rtol=0, atol=0.05 * rates[1].abs().max().item())


# fmt: off
CASES = {
    "beyond the end": (dict(times=(0.5, 1.2)),
                       "from 0.5 to 1.2 s were given to observe; the solution goes from 0 to 1 s"),
    "a unit that differs": (dict(times=(0.0, 500.0), delay=0.01),
                            r"from 0 to 500 s .* from 0 to 1 s \(are they in ms\?\)"),
    "one number": (dict(times=0.5), "one number was given for times"),
    "no sensor": (dict(sensor=3), "sensor = 3"),
    "no time axis": (dict(sensor=lambda state: state.y[0]),
                     r"a sensor that gave \(\) for 10 instants"),
    "no tensor": (dict(sensor=lambda state: None), "a sensor that gave None was given"),
    "rate": (dict(rate=1.0), "rate = 1.0"),
    "delays of other samples": (dict(delay=(0.1, 0.2), solution=motion(torch.ones(10, 3))),
                                "times and readings with the"),
}
# fmt: on


@refusals(CASES)
def test_refused(changed):
    tb.observe(**{**dict(solution=motion(cubic(T)), sensor=number, times=(0.5,)), **changed})
