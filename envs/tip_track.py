"""TipTrack: let the tip of a flexible cantilever follow a moving target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchbeam.extend import count, shown

from .config import BeamEnvConfig
from .core import BeamVectorEnv
from .episodes import Episodes
from .plant import Plant
from .reach import distance, rounded
from .single import SingleEnv
from .task import Task

PATHS = ("circle", "lemniscate", "random")
HARMONICS = 3
RAMP = 0.25  # of the period, in which the path grows from a point
DRAWN = 96  # points of a path in a picture, and instants at which a random one is measured


@dataclass(frozen=True, kw_only=True)
class TipTrackConfig(BeamEnvConfig):
    """path, period (s), reach and preview (intervals): see `TipTrackVectorEnv`; the rest as in
    `BeamEnvConfig`.
    """

    path: str = "any"
    period: float = 2.0
    reach: float = 0.5
    preview: int = 3
    max_episode_steps: int | None = 100

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.path not in (*PATHS, "any"):
            raise ValueError(
                f"path = {shown(self.path)} was given; {', '.join(map(repr, PATHS))} or 'any' is "
                "wanted"
            )
        self.check_numbers("reach", above=0.0, most=1.0)
        self.check_numbers("period", above=0.0)
        count("preview", self.preview, 1)


class TipTrack(Task):
    """Let the tip follow a moving target: `TipTrackVectorEnv` has the specification."""

    Config = TipTrackConfig
    VIEW = (-0.12, 1.12, 0.6)

    def __init__(self, config: TipTrackConfig) -> None:
        super().__init__(config)
        self.goal_size, self.preview = 2 * HARMONICS * self.actions, config.preview
        self.harmonics = torch.arange(1, HARMONICS + 1, dtype=self.dtype, device=self.device)
        self.ahead = torch.arange(config.preview + 1, dtype=self.dtype, device=self.device)

    def prepare(self, plant: Plant) -> None:
        self.reach = self.within_reach(plant, self.config.reach)

    def sample_goal(self, streams: list[np.random.Generator], rows: Tensor) -> Tensor:
        """(k, 2 HARMONICS actions): coefficients a_k, b_k of the paths."""
        axes, harmonics = max(2, self.actions), np.arange(1, HARMONICS + 1)
        paths, shares, senses, numbers = zip(*[self._draw(s, axes) for s in streams], strict=True)
        path, sense, (share, turn) = np.array(paths), np.array(senses), np.array(shares).T
        size, phase = 0.5 + 0.5 * share, 2 * np.pi * turn
        # of each path: harmonic, cosine and sine, axis
        c = np.zeros((len(streams), HARMONICS, 2, axes))
        c[:, 0, :, 0] = np.stack((size * np.cos(phase), -size * np.sin(phase)), -1)
        k = np.where(path == "circle", 1, 2)  # the second axis: sin(k (phi + phase))
        second = (size * sense / k)[:, None] * np.stack((np.sin(k * phase), np.cos(k * phase)), -1)
        c[np.arange(len(k)), k - 1, :, 1] = second
        random = path == "random"
        if random.any():
            own = np.array([x for x in numbers if x is not None]) / harmonics[:, None, None]
            waves = _waves(2 * np.pi * np.arange(DRAWN) / DRAWN)
            largest = np.linalg.norm(waves @ own.reshape(len(own), -1, axes), axis=-1).max(-1)
            c[random] = own * size[random, None, None, None] / largest[:, None, None, None]
        goals = c[..., : self.actions].reshape(len(streams), -1)
        return torch.as_tensor(goals, dtype=self.dtype, device=self.device)

    def _draw(
        self, stream: np.random.Generator, axes: int
    ) -> tuple[str, np.ndarray, int, np.ndarray | None]:
        """Name of a path; two numbers of [0, 1), of its size and its phase; -1 or 1, its sense; and
        of a random one its normal numbers.
        """
        path = PATHS[stream.integers(len(PATHS))] if self.config.path == "any" else self.config.path
        share, sense = stream.random(2), 2 * int(stream.integers(2)) - 1
        return (
            path,
            share,
            sense,
            stream.normal(size=(HARMONICS, 2, axes)) if path == "random" else None,
        )

    def target(self, now: Episodes, ahead: int = 0) -> Tensor:
        k = (
            self.ahead
            if ahead == self.preview
            else torch.arange(ahead + 1, dtype=self.dtype, device=self.device)
        )
        return self.target_at(now, (now.steps[:, None] + k) * self.config.control_interval)

    def share(self, now: Episodes, t: Tensor) -> Tensor:
        """(n, m, actions): how far along its range each action would hold the targets at the
        instants t (n, m) s.
        """
        phi = 2 * torch.pi * t[..., None] / self.config.period * self.harmonics
        waves = torch.stack((torch.cos(phi), torch.sin(phi)), -1).flatten(-2)
        s = (t / (RAMP * self.config.period)).clamp(0, 1)[..., None]
        return s**2 * (3 - 2 * s) * (waves @ now.goal.unflatten(-1, (2 * HARMONICS, -1)))

    def target_at(self, now: Episodes, t: Tensor) -> Tensor:
        """(n, m, 3) m: where the targets are at the instants t (n, m) s."""
        rows = now.member.repeat_interleave(t.shape[1])
        return self.static_tip(self.share(now, t).flatten(0, 1), rows).unflatten(0, t.shape)

    def static_tip(self, share: Tensor, rows: Tensor) -> Tensor:
        """(k, 3) m, of the sub-envs rows (k,) under shares (k, actions)."""
        return self.reach.tip(share, rows)

    def target_high(self) -> np.ndarray:
        return np.repeat((4.0, 20.0, *[2.0] * self.preview), self.directions)

    def target_observation(self, now: Episodes, tip: Tensor | None) -> Tensor:
        target, d = now.target, self.vector
        velocity = (
            (target[:, 1] - target[:, 0]) / self.config.control_interval / self.of(now, self.speed)
        )
        ahead = (target[:, 1:] - now.start.position[:, None, -1]) / self.length
        return torch.cat(
            (self.gap(now, target[:, 0], tip), velocity[:, d], ahead[..., d].flatten(1)), -1
        )

    def cost(self, now: Episodes) -> Tensor:
        return rounded(now.measures["distance"], self.length)

    def measures(self, now: Episodes) -> dict[str, Tensor]:
        return {"distance": distance(now.target[:, 0], now.beam.position[:, -1])}

    def render_data(self, now: Episodes) -> dict[str, Any]:
        once = (
            torch.linspace(1, 2, DRAWN, dtype=self.dtype, device=self.device) * self.config.period
        )
        return {
            **super().render_data(now),
            "path": self.target_at(now, once.expand(len(now.goal), DRAWN)),
        }


class TipTrackVectorEnv(BeamVectorEnv):
    """`num_envs` flexible cantilevers whose tips follow targets, stepped as one batch.

    ## Description
    Follow a target along a closed path with the tip of a strip, by a force on the tip. The strip is
    that of `TipReachVectorEnv`: 1.5 m of aluminium flat bar, clamped, under gravity. The path is
    that of a static tip under the force

        f(t) = reach * force * ramp(t) * sum_k [a_k cos(k phi) + b_k sin(k phi)],
            phi = 2 pi t / period,  k = 1, 2, 3

    with ramp rising smoothly from 0 to 1 in a quarter of a period. The target starts at the tip at
    rest, and every point of the path could be held. Following it takes the forces of inertia in
    addition. By default one period takes 2 s, two of the first mode's; an episode is one period.

    ## Action space
    `Box(-1, 1, (2,), float32)`: the tip force, as in TipReach.

    ## Observation space
    `Box(-high, high, (18 + 3 preview + 2 delay,), float32)`: the target first, the rest as in
    TipReach.

    | index | observation | high |
    |---|---|---|
    | 0-2 | target - tip, x y z, over the length | 4 |
    | 3-5 | target's velocity over the next interval, over L omega | 20 |
    | 6 ... 5 + 3 preview | target less its start after 1 ... preview intervals, by the length | 2 |
    | then 12 | displacement and velocity, tip and mid-span, as in TipReach (or `sensors`) | |
    | then 2 delay | actions that are still to act | 1 |

    ## Reward
    As in TipReach, with the distance to where the target is at the end of the interval.

    ## Starting state
    At rest under gravity. The path comes from the sub-env's own generator. Of a circle (an ellipse
    in space) or a lemniscate (Gerono's, a figure of eight) phase, sense and size, 0.5 to 1, are
    random. Of a random path all a_k and b_k are normal and fall off like 1/k, scaled so that the
    largest |f| has the size 0.5 to 1.

    ## Episode end
    As in TipReach, after 100 steps.

    ## Information
    `distance` (m) from tip to target, `solver_failed`, `action_invalid`, as in TipReach.

    ## Arguments
    The fields of `BeamEnvConfig` (see `envs/config.py`), with its defaults but max_episode_steps =
    100, and

    - `path`: "circle", "lemniscate" or "random"; "any" (default): one of them, drawn with the
      episode
    - `period`: s, 2
    - `reach`: 0.5: share of the force bounds that the static force takes at most on the usual
      strip, above 0 and up to 1
    - `preview`: 3: intervals by which the target is known ahead

    "torchbeam/TipTrackPlanar-v1" is this with planar=True: the horizontal plane, where circle and
    lemniscate are one swing.

    ## Parameters
    As in TipReach; they do not move the target. The goal, for options={"goal": ...}, is
    a_1 b_1 a_2 b_2 a_3 b_3, each along y and z: (12,), or (6,) in a plane.

    ## Version history v1: a failure costs all remaining intervals, see TipReach; in v0 it cost 100,
    less than doing nothing. v0: first version.

    Examples:
        >>> env = envs.TipTrackVectorEnv(2, elements=2, planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> observation.shape, reward.shape
        ((2, 19), (2,))
    """

    task_type = TipTrack


class TipTrackEnv(SingleEnv):
    """One flexible cantilever that follows a target: `TipTrackVectorEnv` with one member, see there
    for everything.

    `gymnasium.make` ends the episode after 100 steps (`max_episode_steps` there); made directly, it
    does not end by itself.

    Examples:
        >>> env = envs.TipTrackEnv(elements=2, planar=True)
        >>> observation, info = env.reset(seed=0)
        >>> env.observation_space.shape, env.action_space.shape
        ((19,), (1,))
    """

    vector = TipTrackVectorEnv


def _waves(phi: np.ndarray) -> np.ndarray:
    """(m, 2 HARMONICS): cos(k phi), sin(k phi)."""
    k = phi[:, None] * np.arange(1, HARMONICS + 1)
    return np.stack((np.cos(k), np.sin(k)), -1).reshape(len(phi), -1)
