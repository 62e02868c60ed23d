"""Insert: a rod led over a hole, then down."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core import BeamVectorEnv
from ..peg import Peg
from .holding import Controller, vector_env


class Insert(Controller):
    """Inserts the rod of a `Peg` by forces stiffness (wanted - place) - damping velocity on its
    carriage.

    The wanted place is over the hole, as high as the start. Once the tip is within `near` of the
    axis, or below the plate's upper side, it goes down to the target. Settings are those of the
    best return on 64 training episodes in the plane.

    Args:
        stiffness: N/m
        damping: N s/m
        near: m

    Raises:
        ValueError: for another task.

    Examples:
        >>> env = envs.PegVectorEnv(2, planar=True)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = baselines.Insert(env)
        >>> controller.begin(env)
        >>> controller(observation).shape
        (2, 2)
    """

    def __init__(
        self, env: BeamVectorEnv, stiffness: float = 60.0, damping: float = 4.0, near: float = 0.015
    ) -> None:
        task = vector_env(env).task
        if not isinstance(task, Peg):
            raise ValueError(f"{type(task).__name__} was given to Insert; Peg is wanted")
        self.stiffness, self.damping, self.near = stiffness, damping, near

    def act(self, observation: Tensor) -> Tensor:
        task, now = self.env.task, self.env.state
        at, velocity = task.carried(now)
        tip = now.beam.position[:, -1]
        down = (torch.linalg.vector_norm(tip[:, :2], dim=-1) < self.near) | (tip[:, 2] < 0)
        wanted = torch.where(
            down[:, None], task.aim, -task.aim * task.config.height / task.config.depth
        )
        force = self.stiffness * (wanted - at) - self.damping * velocity
        return force[:, task.vector] / task.config.motor
