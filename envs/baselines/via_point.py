"""ViaPoint: the tip led to its target by way of a place, the best of some in simulations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from torchbeam.extend import BatchSubset, count

from ..core import BeamVectorEnv
from ..episodes import Episodes
from ..parameters import numbers
from .linear import amount
from .resolved_rate import ResolvedRate

AT_ONCE = 1024  # simulated episodes


class ViaPoint(ResolvedRate):
    """`ResolvedRate` by way of one place (a via point): the tip is led to this place first, then to
    its target.

    At the start of an episode each of some places is simulated to the end of that episode, and so
    is the direct way. The place of the highest return is taken. So it knows the plant and its
    obstacles, and plans once. Later it reads the same as `ResolvedRate`.

    Args:
        points: (p, 3) m, places to choose from
        near: m, distance at which the tip has come to its place
        latest: intervals after which it goes on to the target at the latest
        gain, damping, lead, ahead, turn: as in `ResolvedRate`

    Raises:
        ValueError: for a task of another beam, an env without end, or places of another size.

    Examples:
        >>> env = envs.ReachObstaclesVectorEnv(2, planar=True, max_episode_steps=4)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = baselines.ViaPoint(env, [[0.2, 0.0, 0.6]])
        >>> controller.begin(env)
        >>> controller(observation).shape
        (2, 5)
    """

    def __init__(
        self,
        env: BeamVectorEnv,
        points: Sequence[Sequence[float]],
        *,
        near: float = 0.08,
        latest: int = 14,
        gain: float = 1.0,
        damping: float = 0.005,
        lead: float = 0.1,
        ahead: float = 0.0,
        turn: float = 0.0,
    ) -> None:
        super().__init__(env, gain, damping, lead, ahead, turn)
        places = torch.from_numpy(numbers("points", points))
        if places.ndim != 2 or places.shape[-1] != 3 or not torch.isfinite(places).all():
            raise ValueError(
                f"points of shape {tuple(places.shape)} were given; finite (p, 3) are wanted"
            )
        self.points, self.near, self.latest = places, amount("near", near), count("latest", latest)

    def begin(self, env: Any) -> None:
        super().begin(env)
        env = self.env
        if env.max_episode_steps is None:
            raise ValueError("an env without end was given; max_episode_steps is wanted")
        self.points = self.points.to(env.device, env.dtype)
        self.via = self.points.new_zeros(env.num_envs, 3)
        self.passed = torch.zeros(env.num_envs, dtype=torch.bool, device=env.device)

    def restart(self, fresh: Tensor) -> None:
        """Choose the places of these episodes."""
        for few in fresh.nonzero()[:, 0].split(max(1, AT_ONCE // (len(self.points) + 1))):
            self.via[few] = self._best(few)
        self.passed = self.passed & ~fresh

    def act(self, observation: Tensor) -> Tensor:
        action, self.passed = self._led(self.env.state, self.via, self.passed)
        return action

    def _best(self, few: Tensor) -> Tensor:
        """(k, 3) m for the episodes of these numbers (k,)."""
        env, ways = self.env, len(self.points) + 1
        now = BatchSubset(few.repeat_interleave(ways), env.num_envs).gather(env.state)
        direct = env.task.target(now)[::ways, 0]  # where the tip passes at once: no detour
        places = torch.cat((direct[:, None], self.points.expand(len(few), -1, -1)), 1)
        via = places.flatten(0, 1)
        passed = torch.arange(len(via), device=via.device) % ways == 0
        total = torch.zeros_like(via[:, 0])
        while not now.done.all():
            action, passed = self._led(now, via, passed)
            over = now.done
            now, reward, _ = env.simulation.advance(
                now, action.clamp(-1, 1), ~over if over.any() else None
            )
            total = total + reward
        best = total.view(-1, ways).argmax(-1)
        return places[torch.arange(len(few), device=few.device), best]

    def _led(self, now: Episodes, via: Tensor, passed: Tensor) -> tuple[Tensor, Tensor]:
        """Actions (n, a) to the places (n, 3) m, or to the target where the tip has passed its
        place (n,); whether it has now.
        """
        off = (now.beam.position[:, -1] - via).norm(dim=-1)
        passed = passed | (off < self.near) | (now.steps >= self.latest)
        here, target = self.env.task.target(now, 1).unbind(1)
        ways = (torch.where(passed[:, None], x, via) for x in (here, target))
        return self.towards(now, *ways), passed
