"""stable-baselines3's PPO and SAC on the vector environments (extra `rl`).

python -m training.sb3 --task reach --algorithm sac --budget 100000
"""

from __future__ import annotations

import argparse
import copy
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize
from torchbeam_envs import Sb3VecEnv

from torchbeam.extend.commands import results_folder

from .common import Bar, Budget, Log, add_task, training_seed, validation
from .evaluate import EPISODES, evaluate
from .evaluate import make as judge
from .tuned import SB3 as TUNED
from .tuned import Task

ALGORITHMS = {"ppo": PPO, "sac": SAC}
DEFAULTS = {  # of all tasks, over those of stable-baselines3
    "ppo": dict(
        num_envs=64,
        n_steps=32,
        batch_size=512,
        n_epochs=8,
        learning_rate=1e-3,
        policy_kwargs={"log_std_init": -0.7},
    ),
    "sac": dict(
        num_envs=32,
        learning_rate=1e-3,
        gradient_steps=8,
        learning_starts=1600,
        buffer_size=500_000,
        batch_size=256,
        policy_kwargs={"net_arch": [64, 64]},
    ),
}


class Greedy:
    """A trained model as a controller: observation (n, o) -> the most likely action (n, a)."""

    def __init__(self, model: BaseAlgorithm, normal: VecNormalize) -> None:
        self.model, self.normal = model, normal

    def __call__(self, observation: torch.Tensor) -> torch.Tensor:
        seen = self.normal.normalize_obs(observation.numpy().astype(np.float32))
        return torch.as_tensor(self.model.predict(seen, deterministic=True)[0]).clamp(-1, 1)


def make(
    task: Task, algorithm: str, seed: int, **settings: Any
) -> tuple[BaseAlgorithm, VecNormalize]:
    """The model, and the normalisation of observations and rewards around its env."""
    settings = {**DEFAULTS[algorithm], **TUNED.get(task.name, {}).get(algorithm, {}), **settings}
    env = Sb3VecEnv(task.make(settings.pop("num_envs")))
    normal = VecNormalize(env, gamma=settings.get("gamma", 0.99))
    model = ALGORITHMS[algorithm]("MlpPolicy", normal, device="cpu", **copy.deepcopy(settings))
    # of numpy and torch too: stable-baselines3 has no generator of its own
    model.set_random_seed(seed)
    normal.seed(training_seed(seed))
    return model, normal


def train(
    task: Task,
    algorithm: str,
    folder: str | Path,
    budget: Budget,
    *,
    seed: int = 0,
    name: str = "run",
    every: float = 15.0,
    episodes: int = 64,
    final: int = EPISODES,
    progress: bool = True,
    **settings: Any,
) -> dict[str, Any]:
    """As `training.common.train`, but without checkpoints: writes NAME.csv and the model, NAME.zip
    and NAME.normal.
    """
    model, normal = make(task, algorithm, seed, **settings)
    folder = Path(folder)
    with Bar(name, progress) as bar:
        watch = Watch(
            task, Greedy(model, normal), Log(folder / f"{name}.csv"), budget, bar, every, episodes
        )
        model.learn(budget.steps or 10**12, callback=watch)
    last = evaluate(task, Greedy(model, normal), final)["return"]
    watch.restore(model, normal)
    model.save(folder / f"{name}.zip")
    normal.save(str(folder / f"{name}.normal"))
    return {
        "steps": watch.num_timesteps,
        "seconds": watch.seconds,
        "chosen_steps": watch.best[1],
        "last_return": last,
        **evaluate(task, Greedy(model, normal), final),
    }


class Watch(BaseCallback):
    """Scores the policy every so many CPU seconds of training, which do not hold that time, keeps
    the best, and ends with the budget.
    """

    def __init__(
        self,
        task: Task,
        controller: Greedy,
        log: Log,
        budget: Budget,
        bar: Bar,
        every: float,
        episodes: int,
    ) -> None:
        super().__init__()
        self.task, self.controller, self.log, self.budget = task, controller, log, budget
        self.bar, self.every, self.judge = bar, every, judge(task, episodes)
        self.seconds, self.next, self.best = 0.0, every, (-math.inf, 0, None)

    def _on_training_start(self) -> None:
        self.log.rewind(0)
        self._score()
        self.start = time.process_time()

    def _on_step(self) -> bool:
        now = time.process_time()
        self.seconds, self.start = self.seconds + now - self.start, now
        done = self.budget.done(self.num_timesteps, self.seconds)
        if self.seconds >= self.next or done >= 1:
            self.next = self.seconds + self.every
            self._score()
            self.start = time.process_time()
        self.bar.to(done)
        return done < 1

    def _score(self) -> None:
        scores = validation(self.task, self.controller, self.judge)
        if scores["validation_return"] > self.best[0]:
            parts = self.model.get_parameters(), self.controller.normal.obs_rms
            self.best = scores["validation_return"], self.num_timesteps, copy.deepcopy(parts)
        self.log.write({"steps": self.num_timesteps, "seconds": self.seconds, **scores})
        self.bar.say(f"return {scores['validation_return']:.1f}")

    def restore(self, model: BaseAlgorithm, normal: VecNormalize) -> None:
        """Back to the policy of the best score."""
        parameters, normal.obs_rms = self.best[2]
        model.set_parameters(parameters)


def main(argv: Sequence[str] | None = None) -> int:
    """Train one policy with stable-baselines3."""
    parser = argparse.ArgumentParser(prog="python -m training.sb3", description=main.__doc__)
    add_task(parser)
    parser.add_argument(
        "--algorithm", choices=ALGORITHMS, default="ppo", help="default: %(default)s"
    )
    parser.add_argument("--seed", type=int, default=0, help="default: %(default)s")
    parser.add_argument(
        "--budget", type=int, default=300_000, help="environment steps (default: %(default)s)"
    )
    parser.add_argument(
        "--minutes", type=float, help="end after so many CPU minutes of training at the latest"
    )
    parser.add_argument(
        "--out", default="out/training", help="folder for log and model (default: %(default)s)"
    )
    options = parser.parse_args(argv)
    torch.set_num_threads(1)
    folder = results_folder(parser, options.out)
    name = f"{options.task.name}-sb3-{options.algorithm}-{options.seed}"
    result = train(
        options.task,
        options.algorithm,
        folder,
        Budget(options.budget, options.minutes),
        seed=options.seed,
        name=name,
    )
    print("  ".join(f"{key} {value:.4g}" for key, value in result.items()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
