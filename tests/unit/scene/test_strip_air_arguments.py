"""`StripAir` where there is next to none of it: along the wind, at a tip without chord; and polars
that are none.
"""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

RHO, U = 1.2, 20.0
SECTION = tb.Section.from_stiffness(EA=1e7, GA=1e7, GJ=5e3, EI=(3e3, 1e6), mass=2.0, inertia=0.1)
STIFF = tb.Section.from_stiffness(EA=1e8, GA=1e8, GJ=50.0, EI=(1e7, 1e7), mass=2.0, inertia=0.1)


def air(chord=0.8, axis=0.35, wind=(0.0, -U, 0.0), **more):
    return tb.StripAir(chord, axis=axis, density=RHO, wind=wind, **more)


@pytest.mark.parametrize("engine", ["compiled", "eager"])
@pytest.mark.parametrize(
    "polar, said",
    [
        (lambda a: (a, 0 * a), "a polar that returns 2 coefficients was given"),
        (lambda a: 6.0, "a polar that returns one coefficient was given"),
        (lambda a: (a, None, a), "a polar's coefficient is None"),
    ],
)
def test_what_a_polar_returns_is_three_coefficients(engine, polar, said):
    scene = tb.Scene(tb.Beam.straight(3.0, 2, SECTION), [air(polar=polar)])
    with pytest.raises(ValueError, match=said):
        tb.simulate(scene, [0.0, 0.1], step=0.1, engine=engine)


FOIL = tb.Polar(
    (-0.5, -0.2, 0.0, 0.2, 0.5), (-1.0, -1.2, 0, 1.2, 1.0), (0.4, 0.05, 0.01, 0.05, 0.4)
)


@pytest.mark.parametrize(
    "polar", [None, FOIL, tb.DynamicStall(FOIL)], ids=["slope", "polar", "stall"]
)
@pytest.mark.parametrize("turn", [0.0, 0.3, 1.0])
def test_a_wing_along_the_wind_has_no_load(polar, turn):
    """Of 20 m/s along the beam rounding leaves 1e-15 m/s across it, of any direction: the wing
    rests where it was drawn, to the last place, in motion by both engines and in equilibrium.
    """
    along = (math.cos(turn), math.sin(turn), 0.0)
    beam = tb.Beam.straight(16.0, 4, SECTION, direction=along)
    scene = tb.Scene(beam, [air(wind=tuple(20.0 * x for x in along), polar=polar)])
    for engine in ("compiled", "eager"):
        motion = tb.simulate(scene, [0.0, 0.1], step=0.05, engine=engine)
        assert (motion.status == 0).all()
        assert_close(motion.tip.position[-1], motion.tip.position[0], rtol=1e-15, atol=1e-15)
    assert_close(tb.equilibrium(scene).tip.position, beam.nodes[-1], rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize("polar", [None, tb.DynamicStall(FOIL)], ids=["lags", "stall"])
def test_a_chord_that_vanishes_at_the_tip(polar):
    """An elliptic chord of a wing that is held: lift of each node by its own share of the span,
    rho b cl V^2 (1e-9), none at the tip (1e-6 of the middle's). Motion goes on in both engines
    alike (1e-9), and no small motion grows (by rounding of the fastest lag, 1e-9).
    """
    beam, wind, s = tb.Beam.straight(4.0, 4, STIFF), (0, -U, 2.0), torch.arange(5.0)

    def chord(s):
        return (1 - (s / 4.0).square()).clamp(min=0).sqrt()

    load = air(chord, 0.25, wind, polar=polar)
    held = tb.Scene(beam, [load], supports=[tb.Support(k) for k in range(5)])
    angle = math.atan2(2.0, U)
    cl = 2 * math.pi * math.sin(angle) if polar is None else FOIL(torch.tensor([angle]))[0]
    V = torch.tensor([0.0, -U, 2.0])
    across = torch.linalg.cross(V, torch.tensor([1.0, 0, 0]))
    share = torch.tensor([0.5, 1.0, 1.0, 1.0, 0.5])
    lift = RHO / 2 * V.norm() ** 2 * cl * share * chord(s)
    pushed = -(tb.equilibrium(held).reaction[:, :3] * across).sum(-1) / V.norm()
    assert_close(pushed, lift, rtol=1e-9, atol=1e-6 * float(lift[1]))
    free = tb.Scene(beam, [load])
    paths = [
        tb.simulate(free, [0.0, 0.05, 0.1], step=0.025, engine=engine)
        for engine in ("compiled", "eager")
    ]
    assert all((motion.status == 0).all() for motion in paths)
    assert_close(paths[0].tip.position, paths[1].tip.position, rtol=1e-9, atol=1e-9)
    rates = torch.linalg.eigvals(tb.linearize(free, tb.equilibrium(free)).A)
    assert (rates.real < 1e-9 * rates.abs().max()).all()


@pytest.mark.parametrize("polar", [FOIL, tb.DynamicStall(FOIL)], ids=["polar", "stall"])
def test_gradients_where_the_air_stands_still(polar):
    """A wing that is held at its root falls through air at rest: there the angle of attack is 0/0.
    The gradient by the density is finite, alike in both engines (1e-9), and the change between two
    densities (1e-5, of second order).
    """
    beam, t = tb.Beam.straight(2.0, 3, SECTION), [0.0, 0.04]

    def drop(density, engine="compiled"):
        load = tb.StripAir(0.8, density=density, polar=polar)
        scene = tb.Scene(beam, [load, tb.Gravity((0, 0, -9.81))])
        return tb.simulate(scene, t, step=0.02, engine=engine).tip.position[-1, 2]

    density = torch.tensor(RHO, requires_grad=True)
    slopes = [torch.autograd.grad(drop(density, e), density)[0] for e in ("compiled", "eager")]
    assert_close(*slopes, rtol=1e-9, atol=0)
    change = (drop(RHO + 0.01) - drop(RHO - 0.01)) / 0.02
    assert_close(slopes[0], change, rtol=1e-5, atol=0)


@pytest.mark.parametrize("lags", ["wagner", None])
def test_a_tip_without_chord_has_a_gradient(lags):
    """By the chord there: the change that a thousandth more brings (within 1 %, of first order)."""
    beam = tb.Beam.straight(2.0, 3, SECTION)

    def rise(tip):
        chord = torch.stack((*torch.tensor([0.8, 0.8, 0.8]), tip))
        scene = tb.Scene(beam, [air(chord, wind=(0, -U, 2.0), lags=lags)])
        return tb.simulate(scene, [0.0, 0.1], step=0.05).tip.position[-1, 2]

    tip = torch.zeros((), requires_grad=True)
    change = (rise(torch.tensor(0.002)) - rise(torch.tensor(0.001))) / 0.001
    assert_close(torch.autograd.grad(rise(tip), tip)[0], change, rtol=0.01, atol=0)
