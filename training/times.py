"""Where the time of learning goes, learner by learner: stepping the simulation, the way back
through it, networks and their updates, the rest. CPU time on one thread.

    python -m training.times --out out/times
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor
from torch.nn.modules import module as modules
from torch.optim import optimizer as optimizers
from torchbeam_envs import BeamVectorEnv

from torchbeam.extend.commands import measured_on, results_folder, sentence, table, write_results

from .options import above_zero
from .results import LEARNERS, LIBRARIES
from .table import LABELS
from .tuned import TASKS, Task, task_named

PARTS = {
    "forward": "stepping the simulation",
    "backward": "the way back through it",
    "networks": "networks and updates",
    "rest": "the rest",
}
WARM = 4_000  # environment steps before the clock runs: SAC's first updates are among them


class Clock:
    """CPU seconds by part of `PARTS`; of parts within each other the innermost counts."""

    def __init__(self) -> None:
        self.inside = ["rest"]
        self.restart()

    def restart(self) -> None:
        self.seconds = dict.fromkeys(PARTS, 0.0)
        self.last = time.process_time()

    def _count(self) -> None:
        now = time.process_time()
        self.seconds[self.inside[-1]] += now - self.last
        self.last = now

    def enter(self, part: str) -> None:
        self._count()
        self.inside.append(part)

    def leave(self) -> None:
        self._count()
        self.inside.pop()

    def turn(self, part: str) -> None:
        """Another part in place of the innermost."""
        self._count()
        self.inside[-1] = part

    def during(self, part: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """The function, whose time counts as this part."""

        def timed(*args: Any, **kwargs: Any) -> Any:
            self.enter(part)
            try:
                return call(*args, **kwargs)
            finally:
                self.leave()

        return timed


class Turn(torch.autograd.Function):
    """The tensor itself; on the way back the clock turns to a part."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, clock: Clock, part: str) -> Tensor:
        ctx.clock, ctx.part = clock, part
        return x.view_as(x)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        ctx.clock.turn(ctx.part)
        return gradient, None, None


@contextmanager
def watched(clock: Clock) -> Iterator[None]:
    """All environments, networks, derivatives and optimizers tell the clock."""
    step = BeamVectorEnv.step

    def turned(x: Any, part: str) -> Any:
        return Turn.apply(x, clock, part) if isinstance(x, Tensor) and x.requires_grad else x

    def timed(env: BeamVectorEnv, action: Any) -> tuple:
        clock.enter("forward")
        observation, reward, terminated, truncated, info = step(env, turned(action, "networks"))
        if "final_obs" in info:
            info["final_obs"] = turned(info["final_obs"], "backward")
        after = turned(observation, "backward"), turned(reward, "backward")
        clock.leave()
        return *after, terminated, truncated, info

    def enter(*_: Any) -> None:
        clock.enter("networks")

    def leave(*_: Any) -> None:
        clock.leave()

    hooks = [
        modules.register_module_forward_pre_hook(enter),
        modules.register_module_forward_hook(leave, always_call=True),
        optimizers.register_optimizer_step_pre_hook(enter),
        optimizers.register_optimizer_step_post_hook(leave),
    ]
    derivatives = {
        name: clock.during("networks", getattr(torch.autograd, name))
        for name in ("backward", "grad")
    }
    try:
        with (
            patch.object(BeamVectorEnv, "step", timed),
            patch.multiple(torch.autograd, **derivatives),
        ):
            yield
    finally:
        for hook in hooks:
            hook.remove()


class Watched:
    """As a `watch.Watch`: goes on until so many CPU seconds have been watched."""

    def __init__(self, seconds: float) -> None:
        self.wanted, self.clock, self.first, self.steps = seconds, Clock(), 0, 0

    def begin(self) -> None:
        self.first = 0

    def goes_on(self, steps: int) -> bool:
        if not self.first and steps >= WARM:
            self.first = steps
            self.clock.restart()
        self.steps = steps - self.first
        return not self.first or sum(self.clock.seconds.values()) < self.wanted


def measure(task: Task, algorithm: str, seconds: float) -> dict[str, Any]:
    """A row: microseconds an environment step, and the share of each part; without lessons."""
    watch, steps = Watched(seconds), 0
    with watched(watch.clock), tempfile.TemporaryDirectory() as scratch:
        if algorithm in LEARNERS:
            kind, arguments, tuned = LEARNERS[algorithm]
            settings = {**tuned.get(task.name, {})}
            settings |= {"teacher": ""} if "teacher" in settings else {}
            learner = kind(task, arguments(**settings))
            while watch.goes_on(steps):
                learner.iteration(0.0)
                steps += learner.batch
        elif algorithm.startswith("sb3-"):
            from . import sb3

            model, _ = sb3.make(task, algorithm.removeprefix("sb3-"), 0)
            model.learn(10**9, callback=sb3.Callback(watch))
        else:
            from . import skrl

            agent, env = skrl.make(task, 0, scratch)
            agent.watch = watch
            skrl.learn(agent, env)
    spent = {part: 1e6 * value / watch.steps for part, value in watch.clock.seconds.items()}
    whole = sum(spent.values())
    row = {"task": task.name, "algorithm": algorithm, "steps": watch.steps, "microseconds": whole}
    return row | {part: value / whole for part, value in spent.items()}


def text(content: dict[str, Any]) -> str:
    rows = [
        (
            row["task"],
            LABELS[row["algorithm"]],
            f"{row['microseconds']:.0f}",
            *(f"{100 * row[part]:.0f} %" for part in PARTS),
        )
        for row in content["rows"]
    ]
    head = ("task", "learner", "µs an environment step", *PARTS.values())
    return f"{table(head, rows, words=2)}\n\n{sentence(content)}"


def main(argv: Sequence[str] | None = None) -> int:
    """Measure each learner, and write times.json, times.csv and times.md."""
    parser = argparse.ArgumentParser(
        prog="python -m training.times",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--tasks",
        nargs="+",
        choices=TASKS,
        default=["reach", "reach-uncertain"],
        help="default: %(default)s",
    )
    names = (*(name for name in LEARNERS if name != "student"), *LIBRARIES)  # all of it lessons
    parser.add_argument(
        "--algorithms", nargs="+", choices=names, default=names, help="default: all of them"
    )
    parser.add_argument(
        "--seconds",
        type=above_zero(float),
        default=5.0,
        help="CPU time of each (default: %(default)s)",
    )
    parser.add_argument("--out", default="out/times", help="default: %(default)s")
    options = parser.parse_args(argv)
    out = results_folder(parser, options.out)
    torch.set_num_threads(1)
    rows = [
        measure(task_named(task), algorithm, options.seconds)
        for task in options.tasks
        for algorithm in options.algorithms
    ]
    content = {**measured_on(dtype=None, threads=1), "rows": rows}
    values = (row.values() for row in rows)
    write_results(out, "times", text(content), content, list(rows[0]), values)
    print(text(content))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
