"""Rotors in air and rotors of blades that relax: damping of their modes."""

import math

import numpy as np
import pytest
import torch

import torchbeam as tb

SPEED, RADIUS, MASS, CHORD, RHO = 20.0, 2.0, 1.5, 0.12, 1.225  # rad/s, m, kg/m, m, kg/m^3
INERTIA = MASS * RADIUS**3 / 3  # kg m^2, of a blade about its flap hinge
SECTION = tb.Section.from_stiffness(
    EA=math.inf, GA=math.inf, GJ=math.inf, EI=math.inf, mass=MASS, inertia=0.0
)


def hover(lags, elements=4, blades=3, density=RHO, wind=None):
    """Rigid blades with flap hinges on the axis. The beam lies at three quarters of the chord,
    where a turn of the section about itself makes no upwash.
    """
    parts = {"hub": tb.Body(mass=1.0, inertia=0.1)}
    joints, air = [tb.Hinge(None, "hub", axis=(0, 0, 1))], []
    for k in range(blades):
        s, c = math.sin(2 * math.pi * k / blades), math.cos(2 * math.pi * k / blades)
        parts[f"blade {k}"] = tb.Beam.straight(RADIUS, elements, SECTION, direction=(c, s, 0))
        joints.append(tb.Hinge("hub", (f"blade {k}", 0), axis=(s, -c, 0)))
        strips = dict(axis=0.75, lags=lags, density=density, wind=wind)
        air.append(tb.StripAir(CHORD, **strips, on=f"blade {k}"))
    return tb.Scene(parts, air, joints=joints)


def seen_from_the_blade(diagram):
    """Eigenvalues at the last speed in axes that turn with the rotor, with positive frequencies."""
    value = diagram.eigenvalue[-1] - 1j * diagram.speed[-1] * diagram.whirl[-1].round()
    return torch.complex(value.real, value.imag.abs())


def test_flapping_in_hover_is_damped_by_a_sixteenth_of_the_lock_number():
    """s = W (-g/16 +- i sqrt(1 - (g/16)^2)) with g = rho a c R^4/I, quasi-steady and without
    inflow (Johnson 1980, Helicopter Theory, 5-2). Strips at the ends of N elements make R^4 (1 +
    1/N^2) of R^4: the trapezoidal rule of r^3. Stiffnesses that are infinite are very large ones.
    """
    elements = 4
    lock = RHO * 2 * math.pi * CHORD * RADIUS**4 / INERTIA * (1 + 1 / elements**2)
    expected = SPEED * complex(-lock / 16, math.sqrt(1 - (lock / 16) ** 2))
    diagram = tb.campbell(hover(None, elements), [SPEED], bearing=0, count=3)
    assert diagram.method == "multiblade"
    np.testing.assert_allclose(seen_from_the_blade(diagram), expected, rtol=1e-5)
    assert sorted(name.split()[1] for name in diagram.names) == ["collective", "forward", "forward"]


def test_a_wind_along_the_axis_cones_the_blades_and_does_not_turn_them_over():
    """By less than 1e-2 of the tip's speed, 1e-3 rad and 1e-5 of the damping; before they turn they
    are held by nothing.
    """
    still, windy = (
        tb.campbell(hover(None, 2, wind=wind), [SPEED], bearing=0, count=3)
        for wind in (None, (0, 0, 0.1))
    )
    assert still.method == windy.method == "multiblade"  # equal blades: rounding makes no others
    expected, found = seen_from_the_blade(still), seen_from_the_blade(windy)
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_a_hinged_blade_in_a_frame_that_turns_cones_in_a_wind():
    """beta = pi rho c w (1 + 1/(2 N^2))/(m W): lift along the hinge's arm against W^2 I; strips at
    the ends of N elements make the trapezoidal rule of r^2. To beta^2.
    """
    elements, w = 2, 0.1
    air = tb.StripAir(CHORD, axis=0.75, lags=None, density=RHO, wind=(0, 0, w))
    blade = tb.Beam.straight(RADIUS, elements, SECTION)
    hinge = tb.Hinge(None, ("blade", 0), axis=(0, -1, 0))
    frame = tb.Frame(angular_velocity=(0, 0, SPEED))
    tip = tb.equilibrium(tb.Scene({"blade": blade}, [air], joints=[hinge], frame=frame)).position[
        -1
    ]
    angle = math.pi * RHO * CHORD * w * (1 + 1 / (2 * elements**2)) / (MASS * SPEED)
    np.testing.assert_allclose(tip[2] / tip[0], angle, rtol=1e-5)


def flapping_with_lags(elements, pairs):
    """The eigenvalue of one blade with strips at its nodes, own model: I (f'' + W^2 f) is the
    moment of lift rho b 2 pi W r Q, Q = (1 - sum A) q + sum A z, q = -r f', z' = B W r/b (q - z),
    and of the apparent mass pi rho b^2 (-r f'' - b a W f'), a = 1/2.
    """
    h, b, a = RADIUS / elements, CHORD / 2, 0.5
    r, s = np.arange(elements + 1) * h, np.full(elements + 1, h)
    s[[0, -1]] /= 2
    whole = INERTIA + math.pi * RHO * b**2 * (s * r**2).sum()
    X = np.zeros((2 + 2 * len(r), 2 + 2 * len(r)))
    upwash = np.zeros((len(r), len(X)))
    upwash[:, 1] = -r
    delayed = (1 - sum(A for A, _ in pairs)) * upwash
    for i, (A, B) in enumerate(pairs):
        at = 2 + len(r) * i + np.arange(len(r))
        rate = B * SPEED * r / b
        delayed[np.arange(len(r)), at] = A
        X[at] = rate[:, None] * upwash
        X[at, at] -= rate
    X[0, 1] = 1.0
    X[1] = (s * r * RHO * b * 2 * math.pi * SPEED * r) @ delayed / whole
    X[1, 0] -= INERTIA * SPEED**2 / whole
    X[1, 1] -= math.pi * RHO * b**3 * a * SPEED * (s * r).sum() / whole
    values = np.linalg.eigvals(X)
    return values[values.imag.argmax()]


@pytest.mark.parametrize("method, blades", [("multiblade", 3), ("floquet", 3), ("floquet", 2)])
def test_lags_of_the_wake_go_along_with_the_flapping(method, blades):
    """Wagner's two lags at each node. Infinite stiffnesses are very large ones, which leaves 2e-5;
    16 steps of sixth order err by 1e-7. Two blades keep their own axes.
    """
    expected = flapping_with_lags(2, ((0.165, 0.0455), (0.335, 0.3)))
    options = dict(bearing=0, count=blades, method=method, steps=16)
    diagram = tb.campbell(hover("wagner", 2, blades), [SPEED], **options)
    assert diagram.method == method
    value = seen_from_the_blade(diagram) if blades == 3 else diagram.eigenvalue[-1]
    np.testing.assert_allclose(value, expected, rtol=3e-5)


def bending(frame=None):
    """Three blades near stall that bend and relax, in a turning frame or on a bearing."""
    section = tb.Section.from_stiffness(
        EA=1e6, GA=math.inf, GJ=100.0, EI=(50.0, 200.0), mass=1.0, inertia=1e-3
    )
    alpha = torch.deg2rad(torch.arange(-20.0, 21.0, 4.0))
    lift = 6.0 * alpha - 40.0 * alpha.sign() * torch.relu(alpha.abs() - 0.15) ** 2
    polar = tb.DynamicStall(tb.Polar(alpha, lift, cd=0.01 + 0.3 * alpha**2).extended())
    parts = {"hub": tb.Body(mass=0.5, inertia=(0.05, 0.05, 0.08))}
    hub = tb.Weld(None, "hub") if frame else tb.Hinge(None, "hub", axis=(0, 0, 1))
    joints, effects = [hub], [tb.Viscoelastic((0.3,), (0.2,))]
    for k in range(3):
        s, c = math.sin(2 * math.pi * k / 3), math.cos(2 * math.pi * k / 3)
        along = dict(direction=(c, s, 0), root=(0.2 * c, 0.2 * s, 0))
        parts[f"blade {k}"] = tb.Beam.straight(2.0, 1, section, **along)
        joints.append(tb.Weld("hub", (f"blade {k}", 0)))
        strips = dict(axis=0.4, polar=polar, wind=(0, 0, 5.0), on=f"blade {k}")
        effects.append(tb.StripAir(0.1, **strips))
    return tb.Scene(parts, effects, joints=joints, frame=frame)


def test_blades_in_air_that_relax_have_the_modes_of_a_turning_frame():
    """Lags of the wake, of stall, and Maxwell arms beside each other, of blades that wind bends."""
    frame = tb.Frame(angular_velocity=(0, 0, SPEED))
    turning = tb.modes(bending(frame), count=9).eigenvalue
    diagram = tb.campbell(bending(), [SPEED], count=6)
    assert diagram.method == "multiblade" and (diagram.damping > 0).all()
    value = seen_from_the_blade(diagram)
    off = (value[:, None] - turning).abs().amin(-1)
    assert (off < 1e-8 * value.abs()).all()  # two eigenproblems, with EA 1e5 times EI
