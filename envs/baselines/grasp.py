"""Grasp: fingers closed, then a hub lifted."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core import BeamVectorEnv
from ..gripper import Gripper
from .holding import Controller, vector_env


class Grasp(Controller):
    """Grasps with a `Gripper`: tightens all tendons over a time, then lifts the hub.

    The force on the hub is stiffness (height to go of the ball) - damping velocity, and the usual
    ball's weight. Settings are those of the best return on 64 training episodes in the plane.

    Args:
        grip: of the tendons' range, in [0, 1]
        closing: s
        stiffness: N/m
        damping: N s/m

    Raises:
        ValueError: for another task.

    Examples:
        >>> env = envs.GripperVectorEnv(2, planar=True)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = baselines.Grasp(env)
        >>> controller.begin(env)
        >>> controller(observation).shape
        (2, 3)
    """

    def __init__(
        self,
        env: BeamVectorEnv,
        grip: float = 1.0,
        closing: float = 0.02,
        stiffness: float = 700.0,
        damping: float = 24.0,
    ) -> None:
        task = vector_env(env).task
        if not isinstance(task, Gripper):
            raise ValueError(f"{type(task).__name__} was given to Grasp; Gripper is wanted")
        self.grip, self.closing = grip, closing
        self.stiffness, self.damping = stiffness, damping

    def act(self, observation: Tensor) -> Tensor:
        task, now = self.env.task, self.env.state
        c = task.config
        share = (now.steps + 1) * c.control_interval / self.closing
        tension = (2 * self.grip * share.clamp(max=1) - 1)[:, None].to(now.beam.position)
        to_go = (task.aim - now.beam.position[:, -1])[:, 2]
        weight = 0.0 if task.gravity is None else -c.mass * task.gravity[2]
        force = weight + self.stiffness * to_go - self.damping * task.carried(now)[1]
        lift = torch.where(share < 1, 0.0, force / c.motor)[:, None]
        return torch.cat((lift, tension.expand(-1, len(task.fingers))), -1)
