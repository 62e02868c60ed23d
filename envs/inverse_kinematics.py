"""InverseKinematics: bring the tip of an upright soft arm to a place, turned as wanted."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchbeam.extend import quaternions as quat

from .core import BeamVectorEnv
from .episodes import Episodes
from .manipulator import SEGMENTS, Manipulator, ManipulatorConfig
from .single import SingleEnv
from .soft_arm import NEAR, SoftArm


@dataclass(frozen=True, kw_only=True)
class InverseKinematicsConfig(ManipulatorConfig):
    """yaw (rad): see `InverseKinematicsVectorEnv`; the rest as in `ManipulatorConfig`."""

    yaw: float = math.pi / 2
    max_episode_steps: int | None = 100

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_numbers("yaw", least=0.0, most=math.pi)
        if self.planar:
            raise ValueError("planar = True was given; the tip turns in space, False is wanted")


class Turned(SoftArm):
    """An arm whose tip is to be at a place, and turned about `AXIS` since the start."""

    GOAL = 4
    AXIS = 0.0, 0.0, 1.0
    UNITS = {"distance": "m", "misaligned": ""}  # noqa: RUF012

    def sample_goal(self, streams: list[np.random.Generator], rows: Tensor) -> Tensor:
        """(k, 4): places (m) and turns (rad)."""
        most = self.config.yaw
        drawn = [[*self.in_box(stream), stream.uniform(-most, most)] for stream in streams]
        return torch.tensor(drawn, dtype=self.dtype, device=self.device)

    def target(self, now: Episodes, ahead: int = 0) -> Tensor:
        return now.goal[:, None, :3].expand(-1, ahead + 1, -1)

    def wanted(self, now: Episodes) -> Tensor:
        """(n, 4) quaternion: the turn since the start, frame a."""
        half, axis = now.goal[:, 3:] / 2, self.low.new_tensor(self.AXIS)
        return torch.cat((torch.cos(half), torch.sin(half) * axis), -1)

    def turned(self, now: Episodes) -> Tensor:
        """(n, 4) quaternion: the tip's turn since the start, frame a."""
        q = quat.multiply(now.beam.rotation[:, -1], quat.conjugate(now.start.rotation[:, -1]))
        return quat.normalize(q)

    def to_turn(self, now: Episodes) -> Tensor:
        """(n, 3) rad, frame a: by how much the tip is still to turn."""
        return quat.logarithm(quat.multiply(self.wanted(now), quat.conjugate(self.turned(now))))

    def measures(self, now: Episodes) -> dict[str, Tensor]:
        cosine = (self.turned(now) * self.wanted(now)).sum(-1)
        return super().measures(now) | {"misaligned": 1 - cosine.square()}


class InverseKinematics(Turned, Manipulator):
    """Bring the tip to a place, turned as wanted: `InverseKinematicsVectorEnv` has the
    specification.
    """

    Config = InverseKinematicsConfig
    TWIST = True

    def target_high(self) -> np.ndarray:
        bends, twists = np.full(2 * SEGMENTS, self.config.bend), np.full(SEGMENTS, math.pi / 2)
        return np.concatenate((np.ones(4), bends, twists, np.ones(3), np.ones(4)))

    def target_observation(self, now: Episodes, tip: Tensor | None) -> Tensor:
        # the scalar last, as published
        turned, wanted = self.turned(now).roll(-1, -1), self.wanted(now).roll(-1, -1)
        return torch.cat((turned, self.command(now), now.goal[:, :3], wanted), -1)

    def cost(self, now: Episodes) -> Tensor:
        d, off = (now.measures[name] for name in ("distance", "misaligned"))
        straight, straighter = self.below(off, 0.1), self.below(off, 0.05)
        near = 1 + 0.5 * straight - 0.5 * off
        at = 4 + 0.5 * straight + 1.5 * straighter - 2 * off
        bonus = near * self.below(d, 2 * NEAR) + (at - near) * self.below(d, NEAR)
        return d.square() + 0.5 * off.square() - bonus


class InverseKinematicsVectorEnv(BeamVectorEnv):
    """`num_envs` upright soft arms whose tips are to be at a place, turned as wanted, stepped as
    one batch.

    ## Description
    The arm of `FollowTargetVectorEnv`, from the same publication; twist, too, is natural here. Its
    tip is to come to a place and to be turned about the vertical, as straight up as it stands.

    ## Action space
    `Box(-1, 1, (15,), float32)`: the ten of FollowTarget, then for each segment a change of its
    twist angle over its length: change = 0.05 rad at 1, within +-pi / 2.

    ## Observation space `Box(-high, high, (86 + 15 delay,), float32)`, in metres, m/s and rad; the
    published observation, in another order.

    | index | observation | high |
    |---|---|---|
    | 0-3 | turn of the tip since the start, frame a: quaternion, its scalar last | 1 |
    | 4-13, 14-18 | angles of the segments: bending, twist | 2, pi / 2 |
    | 19-21 | where the tip is to be | 1 |
    | 22-25 | how it is to be turned, likewise | 1 |
    | 26-55, 56-85 | nodes' places and velocities, as in FollowTarget (or `sensors`) | 2, 20 |
    | then 15 delay | actions that are still to act (none by default) | 1 |

    ## Reward
    Per interval, with d (m) the distance of the tip and o = 1 - (q . q wanted)^2:
        - d^2 - o^2 / 2 + bonus
        bonus, d < 0.05:         6 - 2 o where o < 0.05, 4 - 2 o where o > 0.1, else 4.5 - 2 o
        bonus, 0.05 <= d < 0.1:  1 - o / 2 where o > 0.1, else 1.5 - o / 2
    With smooth > 0 the steps in d and o are logistic functions of that width, as in FollowTarget.
    failure_reward = -10 in an interval in which the solver fails.

    ## Starting state
    Upright, at rest under gravity. The place is uniform in the box of FollowTarget, the turn about
    z in [-yaw, yaw], from the sub-env's own generator. Many cannot be had both exactly.

    ## Episode end
    Truncation after 100 steps (10 s), termination where the solver fails.

    ## Information
    `distance` (m), `misaligned` (o above), `solver_failed`, `action_invalid`; masks as in TipReach.

    ## Arguments
    The arguments of FollowTarget without speed, turns and planar, with max_episode_steps = 100, and

    - `yaw`: rad, pi / 2: the largest turn

    ## Parameters
    stiffness, mass, damping as in TipReach. The goal, for options={"goal": ...}, is the place and
    the turn: (4,).

    ## Version history
    v1: as in FollowTarget.
    v0: first version.

    Examples:
        >>> env = envs.InverseKinematicsVectorEnv(2)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> observation.shape, reward.shape
        ((2, 86), (2,))
    """

    task_type = InverseKinematics


class InverseKinematicsEnv(SingleEnv):
    """One upright soft arm to be brought to a place: `InverseKinematicsVectorEnv` with one member,
    see there for everything.

    `gymnasium.make` ends the episode after 100 steps (`max_episode_steps` there); made directly, it
    does not end by itself.

    Examples:
        >>> env = envs.InverseKinematicsEnv()
        >>> observation, info = env.reset(seed=0)
        >>> env.observation_space.shape, env.action_space.shape
        ((86,), (15,))
    """

    vector = InverseKinematicsVectorEnv
