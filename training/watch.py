"""Watch over a run: its budget, validation episodes, log and progress bar."""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gymnasium.vector import VectorEnv

from torchbeam.extend.commands import csv_text, write

from .evaluate import Controller, evaluate, make, scores
from .tuned import VALIDATION, Task

# of a budget, when the policy is validated, and once before: evenly, and closer together at first,
# where it learns most, and where runs of a smaller budget end with which it is compared
SHARES = (1 / 160, 1 / 80, 1 / 40, *(k / 20 for k in range(1, 21)))
VALIDATIONS = 64  # episodes of a validation


@dataclass(frozen=True)
class Budget:
    """When a run ends: at so many environment steps, or CPU minutes of training, whichever comes
    first (None: no such limit).
    """

    steps: int | None = 1_000_000
    minutes: float | None = None

    def done(self, steps: int, seconds: float) -> float:
        """The share that is used up, 0 to 1. With `minutes` it depends on the machine, and so do
        schedules and results.
        """
        by_steps = 0.0 if self.steps is None else steps / self.steps
        return min(
            1.0, max(by_steps, 0.0 if self.minutes is None else seconds / (60 * self.minutes))
        )


def is_due(before: float, now: float) -> bool:
    """Whether one of `SHARES` has been reached since."""
    return any(before < share <= now for share in SHARES)


def validation(task: Task, controller: Controller, env: VectorEnv) -> dict[str, float]:
    """The scores that go into the log, and choose the policy; env from `evaluate.make`."""
    found = evaluate(task, controller, env.num_envs, VALIDATION, env)
    return {f"validation_{name}": found[name] for name in ("return", "success", "final_error")}


@dataclass(frozen=True)
class Best:
    """The policy of the best validation so far: its return, the environment steps it has learned
    from, and whatever gives it back.
    """

    score: float = -math.inf
    steps: int = 0
    policy: Any = None

    def after(self, found: dict[str, float], steps: int, snapshot: Callable[[], Any]) -> Best:
        """The better of this and a policy with `validation` scores."""
        score = found["validation_return"]
        return Best(score, steps, snapshot()) if score > self.score else self


class Watch:
    """Of a learner that has a loop of its own: scores its policy as `train` does, in a log, keeps
    the best, and says when the budget is used up. What that takes is not in `seconds`, CPU time.

    snapshot    () -> whatever gives the policy as it is now back, of its own
    """

    def __init__(
        self,
        task: Task,
        controller: Controller,
        log: Log,
        budget: Budget,
        bar: Bar,
        snapshot: Callable[[], Any],
        *,
        episodes: int = VALIDATIONS,
    ) -> None:
        self.task, self.controller, self.log, self.budget = task, controller, log, budget
        self.bar, self.snapshot = bar, snapshot
        self.judge = make(task, episodes)
        self.steps, self.seconds = 0, 0.0
        self.best = Best()

    def begin(self) -> None:
        self.log.rewind(0)
        self._score()
        self.start = time.process_time()

    def goes_on(self, steps: int) -> bool:
        """To be called after each step of the vector env; `steps` environment steps were taken."""
        now, before = time.process_time(), self.budget.done(self.steps, self.seconds)
        self.steps, self.seconds, self.start = steps, self.seconds + now - self.start, now
        done = self.budget.done(steps, self.seconds)
        if is_due(before, done):
            self._score()
            self.start = time.process_time()
        self.bar.to(done)
        return done < 1

    def result(self, restore: Callable[[Any], None], final: int) -> dict[str, Any]:
        """What `train` returns, of `final` held-out episodes; `restore` takes the best snapshot
        back.
        """
        last = evaluate(self.task, self.controller, final)["return"]
        restore(self.best.policy)
        return {
            "steps": self.steps,
            "seconds": self.seconds,
            "chosen_steps": self.best.steps,
            "last_return": last,
            **scores(self.task, self.controller, final),
        }

    def _score(self) -> None:
        found = validation(self.task, self.controller, self.judge)
        self.best = self.best.after(found, self.steps, self.snapshot)
        self.log.write({"steps": self.steps, "seconds": self.seconds, **found})
        self.bar.say(f"return {found['validation_return']:.1f}")


class Log:
    """A CSV file, a row at a time; columns are those of the first full row, missing values stay
    empty.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.rows = path, 0

    def rewind(self, rows: int) -> None:
        """Keep the first `rows` rows: what a run that was stopped has logged after its checkpoint
        is made again.
        """
        kept = self._read()[:rows] if rows else []
        self._write(kept)

    def write(self, row: dict[str, Any]) -> None:
        self._write([*self._read(), row])

    def _read(self) -> list[dict[str, Any]]:
        if not self.path.exists():
            return []
        with open(self.path, newline="") as file:
            return list(csv.DictReader(file))

    def _write(self, rows: list[dict[str, Any]]) -> None:
        names = list(dict.fromkeys(name for row in rows for name in row))
        write(
            self.path, csv_text([names, *([row.get(name, "") for name in names] for row in rows)])
        )
        self.rows = len(rows)


class Bar:
    """A tqdm bar in per cent of the budget where tqdm is installed and wanted; silent otherwise."""

    def __init__(self, name: str, wanted: bool) -> None:
        self.bar = None
        if wanted:
            try:
                from tqdm import tqdm
            except ImportError:
                return
            self.bar = tqdm(
                total=100.0,
                desc=name,
                bar_format="{desc}: {percentage:3.0f} %|{bar}| {elapsed} {postfix}",
            )

    def __enter__(self) -> Bar:
        return self

    def __exit__(self, *_: Any) -> None:
        if self.bar is not None:
            self.bar.close()

    def to(self, done: float) -> None:
        if self.bar is not None:
            self.bar.update(100 * done - self.bar.n)

    def say(self, text: str) -> None:
        if self.bar is not None:
            self.bar.set_postfix_str(text)
