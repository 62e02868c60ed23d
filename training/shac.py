"""Short-horizon actor-critic: the policy's gradient through the simulation (Xu et al. 2022,
"Accelerated policy learning with parallel differentiable simulation"), in one file; with --entropy
and --critics 2 that of Xing, Luk and Oh 2025 (SAPO, arXiv 2412.12089, equations 18 to 21).

    python -m training.shac --task reach --budget 200000
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from .common import environment_state, main, restore_environment, training_seed
from .imitation import Imitation
from .policies import LOG_DEVIATIONS, Policy, Values, network, squashed
from .tuned import SHAC as TUNED
from .tuned import Task


@dataclass(frozen=True)
class Arguments:
    seed: int = 0
    """of the networks, the noise and the episodes"""
    num_envs: int = 32
    """sub-environments"""
    horizon: int = 32
    """control intervals in a window: through as many the gradient goes"""
    hidden: tuple[int, ...] = (64, 64)
    """units of the hidden layers, of the policy and of the critic"""
    rate: float = 1e-2
    """of the policy's Adam at the start; falls to a tenth, and stays there"""
    critic_rate: float = 2e-3
    """of the critic's, likewise"""
    falling: int = 300_000
    """environment steps in which the rates fall, whatever the budget"""
    discount: float = 0.99
    """of the return, a control interval"""
    trace: float = 0.95
    """lambda of the critic's targets"""
    target: float = 0.2
    """share of the old target critic that an update leaves"""
    critic_epochs: int = 8
    """passes of the critic over a window's data"""
    critic_minibatches: int = 4
    """in a pass"""
    gradient_norm: float = 1.0
    """gradients are scaled down to this norm"""
    reward_scale: float = 0.1
    """rewards are multiplied by this, for the critic's sake"""
    deviation: float = 0.3
    """standard deviation of the actions (before tanh) at the start"""
    critics: int = 1
    """the policy ascends their mean, and their targets come from the least of them"""
    entropy: float = 0.0
    """weight of the entropy at first; it is held at minus half the number of actions. 0: none"""
    frames: int = 0
    """observations side by side that are seen at once; 0: as the task has them"""
    memory: int = 0
    """units of a GRU, by which the policy remembers the episode; 0: none"""
    linear: bool = False
    """whether the policy's network has a linear shortcut"""
    teacher: str = ""
    """a controller of `torchbeam_envs.baselines` that the policy first learns to imitate, such as
    LQR or LQR(effort=0.1); none where it is empty
    """
    lessons: int = 40
    """windows in which it does so, and the critic learns beside it"""
    average: int = 0
    """updates, about so many, over which the weights that are validated and kept are averaged; from
    the lessons on the normalisation of observations then stays. 0: the last weights are kept
    """
    smooth: float = 0.0
    """width by which the environment smooths the steps of its reward in training, where it has such
    an argument: their gradient is zero else. 0: as it is
    """


class SHAC:
    """Ascends the return of a window, differentiated through every step of the simulation, plus the
    critic's value of what comes after it.

    The value at the end of the window, and of an episode that ends within it by the time limit, is
    that of the observation before the reset; after a failed solve it is none. Gradients that are
    not finite are left out and counted.

    `actor` plays and learns; `policy` is what is kept of it: the same, or an exponential average
    of its weights (Polyak and Juditsky 1992), which forgets the noise of single updates.
    """

    NAME = "shac"

    def __init__(self, task: Task, arguments: Arguments) -> None:
        self.arguments = a = arguments
        smooth = dict(smooth=a.smooth) if a.smooth else {}
        self.env = task.seen(a.frames).make(a.num_envs, output="torch", **smooth)
        self.batch = a.num_envs * a.horizon
        inputs = self.env.single_observation_space.shape[0]
        actions = self.env.single_action_space.shape[0]
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(a.seed)
            self.actor = Policy(
                (inputs, *a.hidden, actions),
                squash=True,
                activation="elu",
                deviation=a.deviation,
                linear=a.linear,
                memory=a.memory,
            )
            self.policy = copy.deepcopy(self.actor) if a.average else self.actor
            sizes = (self.actor.features, *a.hidden)
            self.critic = Values(a.critics, sizes, activation="elu")
            self.spread = nn.ModuleList()  # log of the deviation, by features
            if a.entropy:
                self.spread.append(network((*sizes, actions), "elu", last=0.01).float())
                nn.init.constant_(self.spread[0][-1].bias, math.log(a.deviation))
        self.log_weight = nn.Parameter(torch.tensor(a.entropy, dtype=torch.float32).log())
        self.target = copy.deepcopy(self.critic).requires_grad_(False)
        self.parts = [*self.actor.parameters(), *self.spread.parameters()]
        adam = partial(torch.optim.Adam, betas=(0.7, 0.95), fused=True)
        self.optimizer = adam([*self.parts, self.log_weight], a.rate)
        self.critic_optimizer = adam(self.critic.parameters(), a.critic_rate)
        self.generator = torch.Generator().manual_seed(a.seed)
        self.left_out, self.steps = 0, 0
        self.env.reset(seed=training_seed(a.seed))
        self.memory = self.actor.blank(a.num_envs)  # of what was before the observation
        self.imitation = (
            Imitation(self.env, self.actor, a.teacher, a.lessons) if a.teacher else None
        )

    def draw(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """(actions (n, a), by how much their entropy (n,) is above its target, an action: about 0
        to 1.2, or 0 where it has no weight) of features (n, o + m).
        """
        noise = torch.randn(self.env.action_space.shape, generator=self.generator)
        if not self.spread:
            return self.actor.act(features, noise), features.new_zeros(len(features))
        deviation = self.spread[0](features).clamp(*LOG_DEVIATIONS).exp()
        action, likelihood = squashed(self.actor.network(features), deviation, noise)
        return action, 0.5 - likelihood / action.shape[-1]

    def window(self, lesson: Imitation | None = None) -> tuple[Tensor, dict[str, Tensor]]:
        """(objective (n,) in the graph, data (horizon, n, ...) without): one window with the policy
        as it is, or as a lesson.
        """
        a, policy = self.arguments, self.actor
        observation = self.env.initialize_trajectory()
        memory, rows = self.memory, []
        objective = observation.new_zeros(a.num_envs)
        weight = torch.ones_like(objective)
        for k in range(a.horizon):
            features, after_it = policy.see(observation, memory)
            action, entropy = self.draw(features)
            if lesson is not None:
                action = lesson.act(observation, action.to(observation.dtype))
            after, reward, terminated, truncated, info = self.env.step(action.to(observation.dtype))
            reward = a.reward_scale * reward + self.log_weight.detach().exp() * entropy
            over, last = terminated | truncated, after
            if over.any():
                last = torch.where(over[:, None], info["final_obs"], after)
            objective = objective + weight * reward
            end = over if k < a.horizon - 1 else torch.ones_like(over)
            if end.any():
                value = self.target(policy.held(policy.see(last, after_it)[0])).mean(0)
                rest = torch.where(end & ~terminated, value.to(reward.dtype), 0.0)
                objective = objective + weight * a.discount * rest
            weight = torch.where(over, 1.0, a.discount * weight)
            rows.append(
                dict(
                    observation=observation.detach(),
                    memory=memory.detach(),
                    reward=reward.detach(),
                    next=last.detach(),
                    terminated=terminated,
                    over=over,
                    entropy=entropy.detach(),
                )
            )
            observation, memory = after, torch.where(over[:, None], 0.0, after_it)
        self.memory = memory.detach()
        return objective / a.horizon, {
            name: torch.stack([row[name] for row in rows]) for name in rows[0]
        }

    @torch.no_grad()
    def targets(self, data: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """(features (horizon, n, ...), lambda returns (horizon, n) from the target critic)."""
        a, policy = self.arguments, self.actor
        features = policy.see_all(data["observation"], data["memory"][0], data["over"])
        value = self.target(policy.see_next(features, data["next"])).amin(0)
        after = torch.where(data["terminated"], 0.0, value)
        target, rows = after[-1], []
        for k in reversed(range(a.horizon)):
            target = torch.where(
                data["over"][k], after[k], (1 - a.trace) * after[k] + a.trace * target
            )
            target = data["reward"][k].to(after.dtype) + a.discount * target
            rows.append(target)
        return features, torch.stack(rows[::-1])

    def iteration(self, done: float) -> dict[str, float]:
        a = self.arguments
        fallen = min(self.steps / a.falling, 1.0)  # the budget is no matter: it may be long
        for optimizer, rate in ((self.optimizer, a.rate), (self.critic_optimizer, a.critic_rate)):
            for group in optimizer.param_groups:
                group["lr"] = rate * (1 - 0.9 * fallen)
        self.steps += self.batch
        if self.imitation is not None and not self.imitation.over:
            return self.imitate(self.imitation)
        objective, data = self.window()
        self.optimizer.zero_grad()
        (-objective.mean()).backward()
        norm = nn.utils.clip_grad_norm_(self.parts, a.gradient_norm)
        if self.spread:
            self.log_weight.grad = data["entropy"].mean().float()
        if torch.isfinite(norm):
            self.optimizer.step()
        else:
            self.left_out += 1
        error = self.learn_values(data)
        if not (a.average and a.teacher):
            self.actor.statistics.update(data["observation"])
        self.keep(a.average)
        own = self.log_weight if self.spread else self.actor.log_deviation
        return {
            "gradient_norm": norm.item(),
            "left_out": self.left_out,
            "value_error": error,
            "weight" if self.spread else "deviation": own.exp().mean().item(),
        }

    def keep(self, updates: int) -> None:
        """Take the actor's weights into an average over so many updates; 0: they are kept as they
        are.
        """
        if updates:
            for kept, new in zip(self.policy.parameters(), self.actor.parameters(), strict=True):
                kept.data.lerp_(new.data, 1 / updates)
            self.policy.statistics.load_state_dict(self.actor.statistics.state_dict())

    def imitate(self, lesson: Imitation) -> dict[str, float]:
        """An iteration that is a lesson."""
        with torch.no_grad():
            _, data = self.window(lesson)
        error = lesson.learn(self.generator)
        self.keep(min(self.arguments.average, 1))
        return {"imitation_error": error, "value_error": self.learn_values(data)}

    def learn_values(self, data: dict[str, Tensor]) -> float:
        """Fit the critic to the window's targets; returns the mean squared error of the last
        minibatch.
        """
        a = self.arguments
        features, target = (x.flatten(0, 1) for x in self.targets(data))
        for _ in range(a.critic_epochs):
            order = torch.randperm(self.batch, generator=self.generator)
            for rows in order.chunk(a.critic_minibatches):
                error = (self.critic(features[rows]) - target[rows]).square().mean(1).sum()
                self.critic_optimizer.zero_grad()
                error.backward()
                nn.utils.clip_grad_norm_(self.critic.parameters(), a.gradient_norm)
                self.critic_optimizer.step()
        with torch.no_grad():
            for old, new in zip(self.target.parameters(), self.critic.parameters(), strict=True):
                old.lerp_(new, 1 - a.target)
        return error.item()

    def state_dict(self) -> dict[str, Any]:
        return {
            **{name: getattr(self, name).state_dict() for name in self._PARTS},
            "left_out": self.left_out,
            "steps": self.steps,
            "memory": self.memory,
            "log_weight": self.log_weight.detach(),
            "generator": self.generator.get_state(),
            "environment": environment_state(self.env),
            "imitation": self.imitation and self.imitation.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        for name in self._PARTS:
            getattr(self, name).load_state_dict(state[name])
        self.generator.set_state(state["generator"])
        self.left_out, self.steps = state["left_out"], state["steps"]
        self.memory = state["memory"]
        self.log_weight.data.copy_(state["log_weight"])
        restore_environment(self.env, state["environment"])
        if self.imitation is not None:
            self.imitation.load_state_dict(state["imitation"])

    _PARTS = ("policy", "actor", "spread", "critic", "target", "optimizer", "critic_optimizer")


if __name__ == "__main__":
    raise SystemExit(main(None, Arguments, SHAC, TUNED))
