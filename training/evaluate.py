"""Scores of a controller on fixed held-out episodes; the same for every learner and baseline.

python -m training.evaluate training/policies/reach-shac.pt
python -m training.evaluate training/policies/reach-uncertain-shac.pt --outside
python -m training.evaluate out/training/lift-ppo-0.pt --task my_tasks:lift    # an env of one's own
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

import gymnasium
import torch
from gymnasium.vector import VectorEnv

from .options import above_zero, add_task
from .policies import load
from .tuned import HELD_OUT, OUTSIDE, TASKS, Task, widened

EPISODES = 256
DISCOUNT = 0.99
Controller = Callable[[torch.Tensor], torch.Tensor]
"""observation (n, o) -> action (n, a); a method `begin(env)`, if it has one, is called after the
reset of the n episodes
"""


def make(task: Task, episodes: int) -> VectorEnv:
    """The env that `evaluate` plays in."""
    return task.make(episodes, output="torch", autoreset_mode="Disabled")


@torch.no_grad()
def evaluate(
    task: Task,
    controller: Controller,
    episodes: int = EPISODES,
    first: int | Sequence[int] = HELD_OUT,
    env: VectorEnv | None = None,
) -> dict[str, float]:
    """One episode each on the seeds first, first + 1, ..., or on those given; env: one from `make`
    with as many, to be used again.

    return           mean of the sum of rewards, and return_deviation over the episodes
    discounted       mean of the sum of rewards by DISCOUNT from the start, and
    discounted_mean  of its mean over all instants that an episode could start at, until its end
    success          share of the episodes whose error stays within the task's tolerance over its
                     last `hold` steps
    final_error      mean error over these steps (m), and final_error_median over the episodes
    within           share of all intervals at whose end the error is within the tolerance, and
                     within_half within half of it: none of those after an early end
    ended            episodes that ended before their time: they are no success, and their error is
                     the last one
    solver_failures  those of them in which a solve failed
    """
    env = make(task, episodes) if env is None else env
    observation, _ = env.reset(seed=first)
    if hasattr(controller, "begin"):
        controller.begin(env)
    lasted = torch.zeros(episodes, dtype=torch.float64)
    within = torch.zeros(2, dtype=torch.float64)
    rewards, errors, failures, over = [], [], 0, torch.zeros(episodes, dtype=torch.bool)
    while not over.all():
        observation, reward, terminated, truncated, info = env.step(controller(observation))
        rewards.append(reward.double())
        lasted, over = lasted + ~over, terminated | truncated
        errors.append(error := info[task.error])
        near = torch.stack((error <= task.tolerance, error <= task.tolerance / 2)) & ~terminated
        within += near.double().mean(-1)
        failures += int(info["solver_failed"].sum())
    total, *discounts = discounted(torch.stack(rewards), lasted)
    last = torch.stack(errors[-task.hold :])
    final = last.mean(0)
    success = (last <= task.tolerance).all(0) & ~terminated
    return {
        "return": total.mean().item(),
        "return_deviation": total.std().item() if episodes > 1 else 0.0,
        "discounted": discounts[0].mean().item(),
        "discounted_mean": discounts[1].mean().item(),
        "success": success.double().mean().item(),
        "final_error": final.mean().item(),
        "final_error_median": final.median().item(),
        "within": within[0].item() / len(errors),
        "within_half": within[1].item() / len(errors),
        "ended": int(terminated.sum()),
        "solver_failures": failures,
        "episodes": episodes,
    }


def discounted(rewards: torch.Tensor, lasted: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Of rewards (T, n), zero after episodes of `lasted` (n,) intervals: their sums (n,), by
    DISCOUNT from the start, and the mean of that from all instants on, each until the end.
    """
    k = torch.arange(len(rewards), dtype=rewards.dtype)[:, None]
    weights = DISCOUNT**k, (1 - DISCOUNT ** (k + 1)) / (1 - DISCOUNT) / lasted
    return rewards.sum(0), *((weight * rewards).sum(0) for weight in weights)


def evaluate_outside(
    task: Task, controller: Controller, episodes: int = EPISODES
) -> dict[str, float] | None:
    """`evaluate` on plants `outside` of the training range; None where the task draws nothing of
    these.
    """
    found = outside(task, episodes)
    if found is None:
        return None
    wide, env, seeds = found
    return evaluate(wide, controller, episodes, seeds, env)


def outside(task: Task, episodes: int) -> tuple[Task, VectorEnv, list[int]] | None:
    """The task with plants outside of its own range: drawn from the ranges of `tuned.WIDER`, each
    of them in at least one number beyond what the task draws; its env, and the first seeds of
    `tuned.OUTSIDE` on that give such a plant. None where the task draws nothing of these.
    """
    wide = widened(task)
    if wide is None:
        return None
    env = make(wide, episodes)
    return wide, env, seeds_beyond(task, env, episodes)


def seeds_beyond(task: Task, env: VectorEnv, count: int) -> list[int]:
    """The first seeds on that give an env of wider ranges a plant beyond those of the task."""
    seeds: list[int] = []
    start = OUTSIDE
    while len(seeds) < count:
        env.reset(seed=start)
        beyond = torch.zeros(env.num_envs, dtype=torch.bool)
        for name, (low, high) in task.arguments["randomize"].items():
            value = env.state.plant.params[name]
            beyond |= (value < low) | (value > high)
        seeds += [start + k for k in beyond.nonzero()[:, 0].tolist()]
        start += env.num_envs
    return seeds[:count]


def scores(task: Task, controller: Controller, episodes: int = EPISODES) -> dict[str, Any]:
    """Of the held-out episodes; `outside` has those of plants outside of the training range."""
    inside = evaluate(task, controller, episodes)
    return {**inside, "outside": evaluate_outside(task, controller, episodes)}


def main(argv: Sequence[str] | None = None) -> int:
    """Score saved policies on the held-out episodes of the task they were trained for."""
    parser = argparse.ArgumentParser(prog="python -m training.evaluate", description=main.__doc__)
    parser.add_argument("policy", nargs="+", help="files that a learner has written")
    parser.add_argument(
        "--episodes",
        type=above_zero(int),
        default=EPISODES,
        help="held-out episodes (default: %(default)s)",
    )
    parser.add_argument(
        "--outside",
        action="store_true",
        help="on plants outside of the range that it was trained on, of a policy for plants that "
        "are uncertain",
    )
    add_task(parser, default=None, instead="what the file says")
    options = parser.parse_args(argv)
    torch.set_num_threads(1)
    try:
        loaded = [
            (path, policy := load(path), _task(path, policy.about, options.task))
            for path in options.policy
        ]
        for path, _, task in loaded if options.outside else ():
            if widened(task) is None:
                raise ValueError(
                    f"--outside and {path!r} were given; a policy of a task whose plants are "
                    "uncertain is wanted"
                )
    except ValueError as error:
        parser.error(str(error))
    judge = evaluate_outside if options.outside else evaluate
    for path, policy, task in loaded:
        print(json.dumps({"policy": path, **judge(task, policy, options.episodes)}, indent=2))
    return 0


def _task(path: str, about: Any, named: Task | None) -> Task:
    """What a policy was trained for, as its file has it, in an environment of `torchbeam_envs`:
    nothing that a file names is imported. Where a task is named, that one, with the frames that the
    policy sees.
    """
    if named is not None:
        return named.seen(_frames(about))
    try:
        task = Task(about["task"], *(about[field.name] for field in fields(Task)[1:]))
        known = gymnasium.registry[task.env].namespace == "torchbeam"
    except (KeyError, TypeError):
        known = False
    if not known:
        raise ValueError(
            f"the policy {path!r} was given, which names no environment of this release: --task "
            f"is wanted too, one of {', '.join(TASKS)}, or MODULE:NAME"
        )
    if not isinstance(task.arguments, dict):
        raise ValueError(
            f"the policy {path!r} was given, whose task holds more than plain data: --task "
            "MODULE:NAME is wanted too"
        )
    return task


def _frames(about: Any) -> int:
    """Observations side by side that a policy sees, 0: as the task has them. Files of before have
    them among the arguments of the environment alone.
    """
    about = about if isinstance(about, dict) else {}
    arguments = about.get("arguments")
    old = arguments.get("frames", 0) if isinstance(arguments, dict) else 0
    frames = about.get("frames", old)
    return frames if type(frames) is int and frames > 0 else 0


if __name__ == "__main__":
    raise SystemExit(main())
