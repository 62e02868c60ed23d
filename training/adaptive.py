"""What estimation is worth at the uncertain level, and what could be had at most.

python -m training.adaptive --episodes 256 --jobs 2 --out docs/results/adaptive
python -m training.adaptive --episodes 256 --outside --out docs/results/adaptive_outside

By task on the first held-out episodes: MPC by the usual plant, LQR and MPC by what a filter makes
of the readings, MPC that knows the plant but sees it through the readings (the bound), and MPC that
knows and sees all. Outside, plants lie beyond the task's ranges, which is all that filters know of
them. Decision times are those of one training episode, alone: the time that the thread had the
processor, from an observation to its action, and for what is prepared between.

Each batch of episodes writes a file of its own in runs/ when it is complete. Called again, the
command makes what is missing, or was made on another task or by other code, and the table of all.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torchbeam_envs.baselines import LQR, MPC, AdaptiveMPC, Controller, Estimated, JointLQR

from torchbeam.extend.commands import (
    measured_on,
    results_folder,
    sentence,
    table,
    write,
    write_results,
)

from .evaluate import evaluate, make, seeds_beyond
from .options import above_zero
from .results import code, commit, holds, made
from .tuned import HELD_OUT, NOMINAL, TASKS, TRAINING, Task, widened

# of an env and the task's ranges
CONTROLLERS: dict[str, Callable[[Any, Any], Controller]] = {
    "MPC, usual plant": lambda env, _: MPC(env),
    "Estimated(LQR)": lambda env, ranges: Estimated(
        (LQR if env.task.HOLDS else JointLQR)(env), ranges=ranges
    ),
    "AdaptiveMPC": lambda env, ranges: AdaptiveMPC(env, ranges=ranges),
    "bound": lambda env, _: AdaptiveMPC(env, known=True),
    "MPC, informed": lambda env, _: MPC(env, informed=True),
}
FIRST = 5  # decisions that do not count: they compile
BATCH = 32  # episodes of a run


class Run(NamedTuple):
    """Episodes of a task by a controller, from the first of these held-out ones on; or, where that
    is None, the times of its decisions.
    """

    task: str
    controller: str
    first: int | None
    episodes: int
    outside: bool

    @property
    def name(self) -> str:
        words = "".join(c if c.isalnum() else "-" for c in self.controller.lower())
        return f"{self.task}-{words}-{'times' if self.first is None else self.first}"

    @property
    def about(self) -> dict[str, Any]:
        """What is made on what, by which code."""
        return {**self._asdict(), "environment": vars(self.of), "code": code()}

    @property
    def of(self) -> Task:
        return TASKS[f"{self.task}-uncertain"]

    def begun(self, env: Any) -> Controller:
        """The controller, who knows the ranges of the task."""
        drawn = self.of.arguments["randomize"]
        ranges = {name: tuple(bounds) for name, bounds in drawn.items()}
        return CONTROLLERS[self.controller](env, ranges)


class Score(NamedTuple):
    """Of a task and a controller: mean return, shares of episodes and intervals, episodes that were
    lost, and s from an observation to its action (of 99 of 100 at most), and of what is done before
    the next.
    """

    task: str
    controller: str
    total: float
    success: float
    within: float
    lost: int
    median: float
    most: float
    between: float


HEAD = (
    "task", "controller", "return", "success, %", "within, %", "lost", "decision, ms", "99 %, ms",
    "between, ms",
)  # fmt: skip


def play(run: Run, folder: Path) -> None:
    """Makes a run, in its own file."""
    torch.set_num_threads(1)
    # of the code that runs, whatever is written meanwhile
    about = {**run.about, "commit": commit()}
    result = decisions(run) if run.first is None else episodes(run, run.first)
    about |= {**result, "measured": measured_on(dtype=None, threads=1)}
    write(folder / f"{run.name}.json", json.dumps(about, indent=2))


def episodes(run: Run, first: int) -> dict[str, Any]:
    """Scores, as `evaluate` has them."""
    if not run.outside:
        env = make(run.of, run.episodes)
        return evaluate(run.of, run.begun(env), run.episodes, HELD_OUT + first, env)
    wide = widened(run.of)
    env = make(wide, run.episodes)
    seeds = seeds_beyond(run.of, env, first + run.episodes)[first:]
    return evaluate(wide, run.begun(env), run.episodes, seeds, env)


@torch.no_grad()
def decisions(run: Run) -> dict[str, Any]:
    """s of each decision of a training episode, and of what is prepared for the next."""
    env, taken, between = make(run.of, 1), [], []
    observation, _ = env.reset(seed=TRAINING)
    own = run.begun(env)
    own.begin(env)
    while not env.state.done.any():
        times = [time.thread_time()]
        action = own(observation)
        times.append(time.thread_time())
        own.prepare()
        times.append(time.thread_time())
        taken.append(times[1] - times[0])
        between.append(times[2] - times[1])
        observation, *_ = env.step(action)
    median, most = np.quantile(taken[FIRST:], (0.5, 0.99)).tolist()
    return {"median": median, "most": most, "between": float(np.median(between[FIRST:]))}


def score(task: str, controller: str, runs: Sequence[dict[str, Any]]) -> Score:
    """Of all of its runs."""
    (times,) = (r for r in runs if r["first"] is None)
    played = [r for r in runs if r["first"] is not None]
    weights = [r["episodes"] for r in played]
    mean = {
        key: float(np.average([r[key] for r in played], weights=weights))
        for key in ("return", "success", "within")
    }
    lost = sum(r["ended"] for r in played)
    return Score(
        task, controller, *mean.values(), lost, *(times[k] for k in ("median", "most", "between"))
    )


def markdown(rows: Sequence[Score]) -> str:
    lines = [
        (
            r.task,
            r.controller,
            f"{r.total:.2f}",
            *(f"{100 * share:.0f}" for share in (r.success, r.within)),
            f"{r.lost}",
            *(f"{1e3 * t:.1f}" for t in (r.median, r.most, r.between)),
        )
        for r in rows
    ]
    return table(HEAD, lines, words=2)


def plan(options: argparse.Namespace) -> list[Run]:
    """Batch by batch, of all tasks and controllers."""
    firsts = [None, *range(0, options.episodes, BATCH)]
    return [
        Run(task, title, first, min(BATCH, options.episodes - (first or 0)), options.outside)
        for first in firsts
        for task in options.tasks
        for title in options.controllers
    ]


def stored(run: Run, folder: Path) -> dict[str, Any] | None:
    """What is in its file, if it is of this run."""
    path = folder / f"{run.name}.json"
    there = json.loads(path.read_text()) if path.exists() else {}
    return there if holds(there, run.about) else None


def main(argv: Sequence[str] | None = None) -> int:
    """Score controllers that estimate, and the bound, at the uncertain level."""
    parser = argparse.ArgumentParser(
        prog="python -m training.adaptive",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--tasks", nargs="+", choices=NOMINAL, default=NOMINAL)
    parser.add_argument("--controllers", nargs="+", choices=CONTROLLERS, default=[*CONTROLLERS])
    parser.add_argument("--episodes", type=above_zero(int), default=BATCH, metavar="N")
    parser.add_argument(
        "--outside", action="store_true", help="on plants beyond the ranges that are known"
    )
    parser.add_argument(
        "--jobs",
        type=above_zero(int),
        default=os.cpu_count(),
        help="processes of one torch thread (default: %(default)s)",
    )
    parser.add_argument("--out", default="out/adaptive", help="default: %(default)s")
    options = parser.parse_args(argv)
    out = results_folder(parser, options.out)
    (folder := out / "runs").mkdir(exist_ok=True)
    runs = plan(options)
    missing = [run for run in runs if stored(run, folder) is None]
    print(f"{len(runs)} runs, {len(runs) - len(missing)} of them done", file=sys.stderr, flush=True)
    if made(play, [(run, folder) for run in missing], options.jobs):
        return 1
    each: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for run in runs:
        each.setdefault((run.task, run.controller), []).append(stored(run, folder) or {})
    rows = [score(*pair, own) for pair, own in each.items()]
    about = {**next(iter(each.values()))[0]["measured"], "episodes": options.episodes}
    where = ", on plants beyond its ranges" if options.outside else ""
    text = f"{options.episodes} held-out episodes of the uncertain level{where}.\n\n"
    text += f"{markdown(rows)}\n\n{sentence(about)}"
    print(text)
    content = {**about, "outside": options.outside, "rows": [r._asdict() for r in rows]}
    write_results(out, "adaptive", text, content, Score._fields, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
