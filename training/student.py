"""A student: a policy that sees what learners see is taught by a controller that sees more, first
in episodes that the controller plays, then in its own (DAgger; Ross, Gordon and Bagnell 2011).

    python -m training.student --task payload-uncertain
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch

from .common import environment_state, main, restore_environment, training_seed
from .imitation import Imitation
from .policies import Policy
from .tuned import STUDENT as TUNED
from .tuned import Task


@dataclass(frozen=True)
class Arguments:
    seed: int = 0
    """of the network, the episodes and what is drawn of them"""
    num_envs: int = 64
    """sub-environments"""
    horizon: int = 25
    """control intervals in a lesson"""
    hidden: tuple[int, ...] = (64, 64)
    """units of the hidden layers"""
    rate: float = 2e-3
    """of Adam at the start; falls to a tenth at the end of the budget"""
    pace: int = 1
    """control intervals of the task in one of its lessons, in as many substeps as there"""
    frames: int = 0
    """observations side by side that are seen at once; 0: as the task has them"""
    memory: int = 64
    """units of a GRU, by which the policy remembers the episode; 0: none"""
    linear: bool = True
    """whether the policy's network has a linear shortcut"""
    teacher: str = "MPC(informed=True)"
    """a controller of `torchbeam_envs.baselines`"""
    lessons: int = 16
    """in which the teacher plays, in fewer and fewer of the sub-environments; in later ones none"""
    updates: int = 40
    """of the policy in a lesson"""


class Student:
    """Asks the teacher what it would do wherever the episodes come to, and is fitted to all that it
    has said so far; with a memory to whole episodes.
    """

    NAME = "student"

    def __init__(self, task: Task, arguments: Arguments) -> None:
        self.arguments = a = arguments
        self.env = _at_pace(task.seen(a.frames), a.pace).make(a.num_envs, output="torch")
        self.batch = a.num_envs * a.horizon
        inputs = self.env.single_observation_space.shape[0]
        actions = self.env.single_action_space.shape[0]
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(a.seed)
            self.policy = Policy(
                (inputs, *a.hidden, actions),
                squash=True,
                activation="elu",
                linear=a.linear,
                memory=a.memory,
            )
        self.generator = torch.Generator().manual_seed(a.seed)
        self.observation = self.env.reset(seed=training_seed(a.seed))[0]
        self.memory = self.policy.blank(a.num_envs)  # of what was before the observation
        self.imitation = Imitation(
            self.env, self.policy, a.teacher, a.lessons, a.updates, lasting=True
        )

    @torch.no_grad()
    def collect(self) -> None:
        """A lesson, as far as the episodes go in it."""
        for _ in range(self.arguments.horizon):
            features, memory = self.policy.see(self.observation, self.memory)
            action = self.policy.act(features).to(self.observation.dtype)
            action = self.imitation.act(self.observation, action)
            self.observation, _, terminated, truncated, _ = self.env.step(action)
            self.memory = torch.where((terminated | truncated)[:, None], 0.0, memory)

    def iteration(self, done: float) -> dict[str, float]:
        self.imitation.rate(self.arguments.rate * (1 - 0.9 * done))
        self.collect()
        return {"imitation_error": self.imitation.learn(self.generator)}

    def state_dict(self) -> dict[str, Any]:
        return {
            "policy": self.policy.state_dict(),
            "generator": self.generator.get_state(),
            "memory": self.memory,
            "environment": environment_state(self.env),
            "imitation": self.imitation.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.policy.load_state_dict(state["policy"])
        self.generator.set_state(state["generator"])
        self.memory = state["memory"]
        self.observation = restore_environment(self.env, state["environment"])
        self.imitation.load_state_dict(state["imitation"])


def _at_pace(task: Task, pace: int) -> Task:
    """The task with intervals as long as so many of its own, in episodes of the same time."""
    if pace == 1:
        return task
    own = task.make(1).unwrapped.config
    most = own.max_episode_steps
    return task.varied(
        control_interval=pace * own.control_interval,
        max_episode_steps=None if most is None else -(-most // pace),
    )


if __name__ == "__main__":
    raise SystemExit(main(None, Arguments, Student, TUNED))
