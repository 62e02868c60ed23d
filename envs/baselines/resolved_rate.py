"""ResolvedRate: the tip led to its target by the Jacobian of the arm as it stands."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core import BeamVectorEnv
from ..manipulator import Manipulator
from .holding import Controller, vector_env


class ResolvedRate(Controller):
    """Change of the command by damped least squares (Whitney 1969; Wampler 1986), with J the
    manipulator's `tip_jacobian` by the actions and e the way that the tip has to go,

        J' (J J' + damping^2 I)^-1 gain e,    e = target - tip - lead velocity

    the target at the end of the interval. Commands at a limit that would go beyond it are left out,
    and the others take their part. The tip's turn is not led.

    Args:
        gain: share of the way that an interval is to make good
        damping: m, beside the singular values of J: moves of the tip by a full action
        lead: s, by which the tip's own motion is anticipated

    Raises:
        ValueError: for a task that is no manipulator.

    Examples:
        >>> env = envs.InverseKinematicsVectorEnv(2)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = baselines.ResolvedRate(env)
        >>> controller.begin(env)
        >>> controller(observation).shape
        (2, 15)
    """

    def __init__(
        self, env: BeamVectorEnv, gain: float = 1.0, damping: float = 0.005, lead: float = 0.1
    ) -> None:
        task = vector_env(env).task
        if not isinstance(task, Manipulator):
            raise ValueError(
                f"{type(task).__name__} was given to ResolvedRate; a manipulator "
                "(FollowTarget, InverseKinematics) is wanted"
            )
        self.gain, self.damping, self.lead = gain, damping, lead

    def act(self, observation: Tensor) -> Tensor:
        task, now = self.env.task, self.env.state
        J = task.config.change * task.tip_jacobian(now)[0]
        tip = now.beam.position[:, -1] + self.lead * now.beam.velocity[:, -1]
        way = self.gain * (task.target(now, 1)[:, 1] - tip)
        action = self._least_squares(J, way)
        beyond = (task.command(now) + task.config.change * action).abs() > task.limits
        return self._least_squares(J * ~beyond[:, None], way)

    def _least_squares(self, J: Tensor, way: Tensor) -> Tensor:
        eye = self.damping**2 * torch.eye(3, dtype=J.dtype, device=J.device)
        return (J.mT @ torch.linalg.solve(J @ J.mT + eye, way[..., None]))[..., 0]
