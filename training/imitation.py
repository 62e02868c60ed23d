"""Imitation: a policy is taught to act like a controller, in states that it brings about itself
(Ross, Gordon and Bagnell 2011, "A reduction of imitation learning and structured prediction to
no-regret online learning").
"""

from __future__ import annotations

from typing import Any

import torch
from gymnasium.vector import VectorEnv
from torch import Tensor
from torchbeam_envs import baselines

from .policies import Policy

RATE, MINIBATCH, UPDATES = 2e-3, 256, 100  # Adam's; observations in one; in a lesson


class Imitation:
    """Lessons, a window of a learner each: the first ones are played by the controller, later ones
    in a growing share of the sub-environments by the policy, and everywhere the controller says
    what it would do. After each, the policy is fitted to all that was said so far.

    Args:
        env: the learner's, reset
        name: of a controller in `torchbeam_envs.baselines`, taken with its own settings; it may
            read the env's whole state
        lessons: how many there are

    Raises:
        ValueError: where there is no such controller, or it is for another task.
    """

    def __init__(self, env: VectorEnv, policy: Policy, name: str, lessons: int) -> None:
        kind = getattr(baselines, name, None)
        if not (isinstance(kind, type) and issubclass(kind, baselines.Controller)):
            raise ValueError(
                f"the teacher {name!r} was given; a controller of torchbeam_envs.baselines, such "
                "as 'LQR', is wanted"
            )
        self.env, self.policy, self.lessons, self.done = env, policy, lessons, 0
        self.controller = kind(env)
        self.controller.begin(env)
        self.optimizer = torch.optim.Adam(policy.network.parameters(), RATE)
        self.seen: list[Tensor] = []
        self.said: list[Tensor] = []

    @property
    def over(self) -> bool:
        return self.done >= self.lessons

    def act(self, observation: Tensor, action: Tensor) -> Tensor:
        """(n, a): what acts where the policy would do `action`."""
        said = torch.as_tensor(self.controller(observation), dtype=action.dtype)
        self.seen.append(observation.detach())
        self.said.append(said)
        taught = torch.arange(len(said)) < (1 - self.done / self.lessons) * len(said)
        return torch.where(taught[:, None], said, action)

    def learn(self, generator: torch.Generator) -> float:
        """End a lesson: fit the policy; returns the mean squared error of the last minibatch."""
        seen, said = torch.cat(self.seen), torch.cat(self.said)
        self.policy.statistics.update(seen)
        for _ in range(UPDATES):
            rows = torch.randint(len(seen), (MINIBATCH,), generator=generator)
            error = (self.policy.act(seen[rows]) - said[rows]).square().mean()
            self.optimizer.zero_grad()
            error.backward()
            self.optimizer.step()
        self.seen, self.said, self.done = [seen], [said], self.done + 1
        if self.over:
            self.seen, self.said = [], []
        return error.item()

    def state_dict(self) -> dict[str, Any]:
        return {
            "done": self.done,
            "optimizer": self.optimizer.state_dict(),
            "seen": self.seen,
            "said": self.said,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.done, self.seen, self.said = state["done"], state["seen"], state["said"]
        self.optimizer.load_state_dict(state["optimizer"])
        self.controller.begin(self.env)
