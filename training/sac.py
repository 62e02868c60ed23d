"""Soft actor-critic in one file, torch only (Haarnoja et al. 2018, "Soft actor-critic algorithms
and applications").

python -m training.sac --task reach --budget 100000
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from .common import environment_state, main, restore_environment, training_seed
from .policies import LOG_DEVIATIONS, Policy, Values, network, squashed
from .tuned import SAC as TUNED
from .tuned import Task


@dataclass(frozen=True)
class Arguments:
    seed: int = 0
    """of the networks, the noise, the episodes and what is drawn from the memory"""
    num_envs: int = 32
    """sub-environments"""
    horizon: int = 8
    """control intervals between two rounds of updates"""
    hidden: tuple[int, ...] = (64, 64)
    """units of the hidden layers, of the policy and of the critics"""
    rate: float = 1e-3
    """of Adam, for policy, critics and temperature"""
    discount: float = 0.99
    """of the return, a control interval"""
    target: float = 0.01
    """share of the critics that an update mixes into their targets"""
    frames: int = 0
    """observations side by side that are seen at once; 0: as the task has them"""
    updates: int = 64
    """in a round"""
    minibatch: int = 256
    """transitions in an update"""
    memory: int = 200_000
    """transitions that are remembered"""
    warmup: int = 2_000
    """environment steps by actions at random, before the first update"""
    temperature: float = 0.1
    """weight of the entropy at the start; later such that the entropy is minus the number of
    actions
    """
    reward_scale: float = 0.1
    """rewards are multiplied by this, for the critics' sake"""


class SAC:
    """Ascends the lesser of two critics' values plus the entropy of the actions, which are tanh of
    normal ones; transitions of the past are learned from again.

    An episode that ends by the time limit goes on in the critics, from the observation before the
    reset.
    """

    NAME = "sac"

    def __init__(self, task: Task, arguments: Arguments) -> None:
        self.arguments = a = arguments
        self.env = task.seen(a.frames).make(a.num_envs, output="torch")
        self.batch = a.num_envs * a.horizon
        inputs = self.env.single_observation_space.shape[0]
        self.actions = self.env.single_action_space.shape[0]
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(a.seed)
            self.policy = Policy((inputs, *a.hidden, self.actions), squash=True, activation="elu")
            self.spread = network((inputs, *a.hidden, self.actions), "elu", last=0.01).float()
            sizes = (inputs + self.actions, *a.hidden)
            self.critics = Values(2, sizes, activation="elu")
        self.targets = copy.deepcopy(self.critics)
        self.log_temperature = nn.Parameter(torch.tensor(math.log(a.temperature)))
        self.parts = [*self.policy.network.parameters(), *self.spread.parameters()]
        self.optimizers = [
            torch.optim.Adam(group, a.rate, fused=True)
            for group in (self.parts, self.critics.parameters(), [self.log_temperature])
        ]
        self.generator = torch.Generator().manual_seed(a.seed)
        self.memory: dict[str, Tensor] = {}
        self.seen = 0  # transitions, those that are forgotten among them
        self.observation = self.env.reset(seed=training_seed(a.seed))[0]

    def sample(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """(actions (..., a), their log-likelihood (...)) of normalised observations (..., o)."""
        mean = self.policy.network(observation)
        deviation = self.spread(observation).clamp(*LOG_DEVIATIONS).exp()
        noise = torch.randn(mean.shape, generator=self.generator, dtype=mean.dtype)
        return squashed(mean, deviation, noise)

    @torch.no_grad()
    def collect(self) -> dict[str, Tensor]:
        """One horizon of transitions, each (horizon n, ...); `next` is the observation before any
        reset.
        """
        a, rows = self.arguments, []
        for _ in range(a.horizon):
            if self.seen + len(rows) * a.num_envs < a.warmup:
                action = 2 * torch.rand(self.env.action_space.shape, generator=self.generator) - 1
            else:
                action = self.sample(self.policy.statistics(self.observation).float())[0]
            after, reward, terminated, truncated, info = self.env.step(action)
            over, last = terminated | truncated, after
            if over.any():
                last = torch.where(over[:, None], info["final_obs"], after)
            rows.append(
                dict(
                    observation=self.observation.float(),
                    action=action.float(),
                    reward=a.reward_scale * reward.float(),
                    next=last.float(),
                    terminated=terminated,
                )
            )
            self.observation = after
        return {name: torch.cat([row[name] for row in rows]) for name in rows[0]}

    def remember(self, data: dict[str, Tensor]) -> None:
        """Over the oldest transitions, once the memory is full."""
        size, count = self.arguments.memory, len(data["reward"])
        at = torch.arange(self.seen, self.seen + count) % size
        for name, x in data.items():
            if name not in self.memory:
                self.memory[name] = x.new_zeros(size, *x.shape[1:])
            self.memory[name][at] = x
        self.seen += count

    def iteration(self, done: float) -> dict[str, float]:
        a = self.arguments
        data = self.collect()
        self.remember(data)
        self.policy.statistics.update(data["observation"])
        error = entropy = math.nan
        for _ in range(a.updates if self.seen >= a.warmup else 0):
            rows = torch.randint(min(self.seen, a.memory), (a.minibatch,), generator=self.generator)
            error, entropy = self.update({name: x[rows] for name, x in self.memory.items()})
        return {
            "value_error": error,
            "entropy": entropy,
            "temperature": self.log_temperature.exp().item(),
        }

    def update(self, data: dict[str, Tensor]) -> tuple[float, float]:
        """(error of the critics, entropy of the policy) of one step of each on a minibatch."""
        a, see, temperature = self.arguments, self.policy.statistics, self.log_temperature.exp()
        observation, after = see(data["observation"]).float(), see(data["next"]).float()
        with torch.no_grad():
            action, likelihood = self.sample(after)
            value = self.values(self.targets, after, action).amin(0) - temperature * likelihood
            target = data["reward"] + a.discount * torch.where(data["terminated"], 0.0, value)
        error = (self.values(self.critics, observation, data["action"]) - target).square().mean()
        self._step(1, error)
        action, likelihood = self.sample(observation)
        value = self.values(self.critics, observation, action).amin(0)
        self._step(0, (temperature.detach() * likelihood - value).mean())
        entropy = -likelihood.detach().mean()
        self._step(2, self.log_temperature * (entropy + self.actions))
        with torch.no_grad():
            old, new = self.targets.parameters(), self.critics.parameters()
            torch._foreach_lerp_([*old], [*new], a.target)
        return error.item(), entropy.item()

    @staticmethod
    def values(critics: Values, observation: Tensor, action: Tensor) -> Tensor:
        """(2, ...)"""
        return critics(torch.cat((observation, action), -1))

    def _step(self, which: int, loss: Tensor) -> None:
        optimizer = self.optimizers[which]
        own = optimizer.param_groups[0]["params"]
        for parameter, gradient in zip(own, torch.autograd.grad(loss, own), strict=True):
            parameter.grad = gradient
        optimizer.step()

    def state_dict(self) -> dict[str, Any]:
        return {
            **{name: getattr(self, name).state_dict() for name in self._PARTS},
            "optimizers": [optimizer.state_dict() for optimizer in self.optimizers],
            "log_temperature": self.log_temperature.detach(),
            "generator": self.generator.get_state(),
            "memory": {name: x[: self.seen].clone() for name, x in self.memory.items()},
            "seen": self.seen,
            "environment": environment_state(self.env),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        for name in self._PARTS:
            getattr(self, name).load_state_dict(state[name])
        for optimizer, own in zip(self.optimizers, state["optimizers"], strict=True):
            optimizer.load_state_dict(own)
        self.log_temperature.data.copy_(state["log_temperature"])
        self.generator.set_state(state["generator"])
        self.memory, self.seen = {}, 0
        if state["memory"]:
            self.remember(state["memory"])
        self.seen = state["seen"]
        self.observation = restore_environment(self.env, state["environment"])

    _PARTS = ("policy", "spread", "critics", "targets")


if __name__ == "__main__":
    raise SystemExit(main(None, Arguments, SAC, TUNED))
