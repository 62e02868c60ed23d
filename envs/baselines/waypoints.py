"""Waypoints: the command of a soft arm led through places of its own, whatever is seen."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchbeam.extend import shown

from ..core import BeamVectorEnv
from ..parameters import numbers
from ..soft_arm import SoftArm
from .holding import Controller, vector_env
from .linear import amount


class Waypoints(Controller):
    """Leads the command of a soft arm from zero through waypoints, on straight lines, and holds
    the last one.

    It reads the command, and corrects it if something else has changed it; it reads nothing of the
    arm. Its pace is that of the component that changes most.

    Args:
        waypoints: (w, a) commands, in the units of the task's limits (rad, shares of a torque)
        pace: share of the largest change of the command in an interval
        legs: (w,) intervals from each waypoint to the next, in place of a pace

    Raises:
        ValueError: for a task of another beam, waypoints of another size, or other legs than one
            positive number for each.

    Examples:
        >>> env = envs.ReachObstaclesVectorEnv(2, planar=True)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = baselines.Waypoints(env, [[0.5, 0.5, 0.0, 0.0, 0.0]])
        >>> controller.begin(env)
        >>> controller(observation).shape
        (2, 5)
    """

    def __init__(
        self,
        env: BeamVectorEnv,
        waypoints: Sequence[Sequence[float]],
        pace: float = 1.0,
        legs: Sequence[float] | None = None,
    ) -> None:
        env = vector_env(env)
        if not isinstance(env.task, SoftArm):
            raise ValueError(
                f"{type(env.task).__name__} was given to Waypoints; a soft arm (ReachObstacles, "
                "ReachBehind) is wanted"
            )
        places = torch.from_numpy(numbers("waypoints", waypoints)).to(env.device, env.dtype)
        if (
            places.ndim != 2
            or places.shape[-1] != env.task.actions
            or not len(places)
            or not torch.isfinite(places).all()
        ):
            raise ValueError(
                f"waypoints of shape {tuple(places.shape)} were given; finite "
                f"(w, {env.task.actions}) is wanted"
            )
        self.places = torch.cat((torch.zeros_like(places[:1]), places))
        lengths = (self.places[1:] - self.places[:-1]).abs().amax(-1)
        self.pace = amount("pace", pace) * env.task.change
        if legs is not None:
            lengths, self.pace = torch.from_numpy(numbers("legs", legs)).to(lengths), 1.0
            if lengths.shape != self.places[1:, 0].shape or not (lengths > 0).all():
                raise ValueError(
                    f"legs = {shown(legs)} was given; a positive number for each waypoint is wanted"
                )
        self.ends = torch.cat((lengths.new_zeros(1), lengths.cumsum(0)))

    def act(self, observation: Tensor) -> Tensor:
        task, now = self.env.task, self.env.state
        passed = (self.pace * (now.steps + 1).to(self.ends)).clamp(max=self.ends[-1])
        k = torch.searchsorted(self.ends, passed).clamp(min=1)
        length = self.ends[k] - self.ends[k - 1]
        share = ((passed - self.ends[k - 1]) / torch.where(length > 0, length, 1.0))[:, None]
        goal = torch.lerp(self.places[k - 1], self.places[k], share)
        return task.held(now) + (goal - task.command(now)) / task.change
