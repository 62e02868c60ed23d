"""One command for published tasks of soft arms: our learner beside what was published, in the
publication's own metric.

    python -m training.published                    # ten seeds of each task, resumed where cut off
    python -m training.published --quick            # two tasks, two seeds, a tenth of each budget
    python -m training.published --table            # one line of JSON a row, of what is made

Runs are those of `training.results` (NAME.json in OUT/runs, NAME.pt beside it); a row is written
of all seeds that are made: published.json, .csv and .md in OUT.
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

from . import results
from .evaluate import EPISODES
from .options import above_zero
from .statistics import FEWEST, estimate

SEEDS = 10
QUICK: dict[str, Any] = {"tasks": ["obstacles", "ik"], "seeds": 2, "share": 0.1}


class Publication(NamedTuple):
    """What a publication says of a task.

    metric  the entry of `evaluate` that it draws
    value   of the best of its learners, read from its picture; hours of training
    """

    metric: str
    value: float
    hours: float
    source: str


# Choi and Tong 2025 (arXiv 2511.06667), dismech-rl, SAC with 500 environments: the mean of the
# last tenth of its curves, from training episodes, which are sampled; ours are held out, and greedy
PUBLISHED = {
    "follow-3d": Publication("discounted_mean", 99.3, 0.34, "dismech-rl"),
    "ik": Publication("discounted_mean", 197.4, 0.37, "dismech-rl"),
    "obstacles": Publication("discounted_mean", 40.6, 0.6, "dismech-rl"),
    "obstacles-3d": Publication("discounted_mean", 27.7, 0.96, "dismech-rl"),
}


def rows(folder: Path) -> list[dict[str, Any]]:
    """One for each task and learner with runs in a folder."""
    runs: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for path in sorted(folder.glob("*.json")):
        run = json.loads(path.read_text())
        if run["task"] in PUBLISHED:
            runs.setdefault((run["task"], run["algorithm"]), []).append(run)
    return [
        _row(*key, runs[key]) for key in sorted(runs, key=lambda key: [*PUBLISHED].index(key[0]))
    ]


def _row(task: str, learner: str, runs: list[dict[str, Any]]) -> dict[str, Any]:
    source = PUBLISHED[task]
    mean, low, high = estimate(partial(np.mean, axis=-1), [run[source.metric] for run in runs])
    told = len(runs) >= FEWEST  # fewer say nothing of an interval
    return {
        "task": task,
        "learner": learner,
        "metric": source.metric,
        "mean": mean.item(),
        "low": low.item() if told else None,
        "high": high.item() if told else None,
        "seeds": len(runs),
        "seconds": float(np.mean([run["seconds"] for run in runs])),
        "published": source.value,
        "published_hours": source.hours,
        "return": float(np.mean([run["return"] for run in runs])),
        "success": float(np.mean([run["success"] for run in runs])),
        "steps": int(runs[0]["steps"]),
    }


def report(out: Path) -> list[dict[str, Any]]:
    """Write published.json, .csv and .md; returns the rows."""
    lines = rows(out / "runs")
    heading = measured_on(dtype=None, threads=1)
    write(out / "published.json", json.dumps({**heading, "rows": lines}, indent=2) + "\n")
    if not lines:
        return lines
    write(out / "published.csv", csv_text([[*lines[0]], *(row.values() for row in lines)]))
    head = ("task", "learner", "metric [95 % interval]", "published", "env steps", "training")
    head += ("published training", "return", "seeds")
    cells = [
        (
            row["task"],
            row["learner"].upper(),
            f"{row['mean']:.1f}"
            + ("" if row["low"] is None else f" [{row['low']:.1f}, {row['high']:.1f}]"),
            f"{row['published']:.1f}",
            f"{row['steps']:,}",
            f"{row['seconds']:.0f} CPU s",
            f"{row['published_hours']:g} h of 500 processes",
            f"{row['return']:.0f}",
            str(row["seeds"]),
        )
        for row in lines
    ]
    write(out / "published.md", f"{table(head, cells, words=2)}\n\n{sentence(heading)}\n")
    return lines


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
        numbers = [f"--{k}={getattr(options, k)}" for k in ("seeds", "share", "episodes", "jobs")]
        wanted = ["--tasks", *options.tasks, "--algorithms", "shac"]
        code = results.main([*wanted, *numbers, "--out", str(out)])
    for row in report(out):
        print(json.dumps(row))
    return code


if __name__ == "__main__":
    raise SystemExit(main())
