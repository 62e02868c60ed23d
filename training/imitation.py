"""Imitation: a policy is taught to act like a controller, in states that it brings about itself
(Ross, Gordon and Bagnell 2011, "A reduction of imitation learning and structured prediction to
no-regret online learning").
"""

from __future__ import annotations

import ast
from typing import Any

import torch
from gymnasium.vector import VectorEnv
from torch import Tensor, nn
from torchbeam_envs import baselines

from .policies import Policy

RATE, MINIBATCH, UPDATES = 2e-3, 256, 100  # Adam's; observations in one; in a lesson
# of a policy that remembers: episodes, or what there is of them, in a minibatch; in a lesson
EPISODES, EPISODE_UPDATES = 32, 40
NORM = 1.0  # to which its gradient is scaled down


class Imitation:
    """Lessons, a window of a learner each: the first ones are played by the controller, later ones
    in a growing share of the sub-environments by the policy, and everywhere the controller says
    what it would do. After each, the policy is fitted to all that was said so far; one that
    remembers to whole episodes, through which the gradient goes.

    Args:
        env: the learner's, reset
        teacher: a controller in `torchbeam_envs.baselines`, LQR or, with settings of its own,
            LQR(effort=0.1); it may read the env's whole state, which the policy does not see
        lessons: in which the controller plays
        updates: of the policy in a lesson
        lasting: whether lessons go on after these, played by the policy alone

    Raises:
        ValueError: where there is no such controller, or it is for another task.
    """

    def __init__(
        self,
        env: VectorEnv,
        policy: Policy,
        teacher: str,
        lessons: int,
        updates: int | None = None,
        lasting: bool = False,
    ) -> None:
        kind, settings = controller_named(teacher)
        self.env, self.policy, self.lessons, self.done = env, policy, lessons, 0
        self.lasting = lasting
        self.updates = updates or (EPISODE_UPDATES if policy.memory else UPDATES)
        try:
            self.controller = kind(env, **settings)
        except TypeError as error:
            raise ValueError(
                f"the teacher {teacher!r} was given, whose settings do not fit: {error}"
            ) from None
        self.controller.begin(env)
        self.optimizer = torch.optim.Adam(policy.parameters(), RATE, fused=True)
        # what was seen and said, and where episodes began, interval by interval
        self.seen: list[Tensor] = []
        self.said: list[Tensor] = []
        self.first: list[Tensor] = []

    @property
    def over(self) -> bool:
        return self.done >= self.lessons and not self.lasting

    def act(self, observation: Tensor, action: Tensor) -> Tensor:
        """(n, a): what acts where the policy would do `action`."""
        said = torch.as_tensor(self.controller(observation), dtype=action.dtype)
        self.seen.append(observation.detach())
        self.said.append(said)
        self.first.append(self.env.state.steps == 0)
        taught = torch.arange(len(said)) < (1 - self.done / self.lessons) * len(said)
        return torch.where(taught[:, None], said, action)

    def learn(self, generator: torch.Generator) -> float:
        """End a lesson: fit the policy; returns the mean squared error of the last minibatch."""
        self.policy.statistics.update(torch.cat(self.seen[bool(self.done) :]))  # of this lesson
        self.seen, self.said, self.first = (
            [torch.cat(rows)] for rows in (self.seen, self.said, self.first)
        )
        draw = self._episodes if self.policy.memory else self._intervals
        for _ in range(self.updates):
            error = draw(generator)
            self.optimizer.zero_grad()
            error.backward()
            if self.policy.memory:
                nn.utils.clip_grad_norm_(self.policy.parameters(), NORM)
            self.optimizer.step()
        self.done += 1
        if self.over:
            self.seen, self.said, self.first = [], [], []
        return error.item()

    def rate(self, rate: float) -> None:
        """Of Adam, from now on."""
        for group in self.optimizer.param_groups:
            group["lr"] = rate

    def _intervals(self, generator: torch.Generator) -> Tensor:
        """Mean squared error of a minibatch."""
        seen, said = self.seen[0], self.said[0]
        rows = torch.randint(len(seen), (MINIBATCH,), generator=generator)
        features, _ = self.policy.see(seen[rows], self.policy.blank(MINIBATCH))
        return (self.policy.act(features).to(said) - said[rows]).square().mean()

    def _episodes(self, generator: torch.Generator) -> Tensor:
        """Likewise of episodes from their start on, as far as they have been played."""
        n = self.env.num_envs
        seen, said, first = (
            rows[0].unflatten(0, (-1, n)) for rows in (self.seen, self.said, self.first)
        )
        starts = first.nonzero()
        begin, lane = starts[torch.randint(len(starts), (EPISODES,), generator=generator)].mT
        span = min(len(seen), self.env.max_episode_steps or len(seen))
        at = begin + torch.arange(span)[:, None]  # (span, EPISODES)
        rows = at.clamp(max=len(seen) - 1), lane
        within = (at < len(seen)) & (first[rows].cumsum(0) == 1)  # until the next one begins
        blank = self.policy.blank(EPISODES)
        features = self.policy.see_all(seen[rows], blank, torch.zeros_like(within))
        errors = (self.policy.act(features).to(said) - said[rows]).square().mean(-1)
        return (errors * within).sum() / within.sum()

    def state_dict(self) -> dict[str, Any]:
        return {
            "done": self.done,
            "optimizer": self.optimizer.state_dict(),
            "seen": self.seen,
            "said": self.said,
            "first": self.first,
            "controller": memory(self.controller),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        for name in ("done", "seen", "said", "first"):
            setattr(self, name, state[name])
        self.optimizer.load_state_dict(state["optimizer"])
        self.controller.begin(self.env)
        recall(self.controller, state["controller"])


def memory(controller: Any) -> dict[str, Any]:
    """The tensors of a controller and, by name, of its parts that begin with episodes as it does:
    what it remembers of them is among these.
    """
    return {
        name: value if isinstance(value, Tensor) else memory(value)
        for name, value in vars(controller).items()
        if isinstance(value, Tensor) or hasattr(value, "begin")
    }


def recall(controller: Any, kept: dict[str, Any]) -> None:
    """Put what `memory` gave back."""
    for name, value in kept.items():
        if isinstance(value, Tensor):
            setattr(controller, name, value)
        else:
            recall(getattr(controller, name), value)


def controller_named(text: str) -> tuple[type[baselines.Controller], dict[str, Any]]:
    """A controller in `torchbeam_envs.baselines` and its settings, of NAME or NAME(setting=value).

    Raises ValueError where there is none, and for anything but that.
    """
    try:
        tree = ast.parse(text, mode="eval").body
        call = tree if isinstance(tree, ast.Call) else ast.Call(tree, [], [])
        settings = {str(one.arg): ast.literal_eval(one.value) for one in call.keywords}
        kind = getattr(baselines, call.func.id) if not call.args else None
    except (SyntaxError, ValueError, AttributeError):
        kind = None
    if not (isinstance(kind, type) and issubclass(kind, baselines.Controller)):
        raise ValueError(
            f"the teacher {text!r} was given; a controller of torchbeam_envs.baselines, such as "
            "'LQR' or 'LQR(effort=0.1)', is wanted"
        )
    return kind, settings
