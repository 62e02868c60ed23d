"""Reset times: what fresh episodes of uncertain plants cost, and stable-baselines3's interface,
beside a step.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from itertools import groupby
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from torchbeam.extend.commands import table

from .uncertain import UNCERTAIN

BATCHES = (8, 64, 256)
SHARE = 8  # a few are one of so many
STEPS = 5  # between resets
LONG = 10**6  # of an episode: none ends by itself


class ResetTimes(NamedTuple):
    """One line of the table: medians of the time that the thread had the processor (s), taken in
    turns.
    """

    id: str
    batch: int
    step: float
    reset: float  # of all, with what the next step takes longer
    few: float  # of an eighth of them, likewise
    adapter: float | None  # a step through `Sb3VecEnv`; None where that is not installed


FIELDS = (
    "task, uncertain",
    f"step of {', '.join(map(str, BATCHES))}, ms",
    "reset of all, steps",
    "of an eighth, steps",
    "step of Sb3VecEnv, steps",
)
COLUMNS = (  # of the CSV, as measured
    "task, uncertain",
    "batch",
    "step, s",
    "reset of all, s",
    "of an eighth, s",
    "step of Sb3VecEnv, s",
)


def measure(id: str, batch: int, rounds: int, **arguments: Any) -> ResetTimes:
    """Of a task at its uncertain level, under random actions."""
    task = id.split("/")[1].split("-")[0].removesuffix("Planar")
    arguments = {**UNCERTAIN[task], "max_episode_steps": LONG, **arguments}
    env = gymnasium.make_vec(id, num_envs=batch, autoreset_mode="Disabled", **arguments)
    adapter = _adapter(id, batch, arguments)
    few = {"reset_mask": np.arange(batch) < max(1, batch // SHARE)}
    random = np.random.default_rng(0)

    def action() -> np.ndarray:
        return random.uniform(-1, 1, env.action_space.shape).astype(np.float32)

    def stepped(whole: Any) -> float:
        given = action()
        return _timed(lambda: whole.step(given))

    env.reset(seed=0)
    times: dict[str, list[float]] = {name: [] for name in ("step", "reset", "few", "adapter")}
    for _ in range(rounds + 1):
        steps = [stepped(env) for _ in range(STEPS)]
        times["reset"].append(_timed(env.reset) + stepped(env))
        steps += [stepped(env) for _ in range(STEPS)]
        times["few"].append(_timed(lambda: env.reset(options=few)) + stepped(env))
        times["step"] += steps[:1] if not times["step"] else steps
        if adapter is not None:
            adapter.reset()  # no episode ends in so few steps
            times["adapter"] += [stepped(adapter) for _ in range(2 * STEPS)]
    env.close()
    # the first round compiles, and fills caches
    step = float(np.median(times["step"][1:]))
    reset, part = (float(np.median(times[name][1:])) - step for name in ("reset", "few"))
    own = None if adapter is None else float(np.median(times["adapter"][2 * STEPS :]))
    return ResetTimes(id, batch, step, reset, part, own)


def _adapter(id: str, batch: int, arguments: dict[str, Any]) -> Any:
    try:
        from .sb3 import Sb3VecEnv
    except ImportError:
        return None
    env = Sb3VecEnv(gymnasium.make_vec(id, batch, autoreset_mode="SameStep", **arguments))
    env.seed(0)
    return env


def _timed(call: Callable[[], Any]) -> float:
    start = time.thread_time()
    call()
    return time.thread_time() - start


def rows(ids: Iterable[str], rounds: int) -> Iterator[ResetTimes]:
    for id in ids:
        for batch in BATCHES:
            yield measure(id, batch, rounds)


def markdown(rows: Iterable[ResetTimes]) -> str:
    """A line for each task, with its batches side by side."""
    lines = []
    for id, group in groupby(rows, lambda r: r.id):
        own = [*group]
        columns = [[f"{1e3 * r.step:.2g}" for r in own]]
        for name in ("reset", "few", "adapter"):
            each = [getattr(r, name) and getattr(r, name) / r.step for r in own]
            columns.append(["" if x is None else f"{x:.2f}" for x in each])
        lines.append((id, *(", ".join(filter(None, column)) for column in columns)))
    return table(FIELDS, lines, words=1)
