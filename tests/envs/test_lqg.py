"""LQG and its kin: integral action, scheduled gains, latency in the model, hinges that turn."""

import pytest
import torch
from torchbeam_envs import SlewVectorEnv, TipReachVectorEnv
from torchbeam_envs.baselines import LQG, LQR, JointLQG, JointLQR

from tests.cases.episodes import play

torch.set_num_threads(1)
SMALL = dict(elements=2, substeps=1, output="torch", autoreset_mode="Disabled")


def make(n, **arguments):
    return TipReachVectorEnv(n, **{**SMALL, **arguments})


def test_integral_action_takes_off_what_the_model_does_not_know():
    """Actuators that give 0.7 of what is asked, after 3 s: the disturbance that the filter
    estimates brings the tip four times nearer than the filter without.
    """
    plants = dict(planar=True, randomize={"gain": (0.7, 0.7)}, max_episode_steps=150, reach=0.2)
    env = make(4, **plants)
    far, near = (play(env, LQG(env, effort=1.0, disturbance=d))[1] for d in (0.0, 0.03))
    assert near < 0.25 * far
    for name, value in (("disturbance", -1.0), ("action", 0.0), ("latency", 0.5), ("schedule", 2)):
        with pytest.raises(ValueError, match=f"{name} = {value} was given"):
            LQG(env, **{name: value})


def test_scheduled_gains_are_those_about_the_held_shape():
    """At a point of the grid the interpolated gain is that of the model there, half-way between two
    the mean; and the feedback of the scheduled models still reaches the targets.
    """
    env = make(4, planar=True, max_episode_steps=40)
    controller = LQR(env, effort=0.1, schedule=3)
    at = controller.schedule.at(torch.tensor([[-1.0], [0.0], [0.5]]).to(env.high), controller.K)
    K = controller.K
    expected = torch.stack((K[0], K[1], (K[1] + K[2]) / 2))
    torch.testing.assert_close(at, expected, rtol=1e-12, atol=0)
    torch.testing.assert_close(K[1], LQR(env, effort=0.1).K[0], rtol=1e-6, atol=1e-9)
    assert (K[0] - K[1]).abs().max() > 0.05 * K[1].abs().max()
    assert play(env, controller)[1] < 0.02 * env.task.length


def test_latency_in_the_model():
    """Actions that act two intervals later than the env's delay: the model that reckons with them
    loses less than one that does not.
    """
    env = make(4, planar=True, randomize={"latency": (2.0, 2.0)})
    costs = [-play(env, LQG(make(1, planar=True), effort=0.1, latency=k))[0] for k in (0, 2)]
    assert costs[1] < 0.9 * costs[0]


def test_filter_turns_a_hub():
    """Through the same angles, from the observation alone: within a tenth of what JointLQR costs,
    which sees the state; the estimate stays within 2 % of the length of where the tip is.
    """
    env = SlewVectorEnv(4, planar=True, **{**SMALL, "noise": 0.002, "max_episode_steps": 60})
    controller = JointLQG(env, effort=1.0, disturbance=0.01)
    seen = -play(env, controller)[0]
    tip = controller.model.state_at(controller.x[:, : len(controller.A)]).position[:, -1]
    far = (tip - env.state.beam.position[:, -1]).norm(dim=-1)
    assert seen < -1.1 * play(env, JointLQR(env, effort=1.0))[0]
    assert far.max() < 0.02 * env.task.length


def test_filter_knows_turns_that_angles_do_not_tell():
    """The hub is driven on for 1.6 s, past where its angle is read a whole turn less: the estimate
    stays with it. (Its innovation was a turn, and it was lost.)
    """
    env = SlewVectorEnv(2, planar=True, **SMALL)
    observation, _ = env.reset(seed=0)
    controller = JointLQG(env)
    controller.begin(env)
    controller.feedback = lambda z: torch.ones(2, env.task.actions, dtype=env.dtype)
    read = []
    for _ in range(80):
        observation, *_ = env.step(controller(observation))
        read.append(env.state.measures["angle"])
    assert torch.stack(read).diff(dim=0).abs().max() > 6
    tip = controller.model.state_at(controller.x[:, : len(controller.A)]).position[:, -1]
    far = (tip - env.state.beam.position[:, -1]).norm(dim=-1)
    assert far.max() < 0.1 * env.task.length


def test_frames_of_the_past_are_no_matter():
    """The filter reads the last frame: the same actions, of noisy readings and a random plant."""
    given = dict(elements=2, substeps=1, planar=True, noise=0.01, output="torch")
    acted = []
    for frames in (1, 3):
        env = TipReachVectorEnv(2, randomize={"stiffness": (0.7, 1.3)}, frames=frames, **given)
        controller = LQG(env)
        seen, _ = env.reset(seed=0)
        controller.begin(env)
        actions = []
        for _ in range(4):
            actions.append(controller(seen))
            seen, *_ = env.step(actions[-1])
        acted.append(torch.stack(actions))
    assert torch.equal(*acted) and acted[0].abs().max() > 0.01


def test_latency_that_is_drawn_is_in_the_model_of_a_regulator():
    """Its mean, rounded; none where none is drawn, and none of hinges that turn, whose regulator
    loses by it.
    """
    late = {"latency": (0.0, 2.0)}
    for kind in (LQR, LQG):
        assert kind(make(1, planar=True, randomize=late)).late.latency == 1
        assert kind(make(1, planar=True, randomize={"lag": (0.0, 0.04)})).late.latency == 0
        assert kind(make(1, planar=True, randomize=late), latency=2).late.latency == 2
    hub = SlewVectorEnv(1, planar=True, **{**SMALL, "randomize": late})
    assert all(kind(hub).late.latency == 0 for kind in (JointLQR, JointLQG))
