"""Dynamic stall against the polar at rest, Wagner's function where flow is attached, and the
published equations as SciPy integrates them.
"""

import math

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from scipy.interpolate import PchipInterpolator
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.extend import LoadPoint

DOUBLE = torch.float64
DEGREES = torch.tensor(
    [-30.0, -20, -16, -14, -12, -10, -5, 0, 5, 10, 12, 14, 16, 20, 25, 30], dtype=DOUBLE
)
ALPHA = torch.deg2rad(DEGREES)
CL = torch.tensor(
    [-0.9, -0.85, -1.0, -1.25, -1.2, -1.05, -0.55, 0, 0.55, 1.05, 1.2, 1.25, 1.0, 0.85, 0.88, 0.9],
    dtype=DOUBLE,
)
CD = 0.008 + 0.6 * torch.relu(ALPHA.abs() - 0.2) ** 1.5
CM = -0.25 * torch.relu(ALPHA.abs() - 0.22) * ALPHA.sign()
STEADY = tb.Polar(ALPHA, CL, CD, CM).extended()


def rigid(polar, chord=1.0, speed=20.0, **more):
    """The air of a wing whose motion is prescribed; its numbers bound by a scene."""
    section = tb.Section.from_stiffness(EA=1.0, GA=1.0, GJ=1.0, EI=1.0, mass=1.0, inertia=1.0)
    air = tb.StripAir(chord, polar=polar, wind=(0, -speed, 0), density=1.0, **more)
    return tb.Scene(tb.Beam.straight(1.0, 1, section), [air]).effects[0]


def pitched(angle, rate=0.0, internal=None):
    """One site at that angle to the wind, which turns about its quarter chord."""
    c, s = math.cos(angle), math.sin(angle)
    R = torch.tensor([[[1.0, 0, 0], [0, c, -s], [0, s, c]]], dtype=DOUBLE)
    zero = torch.zeros(1, 3, dtype=DOUBLE)
    spin = torch.tensor([[rate, 0, 0]], dtype=DOUBLE)
    return LoadPoint(
        R, position=zero, velocity=zero, spin=spin, s=torch.zeros(1, dtype=DOUBLE), elements=1,
        internal=internal,
    )  # fmt: skip


def loop(air, motion, period, steps, turns=3):
    """Coefficients (turns x steps, 3) of circulation in a motion angle(t) with its rate, at the
    middles of steps, each by the implicit midpoint rule as the solvers take it.
    """
    now, dt = torch.tensor(0.0, dtype=DOUBLE), torch.tensor(period / steps, dtype=DOUBLE)
    z = torch.zeros(1, air.internal, dtype=DOUBLE)
    z = air.advance(pitched(*motion(0.0), z), z, now, {}, torch.tensor(1e9, dtype=DOUBLE))
    rows = []
    for k in range(turns * steps):
        point = pitched(*motion((k + 0.5) * period / steps), z)
        middle = air.advance(point, z, now, {}, dt)
        flow = air._flow(air._motion(point, now, {})).delayed(air.lags, middle)
        rows.append(torch.stack(air.polar.dynamic(flow.angle, middle[..., -2:]), -1)[0])
        z = 2 * middle - z
    return torch.stack(rows)


def test_at_rest_it_is_the_polar():
    """The wing's forces at any angle, to rounding, with and without stall."""
    for angle in (-2.5, -0.4, -0.1, 0.02, 0.2, 0.24, 0.3, 1.0, 2.9):
        stalling, steady = rigid(tb.DynamicStall(STEADY)), rigid(STEADY)
        now = torch.tensor(0.0, dtype=DOUBLE)
        both = []
        for air in (stalling, steady):
            z = torch.zeros(1, air.internal, dtype=DOUBLE)
            z = air.advance(pitched(angle, 0.0, z), z, now, {}, torch.tensor(1e15, dtype=DOUBLE))
            both.append(torch.cat(air.wrench(pitched(angle, 0.0, z), now, {}), -1))
        assert_close(*both, rtol=0, atol=1e-9)


@pytest.mark.parametrize("degrees", [-16.0, 14.0, 16.0])
def test_motion_begins_with_attached_flow(degrees):
    """With all states 0, as at rest, a section has the lift of attached flow where the polar is
    stalled: after Kirchhoff c times the angle (at a place of the table), of which the wake lets
    half act at once; to rounding.
    """
    stalling = rigid(tb.DynamicStall(STEADY))
    angle = math.atan(2 * math.tan(math.radians(degrees)))
    now, z = torch.tensor(0.0, dtype=DOUBLE), torch.zeros(1, stalling.internal, dtype=DOUBLE)
    point = pitched(angle, 0.0, z)
    flow = stalling._flow(stalling._motion(point, now, {})).delayed(stalling.lags, z)
    cl = stalling.polar.dynamic(flow.angle, z[..., -2:])[0]
    assert_close(flow.angle, flow.angle.new_tensor([math.radians(degrees)]), rtol=1e-12, atol=0)
    assert_close(cl, stalling.polar._numbers[0] * flow.angle, rtol=1e-9, atol=0)
    assert cl.abs() > 1.05 * STEADY(flow.angle)[0].abs()


def test_attached_flow_has_wagners_lags_alone():
    """A polar without stall: cl = 6 a at any state of the two lags, whatever the motion."""
    a = torch.linspace(-math.pi, math.pi, 5, dtype=DOUBLE)
    linear = tb.DynamicStall(tb.Polar(a, 6.0 * a, 0 * a + 0.01))
    air = rigid(linear)
    cl = loop(air, lambda t: (0.2 * math.sin(8 * t), 1.6 * math.cos(8 * t)), math.pi / 4, 40, 1)
    plain = rigid(tb.Polar(a, 6.0 * a, 0 * a + 0.01))
    now, z = torch.tensor(0.0, dtype=DOUBLE), torch.zeros(1, 2, dtype=DOUBLE)
    dt = torch.tensor(math.pi / 160, dtype=DOUBLE)
    z = plain.advance(pitched(0.0, 1.6), z, now, {}, torch.tensor(1e9, dtype=DOUBLE))
    for k in range(40):
        t = (k + 0.5) * math.pi / 160
        point = pitched(0.2 * math.sin(8 * t), 1.6 * math.cos(8 * t))
        middle = plain.advance(point, z, now, {}, dt)
        flow = plain._flow(plain._motion(point, now, {})).delayed(plain.lags, middle)
        assert_close(cl[k, 0], 6.0 * flow.angle[0], rtol=1e-6, atol=1e-9)
        z = 2 * middle - z


def published(mean, size, k, chord=1.0, speed=20.0, turns=3, exact=True, met=True):
    """cl, cd, cm at times over the last of some turns by Hansen, Gaunaa and Madsen 2004, in their
    own form. exact: velocities resolved in the section's axes, as `StripAir` has them, in place of
    small angles; met: with what their sum of two curves, each interpolated by itself, lacks of the
    polar between its places.
    """
    a0, A, B, T_p, T_f = 0.0, (0.165, 0.335), (0.0455, 0.3), 1.7, 3.0
    b, omega = chord / 2, 2 * k * speed / chord
    table = STEADY.alpha.numpy()
    cl_st, cd_st, cm_st = (
        PchipInterpolator(table, x.numpy()) for x in (STEADY.cl, STEADY.cd, STEADY.cm)
    )
    core = np.abs(table) > math.radians(1)
    slope = np.max(STEADY.cl.numpy()[core] / table[core])
    share = np.where(core, STEADY.cl.numpy() / (slope * np.where(core, table, 1)), 1.0).clip(0, 1)
    f = (2 * np.sqrt(np.maximum(share, 0.25)) - 1) ** 2
    ends = [np.nonzero((f == 0) & (sign * table > 0))[0] for sign in (1, -1)]
    f[ends[0].min() :], f[: ends[1].max() + 1] = 0, 0
    attached = 1 - f < 1e-3
    fs = np.where(attached, STEADY.cl.numpy() / 2, (STEADY.cl.numpy() - slope * table * f)
                  / np.where(attached, 1, 1 - f))  # fmt: skip
    f_st, cl_fs = PchipInterpolator(table, f), PchipInterpolator(table, fs)
    up = np.nonzero(table > math.radians(3))[0]
    up = up[: np.nonzero(f[up] <= 0)[0][0] + 1]
    arm_places = np.linspace(0, 1, 17)
    arms = np.interp(arm_places, f[up][::-1], (STEADY.cm.numpy()[up] / STEADY.cl.numpy()[up])[::-1])
    arm = lambda x: np.interp(x, arm_places, arms)  # noqa: E731

    def flow(t):
        angle, rate = mean + size * math.sin(omega * t), size * omega * math.cos(omega * t)
        if exact:
            return speed * math.cos(angle), speed * math.sin(angle) + b * rate, rate
        return speed, speed * angle + b * rate, rate  # about the quarter chord: 3/4 is b behind

    def effective(t, x):
        forward, upwash, rate = flow(t)
        late = (1 - sum(A)) * upwash + x[0] + x[1]
        return (math.atan2(late, forward) if exact else late / forward), rate

    def rates(t, x):
        _, upwash, rate = flow(t)
        angle, _ = effective(t, x)
        v = speed / b
        pressed = slope * (angle - a0) + math.pi * b * rate / speed
        return [
            v * B[0] * (A[0] * upwash - x[0]), v * B[1] * (A[1] * upwash - x[1]),
            v / T_p * (pressed - x[2]), v / T_f * (f_st(x[2] / slope + a0) - x[3]),
        ]  # fmt: skip

    _, upwash, rate = flow(0.0)
    start = [A[0] * upwash, A[1] * upwash, 0, 0]
    angle, _ = effective(0.0, start)
    start[2] = slope * angle + math.pi * b * rate / speed
    start[3] = float(f_st(start[2] / slope))
    period = 2 * math.pi / omega
    t = (np.arange(200) + 0.5) / 200 * period + (turns - 1) * period
    x = solve_ivp(rates, (0, turns * period), start, t_eval=t, rtol=1e-8, atol=1e-9).y
    rows = []
    for now, state in zip(t, x.T, strict=True):
        a, _ = effective(now, state)
        y, steady = state[3], float(f_st(a))
        cl = slope * (a - a0) * y + float(cl_fs(a)) * (1 - y)
        if met:
            cl += cl_st(a) - (slope * (a - a0) * steady + float(cl_fs(a)) * (1 - steady))
        more = (math.sqrt(max(steady, 0)) - math.sqrt(max(y, 0))) / 2 - (steady - y) / 4
        cd = float(cd_st(a)) + (float(cd_st(a)) - float(cd_st(a0))) * more
        rows.append((cl, cd, float(cm_st(a)) + cl * (arm(y) - arm(steady))))
    return torch.tensor(rows, dtype=DOUBLE), period, omega


@pytest.mark.parametrize("mean,size", [(8.0, 5.0), (14.0, 8.0)])
def test_a_pitching_section_follows_the_published_equations(mean, size):
    """Light and deep stall, k = 0.1. Against SciPy at a tolerance of 1e-8, with 200 steps a turn,
    whose error is 1e-4: and against the equations as they are printed, for small angles and with
    two interpolated curves, which differ by 0.01 in lift.
    """
    mean, size = math.radians(mean), math.radians(size)
    want, period, omega = published(mean, size, 0.1)
    printed = published(mean, size, 0.1, exact=False, met=False)[0]
    air = rigid(tb.DynamicStall(STEADY))

    def motion(t):
        return mean + size * math.sin(omega * t), size * omega * math.cos(omega * t)

    got = loop(air, motion, period, 200)[-200:]
    assert ((got - want).abs().amax(0) < got.new_tensor([4e-4, 2e-5, 2e-4])).all()
    assert ((got - printed).abs().amax(0) < got.new_tensor([0.012, 0.002, 0.003])).all()
    if size > 0.1:  # stall comes late, and there is less lift while the nose comes down
        steady = STEADY(torch.linspace(mean - size, mean + size, 50, dtype=DOUBLE))[0]
        assert got[:, 0].max() > steady.max() + 0.15
        assert got[50:150, 0].mean() < torch.cat((got[:50, 0], got[150:, 0])).mean() - 0.1


def test_times_that_are_not_positive_are_refused():
    with pytest.raises(ValueError, match="pressure = 0"):
        tb.DynamicStall(STEADY, pressure=0.0)
    with pytest.raises(ValueError, match="rise through 0"):
        tb.DynamicStall(tb.Polar((0.0, 0.1), (1.0, 2.0), (0.0, 0.0)))


def test_gradients_by_times_and_table():
    few = tb.Section.from_stiffness(EA=3e3, GA=1e3, GJ=2.0, EI=(3.0, 9.0), mass=0.3, inertia=3e-4)
    beam, t = tb.Beam.straight(1.0, 2, few), torch.tensor([0.0, 0.1])

    def rise(separation, scale):
        polar = tb.DynamicStall(tb.Polar(ALPHA, scale * CL, CD, CM), separation=separation)
        air = tb.StripAir(0.2, polar=polar, wind=(0, -12.0, 3.0))
        return tb.simulate(tb.Scene(beam, [air]), t, step=0.02, engine="eager").tip.position[-1, 2]

    x = [torch.tensor(v, dtype=DOUBLE, requires_grad=True) for v in (3.0, 1.0)]
    slopes = torch.autograd.grad(rise(*x), x)
    with torch.no_grad():
        for k, slope in enumerate(slopes):
            up, down = ([v + h * (i == k) for i, v in enumerate(x)] for h in (1e-5, -1e-5))
            assert_close(slope, (rise(*up) - rise(*down)) / 2e-5, rtol=2e-4, atol=1e-9)


@pytest.mark.parametrize("curve", ["cl", "cm"])
def test_it_is_differentiable_by_the_steady_polar(curve):
    """Lift, drag and moment at 13 degrees, half attached, by each coefficient of the table: as
    differences have it; arms once did not move with the degree of attachment that they belong to.
    The largest slope of lift is at one place, and no curve is flat, where there are kinks.
    """
    curves = dict(cl=CL + 0.02 * (DEGREES == 5), cd=CD, cm=CM - 0.02 * ALPHA)
    angle, states = ALPHA[11:12] - 0.02, torch.tensor([[1.0, 0.5]], dtype=DOUBLE)

    def of(values):
        polar = tb.Polar(ALPHA, **(curves | {curve: values}))
        return torch.cat(tb.DynamicStall(polar).dynamic(angle, states))

    values, h = curves[curve], 1e-6
    slopes = torch.autograd.functional.jacobian(of, values)
    for k in (8, 10, 11, 12, 13):
        step = h * torch.eye(len(values), dtype=DOUBLE)[k]
        difference = (of(values + step) - of(values - step)) / (2 * h)
        assert_close(slopes[:, k], difference, rtol=1e-6, atol=1e-7)
