"""Environments as functions: what the environment does, by hand, as often as one likes."""

import pytest
import torch
from torch.testing import assert_close
from torchbeam_envs import TipReachVectorEnv, functional

SMALL = dict(elements=2, substeps=1, planar=True, randomize=True, noise=0.01, max_episode_steps=2)


def actions(n=3, steps=3):
    return torch.linspace(-1.2, 0.8, n * steps, dtype=torch.float64).reshape(steps, n, 1)


def test_it_is_the_environment():
    """Observations, rewards and ends of an env whose episodes stand still once they are over: the
    same operations.
    """
    env = TipReachVectorEnv(3, output="torch", autoreset_mode="Disabled", **SMALL)
    sim = functional.simulation(TipReachVectorEnv, 3, **SMALL)
    now = functional.reset(sim, seed=7)
    assert_close(now.observation, env.reset(seed=7)[0], rtol=0, atol=0)
    for action in actions():
        now, reward = functional.step(sim, now, action)
        observation, gained, terminated, truncated, _ = env.step(action)
        pairs = (
            (now.observation, observation),
            (reward, gained),
            (now.terminated, terminated),
            (now.truncated, truncated),
        )
        for a, b in pairs:
            assert_close(a, b, rtol=0, atol=0)
    assert now.truncated.all() and (reward == 0).all()


def test_the_same_episodes_can_be_stepped_again_and_differentiated():
    sim = functional.simulation(TipReachVectorEnv.task_type, 3, delay=0, **SMALL)
    start = functional.reset(sim, seed=[1, 2, 3], goal=None)
    action = actions(steps=1)[0].requires_grad_()
    first = functional.step(sim, start, action).reward
    other = functional.step(sim, start, -action).reward
    again = functional.step(sim, start, action).reward
    assert_close(first, again, rtol=0, atol=0)
    assert (first != other).all()
    h, inside = 1e-6, action.detach().clamp(-1 + 1e-5, 1 - 1e-5).requires_grad_()
    (slope,) = torch.autograd.grad(functional.step(sim, start, inside).reward.sum(), inside)
    up, down = (functional.step(sim, start, inside.detach() + s).reward for s in (h, -h))
    # rounding of a difference over 2e-6
    assert_close(slope[:, 0], (up - down) / (2 * h), rtol=1e-5, atol=1e-7)


def test_refusals():
    sim = functional.simulation(TipReachVectorEnv, 2, **SMALL)
    now = functional.reset(sim)
    for action in (torch.zeros(2, 2), [[0.0], [0.0]], torch.full((2, 1), torch.nan)):
        with pytest.raises(ValueError, match="wanted"):
            functional.step(sim, now, action)
    for of in (3, torch.nn.Module):
        with pytest.raises(ValueError, match="derived from BeamVectorEnv or from Task is wanted"):
            functional.simulation(of, 2)
    with pytest.raises(TypeError):
        functional.simulation(TipReachVectorEnv, 2, lenght=1.0)
