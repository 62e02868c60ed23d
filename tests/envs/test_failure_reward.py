"""Failing is never better than going on, whatever the task: of all that are registered."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import torch
import torchbeam_envs
from torchbeam_envs import TipReachEnv, TipReachVectorEnv
from torchbeam_envs.plant import Plant

# published with their rewards, of an interval in which the simulation fails, whatever is left
PUBLISHED = dict.fromkeys(("FollowTarget", "InverseKinematics", "ReachObstacles"), -10) | {
    "TrackTarget": -1000, "ReachPose": -10000, "ReachBehind": -100,
}  # fmt: skip
IDS = sorted(
    id
    for id in gymnasium.registry
    if id.startswith("torchbeam/") and not any(name in id for name in PUBLISHED)
)
# in space: `long`
ONCE = [pytest.param(id, marks=[pytest.mark.long] * ("Planar" not in id)) for id in IDS]
EPISODES = 2


def vector(id, **changes):
    coarse = {} if "BlockRate" in id else dict(elements=2, substeps=2)
    coarse |= {} if "Gripper" not in id and "Peg" not in id else dict(elements=4, substeps=8)
    changes = {**coarse, "autoreset_mode": "Disabled", **changes}
    return gymnasium.make_vec(id, num_envs=EPISODES, **changes)


def played(env, push, steps):
    """(steps, n) rewards of fresh episodes under a constant action, and which of them failed."""
    env.reset(seed=0)
    rewards, failed = np.zeros((steps, EPISODES)), np.zeros(EPISODES, bool)
    for k in range(steps):
        _, rewards[k], failed, *_ = env.step(np.full(env.action_space.shape, push))
    return rewards, failed


def failing(monkeypatch):
    """From here on each solve fails."""
    advance = Plant.advance

    def failed(plant, state, *arguments):
        after = advance(plant, state, *arguments)
        return replace(after, status=torch.ones_like(after.status))

    monkeypatch.setattr(Plant, "advance", failed)


@pytest.mark.parametrize("id", ONCE)
def test_failing_is_no_better_than_doing_nothing_or_anything_else(id, monkeypatch):
    """Episodes that fail in their first, second and middle intervals return no more than the same
    ones without action; the first also no more than those with all actions at a bound throughout,
    as far as motors drive what they drive. No interval of an episode that goes on costs more than
    one that is left where it fails.
    """
    env, limit = vector(id), gymnasium.spec(id).max_episode_steps
    assert env.config.intervals == limit
    returns = []
    for push in (0.0, 1.0, -1.0):
        rewards, failed = played(env, push, limit)
        assert (rewards[:, ~failed] >= -env.simulation.worst).all()
        returns.append(rewards.sum(0))
    for k in (0, 1, limit // 2):
        before, lost = played(env, 0.0, k)
        with monkeypatch.context() as patch:
            failing(patch)
            _, reward, terminated, _, info = env.step(np.zeros(env.action_space.shape))
        assert terminated.all() and (lost | info["solver_failed"]).all()
        wanted = np.where(lost, 0.0, -(limit - k) * env.simulation.worst)
        np.testing.assert_allclose(reward, wanted)
        assert (before.sum(0) + reward <= returns[0]).all()
        assert k or (reward <= np.min(returns, 0)).all()


def test_published_tasks_keep_their_reward():
    assert {id.split("/")[1].split("-")[0].removesuffix("Planar").removesuffix("Nest")
            for id in gymnasium.registry
            if id.startswith("torchbeam/") and id not in IDS} == {*PUBLISHED}  # fmt: skip
    for name, reward in PUBLISHED.items():
        task = getattr(torchbeam_envs, f"{name}VectorEnv").task_type
        assert task.Config().failure_reward == reward


def test_a_reward_that_is_given_is_that_of_the_interval(monkeypatch):
    """failure_reward = -7: that alone, whenever it fails."""
    env = vector("torchbeam/TipReachPlanar-v1", failure_reward=-7.0)
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape))
    failing(monkeypatch)
    assert (env.step(np.zeros(env.action_space.shape))[1] == -7).all()


def test_single_envs_count_the_intervals_of_their_task(monkeypatch):
    """Without an end of its own an env counts those that the task has by default (Gymnasium's
    wrapper ends it), and once they are over one.
    """
    one = TipReachEnv(elements=2, planar=True)
    many = TipReachVectorEnv(1, elements=2, planar=True)
    for k, steps in ((0, 50), (60, 1)):
        one.reset(seed=0)
        for _ in range(k):
            one.step(np.zeros(1))
        with monkeypatch.context() as patch:
            failing(patch)
            reward = one.step(np.zeros(1))[1]
        assert reward == pytest.approx(-steps * many.simulation.worst)


def test_a_failed_episode_costs_the_worst_of_each_interval_left():
    """TipReach: 20 and the control cost of one action, at a distance of two lengths."""
    env = TipReachVectorEnv(1, elements=2, planar=True)
    soft = env.config.length / 1000
    cost = (np.hypot(2 * env.config.length, soft) - soft) / (0.1 * env.config.length)
    assert env.simulation.worst == pytest.approx(cost + env.config.control_cost, rel=1e-12)
