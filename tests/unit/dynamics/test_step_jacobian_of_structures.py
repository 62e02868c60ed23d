"""Derivative of one step of a structure in the coordinates of a linear model, and its states."""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.unit.dynamics.test_step_jacobian import coordinates, is_the_slope

SECTION = tb.Section.from_stiffness(EA=4e3, GA=1.4e3, GJ=0.8, EI=(1.0, 1.3), mass=0.2, inertia=1e-3)
THIN = tb.Section.from_stiffness(EA=4e3, GA=1.4e3, GJ=0.8, EI=(1.0, 1.3), mass=0.2)
U = torch.tensor([0.1, 0.5, 0.4])
HELD = [tb.Support(("arm", 0))]
TURNING = tb.Frame(angular_velocity=(0.0, 0.0, 3.0))


def linkage(joint=None, *, order=1, section=SECTION, effects=(), joints=(), **of):
    """Two beams, the second upwards from the tip of the first, and a hand on it; forces on that."""
    parts = {
        "arm": tb.Beam.straight(1.0, 2, section, order=order),
        "fore": tb.Beam.straight(
            0.8, 2, section, order=order, root=(1.0, 0, 0), direction=(0, 0, 1), up=(-1, 0, 0)
        ),
        "hand": tb.Body(0.1, 1e-3, position=(1.0, 0, 0.8)),
    }
    met = [joint or tb.Hinge(("arm", -1), ("fore", 0), axis=(0, 1, 0), **LAW)]
    met.append(tb.Weld(("fore", -1), "hand"))
    of = dict(supports=HELD) | of
    force = tb.PointLoad("hand", force=tb.Input("u", 3))
    return tb.Scene(parts, [force, *effects], joints=[*met, *joints], **of)


LAW = dict(stiffness=3.0, damping=0.05)
ELBOW = dict(a=("arm", -1), b=("fore", 0), axis=(0, 1, 0))
ROD = tb.Distance("hand", None, at=(0.3, 0, 0.4))
SCENES = {
    "a sprung hinge": linkage(effects=[tb.Gravity((0, 0, -9.81)), tb.Damping(1e-3)]),
    "a loop in a plane": linkage(joints=[ROD], plane="xz"),
    "a slider": linkage(tb.Slider(**ELBOW, stiffness=30.0)),
    "a driven hinge": linkage(tb.Hinge(**ELBOW, angle=lambda t: 0.1 + 0 * t)),
    "a ball, order 2": linkage(tb.Ball(("arm", -1), ("fore", 0)), order=2),
    "a sprung ball": linkage(tb.Ball(("arm", -1), ("fore", 0), **LAW)),
    "a universal joint": linkage(
        tb.Universal(**ELBOW, second=(1.0, 0, 0), stiffness=(3.0, 2.0), damping=(0.05, 0.1))
    ),
    "a cylindrical joint": linkage(tb.Cylindrical(**ELBOW)),
    "in a frame that turns": linkage(tb.Hinge(**ELBOW, stiffness=3.0), frame=TURNING, section=THIN),
    "parts apart": tb.Scene(
        {
            "arm": tb.Beam.straight(1.0, 2, SECTION),
            "stone": tb.Body(0.3, (1e-2, 2e-2, 3e-2), position=(0, 1.0, 0)),
        },
        [tb.PointLoad("stone", force=tb.Input("u", 3))],
        supports=HELD,
    ),
}


def model_of(scene):
    start = tb.rest(scene)
    if (
        scene.effects[1:]
        or scene.frame
        or (
            scene.joints
            and isinstance(scene.joints[0], tb.Hinge)
            and scene.joints[0].angle is not None
        )
    ):
        start = None
    return tb.linearize(scene, start, inputs={"u": torch.zeros(3)})


@pytest.mark.parametrize("kind", SCENES)
def test_state_at_is_the_inverse_of_departure(kind):
    """To Newton's quadratic convergence, rounding; joints are closed, and tell their coordinate."""
    model = model_of(SCENES[kind])
    z = coordinates(model)
    state = model.state_at(z)
    assert_close(model.departure(state), z, rtol=0, atol=1e-12)
    assert_close(state.position[0], model.state.position[0], rtol=0, atol=1e-14)
    joints = model.chart.joints
    if joints.count:
        reduced = model.space.to_reduced(state)
        pose = joints.pose(reduced.position, reduced.rotation)
        assert_close(
            joints.gaps(pose, model.state.joints),
            torch.zeros(joints.held_count),
            rtol=0,
            atol=1e-14,
        )
        angle = (joints.coordinate(pose) * joints.angles * joints.first).sum(-1)
        if joints.balls is not None:
            angle = angle + joints.balls.to_joints(joints.balls.turn(pose), -2, joints.count)[:, 0]
        assert_close(state.joints[..., 0], angle, rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", SCENES)
def test_is_the_slope_of_a_step(kind):
    """One of them by the adjoint of native steps."""
    engine = "compiled" if kind == "a loop in a plane" else "eager"
    is_the_slope(SCENES[kind], model_of(SCENES[kind]), engine)


def test_a_batch_of_structures_is_each_of_them():
    """Of three stiffnesses of the hinge, about three equilibria."""
    stiffness = torch.tensor([2.0, 3.0, 5.0])

    def jacobian(k):
        scene = linkage(tb.Hinge(**ELBOW, stiffness=k, damping=0.05), effects=[tb.Damping(1e-3)])
        model = tb.linearize(scene, tb.equilibrium(scene, inputs={"u": U}), inputs={"u": U})
        return tb.Stepper(scene, 0.01, engine="eager").jacobian(model.state, U, model)

    together = jacobian(stiffness)
    for k, own in enumerate(stiffness):
        for batch, alone in zip(together, jacobian(own), strict=True):
            assert_close(batch[k], alone, rtol=0, atol=1e-9 * alone.abs().max().item())
