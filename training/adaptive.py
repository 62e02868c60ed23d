"""What estimation is worth at the uncertain level, and what could be had at most.

python -m training.adaptive --episodes 32 --out docs/results/adaptive
python -m training.adaptive --episodes 32 --outside --out docs/results/adaptive_outside

By task on the first held-out episodes: MPC by the usual plant, LQR and MPC by what a filter makes
of the readings, MPC that knows the plant but sees it through the readings (the bound), and MPC that
knows and sees all. Outside, plants lie beyond the task's ranges, which is all that filters know of
them. Decision times are those of one training episode, alone: from an observation to its action,
and of what is prepared between.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torchbeam_envs.baselines import LQR, MPC, AdaptiveMPC, Controller, Estimated, JointLQR

from torchbeam.extend.commands import measured_on, results_folder, sentence, table, write_results

from .evaluate import evaluate, make, outside
from .options import above_zero
from .tuned import HELD_OUT, NOMINAL, TASKS, TRAINING, Task

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


def score(task: Task, title: str, episodes: int, beyond: bool = False) -> Score:
    """On the first held-out episodes; beyond: on those of plants outside of the task's ranges."""
    ranges = {name: tuple(bounds) for name, bounds in task.arguments["randomize"].items()}
    wide, env, seeds = outside(task, episodes) if beyond else (task, make(task, episodes), HELD_OUT)
    controller = CONTROLLERS[title](env, ranges)
    found = evaluate(wide, controller, episodes, seeds, env)
    taken, between = decisions(task, lambda env: CONTROLLERS[title](env, ranges))
    median, most = np.quantile(taken, (0.5, 0.99)).tolist()
    shares = found["return"], found["success"], found["within"]
    name = task.name.removesuffix("-uncertain")
    times = median, most, float(np.median(between))
    return Score(name, title, *shares, int(found["ended"]), *times)


@torch.no_grad()
def decisions(
    task: Task, controller: Callable[[Any], Controller]
) -> tuple[list[float], list[float]]:
    """s of each decision of a training episode, and of what is prepared for the next."""
    env, taken, between = make(task, 1), [], []
    observation, _ = env.reset(seed=TRAINING)
    own = controller(env)
    own.begin(env)
    while not env.state.done.any():
        times = [time.perf_counter()]
        action = own(observation)
        times.append(time.perf_counter())
        own.prepare()
        times.append(time.perf_counter())
        taken.append(times[1] - times[0])
        between.append(times[2] - times[1])
        observation, *_ = env.step(action)
    return taken[FIRST:], between[FIRST:]


def markdown(rows: Sequence[Score]) -> str:
    lines = [
        (
            r.task,
            r.controller,
            f"{r.total:.2f}",
            *(f"{100 * share:.0f}" for share in (r.success, r.within)),
            f"{r.lost}",
            *(f"{1e3 * t:.0f}" for t in (r.median, r.most, r.between)),
        )
        for r in rows
    ]
    return table(HEAD, lines, words=2)


def main(argv: Sequence[str] | None = None) -> int:
    """Score controllers that estimate, and the bound, at the uncertain level."""
    parser = argparse.ArgumentParser(prog="python -m training.adaptive", description=main.__doc__)
    parser.add_argument("--tasks", nargs="+", choices=NOMINAL, default=NOMINAL)
    parser.add_argument("--controllers", nargs="+", choices=CONTROLLERS, default=[*CONTROLLERS])
    parser.add_argument("--episodes", type=above_zero(int), default=16, metavar="N")
    parser.add_argument(
        "--outside", action="store_true", help="on plants beyond the ranges that are known"
    )
    parser.add_argument("--out", help="folder of adaptive.md, .json and .csv (default: none)")
    given = parser.parse_args(argv)
    out = None if given.out is None else results_folder(parser, given.out)
    torch.set_num_threads(1)
    rows: list[Score] = []
    for name in given.tasks:
        for title in given.controllers:
            rows.append(score(TASKS[f"{name}-uncertain"], title, given.episodes, given.outside))
            print(*rows[-1], file=sys.stderr, flush=True)
    about = measured_on(dtype=None, threads=1)
    about |= {"episodes": given.episodes, "outside": given.outside}
    where = ", on plants beyond its ranges" if given.outside else ""
    text = f"{given.episodes} held-out episodes of the uncertain level{where}.\n\n"
    text += markdown(rows) + "\n\n"
    text += sentence(about)
    print(text)
    if out is not None:
        content = {**about, "rows": [r._asdict() for r in rows]}
        write_results(out, "adaptive", text, content, Score._fields, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
