"""Rotors by blade-element momentum theory against published calculations and closed forms."""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases import nrel_5mw

DOUBLE = torch.float64


def test_a_turbine_of_ingrams():
    """Axial and swirl factors and inflow of the elements at 1 to 5 m of Ingram 2011, Wind Turbine
    Blade Analysis using the Blade Element Momentum Method, without losses, cl = 0.084 a (degrees),
    as his worksheet has them, converged (CCBlade.jl's tests: 1e-4, 1e-3 degrees).
    """
    gamma = torch.tensor([74.31002131, 84.89805553, 89.07195504, 91.25038415, 92.58003871])
    rotor = tb.blade_element_momentum(
        7.0, 8 * 7 / 5, [1.0, 2, 3, 4, 5],
        [0.706025153, 0.436187551, 0.304517933, 0.232257636, 0.187279622],
        torch.deg2rad(90 - gamma.double()), lambda a: (0.084 * torch.rad2deg(a), 0 * a, 0 * a),
        hub=0.01, tip=5.0, losses=False, density=1.0,
    ).elements  # fmt: skip
    want = {
        "axial": ((0.2443, 0.2497, 0.2533, 0.2556, 0.25725), 1e-4),
        "swirl": ((0.0676, 0.0180, 0.0081, 0.0046, 0.0030), 1e-4),
        "inflow": ((66.1354, 77.0298, 81.2283, 83.3961, 84.7113), 1e-3),
    }
    for name, (values, atol) in want.items():
        got = getattr(rotor, name)
        got = 90 - torch.rad2deg(got) if name == "inflow" else got
        assert_close(got, torch.tensor(values, dtype=DOUBLE), rtol=0, atol=atol)


def test_a_propeller():
    """Thrust and torque of the propeller of aerodynamics4students.com at 2,100 1/min and 1 to 34
    m/s (sums over 11 equal parts, no losses): 1e-5 N and 2e-5 N m of numbers that CCBlade.jl's
    tests have, of which those here are rounded to 1e-4. A propeller is a turbine with a mirrored
    polar, whose thrust and torque are negative.
    """
    r = torch.linspace(0.08, 0.8, 11, dtype=DOUBLE)
    wind = torch.tensor([1.0, 5, 10, 20, 30, 34], dtype=DOUBLE)

    def mirrored(a):
        cl = -6.2 * a
        return -cl, 0.008 - 0.003 * cl + 0.01 * cl**2, 0 * a

    rotor = tb.blade_element_momentum(
        wind, 2100 * math.pi / 30, r, 0.1 + 0 * r, torch.atan(1 / (2 * math.pi * r)), mirrored,
        blades=2, hub=1e-6, tip=100.0, losses=False,
    )  # fmt: skip
    x, part = rotor.elements, r[1] - r[0]
    thrust, torque = -2 * x.normal.sum(-1) * part, -2 * (x.tangential * r).sum(-1) * part
    want = [1045.361193, 962.407924, 843.134981, 551.815917, 195.775319, 37.854059]
    assert_close(thrust, torch.tensor(want, dtype=DOUBLE), rtol=0, atol=1e-2)
    want = [80.363864, 81.301502, 80.514192, 68.246728, 33.971104, 12.209331]
    assert_close(torque, torch.tensor(want, dtype=DOUBLE), rtol=0, atol=2e-3)


def test_glauerts_ideal_rotor():
    """Blades of his optimum (a = (1 - 3 a)/(4 a - 1) at each radius, many of them, no drag) have
    it: the factors to 1e-6, and the power below Betz's limit as Glauert's integral has it, 0.576
    at a tip-speed ratio of 7 over r/R from 0.1 on.
    """
    tsr, B, R, V = 7.0, 3, 50.0, 10.0
    x = torch.linspace(0.1, 1.0, 400, dtype=DOUBLE) * tsr
    low, high = torch.full_like(x, 0.25 + 1e-12), torch.full_like(x, 1 / 3)
    for _ in range(80):  # 16 a^3 - 24 a^2 + a (9 - 3 x^2) - 1 + x^2 = 0
        a = (low + high) / 2
        above = 16 * a**3 - 24 * a**2 + a * (9 - 3 * x**2) - 1 + x**2 > 0
        low, high = torch.where(above, a, low), torch.where(above, high, a)
    swirl = (1 - 3 * a) / (4 * a - 1)
    phi = torch.atan2(1 - a, (1 + swirl) * x)
    r = x / tsr * R
    cl = 1.0
    chord = 8 * math.pi * r * a * phi.sin() ** 2 / (B * cl * phi.cos() * (1 - a))
    alpha = cl / (2 * math.pi)
    rotor = tb.blade_element_momentum(
        V, tsr * V / R, r, chord, phi - alpha, lambda a: (2 * math.pi * a, 0 * a, 0 * a),
        blades=B, hub=1.0, tip=R + 1e-6, losses=False,
    )  # fmt: skip
    assert_close(rotor.elements.axial, a, rtol=0, atol=1e-6)
    assert_close(rotor.elements.swirl, swirl, rtol=1e-4, atol=1e-6)
    power = B * torch.trapezoid(rotor.elements.tangential * r, r) * tsr * V / R
    share = power / (0.5 * 1.225 * math.pi * R**2 * V**3)
    glauert = 8 / tsr**2 * torch.trapezoid(swirl * (1 - a) * x**3, x)
    assert_close(share, glauert, rtol=1e-5, atol=0)
    assert 0.5 < share < 16 / 27


def rotor_of_5_mw(wind, rpm, r=nrel_5mw.R, chord=nrel_5mw.CHORD, twist=nrel_5mw.TWIST):
    return tb.blade_element_momentum(
        wind, rpm * math.pi / 30, r, chord, twist, nrel_5mw.polar(), hub=nrel_5mw.HUB,
        tip=nrel_5mw.TIP, axis=(0, 0, 1.0), density=nrel_5mw.DENSITY,
    )  # fmt: skip


def test_nrels_5_mw_turbine():
    """Rotor power and thrust at 8 to 11 m/s against Jonkman et al. 2009 (table as in CCBlade's
    tests), of a flexible rotor with 5 degrees of tilt, 2.5 of cone, and shear, whose thrust has the
    share of 110 t along the shaft: power 1.6 %, thrust 0.6 % (cos^3 of the tilt alone is 1.1 %).
    """
    wind = torch.tensor([8.0, 9, 10, 11], dtype=DOUBLE)
    rpm = torch.tensor([9.156, 10.296, 11.431, 11.89], dtype=DOUBLE)
    rotor = rotor_of_5_mw(wind, rpm)
    power = torch.tensor([1876.2, 2668.0, 3653.0, 4833.2], dtype=DOUBLE) * 1e3
    thrust = torch.tensor([478.0, 579.2, 691.5, 790.6], dtype=DOUBLE) * 1e3
    weight = 110e3 * 9.81 * math.sin(math.radians(5))
    assert_close(rotor.torque * rpm * math.pi / 30, power, rtol=0.016, atol=0)
    assert_close(rotor.thrust, thrust - weight, rtol=0.007, atol=0)


@pytest.mark.parametrize("engine", ["eager"])
def test_strips_in_its_induction_are_the_rotor(engine):
    """A stiff blade of the 5 MW turbine turns in the wind and what the theory says that it induces:
    thrust and torque at its root in steady rotation are the theory's, to 1e-5 (its 12 elements'
    lengths are the theory's parts, but for 0.1 mm at the ends).
    """
    rpm, s = torch.tensor(11.431, dtype=DOUBLE), torch.linspace(0, 61.5, 13, dtype=DOUBLE)
    at = torch.cat((s[:1], nrel_5mw.R - nrel_5mw.HUB, s[-1:]))
    twist, chord = (
        tb.Table(at, torch.cat((x[:1], x, x[-1:]))) for x in (nrel_5mw.TWIST, nrel_5mw.CHORD)
    )
    r = nrel_5mw.HUB + s
    r = torch.cat((r[:1] + 1e-4, r[1:-1], r[-1:] - 1e-4))
    rotor = rotor_of_5_mw(torch.tensor(10.0, dtype=DOUBLE), rpm, r, chord(s), twist(s))
    stiff = tb.Section.from_stiffness(EA=1e14, GA=1e14, GJ=1e14, EI=1e14, mass=300.0, inertia=100.0)
    blade = tb.Beam.straight(
        61.5, 12, stiff, root=(nrel_5mw.HUB, 0, 0), twist=tb.Table(at, -twist.values)
    )
    air = tb.StripAir(
        chord, polar=nrel_5mw.polar(), lags=None, wind=tb.Wind((0, 0, 10.0)) + rotor.induction
    )
    spin = tb.Frame(angular_velocity=(0, 0, rpm * math.pi / 30))
    root = tb.equilibrium(tb.Scene(blade, [air], frame=spin), engine=engine).root
    torque = -(root.moment[2] + nrel_5mw.HUB * root.force[1])
    assert_close(-3 * root.force[2], rotor.thrust, rtol=1e-5, atol=0)
    assert_close(3 * torque, rotor.torque, rtol=1e-5, atol=0)


def test_gradients_of_thrust_and_torque():
    r = torch.tensor([2.0, 3.0, 4.0], dtype=DOUBLE)
    foil = tb.Polar((-0.5, 0.0, 0.5), (-2.5, 0.2, 2.7), (0.02, 0.01, 0.03))

    def loads(wind, spin, chord, twist):
        rotor = tb.blade_element_momentum(
            wind, spin, r, chord, twist, foil, hub=1.0, tip=5.0, density=1.2
        )
        return rotor.thrust, rotor.torque, rotor.elements.axial

    values = (torch.tensor(v, dtype=DOUBLE) for v in (8.0, 9.0, [0.5, 0.4, 0.3], [0.2, 0.1, 0.05]))
    assert torch.autograd.gradcheck(loads, [v.requires_grad_() for v in values])


def test_bad_rotors_are_refused():
    foil = tb.Polar((-0.5, 0.5), (-3.0, 3.0), (0.01, 0.01))
    with pytest.raises(ValueError, match="beyond hub and tip"):
        tb.blade_element_momentum(8.0, 1.0, [1.0, 2], [0.1] * 2, [0.1] * 2, foil, hub=1.5, tip=5.0)
    with pytest.raises(ValueError, match="Induction's swirl"):
        tb.Induction((0.0, 1.0), (1.0, 1.0), (1.0,))
