"""Episodes: targets with their holding actions, whole episodes under a controller, and what is
measured on them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbeam import Section

from ..plant import aluminium_strip
from ..reach import holding_action, nearest_action
from ..tip_reach import TipReachVectorEnv

Controller = Callable[[Tensor, Tensor], Tensor]
WINDOW = 0.2  # s at the end of an episode, over which the final distance is the mean
ITERATIONS = 12  # of the search on the polynomial
CLOSE = 0.02  # of the length: "on the target"


@dataclass(frozen=True)
class Targets:
    """Seeds of n episodes and the actions hold (n, 2) that hold their targets, sought by the
    targets: what was drawn from the seeds is not read.
    """

    seeds: list[int]
    hold: Tensor

    @classmethod
    def of(cls, env: TipReachVectorEnv, first: int, rounds: int = 1) -> Targets:
        """num_envs * rounds targets; number i belongs to the strip of sub-env i % num_envs. All
        equilibria are one batch, from what the polynomial of the task's reach says.
        """
        goals, task, count = [], env.task, env.num_envs
        for k in range(rounds):
            env.reset(seed=first + k * count)
            goals.append(env.state.goal)
        goal = torch.cat(goals)
        rows = torch.arange(count).repeat(rounds)
        share = nearest_action(
            lambda action: (task.reach.tip(action, rows), task.reach.slopes(action, rows)),
            goal,
            goal.new_zeros(len(goal), task.actions),
            ITERATIONS,
        )
        hold = holding_action(
            env.scene, goal, task.actions, task.inputs, 2, guess=task.config.reach * share
        )
        return cls([first + i for i in range(len(goal))], hold)

    def pick(self, rows: Tensor) -> Targets:
        return Targets([self.seeds[i] for i in rows.tolist()], self.hold[rows])


@dataclass(frozen=True)
class Record:
    """distance (time, n) m after each control interval; force (time, n, 2) N; reward (time, n);
    nodes (time + 1, n, N+1, 3) m; failed (n,) bool; target (n, 3) m; interval s; length m.
    """

    distance: Tensor
    force: Tensor
    reward: Tensor
    nodes: Tensor
    failed: Tensor
    target: Tensor
    interval: float
    length: float

    @property
    def final(self) -> Tensor:
        """(n,) m, mean distance over the last 0.2 s."""
        return self._last.mean(0)

    @property
    def _last(self) -> Tensor:
        return self.distance[-max(1, round(WINDOW / self.interval)) :]

    @property
    def settling(self) -> Tensor:
        """(n,) s, after which the tip stays within 2 % of the length to the end; the whole episode
        if it does not.
        """
        away = (self.distance > CLOSE * self.length).double()
        last_away = (away * torch.arange(1, len(away) + 1, dtype=away.dtype)[:, None]).amax(0)
        return last_away * self.interval

    def scores(self) -> dict[str, float]:
        """Means over the episodes; the columns of the table."""
        return {
            "final_distance_m": self.final.mean().item(),
            "final_distance_median_m": self.final.median().item(),
            "final_distance_largest_m": self.final.max().item(),
            "share_within_2_percent": (self._last <= CLOSE * self.length)
            .all(0)
            .double()
            .mean()
            .item(),
            "effort_N": self.force.square().sum(-1).mean(0).sqrt().mean().item(),
            "settling_time_s": self.settling.mean().item(),
            "return": self.reward.sum(0).mean().item(),
            "solver_failures": int(self.failed.sum()),
        }


def varied(count: int, spread: float) -> Section:
    """`count` strips whose stiffness goes evenly from 1 - spread to 1 + spread times the default
    one's.
    """
    strip = aluminium_strip()
    factor = torch.linspace(1 - spread, 1 + spread, count, dtype=strip.mass.dtype)[:, None, None]
    return strip.like(strip.compliance / factor, strip.mass)


def make(settings: dict, num_envs: int) -> TipReachVectorEnv:
    return TipReachVectorEnv(num_envs, output="torch", autoreset_mode="Disabled", **settings)


def rollout(env: TipReachVectorEnv, controller: Controller, targets: Targets) -> Record:
    """One episode each; differentiable where gradients are on."""
    observation, _ = env.reset(seed=targets.seeds)
    distance, force, reward, nodes = [], [], [], [env.state.beam.nodes.detach()]
    for _ in range(env.max_episode_steps):
        action = controller(observation, targets.hold)
        observation, gain, _, _, info = env.step(action)
        distance.append(info["distance"])
        force.append(action.detach() * env.task.force)
        reward.append(gain)
        nodes.append(env.state.beam.nodes.detach())
    return Record(
        *map(torch.stack, (distance, force, reward, nodes)),
        env.state.terminated,
        env.state.goal,
        env.config.control_interval,
        env.task.length,
    )


@torch.no_grad()
def evaluate(env: TipReachVectorEnv, controller: Controller, targets: Targets) -> Record:
    return rollout(env, controller, targets)
