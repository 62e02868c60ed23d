"""ReachBehind: bring the tip of a soft arm, driven by torques, to a place behind bars."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchbeam.extend import shown

from .core import BeamVectorEnv
from .episodes import Episodes
from .reach_obstacles import Bars
from .single import SingleEnv
from .torque_arm import TorqueArm, TorqueArmConfig

# Case 3: bars along y from 0 to 1 through these places (x, z) m
PLACES = (
    *((-0.6, 0.12), (-0.2, 0.12), (-0.4, 0.37), (-0.4, 0.0)),
    *((-0.4, -0.2), (-0.4, -0.4), (-0.4, 0.57), (-0.4, 0.77)),
)
# Case 4: the one nest that is published: (x, z) m of their ends, and unit vectors along them; their
# middles are at y = 0.5 m
NEST = (
    *((-0.4425, 0.5887, -0.0116, -0.997, 0.0764), (-0.4706, 0.4055, -0.0674, -0.9804, 0.1851)),
    *((-0.521, 0.4572, -0.1174, -0.9554, -0.2709), (-0.424, 0.2946, 0.1317, -0.9377, 0.3216)),
    *((-0.5424, 0.3643, 0.0616, -0.9798, -0.1903), (-0.4871, 0.0335, 0.0823, -0.9691, 0.2326)),
    *((-0.4611, 0.4785, 0.0798, -0.9658, -0.2466), (-0.4033, 0.0692, 0.1063, -0.9009, -0.4208)),
    *((-0.5102, 0.2246, -0.0069, -0.9994, 0.0348), (-0.5182, -0.0463, -0.0498, -0.9499, -0.3087)),
    *((-0.5125, 0.5291, -0.083, -0.9826, -0.1663), (-0.4232, 0.2999, -0.0214, -0.9958, 0.0896)),
)
RADII = 0.1, 0.03  # m
TARGETS = (-0.8, 0.5, 0.15), (-0.8, 0.5, 0.35)  # m
SHOWN = 5  # points of each bar that are observed


@dataclass(frozen=True, kw_only=True)
class ReachBehindConfig(TorqueArmConfig):
    """nest, contact (N/m): see `ReachBehindVectorEnv`; the rest as in `TorqueArmConfig`."""

    nest: bool = False
    contact: float = 1e6
    elements: int = 50
    direction: tuple[float, ...] = (0.0, 0.0, 1.0)
    up: tuple[float, ...] | None = (-1.0, 0.0, 0.0)
    points: tuple[float, ...] = (0.4, 0.9)
    rate: float = 1000.0
    failure_reward: float | None = -100.0  # as published
    max_episode_steps: int | None = 3571

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_numbers("contact", above=0.0)
        if not isinstance(self.nest, bool):
            raise ValueError(f"nest = {shown(self.nest)} was given; True or False is wanted")


class ReachBehind(TorqueArm):
    """Bring the tip to a place behind bars: `ReachBehindVectorEnv` has the specification."""

    Config = ReachBehindConfig
    ROOT = 0.0, 0.5, 0.0

    def __init__(self, config: ReachBehindConfig) -> None:
        self.DRIVEN = (1, 2) if config.nest else (1,)
        super().__init__(config)
        self.aim = self.low.new_tensor(TARGETS[config.nest])
        self.bar_radius = RADII[config.nest]
        if config.nest:
            x, z, *u = self.low.new_tensor(NEST).unbind(-1)
            start, way = torch.stack((x, 0.5 - 0.5 * u[1], z), -1), torch.stack(u, -1)
        else:
            x, z = self.low.new_tensor(PLACES).unbind(-1)
            start, way = torch.stack((x, 0 * x, z), -1), self.low.new_tensor((0.0, 1.0, 0.0))
        self.bars = torch.stack((start, start + way), 1)  # (bars, 2, 3) m
        share = torch.linspace(0, 1, SHOWN).to(self.low)[:, None]
        self.points = (start[:, None] + share * (self.bars[:, 1] - start)[:, None]).flatten()

    def effects(self, params: dict[str, Tensor]) -> tuple[Any, ...]:
        c = self.config
        ahead = c.control_interval / c.substeps / 2
        sizes = c.radius + self.bar_radius, c.contact, c.length / c.elements, ahead
        bars = Bars(self.bars.flatten(), *map(self.low.new_tensor, sizes))
        return (*super().effects(params), bars)

    def target(self, now: Episodes, ahead: int = 0) -> Tensor:
        return self.aim.expand(len(now.steps), ahead + 1, 3)

    def target_high(self) -> np.ndarray:
        return np.append(super().target_high(), np.full(self.points.numel(), 2.0))

    def target_observation(self, now: Episodes, tip: Tensor | None) -> Tensor:
        bars = self.points.expand(len(now.steps), -1)
        return torch.cat((super().target_observation(now, tip), bars), -1)

    def render_data(self, now: Episodes) -> dict[str, Any]:
        return {**super().render_data(now), "bars": self.bars.expand(len(now.steps), -1, -1, -1)}


class ReachBehindVectorEnv(BeamVectorEnv):
    """`num_envs` soft arms, driven by torques, whose tips are to come to a place behind bars,
    stepped as one batch.

    ## Description
    The arm of `TrackTargetVectorEnv` upright, with its foot at (0, 0.5, 0) m and in 50 elements,
    among round bars that it may touch without friction. Nothing is random. Case 3 of the same
    publication has eight parallel bars across the plane of motion, radius 0.1 m. Case 4 (`nest`)
    has twelve askew, radius 0.03 m. They are the stored ones; each published run drew its own. The
    tip is to come to (-0.8, 0.5, 0.15) m, in case 4 (-0.8, 0.5, 0.35) m.

    Beside the differences in TrackTarget, the contact differs from there. There the load of a
    pressing node on the bar is cancelled. A correction k g + c v follows, with k = 8e4 N/m and c =
    4 N s/m. Here the law of ReachObstacles presses nodes, contact = 1e6 N/m, at their places at the
    end of a step. A load of 2 kN on a node drives it in by 1 mm. Under ResolvedRate in case 4 it is
    4.0 mm at most, while no node moves by more than 28 mm in a step. The spline's points are at 0.4
    and 0.9 of the length, as its text says; its code, restored later, spaces them evenly: points =
    (1/3, 2/3).

    ## Action space
    `Box(-1, 1, (2,), float32)`, in case 4 (4,): as in TrackTarget, two values about the normal, in
    case 4 about the binormal too. The couples follow them by at most rate = 1000 1/s. Couples per
    length are 3,750 S, as 50 elements are part of the task.

    ## Observation space `Box(-high, high, (160 or 220 + 2 or 4 delay,), float32)`, in metres and
    m/s, as published but for the notes here, in another order.

    | index | observation | high |
    |---|---|---|
    | 0-3 | speed of the tip, and its direction, 0 where it is still | 100, 1 |
    | 4-6 | where the tip is to be | 1 |
    | 7-126, in case 4 7-186 | five points of each bar, evenly along it | 2 |
    | last 33 | where eleven nodes are, every fifth from the foot (or the `sensors` given) | 2 |
    | then delay | actions that are still to act (none by default) | 1 |

    In case 4 the published points begin at the arm's foot, not at the bar: a slip.

    ## Reward
    As in TrackTarget, with d (m) the distance from the tip to its place. failure_reward = -100 in
    an interval in which the solver fails.

    ## Starting state
    Upright, at rest.

    ## Episode end
    Truncation after 3571 steps (5 s), termination where the solver fails.

    ## Information
    `distance` (m) of the tip, `solver_failed`, `action_invalid`; masks as in TipReach.

    ## Arguments
    The arguments of TrackTarget without speed and turns, with elements = 50, direction = (0, 0, 1),
    up = (-1, 0, 0), points = (0.4, 0.9), rate = 1000, failure_reward = -100,
    max_episode_steps = 3571, and

    - `nest`: False: case 4, see above
    - `contact`: N/m, 1e6

    "torchbeam/ReachBehindNest-v0" is this with nest=True.

    ## Parameters
    stiffness, mass as in TipReach.

    ## Version history
    v0: first version.

    Examples:
        >>> env = envs.ReachBehindVectorEnv(2, elements=10)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> observation.shape, reward.shape
        ((2, 160), (2,))
    """

    task_type = ReachBehind


class ReachBehindEnv(SingleEnv):
    """One soft arm, driven by torques, to be brought to a place behind bars: `ReachBehindVectorEnv`
    with one member, see there for everything.

    `gymnasium.make` ends the episode after 3571 steps (`max_episode_steps` there); made directly,
    it does not end by itself.

    Examples:
        >>> env = envs.ReachBehindEnv(elements=10)
        >>> observation, info = env.reset(seed=0)
        >>> env.observation_space.shape, env.action_space.shape
        ((160,), (2,))
    """

    vector = ReachBehindVectorEnv
