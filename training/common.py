"""What the learners share: the loop around `Learner.iteration` with its log, checkpoints and
scores, and the command line.
"""

from __future__ import annotations

import argparse
import ast
import copy
import inspect
import textwrap
import time
from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol, get_type_hints

import torch
from gymnasium.vector import VectorEnv

from torchbeam.extend.commands import folder as writable_folder
from torchbeam.extend.commands import results_folder
from torchbeam.extend.commands import save as save_file

from .evaluate import EPISODES, evaluate, make, scores
from .options import add_budget, add_task
from .policies import Policy, is_plain, read, save
from .tuned import FEW, TASKS, TRAINING, VALIDATION, Task, budget
from .watch import VALIDATIONS, Bar, Best, Budget, Log, is_due, validation

APART = 10_000  # seeds of episodes from one run to the next
# of a checkpoint
KEYS = ("settings", "learner", "iteration", "steps", "seconds", "rows", "best")


class Learner(Protocol):
    """What `train` drives. Everything random comes from the generators in its state."""

    arguments: Any
    """a dataclass of its settings"""
    policy: Policy
    batch: int
    """environment steps that one iteration takes"""

    def iteration(self, done: float) -> dict[str, float]:
        """Collect, learn, and say how it went; `done` is the share of the budget that is used up
        (for schedules).
        """

    def state_dict(self) -> dict[str, Any]: ...

    def load_state_dict(self, state: dict[str, Any]) -> None: ...


def train(
    learner: Learner,
    task: Task,
    folder: str | Path,
    budget: Budget,
    *,
    name: str = "run",
    episodes: int | None = None,
    final: int | None = None,
    progress: bool = True,
) -> dict[str, Any]:
    """Iterate until the budget is used up; writes NAME.csv (log), NAME.pt (policy) and, meanwhile,
    NAME.checkpoint.

    A run whose checkpoint is there, of the same task, settings and budget, goes on from it. With a
    budget of steps alone, it then ends in the same bits as a run that was never stopped. When
    `watch.SHARES` of the budget are used up, the policy is scored on `episodes` validation episodes
    (None: `VALIDATIONS`, or `tuned.FEW`) and a checkpoint is written; the time that takes is not in
    `seconds`, the CPU seconds of this process: what else the machine does is not in them, and those
    of a run that goes on add up. The policy of the best such score is the one that is saved, in
    float64, and scored on `final` held-out episodes (None: `EPISODES`, or `tuned.FEW`), which
    choose nothing: `chosen_steps` says when it was met, `last_return` is that of the last policy.

    Raises ValueError for a folder that cannot be written, and for a checkpoint that is damaged, of
    another release, does not fit the learner, or holds more than tensors and plain data: nothing in
    it is ever run.
    """
    folder, task = writable_folder(folder, parents=True), task.seen(learner.arguments.frames)
    checkpoint, log = folder / f"{name}.checkpoint", Log(folder / f"{name}.csv")
    episodes = FEW.get(task.name, VALIDATIONS) if episodes is None else episodes
    final, judge = FEW.get(task.name, EPISODES) if final is None else final, make(task, episodes)
    iteration, steps, seconds, best = 0, 0, 0.0, Best()
    settings = {**vars(learner.arguments), "budget": vars(budget), "task": repr(task)}

    def weights() -> dict[str, Any]:
        return copy.deepcopy(learner.policy.state_dict())

    state = read(checkpoint, "checkpoint", KEYS) if checkpoint.exists() else None
    if state is not None and state["settings"] == settings:
        try:
            learner.load_state_dict(state["learner"])
            iteration, steps = int(state["iteration"]), int(state["steps"])
            seconds, best = float(state["seconds"]), Best(**state["best"])
            log.rewind(int(state["rows"]))
        except (KeyError, TypeError, ValueError, AttributeError, RuntimeError, IndexError):
            raise ValueError(
                f"the checkpoint {str(checkpoint)!r} was given, which does not fit this learner; "
                "the run starts anew where it is removed"
            ) from None
    else:
        log.rewind(0)
        found = validation(task, learner.policy, judge)
        best = best.after(found, 0, weights)
        log.write({"iteration": 0, "steps": 0, "seconds": 0.0, **found})
    with Bar(name, progress) as bar:
        while (done := budget.done(steps, seconds)) < 1:
            start = time.process_time()
            figures = learner.iteration(done)
            seconds += time.process_time() - start
            iteration, steps = iteration + 1, steps + learner.batch
            over = budget.done(steps, seconds)
            if is_due(done, over):
                found = validation(task, learner.policy, judge)
                best = best.after(found, steps, weights)
                log.write(
                    {"iteration": iteration, "steps": steps, "seconds": seconds, **found, **figures}
                )
                save_file(
                    checkpoint,
                    {
                        "settings": settings,
                        "learner": learner.state_dict(),
                        "iteration": iteration,
                        "steps": steps,
                        "seconds": seconds,
                        "rows": log.rows,
                        "best": vars(best),
                    },
                )
                bar.say(f"return {found['validation_return']:.1f}")
            bar.to(over)
    learner.policy.double()  # scores are the same then, to 1e-9, on whatever machine
    last = evaluate(task, learner.policy, final)["return"]
    learner.policy.load_state_dict(best.policy)
    result = {
        "steps": steps,
        "seconds": seconds,
        "iterations": iteration,
        "chosen_steps": best.steps,
        "last_return": last,
        **scores(task, learner.policy, final),
    }
    about = {"task" if key == "name" else key: value for key, value in vars(task).items()}
    if not is_plain(task.arguments):  # with which the file could not be read
        about["arguments"] = repr(task.arguments)
    about["frames"] = learner.arguments.frames
    save(learner.policy, folder / f"{name}.pt", **about, scores=result)
    checkpoint.unlink(missing_ok=True)
    return result


def environment_state(env: VectorEnv) -> dict[str, Any]:
    """Where the episodes of a `BeamVectorEnv` and its streams of random numbers stand, as tensors
    and plain data. The env goes on as one that is restored: what its steppers keep beside the
    states (the angles of a plane, which pairs of elements are near each other) is made anew, as by
    other pairs, which do not touch, a step rounds in another way.
    """
    env.detach()
    now = {
        name: vars(value) if is_dataclass(value) else value
        for name, value in vars(env.state).items()
    }
    params = {
        name: value.detach() for name, value in now.pop("plant")["params"].items() if value.ndim
    }
    state = {
        "episodes": now,
        "params": params,
        "streams": [stream.bit_generator.state for stream in env.np_random],
    }
    restore_environment(env, state)
    return state


def restore_environment(env: VectorEnv, state: dict[str, Any]) -> Any:
    """Go on from there; returns the observation."""
    env.reset(seed=0, options={"params": state["params"]} if state["params"] else None)
    for stream, at in zip(env.np_random, state["streams"], strict=True):
        stream.bit_generator.state = at
    now = {
        name: replace(own, **value) if is_dataclass(own := getattr(env.state, name)) else value
        for name, value in state["episodes"].items()
    }
    return env.set_state(replace(env.state, **now))


def training_seed(seed: int) -> int:
    """First of the seeds of the episodes that run number `seed` of a learner starts with.

    Raises ValueError for a number whose episodes would be those of validations.
    """
    most = (VALIDATION - TRAINING) // APART
    if not 0 <= seed < most:
        raise ValueError(f"the seed {seed} was given; 0 to {most - 1} are wanted")
    return TRAINING + APART * seed


def main(
    argv: Sequence[str] | None, arguments: type, learner: Any, tuned: dict[str, dict[str, Any]]
) -> int:
    """Train one policy from the command line: an option for each field of the dataclass
    `arguments`, and those of the run.
    """
    parser = argparse.ArgumentParser(
        prog=f"python -m training.{learner.NAME}",
        description=inspect.getdoc(learner),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_task(parser)
    add_budget(parser)
    parser.add_argument(
        "--out",
        default="out/training",
        help="folder for log, policy and checkpoint (default: %(default)s)",
    )
    texts, types = documented(arguments), get_type_hints(arguments)
    for one in fields(arguments):
        kind = types[one.name] if types[one.name] in (int, float, str) else ast.literal_eval
        parser.add_argument(
            f"--{one.name.replace('_', '-')}",
            type=kind,
            help=f"{texts.get(one.name, '')} ({one.default})",
        )
    given = vars(parser.parse_args(argv))
    task = given["task"]
    own = {one.name: given[one.name] for one in fields(arguments) if given[one.name] is not None}
    torch.set_num_threads(1)
    known = tuned.get(task.name, {}) if TASKS.get(task.name) is task else {}
    settings = arguments(**{**known, **own})
    name = f"{task.name}-{learner.NAME}-{settings.seed}"
    folder = results_folder(parser, given["out"])
    try:
        ends = budget_given(given, learner.NAME, task)
        print(told(train(learner(task, settings), task, folder, ends, name=name)))
    except ValueError as error:
        parser.error(str(error))
    print(f"policy: {folder / name}.pt, log: {folder / name}.csv")
    return 0


def budget_given(given: dict[str, Any], algorithm: str, task: Task) -> Budget:
    steps, minutes = given["budget"], given["minutes"]
    if steps is None and minutes is None:
        steps = budget(algorithm, task.name)
    return Budget(steps, minutes)


def told(result: dict[str, Any]) -> str:
    """A line of what `train` returns."""
    flat = {key: value for key, value in result.items() if not isinstance(value, dict | None)}
    if result.get("outside"):
        flat["outside_return"] = result["outside"]["return"]
    return "  ".join(f"{key} {value:.4g}" for key, value in flat.items())


def documented(arguments: type) -> dict[str, str]:
    """The docstring under each field of a dataclass, by field."""
    body = ast.parse(textwrap.dedent(inspect.getsource(arguments))).body[0].body
    return {
        a.target.id: " ".join(b.value.value.split())
        for a, b in pairwise(body)
        if isinstance(a, ast.AnnAssign)
        and isinstance(b, ast.Expr)
        and isinstance(b.value, ast.Constant)
    }
