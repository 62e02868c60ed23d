"""FollowTarget: let the tip of an upright soft arm follow a target that moves at random."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from .core import BeamVectorEnv
from .episodes import Episodes
from .manipulator import Manipulator, ManipulatorConfig
from .noise import uniform
from .single import SingleEnv
from .soft_arm import SoftArm

STREAM = 0x3C6EF372FE94F82A  # by which a key's numbers are not those of the sensors' noise


@dataclass(frozen=True, kw_only=True)
class FollowTargetConfig(ManipulatorConfig):
    """speed (m/s), turns: see `FollowTargetVectorEnv`; the rest as in `ManipulatorConfig`."""

    speed: float = 0.5
    turns: float = 0.025
    max_episode_steps: int | None = 500

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_numbers("speed", least=0.0)
        self.check_numbers("turns", least=0.0, most=1.0)


class Wandering(SoftArm):
    """An arm whose target moves straight on, turns round where it is outside of its box, less a
    margin, and takes new directions at times. Its place (3) and velocity (3) are the end of the
    memory.
    """

    GOAL = 6
    RANDOM = True
    MARGIN: ClassVar[float] = 0.0  # m

    def turning(self, now: Episodes, drawn: Tensor) -> Tensor:
        """(n, 1) bool: who takes a new direction, of numbers (n, 1) in (0, 1)."""
        raise NotImplementedError

    def sample_goal(self, streams: list[np.random.Generator], rows: Tensor) -> Tensor:
        """(k, 6): where targets start (m), and their velocities (m/s)."""
        places = torch.as_tensor(np.stack([self.in_box(s) for s in streams])).to(self.low)
        angles = torch.as_tensor(np.stack([s.uniform(0, 1, 2) for s in streams])).to(self.low)
        return torch.cat((places, self._velocity(angles)), -1)

    def _velocity(self, share: Tensor) -> Tensor:
        """(n, 3) m/s, by two angles, shares (n, 2) of a turn."""
        (c, d), (s, e) = (f(2 * torch.pi * share).unbind(-1) for f in (torch.cos, torch.sin))
        across = torch.zeros_like(c) if self.plane else s * e
        return self.config.speed * torch.stack((c * e, across, d), -1)

    def initial_memory(self, goal: Tensor) -> Tensor:
        return torch.cat((super().initial_memory(goal), goal), -1)

    def next_memory(self, now: Episodes, action: Tensor) -> Tensor:
        place, velocity = self.moving(now)
        outside = (place < self.low + self.MARGIN) | (place > self.high - self.MARGIN)
        outside = outside & (velocity != 0) if self.plane else outside
        drawn = uniform(now.key ^ STREAM, now.steps, 3).to(place)
        turns = self.turning(now, drawn[:, :1]) & ~outside.any(-1, keepdim=True)
        velocity = torch.where(turns, self._velocity(drawn[:, 1:]), velocity)
        velocity = torch.where(outside, -velocity, velocity)
        place = place + velocity * self.config.control_interval
        return torch.cat((super().next_memory(now, action), place, velocity), -1)

    def moving(self, now: Episodes) -> tuple[Tensor, Tensor]:
        """(n, 3) m and (n, 3) m/s of the target."""
        return now.memory[:, -6:].split(3, -1)

    def target(self, now: Episodes, ahead: int = 0) -> Tensor:
        """As far as it is known: straight ahead."""
        (place, velocity), dt = self.moving(now), self.config.control_interval
        k = torch.arange(ahead + 1, dtype=self.dtype, device=self.device)
        return place[:, None] + dt * k[:, None] * velocity[:, None]


class FollowTarget(Wandering, Manipulator):
    """Follow a target that moves at random: `FollowTargetVectorEnv` has the specification."""

    Config = FollowTargetConfig

    def turning(self, now: Episodes, drawn: Tensor) -> Tensor:
        return drawn < self.config.turns

    def target_high(self) -> np.ndarray:
        d, bends = self.directions, np.full(self.actions, self.config.bend)
        return np.concatenate((bends, np.full(d, 1.0), np.full(d, max(1.0, self.config.speed))))

    def target_observation(self, now: Episodes, tip: Tensor | None) -> Tensor:
        place, velocity = (x[:, self.vector] for x in self.moving(now))
        return torch.cat((self.command(now), place, velocity), -1)


class FollowTargetVectorEnv(BeamVectorEnv):
    """`num_envs` upright soft arms that follow targets, stepped as one batch.

    ## Description
    A published task (Choi and Tong 2025, "Rapidly learning soft robot control via implicit
    time-stepping"; code: QuantuMope/dismech-rl) in its own numbers and units, so that returns can
    be laid beside each other. A round rod of 1 m, radius 0.05 m, E = 10 MPa, nu = 0.5, 1,000
    kg/m^3, in 20 elements, stands upright, clamped at its foot, under gravity of 9.8 m/s^2. Its tip
    is to follow a target that moves through a box at 0.5 m/s. The actions change the natural
    curvature of five segments of 0.2 m. An interval is 0.1 s, in two implicit steps.

    Two things differ from there. The rod is geometrically exact, with shear, not a discrete elastic
    rod. Steps are of second order, with a damping tau of the bending beyond the natural curvature.
    Implicit Euler's steps h, used there, damp slow motion as tau = h does, and fast motion less:
    damping = 0.043 s here for their 0.05. Under random actions in a plane the tip agrees with that
    rod and scheme to 0.6 to 1.4 % of its motion, RMS (examples/peers/soft_arm/discrete_arm.py). As
    there, the clamp holds half of the first element; the first segment bends by the other half.

    ## Action space
    `Box(-1, 1, (10,), float32)`: for each segment, from the foot, a change of its bending angles
    about the section's y and z, over its length. The change is 0.05 rad at 1, evenly over the
    interval. The angles stay within +-bend = 2 rad, curvatures within 10 1/m.

    ## Observation space `Box(-high, high, (76 + 10 delay,), float32)`, in metres, m/s and rad; the
    published observation, in another order.

    | index | observation | high |
    |---|---|---|
    | 0-9 | angles of the segments | 2 |
    | 10-12 | where the target is | 1 |
    | 13-15 | its velocity | 1 |
    | 16-45 | where every second node is, from node 2 to the tip (or the `sensors` given) | 2 |
    | 46-75 | their velocities | 20 |
    | then 10 delay | actions that are still to act (none by default) | 1 |

    ## Reward
    Per interval, with d (m) the distance from the tip to the target, both at its end:
        - d^2, + 2 where d < 0.05, + 0.5 where 0.05 <= d < 0.1
    Its gradient is that of - d^2. With smooth > 0 the steps are logistic functions of that width:
    1.5 / (1 + exp((d - 0.05) / smooth)) + 0.5 / (1 + exp((d - 0.1) / smooth)). Their gradient leads
    to the bonuses. Use them to learn, not to score. failure_reward = -10 in an interval in which
    the solver fails.

    ## Starting state Upright, at rest under gravity. The target's place is uniform in the box, |x|,
    |y| < 0.6 and 0.3 < z < 0.9 m. Its velocity is 0.5 (cos a sin b, sin a sin b, cos b), a and b
    uniform; both from the sub-env's own generator. At each interval the components in which it is
    outside the box turn round. If there are none, it takes a new velocity with a probability of
    0.025.

    ## Episode end
    Truncation after 500 steps (50 s), termination where the solver fails.

    ## Information
    `distance` (m) from tip to target, `solver_failed`, `action_invalid`; masks as in TipReach.

    ## Arguments The fields of `BeamEnvConfig` (see `envs/config.py`) without section, force,
    actuators, beam and supports. Defaults are length = 1, elements = 20 (a multiple of 5; of fewer
    than 20, every node is observed), direction = (0, 0, 1), gravity = (0, 0, -9.8), damping =
    0.043, delay = 0, control_interval = 0.1, control_cost = 0, failure_reward = -10,
    max_episode_steps = 500. Further arguments:

    - `radius`, `young`, `density`: m, Pa, kg/m^3: 0.05, 1e7, 1000
    - `change`, `bend`: rad: 0.05 and 2, see above
    - `speed`: m/s, 0.5
    - `turns`: 0.025, the probability of a new direction
    - `smooth`: m, 0: width of the bonuses' steps, see Reward

    "torchbeam/FollowTargetPlanar-v1" is this with planar=True, as published: the plane x-z, five
    actions and 49 observations. The target's velocity is then 0.5 (cos a sin b, cos b).

    ## Parameters
    stiffness, mass, damping as in TipReach. The goal, for options={"goal": ...}, is the target's
    first place and velocity: (6,).

    ## Version history v1: the clamp holds half of the first element. Damping, 0.043 s, acts on
    bending beyond the natural curvature, as in the published steps. v0 was 5 to 12 % off, and late.

    v0: first version.

    Examples:
        >>> env = envs.FollowTargetVectorEnv(2, elements=5, planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> observation.shape, reward.shape
        ((2, 29), (2,))
    """

    task_type = FollowTarget


class FollowTargetEnv(SingleEnv):
    """One upright soft arm that follows a target: `FollowTargetVectorEnv` with one member, see
    there for everything.

    `gymnasium.make` ends the episode after 500 steps (`max_episode_steps` there); made directly, it
    does not end by itself.

    Examples:
        >>> env = envs.FollowTargetEnv(elements=5, planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> env.observation_space.shape, env.action_space.shape
        ((29,), (5,))
    """

    vector = FollowTargetVectorEnv
