"""Optimum: the best actions known beforehand, by Gauss-Newton steps from several starts. No
feedback: it needs the exact future.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from torchbeam.extend import count

from ..core import BeamVectorEnv
from ..episodes import Episodes
from .holding import Controller, Static, vector_env
from .trajectory import TipWay, within_bounds

SPREAD = 0.3  # deviation of the actions of further starts from those of the guess
ACCURACY = 1e-5  # of a return, beside its size: what a step must promise to go on


class Optimum(Controller):
    """A local optimum of each episode's return over all its actions: a reference with knowledge of
    the future.

    It uses direct single shooting: damped Gauss-Newton steps (Levenberg and Marquardt) with exact
    derivatives. Each step is a quadratic program solved within the bounds. Each episode starts from
    the actions of a guess and from random ones around them, and plays the best. It is no proven
    bound: `gap` and `spread` say how far it converged. The env must have an end. It knows the
    episodes' own parameters.

    Args:
        guess: controller whose actions are the first start; None = the holding actions
        iterations: largest number of steps from each start
        starts: number of starts
        seed: of the random starts

    After `begin` it has the cost (n,) of the plans, and the gap (n,): the decrease that the
    quadratic model still predicts. The spread (n,) is that of costs at the ends of different
    starts. `steps` counts the env steps played.

    Raises:
        ValueError: for an env without end, no iterations or starts, and as `TipWay`.

    Examples:
        >>> env = envs.TipReachVectorEnv(2, elements=2, planar=True, max_episode_steps=4)
        >>> observation, _ = env.reset(seed=0)
        >>> controller = baselines.Optimum(env, iterations=2, starts=1)
        >>> controller.begin(env)
        >>> controller(observation).shape
        (2, 1)
    """

    def __init__(
        self,
        env: BeamVectorEnv,
        guess: Controller | None = None,
        *,
        iterations: int = 30,
        starts: int = 1,
        seed: int = 0,
    ) -> None:
        env = vector_env(env)
        count("iterations", iterations)
        count("starts", starts)
        count("seed", seed, 0)
        self.guess = Static(env) if guess is None else guess
        self.iterations, self.starts, self.seed, self.steps = iterations, starts, seed, 0

    @torch.no_grad()
    def begin(self, env: Any) -> None:
        """Optimise from the state after the reset, and put the env back there."""
        super().begin(env)
        env = self.env
        if env.max_episode_steps is None:
            raise ValueError("an env without end was given; max_episode_steps is wanted")
        start = env.state.detach()
        generator = torch.Generator().manual_seed(self.seed)
        first = self._guessed()
        ends = []
        for k in range(self.starts):
            moved = SPREAD * torch.randn(first.shape, generator=generator, dtype=torch.float64)
            plan = first if k == 0 else (first + moved.to(first)).clamp(-1, 1)
            ends.append(self._descended(start, plan))
        plans, costs, gaps = (torch.stack(parts) for parts in zip(*ends, strict=True))
        self.cost, best = costs.min(0)
        self.spread = costs.amax(0) - self.cost
        members = torch.arange(env.num_envs, device=env.device)
        self.plan, self.gap, self.next = plans[best, members], gaps[best, members], 0
        env.set_state(start)

    def _descended(self, start: Episodes, plan: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Plan (n, T, a), its cost (n,) and what the last step promised (n,)."""
        way = TipWay(self.env.task, start.plant)
        cost = self._cost(start, plan)
        damping = torch.full_like(cost, 1e-3)
        for _ in range(self.iterations):
            g, H = self._model(way, start, plan)
            trial, promised = _step(g, H, plan, damping)
            after = self._cost(start, trial)
            better = after < cost
            plan = torch.where(better[:, None, None], trial, plan)
            cost = torch.where(better, after, cost)
            damping = (damping * torch.where(better, 0.2, 10.0)).clamp(1e-9, 1e3)
            if (promised < ACCURACY * (1 + cost)).all():
                break
        return plan, cost, _step(*self._model(way, start, plan), plan, 1e-9)[1]

    def _model(self, way: TipWay, start: Episodes, plan: Tensor) -> tuple[Tensor, Tensor]:
        """Gradient and Gauss-Newton matrix of the cost of a plan, by its numbers."""
        delay = self.env.config.delay
        acting = torch.cat((start.pending, plan), 1)[:, : plan.shape[1]]
        _, tips, slopes, _ = way.linearised(start.beam, acting)
        # by what is given within the episode; what comes too late to act costs alone
        own = torch.nn.functional.pad(slopes[:, :, :, delay:], (0, 0, 0, delay)).flatten(3)
        return way.quadratic(way.gaps(start, tips), own, plan.flatten(1))

    def _cost(self, start: Episodes, plan: Tensor) -> Tensor:
        """(n,): less the return of the plan (n, T, a), as the env has it."""
        simulation, now, total = self.env.simulation, start, 0.0
        for action in plan.unbind(1):
            over = now.done
            now, reward, _ = simulation.advance(now, action, ~over if over.any() else None)
            total = total - reward
        self.steps += plan.shape[0] * plan.shape[1]
        return total

    def _guessed(self) -> Tensor:
        """(n, T, a): what the guess does in these episodes."""
        env, start = self.env, self.env.state
        self.guess.begin(env)
        plan = []
        for _ in range(env.max_episode_steps):
            seen = env.state.observation
            plan.append(self.guess(seen))
            env.set_state(env.simulation.advance(env.state, plan[-1], ~env.state.done)[0])
        env.set_state(start)
        return torch.stack(plan, 1)

    def restart(self, fresh: Tensor) -> None:
        if self.next:
            raise ValueError(
                "an episode that began after begin(env) was given to Optimum; begin(env) after "
                "each reset is wanted"
            )

    def act(self, observation: Tensor) -> Tensor:
        self.next += 1
        return self.plan[:, self.next - 1]


def _step(g: Tensor, H: Tensor, plan: Tensor, damping: float | Tensor) -> tuple[Tensor, Tensor]:
    """The plan (n, T, a) after a step, and by how much the model has it lower the cost (n,)."""
    trial = within_bounds(g, H, plan.flatten(1), damping)
    d = trial - plan.flatten(1)
    return trial.view_as(plan), -((g + (H @ d[..., None])[..., 0] / 2) * d).sum(-1)
