"""Proximal policy optimisation in one file, torch only (Schulman et al. 2017, with the details of
Huang et al. 2022).

python -m training.ppo --task reach --budget 500000
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from .common import environment_state, main, restore_environment, training_seed
from .imitation import Imitation
from .policies import Policy, Statistics, Value
from .tuned import PPO as TUNED
from .tuned import Task


@dataclass(frozen=True)
class Arguments:
    seed: int = 0
    """of the networks, the noise and the episodes"""
    num_envs: int = 64
    """sub-environments"""
    horizon: int = 32
    """control intervals between two updates"""
    hidden: tuple[int, ...] = (64, 64)
    """units of the hidden layers, of the policy and of the value"""
    gain: float = 0.6
    """of the weights of hidden layers at the start: networks begin almost linear"""
    rate: float = 1e-3
    """of Adam at the start; falls to a tenth at the end of the budget"""
    discount: float = 0.99
    """of the return, a control interval"""
    trace: float = 0.95
    """lambda of the generalised advantages"""
    clip: float = 0.2
    """of the probability ratio"""
    epochs: int = 8
    """passes over the data of an update, at most"""
    minibatches: int = 4
    """in a pass"""
    divergence: float = 0.03
    """estimated KL divergence from the old policy at which an update ends early"""
    entropy: float = 0.0
    """weight of the entropy bonus"""
    value_weight: float = 0.5
    """weight of the value's squared error, of normalised returns"""
    gradient_norm: float = 0.5
    """gradients of the policy, and those of the value, are scaled down to this norm"""
    deviation: float = 0.5
    """standard deviation of the actions at the start"""
    frames: int = 0
    """observations side by side that are seen at once; 0: as the task has them"""
    memory: int = 0
    """units of a GRU, by which the policy remembers the episode; 0: none"""
    output: str = "numpy"
    """what the environment gives, "numpy" or "torch": the numbers are the same but for rounding to
    float32
    """
    linear: bool = False
    """whether the policy's network has a linear shortcut"""
    teacher: str = ""
    """a controller of `torchbeam_envs.baselines` that the policy first learns to imitate, such as
    LQR or LQR(effort=0.1); none where it is empty
    """
    lessons: int = 40
    """horizons in which it does so, and the value learns beside it"""


class PPO:
    """Clipped surrogate, generalised advantages, observations and the value's targets normalised
    by running statistics.

    The end of an episode by the time limit is not an end of the task: its last value is
    bootstrapped from the observation before the reset. Actions outside [-1, 1] are clipped by the
    environment.
    """

    NAME = "ppo"

    def __init__(self, task: Task, arguments: Arguments) -> None:
        self.arguments = a = arguments
        self.env = task.seen(a.frames).make(a.num_envs, output=a.output)
        self.batch = a.num_envs * a.horizon
        inputs = self.env.single_observation_space.shape[0]
        actions = self.env.single_action_space.shape[0]
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(a.seed)
            self.policy = Policy(
                (inputs, *a.hidden, actions),
                squash=False,
                deviation=a.deviation,
                linear=a.linear,
                gain=a.gain,
                memory=a.memory,
            )
            self.value = Value((self.policy.features, *a.hidden), gain=a.gain)
        groups = [{"params": network.parameters()} for network in (self.policy, self.value)]
        self.optimizer = torch.optim.Adam(groups, a.rate, eps=1e-5, fused=True)
        self.generator = torch.Generator().manual_seed(a.seed)
        self.returns = Statistics(1)  # of the value's targets
        self.observation = torch.as_tensor(self.env.reset(seed=training_seed(a.seed))[0])
        self.memory = self.policy.blank(a.num_envs)  # of what was before the observation
        self.imitation = (
            Imitation(self.env, self.policy, a.teacher, a.lessons) if a.teacher else None
        )

    @torch.no_grad()
    def collect(self, lesson: Imitation | None = None) -> dict[str, Tensor]:
        """One horizon of data, each (horizon, n, ...), with the policy as it is, or as a lesson;
        `next` is the observation before any reset.
        """
        policy, rows = self.policy, []
        for _ in range(self.arguments.horizon):
            noise = torch.randn(self.env.action_space.shape, generator=self.generator)
            features, memory = policy.see(self.observation, self.memory)
            distribution = policy.distribution(features)
            action = distribution.mean + distribution.stddev * noise
            if lesson is not None:
                action = lesson.act(self.observation, action)
            given = action if self.arguments.output == "torch" else action.numpy()
            after, reward, terminated, truncated, info = self.env.step(given)
            after, reward, terminated, truncated = map(
                torch.as_tensor, (after, reward, terminated, truncated)
            )
            over = terminated | truncated
            last = (
                torch.where(over[:, None], torch.as_tensor(info["final_obs"]), after)
                if over.any()
                else after
            )
            rows.append(
                dict(
                    observation=self.observation,
                    memory=self.memory,
                    action=action,
                    reward=reward,
                    next=last,
                    terminated=terminated,
                    over=over,
                    likelihood=distribution.log_prob(action).sum(-1),
                )
            )
            self.observation, self.memory = after, torch.where(over[:, None], 0.0, memory)
        return {name: torch.stack([row[name] for row in rows]) for name in rows[0]}

    @torch.no_grad()
    def advantages(self, data: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """(advantages, normalised targets of the value), (horizon, n)."""
        a, policy = self.arguments, self.policy
        features = policy.see_all(data["observation"], data["memory"][0], data["over"])
        value, after = (
            self.value(x) * self.returns.variance.sqrt() + self.returns.mean
            for x in (features, policy.see_next(features, data["next"]))
        )
        surprise = data["reward"] + a.discount * torch.where(data["terminated"], 0.0, after) - value
        advantage, rows = torch.zeros_like(surprise[0]), []
        for k in reversed(range(a.horizon)):
            advantage = surprise[k] + a.discount * a.trace * torch.where(
                data["over"][k], 0.0, advantage
            )
            rows.append(advantage)
        advantage = torch.stack(rows[::-1])
        target = (advantage + value)[..., None]
        self.returns.update(target)
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        return advantage.float(), self.returns(target)[..., 0].float()

    def iteration(self, done: float) -> dict[str, float]:
        a = self.arguments
        for group in self.optimizer.param_groups:
            group["lr"] = a.rate * (1 - 0.9 * done)
        lesson = self.imitation
        if lesson is not None and not lesson.over:
            return self.imitate(lesson)
        policy, data = self.policy, self.collect()
        data |= dict(zip(("advantage", "target"), self.advantages(data), strict=True))
        gone, passes = 0.0, 0
        for _ in range(a.epochs):
            for part in self.minibatches(data):
                features = policy.see_all(part["observation"], part["memory"][0], part["over"])
                distribution = policy.distribution(features)
                change = distribution.log_prob(part["action"]).sum(-1) - part["likelihood"]
                ratio, gain = change.exp(), part["advantage"]
                better = torch.minimum(
                    ratio * gain, ratio.clamp(1 - a.clip, 1 + a.clip) * gain
                ).mean()
                error = (self.value(features.detach()) - part["target"]).square().mean()
                loss = (
                    -better
                    + a.value_weight * error
                    - a.entropy * distribution.entropy().sum(-1).mean()
                )
                self.descend(loss)
                gone = ((ratio - 1) - change).mean().item()  # Schulman's estimate of the divergence
            passes += 1
            if gone > a.divergence:
                break
        policy.statistics.update(data["observation"])
        return {
            "value_error": error.item(),
            "divergence": gone,
            "passes": passes,
            "deviation": policy.log_deviation.exp().mean().item(),
        }

    def minibatches(self, data: dict[str, Tensor]) -> Iterator[dict[str, Tensor]]:
        """Of a pass: intervals, each a sequence of one; of a policy that remembers, horizons."""
        a = self.arguments
        if not a.memory:
            data = {name: x.flatten(0, 1)[None] for name, x in data.items()}
        order = torch.randperm(data["over"].shape[1], generator=self.generator)
        for rows in order.chunk(a.minibatches):
            yield {name: x[:, rows] for name, x in data.items()}

    def descend(self, loss: Tensor) -> None:
        """A step of Adam. The value's gradient may be far the greater, and takes nothing from the
        policy's.
        """
        self.optimizer.zero_grad()
        loss.backward()
        for group in self.optimizer.param_groups:
            nn.utils.clip_grad_norm_(group["params"], self.arguments.gradient_norm)
        self.optimizer.step()

    def imitate(self, lesson: Imitation) -> dict[str, float]:
        """An iteration that is a lesson."""
        data = self.collect(lesson)
        gap = lesson.learn(self.generator)
        data["target"] = self.advantages(data)[1]
        with torch.no_grad():
            data["features"] = self.policy.see_all(
                data["observation"], data["memory"][0], data["over"]
            )
        for _ in range(self.arguments.epochs):
            for part in self.minibatches(data):
                error = (self.value(part["features"]) - part["target"]).square().mean()
                self.descend(error)
        return {"imitation_error": gap, "value_error": error.item()}

    def state_dict(self) -> dict[str, Any]:
        return {
            "policy": self.policy.state_dict(),
            "value": self.value.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "generator": self.generator.get_state(),
            "returns": self.returns.state_dict(),
            "memory": self.memory,
            "environment": environment_state(self.env),
            "imitation": self.imitation and self.imitation.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        for name in ("policy", "value", "optimizer", "returns"):
            getattr(self, name).load_state_dict(state[name])
        self.generator.set_state(state["generator"])
        self.memory = state["memory"]
        self.observation = torch.as_tensor(restore_environment(self.env, state["environment"]))
        if self.imitation is not None:
            self.imitation.load_state_dict(state["imitation"])


if __name__ == "__main__":
    raise SystemExit(main(None, Arguments, PPO, TUNED))
