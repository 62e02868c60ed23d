"""Rotors without a steady state: small motions about the periodic orbit that gravity makes."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

import torchbeam as tb

from .test_rotors import C, exponents, helicopter
from .test_rotors_in_air import (
    CHORD,
    INERTIA,
    RADIUS,
    RHO,
    SPEED,
    flapping_with_lags,
    hover,
    seen_from_the_blade,
)

OFFSET, LEVER, MASS, ABOUT_CENTRE, G = 0.25, 1.0, 2.0, 0.3, 9.81  # m, m, kg, kg m^2, m/s^2


def hinged(gravity=G, on=None):
    """A rigid blade with a lag hinge beside a horizontal axis; on: stiffness (N/m) along the axis
    of what holds a mast of 2 kg, None = the ground.
    """
    blade = tb.Body(
        mass=MASS, inertia=(0.01, ABOUT_CENTRE, ABOUT_CENTRE), position=(OFFSET + LEVER, 0, 0)
    )
    joints = [
        tb.Hinge(on and "mast", "hub", axis=(0, 1, 0)),
        tb.Hinge("hub", "blade", at=(OFFSET, 0, 0), axis=(0, 1, 0)),
    ]
    hub = tb.Body(mass=5.0, inertia=1.0)
    down = torch.tensor((0, 0, -1.0), dtype=torch.float64)
    effects = [tb.Gravity(gravity * down)] if gravity else []
    parts = {"hub": hub, "blade": blade}
    if on:
        parts["mast"] = tb.Body(mass=2.0, inertia=1.0)
        joints.append(tb.Slider(None, "mast", axis=(0, 1, 0), stiffness=on))
    return tb.Scene(parts, effects, joints=joints)


def exponents_of_hill(speed):
    """Of I z'' + W^2 e S sin z = S g cos(W t + z) about its periodic solution: Hill's equation."""
    S, inertia, turn = MASS * LEVER, ABOUT_CENTRE + MASS * LEVER**2, 2 * math.pi / speed

    def rates(t, y):
        z, angle = y[0], speed * t + y[0]
        a = (S * G * math.cos(angle) - OFFSET * S * speed**2 * math.sin(z)) / inertia
        slope = -(S * G * math.sin(angle) + OFFSET * S * speed**2 * math.cos(z)) / inertia
        return [y[1], a, y[4], y[5], slope * y[2], slope * y[3]]

    def after(y):
        start = [*y, 1.0, 0.0, 0.0, 1.0]
        return solve_ivp(rates, (0, turn), start, rtol=1e-10, atol=1e-12).y[:, -1]

    orbit = fsolve(lambda y: after(y)[:2] - y, (0.0, 0.0), xtol=1e-10)
    return np.log(np.linalg.eigvals(after(orbit)[2:].reshape(2, 2)).astype(complex)) / turn


@pytest.mark.parametrize("speed, grows", [(10.0, True), (16.0, False)])
def test_gravity_makes_a_lag_motion_grow_near_half_of_the_speed(speed, grows):
    """The lag frequency is 0.466 of the speed, next to Mathieu's first region: unstable below 14.4
    rad/s, where S g/(I W^2) > 2 (1/4 - 0.217).
    """
    diagram = tb.campbell(hinged(), [speed], bearing=0, count=1, steps=16)
    assert diagram.method == "floquet" and bool(diagram.unstable.any()) == grows
    expected = exponents_of_hill(speed)
    nearest = np.abs(expected - diagram.eigenvalue[0].numpy()).min()
    error = diagram.error[0, 0].item()
    assert nearest < error < 0.02 * speed / 10  # 65 midpoint steps, 1.5 % of the growth


def test_gravity_does_not_matter_at_high_speed():
    """It falls as 1/W^4: (S g/(I W^2))^2 of the frequency, 1e-6 at 100 rad/s."""
    speed = [100.0]
    with_gravity, without = (
        tb.campbell(hinged(g), speed, bearing=0, count=1, steps=16) for g in (G, 0.0)
    )
    off = (with_gravity.frequency - without.frequency).abs() / without.frequency
    # what is left is the error of the steps: fourth order by two lengths of these
    assert without.method == "multiblade" and off < 2e-4


def test_a_frequency_that_long_steps_take_across_the_speed_is_that_of_its_pair():
    """A mast that moves along the axis beside the speed, by 2e-3 above it, which the half as many
    steps lower by 3.2e-3: of them the other one of the pair is known. Both err by 2e-5 together.
    """
    speed, mass = 100.0, 7.0 + MASS
    scene = hinged(1e-3, on=mass * (1.002 * speed) ** 2)
    diagram = tb.campbell(scene, [speed], bearing=0, count=2, steps=16)
    torch.testing.assert_close(diagram.frequency[0, 1].item(), 1.002 * speed, rtol=2e-5, atol=0)
    assert diagram.error[0, 1].item() < 2e-3 * speed


def test_an_orbit_of_a_rotor_on_a_support_has_the_growth_of_ground_resonance():
    """Hammond's helicopter with next to no gravity, its growth as in `test_rotors`: 81 and 41
    midpoint steps together err by fourth order.
    """
    scene = helicopter((0.0, C, C, C))
    scene = replace(scene, effects=(*scene.effects, tb.Gravity((0, 1e-3, 0))))
    diagram = tb.campbell(scene, [26.0], bearing=0, count=6, steps=20)
    assert diagram.method == "floquet"
    expected = exponents(26.0, (0.0, C, C, C))[::2]
    np.testing.assert_allclose(np.sort(diagram.eigenvalue.real[0]), expected, rtol=0, atol=2e-4)


def test_lags_of_the_wake_are_in_the_map_over_a_turn():
    """Flapping with Wagner's lags under next to no gravity."""
    scene = hover("wagner", 2, 3)
    scene = replace(scene, effects=(*scene.effects, tb.Gravity((1e-3, 0, 0))))
    diagram = tb.campbell(scene, [SPEED], bearing=0, count=1, steps=16)
    expected = flapping_with_lags(2, ((0.165, 0.0455), (0.335, 0.3)))
    np.testing.assert_allclose(seen_from_the_blade(diagram), expected, rtol=2e-4)


def test_modes_of_blades_and_tower_are_all_there():
    """Under next to no gravity those of the same rotor without, by fourth order: 2e-4 of the
    fastest, at 0.28 rad a step. How fast a motion is on average is told in the same coordinates:
    moves of the tower come before those of blades that are three times as fast.
    """
    tower = tb.Section.from_stiffness(EA=1e9, GA=4e8, GJ=1e7, EI=2e7, mass=100.0, inertia=10.0)
    blade = tb.Section.from_stiffness(EA=1e8, GA=4e7, GJ=1e5, EI=(4e5, 1e6), mass=8.0, inertia=0.1)
    parts = {
        "tower": tb.Beam.straight(10.0, 2, tower, direction=(0, 0, 1), up=(1, 0, 0)),
        "hub": tb.Body(200.0, 20.0, position=(0, 0, 10.0)),
    }
    joints = [tb.Hinge(("tower", -1), "hub", axis=(1, 0, 0))]
    for k in range(3):
        along = (0, math.sin(2 * math.pi * k / 3), math.cos(2 * math.pi * k / 3))
        straight = dict(root=(0, 0, 10.0), direction=along, up=(1, 0, 0))
        parts[f"blade {k}"] = tb.Beam.straight(5.0, 1, blade, **straight)
        joints.append(tb.Weld("hub", (f"blade {k}", 0)))
    still = tb.Scene(parts, joints=joints, supports=tb.Support(("tower", 0)))
    heavy = replace(still, effects=[tb.Gravity((0, 0, -1e-3))])
    of = dict(bearing=0, count=6, steps=32)
    expected, found = (tb.campbell(scene, [10.0], **of) for scene in (still, heavy))
    assert (expected.method, found.method) == ("multiblade", "floquet")
    torch.testing.assert_close(found.frequency, expected.frequency, rtol=2e-4, atol=0)


def test_wind_that_shears_moves_blades_and_does_not_change_their_damping():
    """Quasi-steady lift is linear in the wind: the blades go around an orbit, of 4e-3 rad, and flap
    about it as in `test_rotors_in_air`. They are rigid: motions that no step resolves are many.
    """

    def wind(x, t):
        return torch.stack((0 * x[..., 0], 0 * x[..., 0], 0.1 + 0.015 * x[..., 0]), -1)

    diagram = tb.campbell(hover(None, 2, wind=wind), [SPEED], bearing=0, count=1, steps=16)
    assert diagram.method == "floquet"
    lock = RHO * 2 * math.pi * CHORD * RADIUS**4 / INERTIA * (1 + 1 / 2**2)
    expected = SPEED * complex(-lock / 16, math.sqrt(1 - (lock / 16) ** 2))
    np.testing.assert_allclose(seen_from_the_blade(diagram), expected, rtol=2e-4)


@pytest.mark.parametrize("options", [dict(method="multiblade"), dict(held=False)])
def test_what_wants_a_steady_state_is_refused(options):
    with pytest.raises(ValueError, match=r"change with its azimuth.*was given to campbell with"):
        tb.campbell(hinged(), [16.0], bearing=0, count=1, **options)


def test_derivatives_of_an_orbit_are_refused():
    g = torch.tensor(G, dtype=torch.float64, requires_grad=True)
    speed = torch.tensor([16.0], dtype=torch.float64, requires_grad=True)
    for gravity, W in ((g, [16.0]), (G, speed)):
        with pytest.raises(ValueError, match="with derivatives"):
            tb.campbell(hinged(gravity), W, bearing=0, count=1)
