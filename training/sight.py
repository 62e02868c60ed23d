"""What no controller sees of an episode, and a critic may that is there in training alone."""

from __future__ import annotations

import torch
from torch import Tensor
from torchbeam_envs import BeamVectorEnv
from torchbeam_envs.sensors import NodeMotions


def sight(env: BeamVectorEnv) -> Tensor:
    """(n, p) of each episode: how much of it is over, its plant's parameters, the motion of the
    beam without noise and bias, the goal, and the actions that act and are to act. Differentiable
    by beam and actions.
    """
    now, limit = env.state, env.config.max_episode_steps
    plant = [value for value in now.plant.params.values() if value.ndim]
    queue = [rows.flatten(1) for rows in (now.late, now.pending) if rows is not None]
    motion = NodeMotions(now.start, env.task.plane)(now.beam)
    share = now.steps / (limit or 1)
    return torch.cat(
        (torch.stack([share.to(motion), *plant], -1), motion, now.goal, now.acting, *queue), -1
    )
