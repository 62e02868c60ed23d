"""Runs of joints that are led: a warning where they start with a jump, and none else."""

import math
import warnings
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

RATE, STEP = 2.0, 1e-3  # rad/s, s
T = [0.0, STEP, 2 * STEP, 3 * STEP]


def rotor(angle, *loads):
    """A body 1 m off the axis about which it is led."""
    body = tb.Body(1.0, 0.1, position=(1.0, 0, 0))
    hinge = tb.Hinge(None, "body", at=(0.0, 0, 0), axis=(0, 0, 1), angle=angle)
    return tb.Scene({"body": body}, loads, joints=[hinge])


def spun(scene, rate):
    """At rest but for a spin about z, as of a rigid body."""
    state = tb.rest(scene)
    spin = state.position.new_tensor([0.0, 0.0, rate]).expand_as(state.position)
    return replace(state, velocity=torch.linalg.cross(spin, state.position), spin=spin)


def warned(scene, initial=None, **options):
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        tb.simulate(scene, T, initial, step=STEP, **options)
    return [
        str(w.message) for w in seen if "joint 0, a Hinge, is led with a jump" in str(w.message)
    ]


@pytest.mark.parametrize("method", ["midpoint", "generalized_alpha"])
@pytest.mark.parametrize("angle", [torch.sin, lambda t: 0.3 + t**2, 0.3])
def test_a_jump_is_told_once(angle, method):
    assert len(warned(rotor(angle), method=method)) == 1


@pytest.mark.parametrize(
    "angle", [lambda t: RATE * t**2, lambda t: t**3, lambda t: 1 - torch.cos(40 * t), 0.0]
)
def test_a_smooth_start_is_not(angle):
    assert warned(rotor(angle)) == []


def test_an_angle_that_the_state_has_is_not():
    """In equilibrium, at a speed, and beyond a turn, where angles are counted by turns."""
    assert warned(rotor(0.3), tb.equilibrium(rotor(0.3))) == []
    at_speed = rotor(lambda t: RATE * t)
    assert warned(at_speed, spun(at_speed, RATE)) == []
    assert len(warned(at_speed, spun(at_speed, 2 * RATE))) == 1
    far = rotor(lambda t: 7.0 + t**2)
    assert warned(far, tb.equilibrium(far)) == []


def test_the_rate_is_constant_from_a_state_that_moves():
    """RATE W after each midpoint step, within W (W dt)^2/6 = 1.3e-6, for a step turns by a tangent;
    from rest 2 W, 0, 2 W.
    """
    scene = rotor(lambda t: RATE * t)
    rate = tb.simulate(scene, T, spun(scene, RATE), step=STEP).joint[0].rate[1:]
    assert_close(rate, torch.full_like(rate, RATE), rtol=0, atol=1.5e-6)
    with pytest.warns(UserWarning, match="is led with a jump"):
        rate = tb.simulate(scene, T, step=STEP).joint[0].rate[1:]
    assert_close(rate, rate.new_tensor([2 * RATE, 0.0, 2 * RATE]), rtol=0, atol=1.5e-6)


def test_a_stepper_tells_at_its_begin_alone():
    scene = rotor(lambda t: RATE * t, tb.PointLoad(force=tb.Input("u", 3), node="body"))
    stepper = tb.Stepper(scene, STEP)
    with pytest.warns(UserWarning, match="is led with a jump"):
        state = stepper.begin(tb.rest(scene))  # which wants no inputs
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        stepper(state, u=torch.zeros(3))


def test_a_run_goes_on_from_each_of_its_states():
    """Also from turning points, where the rate is zero and that of the state nearly so."""
    scene = rotor(lambda t: 1 - torch.cos(40 * t))
    states = tb.simulate(scene, torch.linspace(0, 0.2, 41), engine="compiled").state
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        tb.Stepper(scene, torch.tensor(0.005)).begin(states[1:])


@pytest.mark.parametrize("place", [0.45, 0.5, 0.55])
def test_a_turning_point_within_the_first_step_is_no_jump(place):
    """Where the angle after the step is nearly that before it."""
    top, speed = place * STEP, 40.0
    scene = rotor(lambda t: torch.cos(speed * (t - top)) - math.cos(speed * top))
    assert warned(scene, spun(scene, speed * math.sin(speed * top))) == []


@pytest.mark.parametrize("periods", [1, 200, 1000])
def test_adaptive_steps_have_no_length_to_begin_with(periods):
    """Of an angle with so many periods in the run, at rest when it begins; and one with a rate.
    200 are one a step that is tried first. The run itself is cut short.
    """
    end, speed = 0.4, 2 * math.pi * periods / 0.4

    def told(angle):
        with warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always")
            tb.simulate(rotor(angle), [0.0, end], rtol=1e-9, max_steps=1)
        return ["is led with a jump" in str(w.message) for w in seen]

    assert not any(told(lambda t: 1 - torch.cos(speed * t)))
    assert any(told(lambda t: torch.sin(speed * t)))


def test_a_joint_that_an_input_leads_is_asked_nothing():
    """And the other one still is, whichever is the first."""

    def pair(*angles):
        bodies = {name: tb.Body(1.0, 0.1, position=(1.0, 0, 0)) for name in "ab"}
        joints = [
            tb.Hinge(None, name, at=(0.0, 0, 0), axis=(0, 0, 1), angle=angle)
            for name, angle in zip(bodies, angles, strict=True)
        ]
        return tb.Scene(bodies, joints=joints)

    def told(*angles):
        scene = pair(*angles)
        with warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always")
            tb.Stepper(scene, STEP).begin(tb.rest(scene))
        return [str(w.message)[:8] for w in seen if "is led with a jump" in str(w.message)]

    led = tb.Input("u", 1)
    assert told(led, torch.sin) == ["joint 1,"]
    assert told(torch.sin, led) == ["joint 0,"]
    assert told(led, torch.square) == told(led, None) == []


def test_samples_of_a_batch():
    """One that jumps among others that do not, by scenes and by states."""
    rate = torch.tensor([0.0, 0.0, RATE])
    scene = rotor(lambda t: rate * t)
    assert len(warned(scene)) == 1
    assert warned(rotor(lambda t: 0 * rate * t)) == []

    def end(rate):
        scene = rotor(lambda t: rate * t)
        return tb.simulate(scene, T, step=STEP, engine="eager").state.position[-1, 0, 1]

    with pytest.warns(UserWarning, match="joint 0, a Hinge, is led with a jump"):
        assert torch.func.vmap(end)(rate).shape == (3,)


def test_supports_have_their_speed_from_the_first_step():
    """Of supports the rate is that of their motion, whatever the state has: there is no jump from
    step to step, and from `rest` none at all.
    """
    strip = tb.Section.circle(0.01, E=210e9, nu=0.3, rho=7800.0)

    def lifted(t):
        return torch.stack((0 * t, RATE * t, 0 * t), -1)

    support = tb.Support(0, displacement=lifted)
    scene = tb.Scene(tb.Beam.straight(1.0, 1, strip), supports=[support])
    rest = tb.rest(scene)
    for initial, first in ((rest, RATE), (replace(rest, velocity=0 * rest.velocity), 0.0)):
        speed = tb.simulate(scene, T, initial, step=STEP).state.velocity[:, 0, 1]
        assert_close(speed, speed.new_tensor([first, *[RATE] * 3]), rtol=0, atol=1e-12)
