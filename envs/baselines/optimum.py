"""Optimum: the best actions known beforehand, by gradients through the simulation. No feedback: it
needs the exact future.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..core import BeamVectorEnv
from .holding import Controller, Static


class Optimum(Controller):
    """A local optimum of each episode's return over all its actions: Adam from those of a guess,
    each episode by itself.

    The env must have output="torch"; its noise and parameters are known to the optimiser, as the
    future is. The actions of the best iterate of each episode are played.

    guess       controller whose actions are the start; None = the holding actions
    iterations  whole episodes simulated and differentiated, each
    rate        of Adam at the start, falling to a twentieth along a cosine
    """

    def __init__(
        self,
        env: BeamVectorEnv,
        guess: Controller | None = None,
        *,
        iterations: int = 60,
        rate: float = 0.05,
    ) -> None:
        self.guess = Static(env) if guess is None else guess
        self.iterations, self.rate, self.steps = iterations, rate, 0

    def begin(self, env: BeamVectorEnv) -> None:
        """Optimise from the state after the reset, and put the env back there. Raises ValueError
        where it gives numpy.
        """
        super().begin(env)
        if env.output != "torch" or env.max_episode_steps is None:
            raise ValueError(
                "an env without end, or of output='numpy', was given; a limit and "
                "output='torch' are wanted"
            )
        start = env.state.detach()
        best = self._guessed()
        least = torch.full((env.num_envs,), torch.inf, dtype=env.dtype, device=env.device)
        plan = best.clone().requires_grad_()
        optimizer = torch.optim.Adam([plan], self.rate)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(
            optimizer, self.iterations, self.rate / 20
        )
        for _ in range(self.iterations):
            with torch.enable_grad():
                env.set_state(start)
                cost = -sum(env.step(action)[1] for action in plan)
                gradient = torch.autograd.grad(cost.sum(), plan)[0]
            better = cost.detach() < least
            best = torch.where(better[:, None], plan.detach(), best)
            least = torch.where(better, cost.detach(), least)
            plan.grad = torch.nan_to_num(gradient, posinf=0.0, neginf=0.0)
            optimizer.step()
            schedule.step()
            with torch.no_grad():
                plan.clamp_(-1, 1)
        self.steps += self.iterations * env.num_envs * len(plan)
        self.plan = best
        self.next = 0
        env.set_state(start)

    @torch.no_grad()
    def _guessed(self) -> Tensor:
        """(steps, n, a): what the guess does in these episodes."""
        self.guess.begin(self.env)
        observation, plan = self.env.state.observation, []
        for _ in range(self.env.max_episode_steps):
            plan.append(self.guess(observation))
            observation = self.env.step(plan[-1])[0]
        return torch.stack(plan)

    def act(self, observation: Tensor) -> Tensor:
        self.next += 1
        return self.plan[self.next - 1]
