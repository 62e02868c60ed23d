"""Soft actor-critic in one file, torch only (Haarnoja et al. 2018, "Soft actor-critic algorithms
and applications"); with --memory from sequences of the past (Ni, Eysenbach and Salakhutdinov 2022,
arXiv 2110.05038), each begun by what was remembered then and brought up to date (stored state and
burn-in: Kapturowski et al. 2019, "Recurrent experience replay", section 3).

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
    replay: int = 200_000
    """transitions of the past that are kept"""
    memory: int = 0
    """units of a GRU, by which the policy remembers the episode; 0: none"""
    window: int = 32
    """transitions one after the other, with a memory, that are learned from at once"""
    burn: int = 8
    """intervals before them, in which the memory is brought up to date"""
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
    reset. With a memory, what is drawn are windows of as many transitions in all, and the memory's
    gradient goes back to the start of a window. It is that of the critics' error alone: the policy
    takes the memory as it is.
    """

    NAME = "sac"

    def __init__(self, task: Task, arguments: Arguments) -> None:
        self.arguments = a = arguments
        self.burn, self.window = (a.burn, a.window) if a.memory else (0, 1)
        if a.replay < a.num_envs * (least := max(a.horizon, self.burn + self.window)):
            raise ValueError(
                f"replay = {a.replay} was given; at least {least * a.num_envs} is wanted, {least} "
                f"intervals of {a.num_envs} environments"
            )
        self.env = task.seen(a.frames).make(a.num_envs, output="torch")
        self.batch = a.num_envs * a.horizon
        inputs = self.env.single_observation_space.shape[0]
        self.actions = self.env.single_action_space.shape[0]
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(a.seed)
            self.policy = Policy(
                (inputs, *a.hidden, self.actions), squash=True, activation="elu", memory=a.memory
            )
            inputs = self.policy.features
            self.spread = network((inputs, *a.hidden, self.actions), "elu", last=0.01).float()
            sizes = (inputs + self.actions, *a.hidden)
            self.critics = Values(2, sizes, activation="elu")
        self.targets = copy.deepcopy(self.critics)
        self.log_temperature = nn.Parameter(torch.tensor(math.log(a.temperature)))
        remembering = self.policy.recurrent.parameters() if a.memory else ()
        self.parts = [*self.policy.network.parameters(), *self.spread.parameters()]
        valuing = [*self.critics.parameters(), *remembering]
        self.optimizers = [
            torch.optim.Adam(group, a.rate, fused=True)
            for group in (self.parts, valuing, [self.log_temperature])
        ]
        self.generator = torch.Generator().manual_seed(a.seed)
        self.replay: dict[str, Tensor] = {}  # (intervals, n, ...), a ring
        self.rows = a.replay // a.num_envs  # of it
        self.seen = 0  # transitions, those that are forgotten among them
        self.observation = self.env.reset(seed=training_seed(a.seed))[0]
        self.memory = self.policy.blank(a.num_envs)  # of what was before the observation

    def sample(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """(actions (..., a), their log-likelihood (...)) of features (..., o + m)."""
        mean = self.policy.network(features)
        deviation = self.spread(features).clamp(*LOG_DEVIATIONS).exp()
        noise = torch.randn(mean.shape, generator=self.generator, dtype=mean.dtype)
        return squashed(mean, deviation, noise)

    @torch.no_grad()
    def collect(self) -> dict[str, Tensor]:
        """One horizon of transitions, each (horizon, n, ...); `next` is the observation before any
        reset.
        """
        a, rows = self.arguments, []
        for _ in range(a.horizon):
            features, memory = self.policy.see(self.observation, self.memory)
            if self.seen + len(rows) * a.num_envs < a.warmup:
                action = 2 * torch.rand(self.env.action_space.shape, generator=self.generator) - 1
            else:
                action = self.sample(features)[0]
            after, reward, terminated, truncated, info = self.env.step(action)
            over, last = terminated | truncated, after
            if over.any():
                last = torch.where(over[:, None], info["final_obs"], after)
            rows.append(
                dict(
                    observation=self.observation.float(),
                    memory=self.memory,
                    action=action.float(),
                    reward=a.reward_scale * reward.float(),
                    next=last.float(),
                    terminated=terminated,
                    over=over,
                )
            )
            self.observation, self.memory = after, torch.where(over[:, None], 0.0, memory)
        return {name: torch.stack([row[name] for row in rows]) for name in rows[0]}

    def remember(self, data: dict[str, Tensor]) -> None:
        """Over the oldest transitions (intervals, n, ...), once as many are kept as may be."""
        count, n = data["reward"].shape
        at = torch.arange(self.seen // n, self.seen // n + count) % self.rows
        for name, x in data.items():
            if name not in self.replay:
                self.replay[name] = x.new_zeros(self.rows, *x.shape[1:])
            self.replay[name][at] = x
        self.seen += count * n

    def draw(self) -> dict[str, Tensor]:
        """Windows from anywhere in the past, each (burn + window, k, ...)."""
        a, past = self.arguments, self.seen // self.arguments.num_envs
        span, kept = self.burn + self.window, min(past, self.rows)
        among = (kept - span + 1) * a.num_envs
        first = torch.randint(among, (-(-a.minibatch // self.window),), generator=self.generator)
        at = past - kept + first // a.num_envs + torch.arange(span)[:, None]
        return {name: x[at % self.rows, first % a.num_envs] for name, x in self.replay.items()}

    def iteration(self, done: float) -> dict[str, float]:
        a = self.arguments
        data = self.collect()
        self.remember(data)
        self.policy.statistics.update(data["observation"])
        error = entropy = math.nan
        enough = max(a.warmup, (self.burn + self.window) * a.num_envs)
        for _ in range(a.updates if self.seen >= enough else 0):
            error, entropy = self.update(self.draw())
        return {
            "value_error": error,
            "entropy": entropy,
            "temperature": self.log_temperature.exp().item(),
        }

    def update(self, data: dict[str, Tensor]) -> tuple[float, float]:
        """(error of the critics, entropy of the policy) of one step of each on windows."""
        a, policy, temperature = self.arguments, self.policy, self.log_temperature.exp()
        memory = self.brought_up(data)
        data = {name: x[self.burn :] for name, x in data.items()}
        features = policy.see_all(data["observation"], memory, data["over"])
        with torch.no_grad():
            after = policy.see_next(features, data["next"])
            action, likelihood = self.sample(after)
            value = self.values(self.targets, after, action).amin(0) - temperature * likelihood
            target = data["reward"] + a.discount * torch.where(data["terminated"], 0.0, value)
        error = (self.values(self.critics, features, data["action"]) - target).square().mean()
        self._step(1, error)
        features = features.detach()
        action, likelihood = self.sample(features)
        value = self.values(self.critics, features, action).amin(0)
        self._step(0, (temperature.detach() * likelihood - value).mean())
        entropy = -likelihood.detach().mean()
        self._step(2, self.log_temperature * (entropy + self.actions))
        with torch.no_grad():
            old, new = self.targets.parameters(), self.critics.parameters()
            torch._foreach_lerp_([*old], [*new], a.target)
        return error.item(), entropy.item()

    @torch.no_grad()
    def brought_up(self, data: dict[str, Tensor]) -> Tensor:
        """(k, m): the memory after the burn-in of windows, from what was remembered then."""
        memory = data["memory"][0]
        for observation, over in zip(data["observation"][: self.burn], data["over"], strict=False):
            _, memory = self.policy.see(observation, memory)
            memory = torch.where(over[:, None], 0.0, memory)
        return memory

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
        a = self.arguments
        return {
            **{name: getattr(self, name).state_dict() for name in self._PARTS},
            "optimizers": [optimizer.state_dict() for optimizer in self.optimizers],
            "log_temperature": self.log_temperature.detach(),
            "generator": self.generator.get_state(),
            "replay": {
                name: x[: self.seen // a.num_envs].clone() for name, x in self.replay.items()
            },
            "seen": self.seen,
            "memory": self.memory,
            "environment": environment_state(self.env),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        for name in self._PARTS:
            getattr(self, name).load_state_dict(state[name])
        for optimizer, own in zip(self.optimizers, state["optimizers"], strict=True):
            optimizer.load_state_dict(own)
        self.log_temperature.data.copy_(state["log_temperature"])
        self.generator.set_state(state["generator"])
        self.replay, self.seen = {}, 0
        if state["replay"]:
            self.remember(state["replay"])
        self.seen, self.memory = state["seen"], state["memory"]
        self.observation = restore_environment(self.env, state["environment"])

    _PARTS = ("policy", "spread", "critics", "targets")


if __name__ == "__main__":
    raise SystemExit(main(None, Arguments, SAC, TUNED))
