"""TrackTarget: let the tip of a soft arm, driven by torques, follow a target that moves about."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from .core import BeamVectorEnv
from .episodes import Episodes
from .follow_target import Wandering
from .single import SingleEnv
from .torque_arm import TorqueArm, TorqueArmConfig, moving


@dataclass(frozen=True, kw_only=True)
class TrackTargetConfig(TorqueArmConfig):
    """speed (m/s), turns (s): see `TrackTargetVectorEnv`; the rest as in `TorqueArmConfig`."""

    speed: float = 0.5
    turns: float = 0.7
    failure_reward: float | None = -1000.0  # as published
    max_episode_steps: int | None = 7142

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_numbers("speed", least=0.0)
        self.check_numbers("turns", above=0.0)


class TrackTarget(Wandering, TorqueArm):
    """Follow a target that moves about: `TrackTargetVectorEnv` has the specification."""

    Config = TrackTargetConfig
    MARGIN = 0.05

    def turning(self, now: Episodes, drawn: Tensor) -> Tensor:
        every = max(1, round(self.config.turns / self.config.control_interval))
        return ((now.steps + 1) % every == 0)[:, None]

    def target_high(self) -> np.ndarray:
        return np.append(super().target_high(), [max(1.0, self.config.speed), 1, 1, 1])

    def target_observation(self, now: Episodes, tip: Tensor | None) -> Tensor:
        return torch.cat((super().target_observation(now, tip), moving(self.moving(now)[1])), -1)


class TrackTargetVectorEnv(BeamVectorEnv):
    """`num_envs` soft arms, driven by torques, that follow targets, stepped as one batch.

    ## Description
    A published task, case 1 of Naughton et al. 2021, "Elastica: a compliant mechanics environment
    for soft robotic control" (code: GazzolaLab/Elastica-RL-control), in its own numbers and units.
    A round rod of 1 m, radius 0.05 m, E = 10 MPa, 1,000 kg/m^3, in 20 elements, clamped at its
    foot, without gravity, in a viscous medium. Its tip is to follow a target that moves through a
    box at 0.5 m/s, by couples along it. An interval is 1.4 ms, in one implicit step.

    G = E / 1.5 and a shear stiffness of 4/3 G A, as there. The medium takes a force 30 v and a
    couple 30 omega per length, of the same number, by the absolute motion. The couple dominates:
    the first mode decays in 0.25 s.

    There the axes of the first element are held, and elements bend between their middles. So the
    first one here bends, and twists, half as much as another. Under random actions of 2 s, held for
    one interval to 500, the tip is 1.1 to 1.8 % of its motion from PyElastica 1.0's (RMS;
    `examples/peers/soft_arm`).

    Three things differ from there. Couples and drag act at nodes, half of an element's at each of
    its two; there they act on the element. An element's couple is that of its end by the arc length
    at rest. Steps are implicit midpoint steps of 1.4 ms; there seven explicit ones are made.

    Not stated there: whether a target moves before or after the arm (after, here). A coordinate
    that starts within 0.05 m of a wall turns round at each interval, and so stays, as there.

    ## Action space
    `Box(-1, 1, (12,), float32)`: values of a cubic spline S at six points, evenly spaced between
    foot and tip, about the section's normal, then the binormal. S is 0 at both ends (not-a-knot).
    Each element takes the couple 75 S (N m), which turns with it: a couple per length of 1,500 S,
    as 20 elements are part of the task.

    ## Observation space `Box(-high, high, (44 + 12 delay,), float32)`, in metres and m/s; the
    published observation, in another order.

    | index | observation | high |
    |---|---|---|
    | 0-3 | speed of the tip, and its direction, 0 where it is still | 100, 1 |
    | 4-6 | where the target is | 1 |
    | 7-10 | its speed and direction | 1 |
    | 11-43 | where eleven nodes are, every second from the foot (or the `sensors` given) | 2 |
    | then 12 delay | actions that are still to act (none by default) | 1 |

    ## Reward
    Per interval, with d (m) the distance from the tip to the target, both at its end:
        - d^2, + 2 where d < 0.05, + 0.5 where 0.05 <= d < 0.1
    smooth > 0 as in FollowTarget. failure_reward = -1000 in an interval in which the solver fails.

    ## Starting state Straight along y, at rest. The target's place is uniform in the box, |x|, |z|
    < 0.6 and 0.3 < y < 0.9 m. Its velocity is 0.5 (cos a sin b, sin a sin b, cos b), a and b
    uniform; both from the sub-env's own generator. Each 0.7 s it takes a new one.

    ## Episode end
    Truncation after 7142 steps (10 s), termination where the solver fails.

    ## Information
    `distance` (m) from tip to target, `solver_failed`, `action_invalid`; masks as in TipReach.

    ## Arguments The fields of `BeamEnvConfig` (see `envs/config.py`) without section, force,
    actuators, beam, supports and planar. Defaults are length = 1, elements = 20, direction = (0, 1,
    0), up = (1, 0, 0), the binormal, gravity = None, damping = None, delay = 0, control_interval =
    0.0014, substeps = 1, control_cost = 0, failure_reward = -1000, max_episode_steps = 7142.
    Further arguments:

    - `radius`, `young`, `density`: m, Pa, kg/m^3: 0.05, 1e7, 1000
    - `torque`: N m, 75: see above
    - `points`: of the splines, in shares of the length
    - `rate`: 1/s, inf: largest rate of the couples
    - `viscous`: N s/m^2, 30
    - `speed`: m/s, 0.5
    - `turns`: s, 0.7, from one direction to the next
    - `smooth`: m, 0: width of the bonuses' steps

    Returns are sums over 7142 intervals. With a longer control_interval and fewer steps they are
    fewer and comparable by their mean.

    ## Parameters
    stiffness, mass as in TipReach. The goal, for options={"goal": ...}, is the target's first place
    and velocity: (6,).

    ## Version history
    v0: first version.

    Examples:
        >>> env = envs.TrackTargetVectorEnv(2, elements=10)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> observation.shape, reward.shape
        ((2, 44), (2,))
    """

    task_type = TrackTarget


class TrackTargetEnv(SingleEnv):
    """One soft arm, driven by torques, that follows a target: `TrackTargetVectorEnv` with one
    member, see there for everything.

    `gymnasium.make` ends the episode after 7142 steps (`max_episode_steps` there); made directly,
    it does not end by itself.

    Examples:
        >>> env = envs.TrackTargetEnv(elements=10)
        >>> observation, info = env.reset(seed=0)
        >>> env.observation_space.shape, env.action_space.shape
        ((44,), (12,))
    """

    vector = TrackTargetVectorEnv
