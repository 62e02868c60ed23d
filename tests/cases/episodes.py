"""Episodes of environments that a controller plays."""

import torch


@torch.no_grad()
def play(env, controller, seed=0):
    """(return, distance at the end), means."""
    observation, _ = env.reset(seed=seed)
    controller.begin(env)
    total = 0.0
    for _ in range(env.max_episode_steps):
        observation, reward, terminated, _, info = env.step(controller(observation))
        total = total + reward
    assert not terminated.any()
    return total.mean().item(), info["distance"].mean().item()
