"""ResolvedRate: the tip led to its target by the Jacobian of the arm as it stands."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core import BeamVectorEnv
from ..episodes import Episodes
from ..inverse_kinematics import Turned
from ..soft_arm import SoftArm
from ..torque_arm import TorqueArm
from .holding import Controller, vector_env
from .linear import amount

ROUNDS = 4  # in each of which more components may come to their bounds


class ResolvedRate(Controller):
    """Change of the command by damped least squares (Whitney 1969; Wampler 1986). J is the soft
    arm's `tip_jacobian` by the actions, and e is the remaining way of the tip,

        J' (J J' + damping^2 I)^-1 gain e,    e = target - tip + ahead target' - lead tip'

    with the target at the end of the interval. With a `turn`, the tip's turn has three more rows,
    if the task asks for a turn. Actions and commands that would pass their bounds stay there, and
    the others take over (Flacco, De Luca and Khatib 2012, "Motion control of redundant robots under
    joint constraints: saturation in the null space"). An arm that follows its command with a lag
    tau needs lead = ahead = tau, and a small gain beside the intervals in tau.

    With `standing`, moves start from the command that would hold the arm as it stands, not from
    the one that acts. So a viscous arm of a time constant tau goes the remaining way as
    exp(- gain t / tau): it wants a gain above 1, no lead, and ahead = tau / gain. Nothing is summed
    up, so that a bar in the way stops it for good.

    Args:
        gain: share of the remaining way that an interval covers
        damping: m, compared with the singular values of J: moves of the tip by a full action
        lead: s, by which the tip's own motion is anticipated
        ahead: s, by which the target's motion is anticipated
        turn: m, weight of a turn of the tip by 1 rad
        standing: share by which the squares of what would hold the arm are damped, for moves that
            start from there, of arms driven by torques; 0: they start from what acts

    Raises:
        ValueError: for a task of another beam, a damping that is not positive, a `standing` below
            0, and one with an arm that is not driven by torques.

    Examples:
        >>> env = envs.InverseKinematicsVectorEnv(2)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = baselines.ResolvedRate(env)
        >>> controller.begin(env)
        >>> controller(observation).shape
        (2, 15)
    """

    def __init__(
        self,
        env: BeamVectorEnv,
        gain: float = 1.0,
        damping: float = 0.005,
        lead: float = 0.1,
        ahead: float = 0.0,
        turn: float = 0.0,
        standing: float = 0.0,
    ) -> None:
        task = vector_env(env).task
        if not isinstance(task, SoftArm):
            raise ValueError(
                f"{type(task).__name__} was given to ResolvedRate; a soft arm (FollowTarget, "
                "TrackTarget) is wanted"
            )
        if standing and not isinstance(task, TorqueArm):
            raise ValueError(
                f"standing = {standing} was given for {type(task).__name__}; an arm driven by "
                "torques (TrackTarget, ReachPose) is wanted"
            )
        self.standing = amount("standing", standing, zero=True)
        self.gain, self.damping, self.lead = gain, amount("damping", damping), lead
        self.ahead, self.turn = ahead, turn if isinstance(task, Turned) else 0.0

    def act(self, observation: Tensor) -> Tensor:
        now = self.env.state
        return self.towards(now, *self.env.task.target(now, 1).unbind(1))

    def towards(self, now: Episodes, here: Tensor, target: Tensor) -> Tensor:
        """Actions (n, a) that lead the tip to a target (n, 3) m, which is `here` now."""
        task = self.env.task
        J, turned = (task.change * x for x in task.tip_jacobian(now))
        tip = now.beam.position[:, -1] + self.lead * now.beam.velocity[:, -1]
        way = target + self.ahead / task.config.control_interval * (target - here) - tip
        if self.turn:
            off = task.to_turn(now) - self.lead * now.beam.spin[:, -1]
            J, way = torch.cat((J, self.turn * turned), 1), torch.cat((way, self.turn * off), 1)
        return self._within_bounds(now, J, self.gain * way)

    def _within_bounds(self, now: Episodes, J: Tensor, way: Tensor) -> Tensor:
        """(n, a): actions and commands beyond their bounds stay there, and the rest takes over."""
        task = self.env.task
        held, command = task.held(now), task.command(now) / task.change
        if self.standing:
            held = command = task.standing(now, self.standing)
        room, fixed = task.limits / task.change, torch.zeros_like(held, dtype=torch.bool)
        low, high = (-1 - held).maximum(-room - command), (1 - held).minimum(room - command)
        move = torch.zeros_like(held)
        for _ in range(ROUNDS):
            left = way - (J @ (move * fixed)[..., None])[..., 0]
            move = torch.where(fixed, move, self._least_squares(J * ~fixed[:, None], left))
            fixed = fixed | (move <= low) | (move >= high)
            move = move.clamp(low, high)
        return held + move

    def _least_squares(self, J: Tensor, way: Tensor) -> Tensor:
        eye = self.damping**2 * torch.eye(way.shape[-1], dtype=J.dtype, device=J.device)
        return (J.mT @ torch.linalg.solve(J @ J.mT + eye, way[..., None]))[..., 0]
