"""Structures against equations of motion of few coordinates, closed forms and differences of
energy.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

import torchbeam as tb

SECTION = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-4)
STOCKY = tb.Section.from_stiffness(EA=1e3, GA=5e2, GJ=0.7, EI=(1.0, 2.0), mass=0.3, inertia=1e-3)
INF = math.inf
WEIGHT = tb.Gravity((0, 0, -9.81))


def last(scene, t, steps, **more):
    """State after so many steps from rest."""
    stepper, state = tb.Stepper(scene, t / steps, engine="eager", **more), tb.rest(scene)
    for _ in range(steps):
        state = stepper(state)
    assert not state.status.any()
    return state


def double_pendulum(**scene):
    """Two bodies that fall from the horizontal: 1 kg, 0.1 kg m^2, 0.5 m from their hinges, which
    are 1 m apart.
    """
    parts = {
        "upper": tb.Body(1.0, 0.1, position=(0.5, 0, 0)),
        "lower": tb.Body(1.0, 0.1, position=(1.5, 0, 0)),
    }
    joints = [
        tb.Hinge(None, "upper", at=(0, 0, 0), axis=(0, 1, 0)),
        tb.Hinge("upper", "lower", at=(1, 0, 0), axis=(0, 1, 0)),
    ]
    return tb.Scene(parts, [WEIGHT], joints=joints, **scene)


def double_pendulum_angles(t, J=0.1):
    """From the vertical, by the equations of Lagrange; J: over the mass and 1 m^2."""

    def rates(_, y):
        a, b, u, v = y
        c, s = 0.5 * math.cos(a - b), 0.5 * math.sin(a - b)
        M = np.array([[J + 0.25 + 1.0, c], [c, J + 0.25]])
        f = np.array([-s * v**2 - 1.5 * 9.81 * math.sin(a), s * u**2 - 0.5 * 9.81 * math.sin(b)])
        return [u, v, *np.linalg.solve(M, f)]

    return solve_ivp(rates, (0, t), [math.pi / 2, math.pi / 2, 0, 0], rtol=1e-11, atol=1e-11).y[
        :2, -1
    ]


@pytest.mark.parametrize(("method", "plane"), [("midpoint", None), ("generalized_alpha", "xz")])
def test_rigid_double_pendulum(method, plane):
    """Of order two; the lower hinge's coordinate is the difference of the angles."""
    a, b = double_pendulum_angles(0.5)
    wanted = torch.tensor([math.sin(a) + 0.5 * math.sin(b), -math.cos(a) - 0.5 * math.cos(b)])
    states = [last(double_pendulum(plane=plane), 0.5, steps, method=method) for steps in (20, 40)]
    errors = [torch.linalg.vector_norm(state["lower"].position[::2] - wanted) for state in states]
    assert errors[1] < 6e-3 and 3.6 < errors[0] / errors[1] < 4.4
    assert abs(states[1].joint[1].coordinate - (a - b)) < 6e-3  # a turn about y is downward


@pytest.mark.parametrize("elements", [1, 4])
def test_double_pendulum_of_rigid_beams(elements):
    """Two rigid beams, 1 m and 1.2 kg each, that fall from the horizontal: m L^2/12 about their
    middles on every mesh, in steps of 5 ms by midpoint4 within 1e-7 m (1.6e-8, the steps) of
    Lagrange's equations after 1 s. With half of it lumped they were 0.24 and 0.018 m off.
    """
    of = tb.Section.from_stiffness(EA=INF, GA=INF, GJ=INF, EI=INF, mass=1.2)
    parts = {
        "upper": tb.Beam.straight(1.0, elements, of),
        "lower": tb.Beam.straight(1.0, elements, of, root=(1.0, 0, 0)),
    }
    joints = [
        tb.Hinge(None, ("upper", 0), at=(0, 0, 0), axis=(0, 1, 0)),
        tb.Hinge(("upper", -1), ("lower", 0), at=(1, 0, 0), axis=(0, 1, 0)),
    ]
    scene = tb.Scene(parts, [WEIGHT], joints=joints, plane="xz")
    state = tb.simulate(scene, [0.0, 1.0], step=0.005, method="midpoint4").state["lower"]
    a, b = double_pendulum_angles(1.0, 1 / 12)
    wanted = torch.tensor([math.sin(a) + math.sin(b), -math.cos(a) - math.cos(b)])
    assert torch.linalg.vector_norm(state.tip.position[-1, ::2] - wanted) < 1e-7


def test_slider_crank():
    """A crank of 0.3 m driven by 2 N m turns a slider by a rod of 1 m: one coordinate, mass by its
    square's factor.
    """
    start, r, l = 1.0, 0.3, 1.0
    x = math.sqrt(l**2 - (r * math.sin(start)) ** 2)
    pin, end = (r * math.cos(start), 0, r * math.sin(start)), (r * math.cos(start) + x, 0, 0)
    middle = tuple((p + q) / 2 for p, q in zip(pin, end, strict=True))
    parts = {
        "crank": tb.Body(0.5, 0.02),
        "rod": tb.Body(0.4, 0.03, position=middle),
        "slider": tb.Body(0.7, 0.01, position=end),
    }
    scene = tb.Scene(
        parts,
        plane="xz",
        joints=[
            tb.Hinge(None, "crank", at=(0, 0, 0), axis=(0, -1, 0), torque=2.0),
            tb.Hinge("crank", "rod", at=pin, axis=(0, 1, 0)),
            tb.Hinge("rod", "slider", at=end, axis=(0, 1, 0)),
            tb.Slider(None, "slider", axis=(1, 0, 0)),
        ],
    )

    def inertia(angle):
        tilt = math.asin(r * math.sin(angle) / l)
        turn = r * math.cos(angle) / (l * math.cos(tilt))
        middle = -r * math.sin(angle) - l / 2 * math.sin(tilt) * turn, r / 2 * math.cos(angle)
        slider = -r * math.sin(angle) - l * math.sin(tilt) * turn
        return 0.02 + 0.4 * (middle[0] ** 2 + middle[1] ** 2) + 0.03 * turn**2 + 0.7 * slider**2

    def rates(_, y):
        change = (inertia(y[0] + 1e-5) - inertia(y[0] - 1e-5)) / 2e-5
        return [y[1], (2.0 - change * y[1] ** 2 / 2) / inertia(y[0])]

    angle = solve_ivp(rates, (0, 0.4), [start, 0], rtol=1e-10, atol=1e-10).y[0, -1]
    states = [last(scene, 0.4, steps) for steps in (16, 32)]
    errors = [abs(state.joint[0].coordinate - (angle - start)) for state in states]
    assert errors[1] < 3e-3 and 3.7 < errors[0] / errors[1] < 4.3
    travel = r * math.cos(angle) + math.sqrt(l**2 - (r * math.sin(angle)) ** 2) - end[0]
    assert abs(states[1].joint[3].coordinate - travel) < 3e-3


def bent_frame(joint, force=(0.0, 0.3, -0.5)):
    """A beam along x with another along z on its end."""
    parts = {
        "foot": tb.Beam.straight(1.0, 3, SECTION),
        "post": tb.Beam.straight(0.6, 2, SECTION, root=(1.0, 0, 0), direction=(0, 0, 1)),
    }
    return tb.Scene(
        parts,
        [tb.PointLoad(("post", -1), force=force)],
        joints=[joint],
        supports=[tb.Support(("foot", 0))],
    )


def test_stiff_hinge_tends_to_a_weld():
    """At the rate 1/k."""
    ends = ("foot", -1), ("post", 0)
    weld = tb.equilibrium(bent_frame(tb.Weld(*ends)))
    off = [
        torch.linalg.vector_norm(
            tb.equilibrium(bent_frame(tb.Hinge(*ends, axis=(0, 1, 0), stiffness=k))).nodes
            - weld.nodes
        )
        for k in (1e3, 1e5)
    ]
    assert off[1] < 1e-4 and 99 < off[0] / off[1] < 101


def test_gradients_by_joints():
    """By stiffness, place, axis and prescribed angle of a hinge, of a tip in equilibrium, against
    differences.
    """
    ends = ("foot", -1), ("post", 0)
    given = dict(
        stiffness=torch.tensor(2.0),
        at=torch.tensor([1.0, 0.05, 0.1]),
        axis=torch.tensor([0.1, 1.0, 0.2]),
    )

    def tip(**more):
        return tb.equilibrium(bent_frame(tb.Hinge(*ends, **given | more)))["post"].tip.position[
            ..., 2
        ]

    for name, value in given.items():
        x = value.clone().requires_grad_()
        (slope,) = torch.autograd.grad(tip(**{name: x}), x)
        up, down = tip(**{name: torch.stack((value + 1e-5, value - 1e-5))})
        torch.testing.assert_close(slope.sum(), (up - down) / 2e-5, rtol=1e-6, atol=1e-8)


def link(**law):
    """A beam along x, another on its end that is held at its far end by a slider to the ground."""
    parts = {
        "foot": tb.Beam.straight(1.0, 2, SECTION),
        "post": tb.Beam.straight(0.6, 2, SECTION, root=(1.0, 0, 0), direction=(0.3, 0.2, 1)),
    }
    way = {"axis": (0.2, 1.0, 0.1)}
    joints = [
        tb.Hinge(("foot", -1), ("post", 0), **way, angle=law.get("angle", 0.3)),
        tb.Slider(None, ("post", -1), **way, travel=law.get("travel", 0.1)),
    ]
    move = tb.Support(("foot", 0), displacement=(0, 0, law.get("lift", 0.05)))
    return tb.Scene(parts, joints=joints, supports=[move])


def test_forces_of_joints_and_reactions_are_slopes_of_the_energy():
    """By the angle of a hinge, the travel of a slider and the way of a support: virtual work, by
    differences of 1e-4 of what is cubic in them (1e-8)."""

    def energy(**law):
        state = tb.equilibrium(link(**law), tolerance=1e-13)
        compliance = 1 / torch.tensor([1e4, 4e3, 4e3, 0.8, 1, 1])
        lengths = ("foot", 0.5), ("post", 0.3)  # of the elements
        return sum(h / 2 * (state[name].stress ** 2 * compliance).sum() for name, h in lengths)

    state, e = tb.equilibrium(link(), tolerance=1e-13), 1e-4
    axis = torch.nn.functional.normalize(torch.tensor([0.2, 1.0, 0.1]), dim=0)
    turned = state["foot"].tip.rotation @ axis
    hinge, slider = state.joint
    for value, name, wanted in (
        (0.3, "angle", hinge.moment @ turned),
        (0.1, "travel", slider.force @ axis),
        (0.05, "lift", state["foot"].root.force[2]),
    ):
        slope = (energy(**{name: value + e}) - energy(**{name: value - e})) / (2 * e)
        torch.testing.assert_close(slope, wanted, rtol=1e-6, atol=1e-8)


def test_derivatives_by_lengths_offsets_and_places():
    """Of a tip in equilibrium by the length of a beam, the point of a body, and the place at which
    a rod is held, against differences of 1e-5 (1e-9 of second order)."""
    given = dict(
        length=torch.tensor(1.0),
        point=torch.tensor([0.0, -0.2, 0.05]),
        at=torch.tensor([1.2, 0.3, 0.6]),
    )

    def tip(length, point, at):
        middle = torch.stack((length, 0 * length, 0 * length)) - point
        parts = {
            "arm": tb.Beam.straight(length, 2, SECTION),
            "hub": tb.Body(0.1, 1e-3, position=middle),
        }
        joints = [tb.Weld(("arm", -1), ("hub", point)), tb.Distance("hub", None, at=at)]
        scene = tb.Scene(parts, [WEIGHT], joints=joints, supports=[tb.Support(("arm", 0))])
        state = tb.equilibrium(scene, tolerance=1e-13)
        return state["hub"].position[1] + state.joint[1].force[0]

    traced = {name: x.clone().requires_grad_() for name, x in given.items()}
    slopes = torch.autograd.grad(tip(**traced), traced.values())
    for (name, x), slope in zip(given.items(), slopes, strict=True):
        more, less = (tip(**given | {name: x + e}) for e in (1e-5, -1e-5))
        torch.testing.assert_close(slope.sum(), (more - less) / 2e-5, rtol=1e-6, atol=1e-7)


def tumbling():
    """Two bars on a hinge and a ball, and how far points that are joined are apart, in m, and the
    hinge's axes."""
    parts = {
        "upper": tb.Body(1.0, (0.1, 0.2, 0.3), position=(0.5, 0, 0)),
        "lower": tb.Body(1.0, (0.1, 0.2, 0.3), position=(1.5, 0, 0)),
    }
    joints = [
        tb.Hinge(None, "upper", at=(0, 0, 0), axis=(0, 1, 0)),
        tb.Ball("upper", "lower", at=(1, 0, 0)),
    ]

    def gaps(state):
        upper, lower, half = state["upper"], state["lower"], torch.tensor([0.5, 0, 0])
        return (
            upper.position - upper.rotation @ half,
            upper.position + upper.rotation @ half - lower.position + lower.rotation @ half,
            upper.rotation[[0, 2], 1],
        )

    push = tb.PointLoad("lower", moment=(0.1, 0, 0))
    return tb.Scene(parts, [WEIGHT, push], joints=joints), gaps


def linkage():
    """A closed loop, one way to move: a crank and a rocker on hinges, and a flexible rod on a ball
    and a universal joint between them; the gaps of its points, and of the axes that stay at right
    angles."""
    crank, pin, pivot = ((0.15, 0, 0), (0.9, 0.1, 0.6), (1.2, 0.1, 0.0))
    rod = torch.tensor(pin) - torch.tensor([0.3, 0, 0])
    parts = {
        "crank": tb.Body(0.5, (0.01, 0.02, 0.02), position=crank),
        "rod": tb.Beam.straight(rod.norm(), 2, STOCKY, root=(0.3, 0, 0), direction=rod),
        "rocker": tb.Body(0.4, (0.02, 0.03, 0.01), position=(1.05, 0.1, 0.3)),
    }
    y, to_pin, to_pivot = (0, 1.0, 0), (-0.15, 0, 0.3), (0.15, 0, -0.3)
    joints = [
        tb.Hinge(None, "crank", at=(0, 0, 0), axis=y),
        tb.Ball(("crank", crank), ("rod", 0)),
        tb.Universal(("rod", -1), ("rocker", to_pin), axis=y, second=(1.0, 0, 0)),
        tb.Hinge(None, "rocker", at=pivot, axis=y),
    ]
    scene = tb.Scene(parts, [WEIGHT], joints=joints)
    drawn = tb.rest(scene)["rod"].tip.rotation.mT @ torch.tensor(y)

    def gaps(state):
        crank_, rod, rocker = state["crank"], state["rod"], state["rocker"]
        arm = crank_.rotation @ torch.tensor(crank)
        ends = (rocker.position + rocker.rotation @ torch.tensor(x) for x in (to_pin, to_pivot))
        return (
            crank_.position - arm, crank_.position + arm - rod.nodes[0],
            next(ends) - rod.tip.position, next(ends) - torch.tensor(pivot),
            crank_.rotation[[0, 2], 1], rocker.rotation[[0, 2], 1],
            (rod.tip.rotation @ drawn) @ rocker.rotation[:, 0],
        )  # fmt: skip

    return scene, gaps


@pytest.mark.parametrize(
    "steps", [40, pytest.param(100_000, marks=pytest.mark.long)], ids=["short", "long"]
)
@pytest.mark.parametrize("case", [tumbling, linkage])
def test_joints_do_not_drift(case, steps):
    """Points that are joined stay where they meet, to 1e-10 m, and axes, to 1e-10. (The rod, which
    nothing damps, keeps its energy by conserve.)"""
    scene, gaps = case()
    engine = "eager" if steps == 40 else "compiled"
    stepper = tb.Stepper(scene, 0.02, engine=engine, conserve=case is linkage)
    state = tb.rest(scene)
    for _ in range(steps // 40):
        state = tb.rollout(stepper, state, 40)[-1]
    assert not state.status.any()
    assert state.velocity.abs().max() > 0.1  # it still moves
    assert max(gap.abs().max() for gap in gaps(state)) < 1e-10


def test_a_turning_frame_is_a_turning_support():
    """A bob on a hinge at the end of an arm that a shaft turns at 3 rad/s, seen from the shaft and
    from outside: both of second order in the step, and so is their distance."""
    spin, t = torch.tensor([0, 0, 3.0]), 0.16
    parts = {
        "arm": tb.Beam.straight(0.5, 1, STOCKY),
        "bob": tb.Body(0.2, (1e-3, 2e-3, 3e-3), position=(0.5, 0, -0.3)),
    }
    law = dict(stiffness=0.2, damping=0.01)
    hinge = tb.Hinge(("arm", -1), "bob", at=(0.5, 0, 0), axis=(0, 1, 0), **law)
    turning = tb.Support(("arm", 0), turn=lambda t: spin * t[..., None])

    def scene(support, frame=None):
        return tb.Scene(parts, [WEIGHT], joints=[hinge], supports=[support], frame=frame)

    outside, inside = scene(turning), scene(tb.Support(("arm", 0)), tb.Frame(angular_velocity=spin))
    still = tb.rest(outside)
    carried = torch.linalg.cross(spin.expand_as(still.position), still.position)
    starts = replace(still, velocity=carried, spin=spin.expand_as(carried)), tb.rest(inside)
    R = torch.linalg.matrix_exp(torch.tensor([[0, -3.0, 0], [3.0, 0, 0], [0, 0, 0]]) * t)
    apart = []
    for steps in (4, 8):
        ends = []
        for of, state in zip((outside, inside), starts, strict=True):
            stepper = tb.Stepper(of, t / steps, engine="eager")
            for _ in range(steps):
                state = stepper(state)
            ends.append(state.nodes)
        apart.append((ends[0] - ends[1] @ R.T).abs().max())
    assert apart[1] < 1e-4 and 3.6 < apart[0] / apart[1] < 4.4
