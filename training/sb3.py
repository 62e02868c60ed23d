"""stable-baselines3's PPO and SAC on the vector environments (extra `rl`).

python -m training.sb3 --task reach --algorithm sac --budget 100000
"""

from __future__ import annotations

import argparse
import copy
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

from torchbeam.extend.commands import folder as writable_folder
from torchbeam.extend.commands import results_folder

from .common import budget_given, told, training_seed
from .evaluate import EPISODES
from .options import add_budget, add_task
from .tuned import SB3 as TUNED
from .tuned import Task, frames
from .watch import VALIDATIONS, Bar, Budget, Log, Watch

ALGORITHMS = {"ppo": PPO, "sac": SAC}


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
    settings = {**TUNED[algorithm], **settings}
    env = Sb3VecEnv(task.make(settings.pop("num_envs")))
    normal = VecNormalize(env, gamma=settings.get("gamma", 0.99))
    # the seed is also of numpy and torch: stable-baselines3 has no generator of its own
    settings = {"device": "cpu", "seed": seed, **copy.deepcopy(settings)}
    model = ALGORITHMS[algorithm]("MlpPolicy", normal, **settings)
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
    episodes: int = VALIDATIONS,
    final: int = EPISODES,
    progress: bool = True,
    frames: int = 0,
    **settings: Any,
) -> dict[str, Any]:
    """As `training.common.train`, but without checkpoints: writes NAME.csv and the model, NAME.zip
    and NAME.normal.
    """
    task = task.seen(frames)
    model, normal = make(task, algorithm, seed, **settings)
    folder, controller = writable_folder(folder, parents=True), Greedy(model, normal)

    def snapshot() -> Any:
        return copy.deepcopy((model.get_parameters(), normal.obs_rms))

    def restore(kept: Any) -> None:
        parameters, normal.obs_rms = kept
        model.set_parameters(parameters)

    with Bar(name, progress) as bar:
        log = Log(folder / f"{name}.csv")
        watch = Watch(task, controller, log, budget, bar, snapshot, episodes=episodes)
        model.learn(budget.steps or 10**12, callback=Callback(watch))
    result = watch.result(restore, final)
    model.save(folder / f"{name}.zip")
    normal.save(str(folder / f"{name}.normal"))
    return result


class Callback(BaseCallback):
    """A watch, as stable-baselines3 asks."""

    def __init__(self, watch: Watch) -> None:
        super().__init__()
        self.watch = watch

    def _on_training_start(self) -> None:
        self.watch.begin()

    def _on_step(self) -> bool:
        return self.watch.goes_on(self.num_timesteps)


def main(argv: Sequence[str] | None = None) -> int:
    """Train one policy with stable-baselines3."""
    parser = argparse.ArgumentParser(prog="python -m training.sb3", description=main.__doc__)
    add_task(parser)
    parser.add_argument(
        "--algorithm", choices=ALGORITHMS, default="ppo", help="default: %(default)s"
    )
    parser.add_argument("--seed", type=int, default=0, help="default: %(default)s")
    add_budget(parser)
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
        budget_given(vars(options), f"sb3-{options.algorithm}", options.task),
        seed=options.seed,
        name=name,
        frames=frames(options.task.name),
    )
    print(told(result))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
