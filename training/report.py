"""Report: the tables and the picture from the files of runs."""

from __future__ import annotations

import csv
import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from torchbeam.extend.commands import measured_on, sentence

from .tuned import TASKS

Run = dict[str, Any]
LABELS = {
    "zero": "no action",
    "static": "static feed-forward",
    "pd": "PD + static",
    "lqr": "LQR + static",
    "lqg": "LQG + static",
    "mpc": "MPC",
    "optimum": "open-loop optimum",
    "ppo": "PPO",
    "shac": "SHAC",
    "sb3-ppo": "PPO (stable-baselines3)",
    "sb3-sac": "SAC (stable-baselines3)",
}
# Student's t, 97.5 %, by degrees of freedom
T95 = (math.nan, 12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262)
LEAST = 3  # seeds for a band; the curve of each is thin
COLORS = {"ppo": "#e08214", "shac": "#1b6ca8", "sb3-ppo": "#b35806", "sb3-sac": "#7fbc41"}
STYLES = {
    "zero": ":",
    "static": (0, (1, 3)),
    "pd": "--",
    "lqr": "-.",
    "lqg": (0, (5, 1)),
    "mpc": "--",
    "optimum": "-",
}


def report(out: Path) -> str:
    """Write results.json, results.csv, results.md, curves.png (with matplotlib) and policies/;
    returns the Markdown table.
    """
    runs = [json.loads(path.read_text()) for path in sorted((out / "runs").glob("*.json"))]
    rows = table(runs, lambda run: curve(out / "runs", run))
    # of each run; the runs may have been made side by side
    heading = measured_on(dtype=None, threads=1)
    (out / "results.json").write_text(
        json.dumps({**heading, "rows": rows, "runs": runs}, indent=2) + "\n"
    )
    if rows:
        with open(out / "results.csv", "w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
    failed = sorted(path.stem for path in (out / "runs").glob("*.failed"))
    text = markdown(rows) + "".join(f"\n{name}: failed\n" for name in failed)
    text += f"\n\n{sentence(heading)}"
    (out / "results.md").write_text(text + "\n")
    policies(out, runs)
    try:
        import matplotlib
    except ImportError:
        return text
    matplotlib.use("Agg")
    picture(out, runs)
    return text


def curve(folder: Path, run: Run) -> dict[str, np.ndarray] | None:
    """steps, seconds and held-out return of a learner's log, in order; None for a baseline."""
    path = folder / f"{run['task']}-{run['algorithm']}-{run['seed']}.csv"
    if run["seconds"] is None or not path.exists():
        return None
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    return {
        name: np.array([float(row[name]) for row in rows])
        for name in ("steps", "seconds", "held_out_return")
    }


def table(runs: list[Run], curves: Callable[[Run], dict | None]) -> list[dict[str, Any]]:
    """One row a task and algorithm: means over the seeds, and deviations.

    return_at_steps, return_at_seconds  the learning curves at the environment steps, and at the
                                        training time, that every run of every learner of the task
                                        has had
    """
    rows = []
    for task in dict.fromkeys(run["task"] for run in runs):
        here = [run for run in runs if run["task"] == task]
        learned = {id(run): found for run in here if (found := curves(run)) is not None}
        common = {
            axis: min((found[axis][-1] for found in learned.values()), default=None)
            for axis in ("steps", "seconds")
        }
        for algorithm in sorted({run["algorithm"] for run in here}, key=list(LABELS).index):
            group = [run for run in here if run["algorithm"] == algorithm]
            found = [learned[id(run)] for run in group if id(run) in learned]
            row = {"task": task, "algorithm": algorithm, "runs": len(group)}
            for name in ("return", "success", "final_error"):
                row[name] = mean([run[name] for run in group])
                row[f"{name}_deviation"] = deviation([run[name] for run in group])
            row["steps"] = mean([run["steps"] for run in group])
            row["seconds"] = mean([run["seconds"] for run in group]) if found else None
            for axis in ("steps", "seconds"):
                at = [
                    float(np.interp(common[axis], one[axis], one["held_out_return"]))
                    for one in found
                ]
                row[f"common_{axis}"] = common[axis] if found else None
                row[f"return_at_{axis}"] = mean(at) if found else None
                row[f"return_at_{axis}_deviation"] = deviation(at) if found else None
            row["ended"] = sum(run["ended"] for run in group)
            row["solver_failures"] = sum(run["solver_failures"] for run in group)
            rows.append(row)
    return rows


def mean(values: list[float]) -> float:
    return float(np.mean(values))


def deviation(values: list[float]) -> float | None:
    return float(np.std(values, ddof=1)) if len(values) > 1 else None


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table for people."""
    lines = [
        "| task | controller | return | success | final error | env steps | training | return at "
        "equal steps | return at equal time |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        training = "" if row["seconds"] is None else f"{row['seconds'] / 60:.1f} min"
        equal = [
            _pm(row[f"return_at_{axis}"], row[f"return_at_{axis}_deviation"])
            for axis in ("steps", "seconds")
        ]
        success = _pm(100 * row["success"], _times(100, row["success_deviation"]), 0)
        error = _pm(1e3 * row["final_error"], _times(1e3, row["final_error_deviation"]), 1)
        steps = f"{row['steps']:,.0f}" if row["steps"] else ""
        lines.append(
            f"| {row['task']} | {LABELS[row['algorithm']]} | "
            f"{_pm(row['return'], row['return_deviation'])} | {success} % | {error} mm | {steps} | "
            f"{training} | {equal[0]} | {equal[1]} |"
        )
    for task in dict.fromkeys(row["task"] for row in rows):
        common = [row for row in rows if row["task"] == task and row["seconds"] is not None]
        if common:
            one = common[0]
            lines.append("")
            lines.append(
                f"{task}: equal steps are {one['common_steps']:,.0f}, equal time is "
                f"{one['common_seconds']:.0f} s of training on one thread; "
                f"{max(row['runs'] for row in common)} seeds, mean ± standard deviation."
            )
    return "\n".join(lines)


def _pm(value: float | None, spread: float | None, digits: int | None = None) -> str:
    if value is None:
        return ""
    digits = (2 if abs(value) < 10 else 1) if digits is None else digits
    return f"{value:.{digits}f}" + ("" if spread is None else f" ± {spread:.{digits}f}")


def _times(factor: float, value: float | None) -> float | None:
    return None if value is None else factor * value


def policies(out: Path, runs: list[Run]) -> None:
    """Copy the policies of seed 0 (not of the best seed) with their scores."""
    folder, scores = out / "policies", {}
    for run in runs:
        source = out / "runs" / f"{run['task']}-{run['algorithm']}-{run['seed']}.pt"
        if run["seed"] == 0 and source.exists():
            folder.mkdir(exist_ok=True)
            name = f"{run['task']}-{run['algorithm']}.pt"
            shutil.copyfile(source, folder / name)
            scores[name] = {
                key: value for key, value in run.items() if key not in ("minutes_all", "budget")
            }
    if scores:
        (folder / "scores.json").write_text(json.dumps(scores, indent=2) + "\n")


def picture(out: Path, runs: list[Run]) -> None:
    """Cost (minus the return on held-out episodes) against steps and against training time, one row
    a task, logarithmic: the geometric mean over seeds with its 95 % confidence band, from three
    seeds on, and each seed.
    """
    import matplotlib.pyplot as plt

    names = [name for name in TASKS if any(run["task"] == name for run in runs)]
    if not names:
        return
    with plt.rc_context(
        {
            "font.size": 9,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "legend.frameon": False,
            "axes.titlelocation": "left",
            "axes.titlesize": 10,
        }
    ):
        figure, axes = plt.subplots(
            len(names), 2, figsize=(11, 3.2 * len(names)), squeeze=False, layout="constrained"
        )
        for name, pair in zip(names, axes, strict=True):
            here = sorted(
                (run for run in runs if run["task"] == name),
                key=lambda run: list(LABELS).index(run["algorithm"]),
            )
            for ax, axis, unit, label in (
                (pair[0], "steps", 1e3, "environment steps (thousands)"),
                (pair[1], "seconds", 1, "training time, one thread (s)"),
            ):
                levels = _levels(ax, here)
                levels += _curves(ax, out, here, axis, unit)
                ax.set(
                    xscale="log",
                    yscale="log",
                    xlabel=label,
                    ylim=(min(levels) / 1.3, max(levels) * 1.3),
                    title=f"{name}: cost (- return) on held-out episodes",
                )
                ax.xaxis.set_minor_formatter("")
                ax.xaxis.set_major_formatter("{x:g}")
            pair[1].legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
        figure.savefig(out / "curves.png", dpi=120)
        plt.close(figure)


def _curves(ax: Any, out: Path, runs: list[Run], axis: str, unit: float) -> list[float]:
    """Draw the learners; returns some of their costs."""
    levels = []
    for algorithm in dict.fromkeys(run["algorithm"] for run in runs):
        found = [
            one
            for run in runs
            if run["algorithm"] == algorithm and (one := curve(out / "runs", run)) is not None
        ]
        if not found:
            continue
        first, last = max(one[axis][1] for one in found), min(one[axis][-1] for one in found)
        x = np.geomspace(first, max(first, last), 200)
        y = np.array(
            [np.interp(x, one[axis], np.log(_cost(one["held_out_return"]))) for one in found]
        )
        color, mean = COLORS[algorithm], y.mean(0)
        ax.plot(x / unit, np.exp(mean), color=color, lw=1.8, label=LABELS[algorithm])
        ax.plot(x / unit, np.exp(y).T, color=color, lw=0.6, alpha=0.6)
        if LEAST <= len(found) <= len(T95):
            half = T95[len(found) - 1] * y.std(0, ddof=1) / math.sqrt(len(found))
            ax.fill_between(
                x / unit, np.exp(mean - half), np.exp(mean + half), color=color, alpha=0.18, lw=0
            )
        levels += [np.exp(y).min(), np.exp(y).max()]
    return levels


def _levels(ax: Any, runs: list[Run]) -> list[float]:
    """Draw the baselines as lines across; returns their costs."""
    levels = []
    for run in runs:
        if run["algorithm"] in STYLES:
            levels.append(float(_cost(run["return"])))
            ax.axhline(
                levels[-1],
                color="0.35",
                ls=STYLES[run["algorithm"]],
                lw=1,
                label=LABELS[run["algorithm"]],
            )
    return levels


def _cost(value: Any) -> Any:
    return np.maximum(-np.asarray(value), 1e-6)
