"""Gripper: what it holds, what its balancer bears, what a finger is pulled by."""

import numpy as np
import pytest
import torch
from torchbeam_envs import GripperVectorEnv, TipReachVectorEnv
from torchbeam_envs.baselines import Grasp, Zero

from tests.cases.refusals import refusals


def test_balls_are_lifted_and_kept():
    """`Grasp` has sixteen balls, whatever their mass and friction, within 5 mm of their target
    after 1 s, and to the end all but a heavy smooth one, which slips out in the last 60 ms (by 16
    and 32 steps an interval, too); without action none leaves the table. No solve fails.
    """
    env = GripperVectorEnv(16, planar=True, autoreset_mode="Disabled", params_in_info=True)
    for kind, wanted in ((Grasp, (15, 16)), (Zero, (0,))):
        controller = kind(env)
        observation, info = env.reset(seed=0)
        assert np.ptp(info["params"]["ball"]) > 0.02 and np.ptp(info["params"]["friction"]) > 0.3
        controller.begin(env)
        for k in range(100):
            observation, *_, info = env.step(controller(observation))
            assert not info["solver_failed"].any()
            assert k < 50 or info["lifted"].sum() in wanted


def test_a_ball_that_is_held_on_the_table_fails_no_solve():
    """Fingers that squeeze it with all of their tension while the hub rests: a failed solve would
    end the episode at less cost (100) than waiting has (3 an interval). With two halvings, those of
    most tasks, solves of six of these eight fail.
    """
    env = GripperVectorEnv(8, planar=True, autoreset_mode="Disabled")
    env.reset(seed=0)
    action = np.zeros((8, 3))
    for k in range(24):
        action[:, 1:] = min(1.0, -1 + k / 10)
        *_, info = env.step(action)
        assert not info["solver_failed"].any()


def test_smooth_balls_slip_out_of_a_loose_grip():
    """The heaviest ball in six tenths of the grip: a rough one goes up with the hub, a smooth one
    stays on the table, of which the whole grip lifts it.
    """
    env = GripperVectorEnv(2, planar=True, autoreset_mode="Disabled")
    given = {"params": {"ball": 0.07, "friction": [0.5, 0.8]}, "goal": [[0.0], [0.0]]}
    heights = []
    for grip in (0.6, 1.0):
        controller = Grasp(env, grip=grip, closing=0.4, stiffness=120.0, damping=8.0)
        observation, _ = env.reset(seed=0, options=given)
        controller.begin(env)
        for _ in range(60):
            observation, *_ = env.step(controller(observation))
        heights.append(env.state.beam.position[:, -1, 2] - env.config.ball)
    loose, tight = heights
    assert loose[0] < 1e-3 and loose[1] > 0.03 and (tight > 0.03).all()


def test_nothing_moves_by_itself():
    """Slack tendons, the usual ball and no force on the hub: all rests but for the stretch of the
    fingers under their weight, 0.1 mm.
    """
    env = GripperVectorEnv(1, planar=True, randomize={"ball": (0.05, 0.05)})
    env.reset(seed=0)
    start = env.state.beam.position
    for _ in range(10):
        env.step(np.array([[0.0, -1.0, -1.0]]))
    assert (env.state.beam.position - start).abs().max() < 1e-4
    assert env.state.beam.tendons[..., 0].abs().max() == 0
    env.step(np.array([[0.0, 1.0, -1.0]]))
    tension = torch.tensor([10.0, 0.0], dtype=torch.float64)
    torch.testing.assert_close(env.state.beam.tendons[0, :, 0], tension)


def test_one_action_has_one_reward():
    """In space three fingers close on a ball that lies aside. Actions that differ by 1e-8 give
    rewards that do, with v1's eight steps an interval; with four Newton's method ends in the whole
    step or, as often, in none, so that the step is made in parts, and rewards are 0.01 apart.
    """
    env = GripperVectorEnv(32)
    place = [-0.0006795857531744287, 0.0014811480982497743]
    given = {
        "params": {"ball": 0.049003355951060035, "friction": 0.5029511424827127},
        "goal": place,
    }
    near = 1 + 1e-8 * np.random.default_rng(1).standard_normal((32, 1))
    env.reset(seed=0, options=given)
    action = [0.5493044705300076, -0.6062737704789469, -0.40862550600460157, 0.1911097096819987]
    _, reward, *_, info = env.step(near * action)
    assert not info["solver_failed"].any()
    assert np.ptp(reward) < 1e-5


@refusals(
    (dict(length=0.05), "length = 0.05"),
    (dict(pull=-1.0), "pull = -1.0"),
    (dict(offset=0.01), "offset = 0.01"),
    (dict(friction=-0.1), "friction = -0.1"),
    (dict(force=(1.0, 1.0)), "force was given"),
)
def test_bad_arguments_are_refused(arguments):
    GripperVectorEnv(1, **arguments)


def test_grasp_is_for_grippers():
    with pytest.raises(ValueError, match="Gripper is wanted"):
        Grasp(TipReachVectorEnv(1, elements=2))
