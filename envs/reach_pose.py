"""ReachPose: bring the tip of a soft arm, driven by torques, to a place, turned as wanted."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from .core import BeamVectorEnv
from .episodes import Episodes
from .inverse_kinematics import Turned
from .single import SingleEnv
from .soft_arm import NEAR
from .torque_arm import TorqueArm, TorqueArmConfig


@dataclass(frozen=True, kw_only=True)
class ReachPoseConfig(TorqueArmConfig):
    """yaw (rad): see `ReachPoseVectorEnv`; the rest as in `TorqueArmConfig`."""

    yaw: float = math.pi / 2
    failure_reward: float | None = -10000.0  # as published
    max_episode_steps: int | None = 1428

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_numbers("yaw", least=0.0, most=math.pi)


class ReachPose(Turned, TorqueArm):
    """Bring the tip to a place, turned as wanted: `ReachPoseVectorEnv` has the specification."""

    Config = ReachPoseConfig
    DRIVEN = 1, 2, 0
    AXIS = 0.0, 1.0, 0.0

    def target_high(self) -> np.ndarray:
        return np.append(super().target_high(), np.ones(12))

    def target_observation(self, now: Episodes, tip: Tensor | None) -> Tensor:
        still = now.goal.new_zeros(len(now.steps), 4)
        seen = super().target_observation(now, tip)
        return torch.cat((seen, still, self.turned(now), self.wanted(now)), -1)

    def cost(self, now: Episodes) -> Tensor:
        d, off = (now.measures[name] for name in ("distance", "misaligned"))
        near = 1 - 0.5 * off + 0.5 * self.below(off, 0.1)
        at = 3 - 1.5 * off + 1.5 * self.below(off, 0.05)
        bonus = near * self.below(d, 2 * NEAR) + at * self.below(d, NEAR)
        return d.square() + 0.5 * off.square() - bonus


class ReachPoseVectorEnv(BeamVectorEnv):
    """`num_envs` soft arms, driven by torques, whose tips are to be at a place, turned as wanted,
    stepped as one batch.

    ## Description
    The arm of `TrackTargetVectorEnv`, case 2 of the same publication; torques act about its tangent
    too. Its tip is to come to a place that stays, turned about y, as it stands at rest otherwise.

    ## Action space
    `Box(-1, 1, (18,), float32)`: as in TrackTarget, six values about the normal, the binormal and
    the tangent.

    ## Observation space `Box(-high, high, (52 + 18 delay,), float32)`, in metres and m/s; the
    published observation, in another order, with turns since the start in place of turns from frame
    a.

    | index | observation | high |
    |---|---|---|
    | 0-3 | speed of the tip, and its direction, 0 where it is still | 100, 1 |
    | 4-6 | where the tip is to be | 1 |
    | 7-10 | speed and direction of that: 0 | 1 |
    | 11-14 | turn of the tip since the start, frame a: quaternion, its scalar first | 1 |
    | 15-18 | how it is to be turned, likewise | 1 |
    | 19-51 | where eleven nodes are, every second from the foot (or the `sensors` given) | 2 |
    | then 18 delay | actions that are still to act (none by default) | 1 |

    ## Reward
    Per interval, with d (m) the distance of the tip and o = 1 - (q . q wanted)^2:
        - d^2 - o^2 / 2 + bonus
        bonus, d < 0.1:  1 - o / 2, and 0.5 where o < 0.1
        bonus, d < 0.05: beside it 3 - 1.5 o, and 1.5 where o < 0.05
    With smooth > 0 the steps in d and o are logistic functions of that width, as in FollowTarget.
    failure_reward = -10000 in an interval in which the solver fails.

    ## Starting state
    Straight along y, at rest. The place is uniform in the box of TrackTarget, the turn about y in
    [-yaw, yaw], from the sub-env's own generator.

    ## Episode end
    Truncation after 1428 steps (2 s), termination where the solver fails.

    ## Information
    `distance` (m), `misaligned` (o above), `solver_failed`, `action_invalid`; masks as in TipReach.

    ## Arguments
    The arguments of TrackTarget without speed and turns, with failure_reward = -10000,
    max_episode_steps = 1428, and

    - `yaw`: rad, pi / 2: the largest turn

    ## Parameters
    stiffness, mass as in TipReach. The goal, for options={"goal": ...}, is the place and the turn:
    (4,).

    ## Version history
    v0: first version.

    Examples:
        >>> env = envs.ReachPoseVectorEnv(2, elements=10)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> observation.shape, reward.shape
        ((2, 52), (2,))
    """

    task_type = ReachPose


class ReachPoseEnv(SingleEnv):
    """One soft arm, driven by torques, to be brought to a place: `ReachPoseVectorEnv` with one
    member, see there for everything.

    `gymnasium.make` ends the episode after 1428 steps (`max_episode_steps` there); made directly,
    it does not end by itself.

    Examples:
        >>> env = envs.ReachPoseEnv(elements=10)
        >>> observation, info = env.reset(seed=0)
        >>> env.observation_space.shape, env.action_space.shape
        ((52,), (18,))
    """

    vector = ReachPoseVectorEnv
