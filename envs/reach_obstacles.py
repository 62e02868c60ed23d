"""ReachObstacles: bring the tip of an upright soft arm to a place among bars."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import POSITION, VELOCITY, LoadEffect, LoadPoint, Value, leaf

from .core import BeamVectorEnv
from .episodes import Episodes
from .manipulator import Manipulator, ManipulatorConfig
from .single import SingleEnv

# In the plane: bars along y through these places (x, z) m, of this radius, and the target
PLACES = (0.2, 0.12), (0.6, 0.12), (0.4, 0.0), (0.4, 0.37), (0.4, 0.57), (0.4, 0.77)
PLANAR_RADIUS, PLANAR_TARGET = 0.1, (0.8, 0.0, 0.15)
# In space
BARS, RADIUS, TARGET = 8, 0.03, (0.8, 0.0, 0.35)
CENTRES = (0.3, 0.6), (-0.6, 0.6), (-0.1, 0.8)  # m, of the bars' middles, and where their ends are
APART = 0.015  # m, between their axes
DRAWN = 256  # bars at once, one in some eighty lies in the box
BAND = 5e-3  # m: contact begins so far off


@dataclass(frozen=True)
class Bars(LoadEffect):
    """Round bars that press a beam's nodes away, per length of it.

        p = 2 stiffness s / (1 + exp(-K g)) n / spacing,    s = ln(1 + exp(K g)) / K,    K = 15/BAND

    with g the overlap of both surfaces and n out of the bar: the gradient of the published energy
    stiffness s^2 of an edge of the beam.

    ends       (..., 6 bars) m, frame a: the two ends of each bar's axis
    radius     (...) m of the bars and the beam together
    stiffness  (...) N/m
    spacing    (...) m of the beam's edges
    ahead      (...) s: nodes press where they will be by then: half of a midpoint step makes it
               that of implicit Euler, which takes the energy of a blow
    """

    ends: Value | tb.Input = leaf(1)
    radius: Value = leaf(0)
    stiffness: Value = leaf(0)
    spacing: Value = leaf(0)
    ahead: Value = leaf(0)

    node = None
    depends = frozenset({POSITION, VELOCITY})
    conservative = True

    def wrench(self, point: LoadPoint, t: Tensor, inputs: Any) -> tuple[Tensor, None]:
        radius, k, spacing, ahead = (
            x[..., None, None] for x in (self.radius, self.stiffness, self.spacing, self.ahead)
        )
        place, total = point.position + ahead * point.velocity, 0.0
        for bar in self.ends[..., None, :].split(6, -1):
            a, b = bar.split(3, -1)
            along, way = b - a, place - a
            share = (way * along).sum(-1, keepdim=True) / (along * along).sum(-1, keepdim=True)
            away = way - share.clamp(0.0, 1.0) * along
            far = (away.square().sum(-1, keepdim=True) + 1e-12).sqrt()
            x = ((15 / BAND) * (radius - far)).clamp(min=-50.0)  # of nothing, further off
            s = (BAND / 15) * (x.clamp(min=0.0) + torch.log1p(torch.exp(-x.abs())))
            total = total + 2 * k / spacing * s * torch.sigmoid(x) * away / far
        return total, None


@dataclass(frozen=True, kw_only=True)
class ReachObstaclesConfig(ManipulatorConfig):
    """contact (N/m): see `ReachObstaclesVectorEnv`; the rest as in `ManipulatorConfig`."""

    contact: float = 1e6
    change: float = 0.25
    control_interval: float = 0.5
    substeps: int = 40
    max_episode_steps: int | None = 50

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_numbers("contact", above=0.0)
        if self.solver is None:  # what slips past a bar wants short steps
            object.__setattr__(self, "solver", {"halvings": 4, "iterations": 200})


class ReachObstacles(Manipulator):
    """Bring the tip to a place among bars: `ReachObstaclesVectorEnv` has the specification."""

    Config = ReachObstaclesConfig

    def __init__(self, config: ReachObstaclesConfig) -> None:
        super().__init__(config)
        self.aim = self.low.new_tensor(TARGET if self.plane is None else PLANAR_TARGET)
        self.goal_size = 6 * BARS if self.plane is None else 0
        self.bar_radius = RADIUS if self.plane is None else PLANAR_RADIUS
        places = PLACES if self.plane is not None else BARS * ((0.0, 0.0),)
        ends = [[(x, y, z) for y in (-0.5, 0.5)] for x, z in places]
        self.fixed = self.low.new_tensor(ends).flatten()

    def effects(self, params: dict[str, Tensor]) -> tuple[Any, ...]:
        c = self.config
        ahead = c.control_interval / c.substeps / 2
        sizes = c.radius + self.bar_radius, c.contact, c.length / c.elements, ahead
        return (Bars(tb.Input("bars", self.fixed.numel()), *map(self.low.new_tensor, sizes)),)

    def inputs(
        self, action: Tensor, now: Episodes | None = None
    ) -> dict[str, Tensor] | list[dict[str, Tensor]]:
        driven = super().inputs(action, now)
        if now is None:
            return driven | self.idle_inputs()
        return [one | {"bars": self.ends(now)} for one in driven]

    def idle_inputs(self) -> dict[str, Tensor]:
        """Bars that are out of reach."""
        return {"bars": self.fixed + 9.0}

    def ends(self, now: Episodes) -> Tensor:
        """(n, 6 bars) m."""
        return now.goal if self.goal_size else self.fixed.expand(len(now.steps), -1)

    # Episodes

    def sample_goal(self, streams: list[np.random.Generator], rows: Tensor) -> Tensor:
        """(k, 48) m, or (k, 0) in a plane: the ends of the bars."""
        if self.plane is not None:
            return super().sample_goal(streams, rows)
        return self.low.new_tensor(np.stack([bars(stream) for stream in streams]))

    def target(self, now: Episodes, ahead: int = 0) -> Tensor:
        return self.aim.expand(len(now.steps), ahead + 1, 3)

    def target_high(self) -> np.ndarray:
        d = self.directions
        return np.concatenate(
            (np.full(self.actions, self.config.bend), np.ones(d + self.goal_size))
        )

    def target_observation(self, now: Episodes, tip: Tensor | None) -> Tensor:
        return torch.cat((self.command(now), now.target[:, 0, self.vector], now.goal), -1)

    def render_data(self, now: Episodes) -> dict[str, Any]:
        bars = self.ends(now).unflatten(-1, (-1, 2, 3))
        shown = super().render_data(now)
        if self.plane is None:
            return {**shown, "bars": bars}
        middle = bars.mean(-2)
        return {**shown, "balls": torch.cat((middle, 0 * middle[..., :1] + PLANAR_RADIUS), -1)}


def bars(stream: np.random.Generator) -> np.ndarray:
    """(48,) m, the ends of eight bars of length 1: middles uniform in the box, directions uniform
    on the sphere, where both ends lie in the box and axes keep apart.
    """
    low, high = np.transpose(CENTRES)
    placed = np.empty((0, 2, 3))
    while len(placed) < BARS:
        way, middle = stream.normal(size=(DRAWN, 3)), stream.uniform(low, high, (DRAWN, 3))
        half = way / (2 * np.linalg.norm(way, axis=-1, keepdims=True))
        ends = np.stack((middle - half, middle + half), 1)
        for one in ends[((ends >= low) & (ends <= high)).all((1, 2))]:
            if len(placed) < BARS and (axes_apart(one, placed) >= APART).all():
                placed = np.concatenate((placed, one[None]))
    return placed.ravel()


def axes_apart(one: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(k,) m, the least distances of a piece of a line (2, 3) m from others (k, 2, 3): where both
    are nearest within (Ericson 2005, "Real-time collision detection", 5.1.9), or at an end.
    """
    a, u = one[0], one[1] - one[0]
    b, v = others[:, 0], others[:, 1] - others[:, 0]
    w, uu, uv, vv = a - b, u @ u, v @ u, (v * v).sum(-1)
    s = np.clip((uv * (w * v).sum(-1) - vv * (w @ u)) / np.maximum(uu * vv - uv**2, 1e-12), 0, 1)
    t = np.clip(((w + s[:, None] * u) * v).sum(-1) / vv, 0, 1)
    s = np.clip(((b + t[:, None] * v - a) @ u) / uu, 0, 1)
    return np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=-1)


class ReachObstaclesVectorEnv(BeamVectorEnv):
    """`num_envs` upright soft arms whose tips are to come to a place behind bars, stepped as one
    batch.

    ## Description
    The arm of `FollowTargetVectorEnv`, from the same publication, among round bars that it may
    touch without friction. Its tip is to come to a fixed place, (0.8, 0, 0.35) m, behind eight bars
    of 1 m, radius 0.03 m, which are random in each episode. In a plane the place is (0.8, 0.15) m,
    behind six bars across it, radius 0.1 m, always the same. An interval is 0.5 s, in forty
    implicit steps.

    Beside the differences in FollowTarget, three things differ from there. Bars press the arm's
    nodes, 0.05 m apart, not the nearest places of its edges. Between two nodes a bar may enter by
    up to 0.05^2/8 over the sum of both radii, 2 mm in the plane and 4 mm in space. The law is the
    same, per node: the gradient of contact s^2, s = ln(1 + exp(K g)) / K, of an overlap g. K =
    3,000 1/m and contact = 1e6 N/m. It is evaluated at the nodes at the end of a step, like
    implicit Euler's method there: blows take energy. Steps are a quarter as long, 0.0125 s, and all
    converge, or the episode ends; there two to five iterations are made.

    ## Action space
    `Box(-1, 1, (10,), float32)`: as in FollowTarget, with change = 0.25 rad.

    ## Observation space `Box(-high, high, (121 + 10 delay,), float32)`, in metres, m/s and rad; the
    published observation, in another order.

    | index | observation | high |
    |---|---|---|
    | 0-9 | angles of the segments | 2 |
    | 10-12 | where the tip is to be | 1 |
    | 13-60 | the ends of the bars' axes (not in a plane) | 1 |
    | 61-90 | where every second node is, from node 2 to the tip (or the `sensors` given) | 2 |
    | 91-120 | their velocities | 20 |
    | then 10 delay | actions that are still to act (none by default) | 1 |

    ## Reward
    As in FollowTarget, with d (m) the distance from the tip to its place.

    ## Starting state
    Upright, at rest under gravity. The bars' middles are uniform in 0.3 < x < 0.6, |y| < 0.6 and
    -0.1 < z < 0.8 m, and their directions uniform. Both ends lie in that box, and the axis is at
    least 0.015 m from the axes of the bars before. They come from the sub-env's own generator.

    ## Episode end
    Truncation after 50 steps (25 s), termination where the solver fails.

    ## Information
    `distance` (m) of the tip, `solver_failed`, `action_invalid`; masks as in TipReach.

    ## Arguments
    The arguments of FollowTarget, without speed and turns, with change = 0.25, control_interval =
    0.5, substeps = 40, max_episode_steps = 50, solver = {"halvings": 4, "iterations": 200}, and

    - `contact`: N/m, 1e6: see above

    "torchbeam/ReachObstaclesPlanar-v0" is this with planar=True, as published: the plane x-z, five
    actions and 47 observations.

    ## Parameters
    stiffness, mass, damping as in TipReach. The goal, for options={"goal": ...}, is the ends of the
    bars' axes: (48,) m.

    ## Version history
    v0: first version.

    Examples:
        >>> env = envs.ReachObstaclesVectorEnv(2, planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> observation.shape, reward.shape
        ((2, 47), (2,))
    """

    task_type = ReachObstacles


class ReachObstaclesEnv(SingleEnv):
    """One upright soft arm to be brought to a place among bars: `ReachObstaclesVectorEnv` with one
    member, see there for everything.

    `gymnasium.make` ends the episode after 50 steps (`max_episode_steps` there); made directly, it
    does not end by itself.

    Examples:
        >>> env = envs.ReachObstaclesEnv(planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> env.observation_space.shape, env.action_space.shape
        ((47,), (5,))
    """

    vector = ReachObstaclesVectorEnv
