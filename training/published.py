"""One command for published tasks of soft arms: our learners and controllers beside what was
published, in the publication's own metric.

    python -m training.published                    # ten seeds of each task, resumed where cut off
    python -m training.published --quick            # two tasks, two seeds, a tenth of each budget
    python -m training.published --table            # one line of JSON a row, of what is made

Runs are those of `training.results` (NAME.json in OUT/runs, NAME.pt beside it); a row is written
of all seeds that are made: published.json, .csv and .md in OUT, and curves of what was learned,
over steps and over CPU seconds: published.png.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torchbeam.extend.commands import csv_text, measured_on, results_folder, sentence, table, write

from . import results, tuned
from .baselines import BASELINES, leading
from .curves import picture
from .evaluate import EPISODES
from .options import above_zero
from .statistics import FEWEST, estimate
from .table import LABELS, label
from .watch import Budget

SEEDS = 10
NAMES = {**LABELS, "student": "student"}  # of several teachers
QUICK: dict[str, Any] = {"tasks": ["obstacles", "ik"], "seeds": 2, "share": 0.1}


class Publication(NamedTuple):
    """What a publication says of a task.

    metric   the entry of `evaluate` that it draws or logs
    value    of the best of its learners, and hours of its training; None = not published
    learner  by which we learn it; None where none was seen to learn, and the arm is led alone
    """

    metric: str
    value: float | None
    hours: float | None
    source: str
    learner: str | None = "shac"


# Choi and Tong 2025 (arXiv 2511.06667), dismech-rl, SAC with 500 environments: the mean of the
# last tenth of its curves, from training episodes, which are sampled; ours are held out, and
# greedy. Naughton et al. 2021, Elastica-RL-control: the mean over seeds of the last tenth of its
# logs of its best learner (PPO, SAC, TRPO, TRPO), likewise
PUBLISHED = {
    "follow": Publication("discounted_mean", None, None, "dismech-rl"),
    "follow-3d": Publication("discounted_mean", 99.3, 0.34, "dismech-rl"),
    "ik": Publication("discounted_mean", 197.4, 0.37, "dismech-rl", "student"),
    "obstacles": Publication("discounted_mean", 40.6, 0.6, "dismech-rl"),
    "obstacles-3d": Publication("discounted_mean", 27.7, 0.96, "dismech-rl", None),
    "track-target": Publication("return", 10834.0, 10.9, "Elastica-RL-control", "student"),
    "reach-pose": Publication("return", 2044.0, 25.0, "Elastica-RL-control", "student"),
    "reach-behind": Publication("return", 4115.0, 2.1, "Elastica-RL-control", "student"),
    "reach-nest": Publication("return", 2036.0, 7.8, "Elastica-RL-control", "student"),
}


def runs(folder: Path) -> list[dict[str, Any]]:
    """Those of published tasks in a folder."""
    found = [json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))]
    return [run for run in found if run["task"] in PUBLISHED]


def rows(found: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One for each task and learner or controller."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for run in found:
        groups.setdefault((run["task"], run["algorithm"]), []).append(run)

    def order(key: tuple[str, str]) -> tuple[int, int]:
        return [*PUBLISHED].index(key[0]), [*NAMES].index(key[1])

    return [_row(*key, groups[key]) for key in sorted(groups, key=order)]


def _row(task: str, learner: str, runs: list[dict[str, Any]]) -> dict[str, Any]:
    source, learned = PUBLISHED[task], runs[0]["seconds"] is not None
    known = all(source.metric in run for run in runs)  # older runs have no discounted returns
    mean, low, high = (
        estimate(partial(np.mean, axis=-1), [run[source.metric] for run in runs])
        if known
        else 3 * (None,)
    )
    told = known and len(runs) >= FEWEST  # fewer say nothing of an interval
    return {
        "task": task,
        "learner": learner,
        "metric": source.metric,
        "mean": mean.item() if known else None,
        "low": low.item() if told else None,
        "high": high.item() if told else None,
        "seeds": len(runs) if learned else None,
        "seconds": float(np.mean([run["seconds"] for run in runs])) if learned else None,
        "published": source.value,
        "published_hours": source.hours,
        "source": source.source,
        "return": float(np.mean([run["return"] for run in runs])),
        "success": float(np.mean([run["success"] for run in runs])),
        "steps": int(runs[0]["steps"]),
        "episodes": runs[0].get("episodes"),
    }


def report(out: Path) -> list[dict[str, Any]]:
    """Write published.json, .csv, .md and, with matplotlib, .png; returns the rows."""
    found = runs(out / "runs")
    lines, heading = rows(found), measured_on(dtype=None, threads=1)
    write(out / "published.json", json.dumps({**heading, "rows": lines}, indent=2) + "\n")
    if not lines:
        return lines
    write(out / "published.csv", csv_text([[*lines[0]], *(row.values() for row in lines)]))
    head = ("task", "learner", "metric [95 % interval]", "published", "return", "success")
    head += ("env steps", "training", "published training", "seeds")
    cells = [
        (
            row["task"],
            label(row["learner"], row["task"]),
            _said(row["mean"])
            + ("" if row["low"] is None else f" [{row['low']:.1f}, {row['high']:.1f}]"),
            _said(row["published"]),
            _said(row["return"]),
            f"{100 * row['success']:.0f} %",
            f"{row['steps']:,}" if row["steps"] else "",
            "" if row["seconds"] is None else f"{row['seconds']:.0f} CPU s",
            "" if row["published_hours"] is None else f"{row['published_hours']:g} h",
            str(row["seeds"] or ""),
        )
        for row in lines
    ]
    write(out / "published.md", f"{table(head, cells, words=2)}\n\n{sentence(heading)}\n")
    learned = {run["task"] for run in found if run["seconds"] is not None}
    names = [name for name in PUBLISHED if name in learned]
    try:
        import matplotlib
    except ImportError:
        return lines
    if any((out / "runs").glob("*.csv")):
        matplotlib.use("Agg")
        picture(out, found, "published.png", names, NAMES)
    return lines


def _said(value: float | None) -> str:
    return "" if value is None else f"{value:.{0 if abs(value) >= 300 else 1}f}"


def plan(options: argparse.Namespace) -> dict[results.Run, tuple[Budget, int]]:
    """The runs that are wanted, seed by seed, with budgets and held-out episodes."""
    wanted = {}
    for seed in range(options.seeds):
        for task in options.tasks:
            source = PUBLISHED[task]
            for name in (*leading(task), *filter(None, [source.learner])):
                fixed = name in BASELINES
                run = results.Run(task, name, None if fixed else seed)
                steps = None if fixed else round(options.share * tuned.budget(name, task))
                wanted[run] = Budget(steps, None), results.held_out(run, options)
    return wanted


def main(argv: Sequence[str] | None = None) -> int:
    """Make the runs that are missing, then the table."""
    parser = argparse.ArgumentParser(
        prog="python -m training.published",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--table", action="store_true", help="no run: print a row of JSON a line")
    parser.add_argument("--quick", action="store_true", help="some three minutes, see above")
    parser.add_argument("--tasks", nargs="+", choices=PUBLISHED, default=[*PUBLISHED])
    parser.add_argument("--seeds", type=above_zero(int), default=SEEDS, help="%(default)s")
    parser.add_argument(
        "--share", type=above_zero(float), default=1.0, help="of each budget (%(default)s)"
    )
    parser.add_argument("--episodes", type=above_zero(int), default=EPISODES, help="%(default)s")
    parser.add_argument("--jobs", type=above_zero(int), default=1, help="processes (%(default)s)")
    parser.add_argument("--out", default="out/published", help="%(default)s")
    if parser.parse_known_args(argv)[0].quick:
        parser.set_defaults(**QUICK)
    options = parser.parse_args(argv)
    out, code = results_folder(parser, options.out), 0
    if not options.table:
        code = results.complete(plan(options), out / "runs", options.jobs)
    for row in report(out):
        print(json.dumps(row))
    return code


if __name__ == "__main__":
    raise SystemExit(main())
