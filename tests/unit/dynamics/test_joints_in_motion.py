"""Joints: what they hold, whatever the pose, and what they leave alone."""

from dataclasses import replace

import pytest
import torch
from scipy.integrate import solve_ivp

import torchbeam as tb
from torchbeam.dynamics.failure import unresisted_motion
from torchbeam.nodal.discretise import discretise

METHODS = ("midpoint", "generalized_alpha")
SECTION = tb.Section.from_stiffness(EA=1e3, GA=5e2, GJ=0.7, EI=1.0, mass=0.3, inertia=1e-3)
GRAVITY = tb.Gravity((0, 0, -9.81))


def pendulum(spin=8.0, **joint):
    """A body of 1 kg, 1 m below its hinge, which turns by so much rad/s: over the top."""
    body = tb.Body(mass=1.0, inertia=(0.1, 0.2, 0.3), position=(0.0, 0, -1))
    scene = tb.Scene(
        {"body": body},
        [GRAVITY],
        joints=[tb.Hinge(None, "body", at=(0, 0, 0), axis=(0, 1, 0), **joint)],
    )
    return scene, replace(
        tb.rest(scene),
        velocity=torch.tensor([[-spin, 0.0, 0]]),
        spin=torch.tensor([[0, spin, 0.0]]),
    )


def test_hinge_holds_its_axis_at_any_angle():
    """Its two rows about the axis stay as independent as they are as drawn: at a right angle
    too.
    """
    scene, state = pendulum()
    joints, stepper, least = discretise(scene).joints, tb.Stepper(scene, 0.04), []
    for _ in range(12):  # up to 3 rad
        pose = joints.pose(state.position, state.rotation)
        turning = joints.gradient(joints.v.at(pose), joints.w.at(pose))[0, :, 9:][
            joints.held[0] > 0
        ][3:]
        least.append(torch.linalg.svdvals(turning)[-1])
        state = stepper(state)
    assert state.nodes[0, 2] > 0.9  # it is at the top
    torch.testing.assert_close(torch.stack(least), torch.ones(12), rtol=0, atol=1e-9)


@pytest.mark.steps
@pytest.mark.parametrize("method", METHODS)
def test_pendulum_of_a_body_alone_has_order_two(method):
    """(J + m l^2) a = -m g l sin(angle), without any beam, against the ODE."""
    exact = solve_ivp(
        lambda t, y: [y[1], -9.81 / 1.2 * torch.sin(torch.tensor(y[0])).item()],
        (0, 0.4),
        [0, 8.0],
        rtol=1e-12,
        atol=1e-12,
    ).y[0, -1]
    errors = []
    for steps in (20, 40):
        scene, state = pendulum()
        stepper = tb.Stepper(scene, 0.4 / steps, method=method)
        for _ in range(steps):
            state = stepper(state)
        wanted = -torch.sin(torch.tensor(exact)), -torch.cos(torch.tensor(exact))
        errors.append(torch.hypot(state.nodes[0, 0] - wanted[0], state.nodes[0, 2] - wanted[1]))
    assert errors[1] < 1e-2 and 3.7 < errors[0] / errors[1] < 4.3


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("order", "linked", "plane"),
    [(1, False, None), (1, True, None), (2, False, None), (1, False, "xz"), (2, False, "xz")],
)
def test_beam_cut_and_welded_is_the_beam(method, order, linked, plane):
    """In statics and in motion, but for rounding: the two nodes at the weld share the beam's
    inertia and stiffness there.
    """

    def beam(length, n, **more):
        made = tb.Beam.straight(length, n, SECTION, order=order, **more)
        return made.linked() if linked else made

    force = (0.1, 0.0 if plane else 0.3, -0.4)
    whole = tb.Scene(beam(1.0, 4), [tb.TipLoad(force=force)], plane=plane)
    cut = tb.Scene(
        {"a": beam(0.5, 2), "b": beam(0.5, 2, root=(0.5, 0, 0))},
        [tb.PointLoad(("b", -1), force=force)],
        plane=plane,
        joints=[tb.Weld(("a", -1), ("b", 0))],
        supports=[tb.Support(("a", 0))],
    )
    # the nodes of the beam among those of both
    again = [i for i in range(4 * order + 2) if i != 2 * order + 1]
    one, two = (tb.equilibrium(scene, tolerance=1e-13) for scene in (whole, cut))
    torch.testing.assert_close(two.nodes[again], one.nodes, rtol=0, atol=1e-13)
    if linked:
        return  # the masses of its nodes are shared by another rule at ends
    one, two = tb.rest(whole), tb.rest(cut)
    tight = dict(method=method, engine="eager", tolerance=1e-13)
    steppers = [tb.Stepper(scene, 0.02, **tight) for scene in (whole, cut)]
    for _ in range(4):
        one, two = steppers[0](one), steppers[1](two)
    torch.testing.assert_close(two.nodes[again], one.nodes, rtol=0, atol=1e-13)
    # of EA = 1000 N times strains of places that are known to 1e-16
    torch.testing.assert_close(two.reaction, one.reaction, rtol=0, atol=1e-10)


def test_adaptive_steps_of_a_body_alone():
    """A body that a moment makes tumble, whose centre stays: its rotation is what the tolerance
    holds; started again from where it is. The tolerance of an angle is that of a place over its
    radius of gyration.
    """
    scene = tb.Scene(
        {"b": tb.Body(1.0, (1.0, 2.0, 2.5))}, [tb.PointLoad("b", moment=(1.0, 30.0, 1.0))]
    )
    times = torch.tensor([0.0, 0.3])
    fine = tb.simulate(scene, times, method="midpoint4", step=0.02, engine="eager").state[-1]
    found = tb.simulate(scene, times, atol=1e-3, engine="eager").state[-1]
    assert (found.rotation - fine.rotation).abs().max() < 1e-3
    again = tb.simulate(scene, times, found, atol=1e-2, engine="eager")
    assert int(again.status) == 0


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("alone", [False, True], ids=["joint", "support"])
def test_a_twist_that_nothing_resists_is_named(method, alone):
    """Of a section without rotary inertia behind a hinge along the beam, or on a pin."""
    thin = tb.Section.from_stiffness(EA=1e3, GA=5e2, GJ=0.7, EI=1.0, mass=0.3)
    arm = tb.Beam.straight(0.5, 1, SECTION)
    rod = tb.Beam.straight(0.5, 2, thin, root=(0.5, 0, 0))
    if alone:
        scene, node = tb.Scene(rod, [GRAVITY], supports=[tb.Support(0, rotation="")]), "[0-2]"
    else:
        hinge = tb.Hinge(("arm", -1), ("rod", 0), axis=(1, 0, 0))
        held = [tb.Support(("arm", 0))]
        scene = tb.Scene({"arm": arm, "rod": rod}, [GRAVITY], joints=[hinge], supports=held)
        node = r"\('rod', [0-2]\)"
    sentence = rf"neither stiffness nor inertia resists a rotation about \(1, 0, 0\) of node {node}"
    with pytest.warns(RuntimeWarning, match=sentence):
        tb.simulate(scene, [0.0, 0.02], step=0.02, method=method, throw=False)


def test_what_is_lost_beside_a_joint_is_said():
    """A hinge with a friction of 1e10 N m: rounding keeps nothing of the stiffness beside it."""
    parts = {
        "a": tb.Beam.straight(1.0, 2, SECTION),
        "b": tb.Beam.straight(1.0, 2, SECTION, root=(1.0, 0, 0)),
    }
    hinge = tb.Hinge(("a", -1), ("b", 0), friction=1e10, slip_speed=1e-3)
    scene = tb.Scene(parts, [GRAVITY], joints=[hinge], supports=[tb.Support(("a", 0))])
    sentence = r"what acts in a joint of node \('[ab]', [02]\) is more than 1e\+10 times"
    with pytest.warns(RuntimeWarning, match=sentence):
        tb.simulate(scene, [0.0, 0.01], step=0.01, engine="eager", halvings=0, throw=False)


# so many of a system's units of length and of force in 1 m and 1 N
UNITS = {"SI": (1.0, 1.0), "mm-N-s-t": (1e3, 1.0), "um-uN-s": (1e6, 1e6), "km-N-s": (1e-3, 1.0)}


@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("friction, said", [(1e6, False), (1e12, True)])
def test_what_is_lost_is_told_in_any_units(units, friction, said):
    """The tangent of a chain of rods, of which each joint's friction is so many N m: the sentence
    does not hang on the units of moments beside forces.
    """
    m, N = UNITS[units]
    section = tb.Section.from_stiffness(
        EA=1e4 * N, GA=4e3 * N, GJ=0.8 * N * m**2, EI=1.0 * N * m**2, mass=0.2 * N / m / m
    )
    parts = {
        "a": tb.Beam.straight(1.0 * m, 2, section),
        "b": tb.Beam.straight(1.0 * m, 2, section, root=(1.0 * m, 0, 0)),
    }
    hinge = tb.Hinge(("a", -1), ("b", 0), friction=friction * N * m, slip_speed=1e-3)
    scene = tb.Scene(parts, joints=[hinge], supports=[tb.Support(("a", 0))], plane="xz")
    stepper = tb.Stepper(scene, 0.01, engine="eager")
    problem = stepper.method.problem(
        stepper.model, stepper.reduced(stepper.rest()), stepper.dt, torch.tensor(0.0), {}
    )
    sentence = unresisted_motion(problem, torch.tensor(True))
    assert said == ("what acts in a joint" in (sentence or "")), sentence


def test_friction_is_solved_for_not_foreseen():
    """It turns over within a slip speed, so that a residual that has fallen fast does not go on to:
    the kinetic energy is the work, to rounding.
    """
    parts = {
        "a": tb.Body(0.5, 0.1, position=(0.5, 0, 0)),
        "b": tb.Body(0.5, 0.1, position=(1.5, 0, 0)),
    }
    law = dict(axis=(0, 1, 0), friction=0.5, slip_speed=0.01)
    joints = [tb.Hinge(None, "a", at=(0, 0, 0), **law), tb.Hinge("a", "b", at=(1, 0, 0), **law)]
    push = tb.PointLoad("b", force=lambda t: torch.stack((0 * t, 0 * t, 4 * torch.cos(20 * t)), -1))
    stepper = tb.Stepper(
        tb.Scene(parts, [push], joints=joints), 0.02, engine="eager", tolerance=1e-12
    )
    state = stepper.rest()
    for _ in range(12):
        state = stepper(state)
    kinetic = sum(
        (m / 2) * state[name].velocity.square().sum() + 0.05 * state[name].spin.square().sum()
        for name, m in (("a", 0.5), ("b", 0.5))
    )
    torch.testing.assert_close(kinetic, state.work, rtol=1e-11, atol=0)
