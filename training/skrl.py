"""skrl's PPO on the vector environments as they are, through its own wrapper (extra `rl`).

python -m training.skrl --task reach --budget 200000
"""

from __future__ import annotations

import argparse
import copy
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import skrl
import torch
from skrl.agents.torch.ppo import PPO
from skrl.envs.wrappers.torch import Wrapper, wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.resources.preprocessors.torch import RunningStandardScaler
from skrl.trainers.torch import SequentialTrainer
from torch import Tensor, nn

from torchbeam.extend.commands import folder as writable_folder
from torchbeam.extend.commands import results_folder

from .common import budget_given, told, training_seed
from .evaluate import EPISODES
from .options import add_budget, add_task
from .tuned import SKRL as TUNED
from .tuned import Task, frames
from .watch import VALIDATIONS, Bar, Budget, Log, Watch


class Policy(GaussianMixin, Model):
    """A normal distribution of actions, of one deviation each."""

    def __init__(self, env: Wrapper, hidden: int, log_deviation: float) -> None:
        Model.__init__(self, observation_space=env.observation_space, action_space=env.action_space)
        GaussianMixin.__init__(self)
        self.network = layers(self.num_observations, hidden, self.num_actions)
        start = torch.full((self.num_actions,), log_deviation, dtype=torch.float32)
        self.log_deviation = nn.Parameter(start)

    def compute(self, inputs: dict[str, Any], role: str = "") -> tuple[Tensor, dict[str, Any]]:
        return self.network(inputs["observations"]), {"log_std": self.log_deviation}


class Value(DeterministicMixin, Model):
    def __init__(self, env: Wrapper, hidden: int) -> None:
        Model.__init__(self, observation_space=env.observation_space, action_space=env.action_space)
        DeterministicMixin.__init__(self)
        self.network = layers(self.num_observations, hidden, 1)

    def compute(self, inputs: dict[str, Any], role: str = "") -> tuple[Tensor, dict[str, Any]]:
        return self.network(inputs["observations"]), {}


def layers(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(inputs, hidden),
        nn.Tanh(),
        nn.Linear(hidden, hidden),
        nn.Tanh(),
        nn.Linear(hidden, outputs),
    ).float()


class Over(Exception):
    """The budget is used up."""


class Watched(PPO):
    """With a watch that looks on after each step of the vector env. An episode that the time limit
    ends is valued by its own last observation, not by the first of the next one, which is what skrl
    sees of an env that resets in the same step.
    """

    watch: Watch

    def record_transition(
        self, *, next_observations: Tensor, truncated: Tensor, infos: dict[str, Any], **rest: Any
    ) -> None:
        last = next_observations
        if "final_obs" in infos:
            final = torch.as_tensor(infos["final_obs"], dtype=last.dtype)
            last = torch.where(truncated, final, last)
        super().record_transition(next_observations=last, truncated=truncated, infos=infos, **rest)

    def post_interaction(self, *, timestep: int, timesteps: int) -> None:
        super().post_interaction(timestep=timestep, timesteps=timesteps)
        if not self.watch.goes_on((timestep + 1) * self.memory.num_envs):
            raise Over


class Greedy:
    """An agent as a controller: observation (n, o) -> the most likely action (n, a)."""

    def __init__(self, agent: PPO) -> None:
        self.agent = agent

    def __call__(self, observation: Tensor) -> Tensor:
        seen = self.agent.checkpoint_modules["observation_preprocessor"](observation.float())
        return self.agent.policy.network(seen).double().clamp(-1, 1)


def make(task: Task, seed: int, folder: str | Path, **settings: Any) -> tuple[Watched, Wrapper]:
    """The agent and its env; whatever skrl may write of itself goes into the folder."""
    settings = {**TUNED, **settings}
    skrl.config.torch.key = training_seed(seed)  # the wrapper's first reset is by it
    env = wrap_env(task.make(settings.pop("num_envs")), wrapper="gymnasium", verbose=False)
    torch.manual_seed(seed)  # skrl has no generator of its own
    hidden = settings.pop("hidden")
    models = {
        "policy": Policy(env, hidden, settings.pop("log_deviation")),
        "value": Value(env, hidden),
    }
    scaler = {"observation": env.observation_space, "value": 1}
    settings |= {f"{name}_preprocessor": RunningStandardScaler for name in scaler}
    settings |= {f"{name}_preprocessor_kwargs": {"size": of} for name, of in scaler.items()}
    silent = {"write_interval": 0, "checkpoint_interval": 0, "directory": str(folder)}
    agent = Watched(
        models=models,
        memory=RandomMemory(memory_size=settings["rollouts"], num_envs=env.num_envs),
        observation_space=env.observation_space,
        action_space=env.action_space,
        cfg={**settings, "experiment": silent},
    )
    return agent, env


def learn(agent: Watched, env: Wrapper) -> None:
    """As long as the agent's watch goes on."""
    loop = dict(timesteps=10**9, disable_progressbar=True, close_environment_at_exit=False)
    trainer = SequentialTrainer(env=env, agents=agent, cfg={**loop, "headless": True})
    agent.watch.begin()
    try:
        trainer.train()
    except Over:
        pass


def train(
    task: Task,
    folder: str | Path,
    budget: Budget,
    *,
    seed: int = 0,
    name: str = "run",
    episodes: int = VALIDATIONS,
    final: int = EPISODES,
    progress: bool = True,
    frames: int = 0,
    **settings: Any,
) -> dict[str, Any]:
    """As `training.common.train`, but without checkpoints: writes NAME.csv and the agent,
    NAME.skrl.
    """
    task = task.seen(frames)
    folder = writable_folder(folder, parents=True)
    with tempfile.TemporaryDirectory() as scratch, Bar(name, progress) as bar:
        agent, env = make(task, seed, scratch, **settings)
        controller = Greedy(agent)

        def snapshot() -> Any:
            modules = agent.checkpoint_modules.items()
            return {key: copy.deepcopy(module.state_dict()) for key, module in modules}

        def restore(kept: Any) -> None:
            for key, state in kept.items():
                agent.checkpoint_modules[key].load_state_dict(state)

        log = Log(folder / f"{name}.csv")
        agent.watch = Watch(task, controller, log, budget, bar, snapshot, episodes=episodes)
        learn(agent, env)
    result = agent.watch.result(restore, final)
    agent.save(str(folder / f"{name}.skrl"))
    return result


def main(argv: Sequence[str] | None = None) -> int:
    """Train one policy with skrl's PPO."""
    parser = argparse.ArgumentParser(prog="python -m training.skrl", description=main.__doc__)
    add_task(parser)
    parser.add_argument("--seed", type=int, default=0, help="default: %(default)s")
    add_budget(parser)
    parser.add_argument(
        "--out", default="out/training", help="folder for log and agent (default: %(default)s)"
    )
    options = parser.parse_args(argv)
    torch.set_num_threads(1)
    folder = results_folder(parser, options.out)
    name = f"{options.task.name}-skrl-ppo-{options.seed}"
    budget = budget_given(vars(options), "skrl-ppo", options.task)
    seen = frames(options.task.name)
    print(told(train(options.task, folder, budget, seed=options.seed, name=name, frames=seen)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
