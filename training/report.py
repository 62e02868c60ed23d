"""Report: the tables and the picture from the files of runs."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from torchbeam.extend.commands import measured_on, sentence

from .cards import policies
from .statistics import estimate, improvement, interquartile_mean
from .tuned import TASKS

Run = dict[str, Any]
LABELS = {
    "zero": "no action",
    "static": "static feed-forward",
    "pd": "PD + static",
    "lqr": "LQR + static",
    "lqg": "LQG + static",
    "mpc": "MPC",
    "mpc-informed": "MPC, plant known",
    "optimum": "open-loop optimum",
    "ppo": "PPO",
    "sac": "SAC",
    "shac": "SHAC",
    "sb3-ppo": "PPO (stable-baselines3)",
    "sb3-sac": "SAC (stable-baselines3)",
    "skrl-ppo": "PPO (skrl)",
}
LINEAR = ("pd", "lqr", "lqg")
KNOWING = "mpc-informed"
CURVE = "validation_return"  # of a learner's log
WIDE = 1e3  # ratio of costs from which powers of ten alone are labelled
LEAST = 3  # seeds for a band; the curve of each is thin
COLORS = {
    "ppo": "#e08214",
    "sac": "#4d9221",
    "shac": "#1b6ca8",
    "sb3-ppo": "#b35806",
    "sb3-sac": "#7fbc41",
    "skrl-ppo": "#a6761d",
}
STYLES = {
    "zero": ":",
    "static": (0, (1, 3)),
    "pd": "--",
    "lqr": "-.",
    "lqg": (0, (5, 1)),
    "mpc": (0, (4, 1, 1, 1, 1, 1)),
    "mpc-informed": (0, (12, 8)),
    "optimum": "-",
}


def report(out: Path) -> str:
    """Write results.json, results.csv, results.md, summary.md, curves.png (with matplotlib) and
    policies/; returns the Markdown of results.md.
    """
    runs = [json.loads(path.read_text()) for path in sorted((out / "runs").glob("*.json"))]
    rows, compared = table(runs, lambda run: curve(out / "runs", run)), comparisons(runs)
    # of each run; the runs may have been made side by side
    heading = measured_on(dtype=None, threads=1)
    (out / "results.json").write_text(
        json.dumps({**heading, "rows": rows, "comparisons": compared, "runs": runs}, indent=2)
        + "\n"
    )
    if rows:
        with open(out / "results.csv", "w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
    failed = sorted(path.stem for path in (out / "runs").glob("*.failed"))
    text = markdown(rows, compared) + "".join(f"\n{name}: failed\n" for name in failed)
    text += f"\n\n{sentence(heading)}"
    (out / "results.md").write_text(text + "\n")
    (out / "summary.md").write_text(f"{summary(rows, runs)}\n\n{sentence(heading)}\n")
    policies(out, runs)
    try:
        import matplotlib
    except ImportError:
        return text
    matplotlib.use("Agg")
    picture(out, runs)
    return text


def curve(folder: Path, run: Run) -> dict[str, np.ndarray] | None:
    """steps, seconds and validation return of a learner's log, in order; None for a baseline."""
    path = folder / f"{run['task']}-{run['algorithm']}-{run['seed']}.csv"
    if run["seconds"] is None or not path.exists():
        return None
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    return {
        name: np.array([float(row[name]) for row in rows]) for name in ("steps", "seconds", CURVE)
    }


def table(runs: list[Run], curves: Callable[[Run], dict | None]) -> list[dict[str, Any]]:
    """One row a task and algorithm: interquartile means over the seeds, NAME, and their intervals,
    NAME_low and NAME_high.

    better                              probability that a seed returns more than the best of
                                        `LINEAR` there
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
        linear = [run["return"] for run in here if run["algorithm"] in LINEAR]
        for algorithm in sorted({run["algorithm"] for run in here}, key=list(LABELS).index):
            group = [run for run in here if run["algorithm"] == algorithm]
            found = [learned[id(run)] for run in group if id(run) in learned]
            row = {"task": task, "algorithm": algorithm, "runs": len(group)}
            returns = [run["return"] for run in group]
            for name in ("return", "success", "final_error"):
                row |= _entry(name, interquartile_mean, [run[name] for run in group])
            best = [returns, [max(linear)]] if found and linear else []
            row |= _entry("better", improvement, *best)
            row["steps"] = mean([run["steps"] for run in group])
            row["seconds"] = mean([run["seconds"] for run in group]) if found else None
            for axis in ("steps", "seconds"):
                at = [float(np.interp(common[axis], one[axis], one[CURVE])) for one in found]
                row[f"common_{axis}"] = common[axis] if found else None
                row |= _entry(f"return_at_{axis}", interquartile_mean, *[at] if at else [])
            row["ended"] = sum(run["ended"] for run in group)
            row["solver_failures"] = sum(run["solver_failures"] for run in group)
            rows.append(row)
    return rows


def _entry(name: str, statistic: Callable[..., Any], *strata: list[float]) -> dict[str, Any]:
    """A statistic with its interval, in a row; None where there are no runs."""
    values = map(float, estimate(statistic, *strata)) if strata else (None,) * 3
    return dict(zip((name, f"{name}_low", f"{name}_high"), values, strict=True))


def mean(values: list[float]) -> float:
    return float(np.mean(values))


def comparisons(runs: list[Run]) -> list[dict[str, Any]]:
    """Of each pair of learners: the probability that a seed of the one returns more than one of the
    other, mean over the tasks that both have.
    """
    returns: dict[str, dict[str, list[float]]] = {}
    for run in runs:
        if run["seconds"] is not None:
            by_task = returns.setdefault(run["algorithm"], {})
            by_task.setdefault(run["task"], []).append(run["return"])
    rows = []
    for one, other in combinations(sorted(returns, key=list(LABELS).index), 2):
        tasks = [task for task in returns[one] if task in returns[other]]
        strata = [returns[name][task] for task in tasks for name in (other, one)]

        def probability(*groups: np.ndarray) -> np.ndarray:
            pairs = zip(groups[::2], groups[1::2], strict=True)
            return np.mean([improvement(*pair) for pair in pairs], axis=0)

        if tasks:
            row = {"algorithm": other, "over": one, "tasks": tasks}
            rows.append(row | _entry("probability", probability, *strata))
    return rows


def markdown(rows: list[dict[str, Any]], compared: list[dict[str, Any]]) -> str:
    """The table for people."""
    lines = [
        "| task | controller | return | success | final error | ahead of linear | env steps | "
        "training | return at equal steps | return at equal time |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        training = "" if row["seconds"] is None else f"{row['seconds'] / 60:.1f} min"
        steps = f"{row['steps']:,.0f}" if row["steps"] else ""
        lines.append(
            f"| {row['task']} | {LABELS[row['algorithm']]} | {_said(row, 'return')} | "
            f"{_said(row, 'success', 100, 0, ' %')} | {_said(row, 'final_error', 1e3, 1, ' mm')} | "
            f"{_said(row, 'better', 100, 0, ' %')} | {steps} | {training} | "
            f"{_said(row, 'return_at_steps')} | {_said(row, 'return_at_seconds')} |"
        )
    for task in dict.fromkeys(row["task"] for row in rows):
        common = [row for row in rows if row["task"] == task and row["seconds"] is not None]
        if common:
            one = common[0]
            lines.append("")
            lines.append(
                f"{task}: equal steps are {one['common_steps']:,.0f}, equal time is "
                f"{one['common_seconds']:.0f} CPU s of training on one thread; "
                f"{max(row['runs'] for row in common)} seeds, interquartile mean [95 % interval]."
            )
    for row in compared:
        lines.append("")
        lines.append(
            f"A seed of {LABELS[row['algorithm']]} returns more than one of {LABELS[row['over']]}: "
            f"{_said(row, 'probability', 100, 0, ' %')} (mean of {', '.join(row['tasks'])})."
        )
    return "\n".join(lines)


def summary(rows: list[dict[str, Any]], runs: list[Run]) -> str:
    """A row a task: the controllers of `LINEAR` and MPC beside the learners, with return, success
    and the number of seeds, the largest return in bold (but of `KNOWING`, which no real controller
    can be); then, of each pair of learners, the
    probability that a seed of the one returns more.
    """
    there = {row["algorithm"] for row in rows}
    shown = [name for name in (*LINEAR, "mpc", KNOWING, *COLORS) if name in there]
    pairs = [(b, a) for a, b in combinations((name for name in shown if name in COLORS), 2)]
    heads = ["task", *(LABELS[name] for name in shown)]
    heads += [f"{LABELS[one]} ahead of {LABELS[other]}" for one, other in pairs]
    lines = [f"| {' | '.join(heads)} |", f"|---|{'---:|' * (len(heads) - 1)}"]
    for task in dict.fromkeys(row["task"] for row in rows):
        here = {row["algorithm"]: row for row in rows if row["task"] == task}
        best = max(
            (here[name]["return"] for name in shown if name in here and name != KNOWING),
            default=None,
        )
        cells = [_cell(here[name], best) if name in here else "" for name in shown]
        returns = {
            name: [run["return"] for run in runs if (run["task"], run["algorithm"]) == (task, name)]
            for name in shown
        }
        for pair in pairs:
            both = [returns[name] for name in pair]
            found = _entry("ahead", improvement, *(both if all(both) else ()))
            cells.append(_said(found, "ahead", 100, 0, " %"))
        lines.append(f"| {task} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(row: dict[str, Any], best: float) -> str:
    text = _said(row, "return")
    text = f"**{text}**" if row["return"] == best else text
    seeds = f" ({row['runs']})" if row["algorithm"] in COLORS else ""
    return f"{text}, {100 * row['success']:.0f} %{seeds}"


def _said(
    row: dict[str, Any], name: str, factor: float = 1.0, digits: int | None = None, unit: str = ""
) -> str:
    """A statistic with its interval, where it has one."""
    if row[name] is None:
        return ""
    value, low, high = (factor * row[key] for key in (name, f"{name}_low", f"{name}_high"))
    digits = (2 if abs(value) < 10 else 1) if digits is None else digits
    interval = "" if low == high else f" [{low:.{digits}f}, {high:.{digits}f}]"
    return f"{value:.{digits}f}{interval}{unit}"


def picture(out: Path, runs: list[Run]) -> None:
    """Cost (minus the return on validation episodes) against steps and against training time, one
    row a task, logarithmic: the interquartile mean over seeds of its logarithm with a 95 % band,
    from three seeds on, and each seed.
    """
    import matplotlib.pyplot as plt
    from matplotlib.ticker import LogLocator, NullLocator

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
            len(names), 2, figsize=(9, 1 + 1.9 * len(names)), squeeze=False, layout="constrained"
        )
        lines: dict[str, Any] = {}
        for name, pair in zip(names, axes, strict=True):
            here = sorted(
                (run for run in runs if run["task"] == name),
                key=lambda run: list(LABELS).index(run["algorithm"]),
            )
            for ax, axis, unit, label in (
                (pair[0], "steps", 1e3, "environment steps (thousands)"),
                (pair[1], "seconds", 1, "training, one thread (CPU s)"),
            ):
                levels = _levels(ax, here)
                levels += _curves(ax, out, here, axis, unit)
                ax.set(
                    xscale="log",
                    yscale="log",
                    xlabel=label if name == names[-1] else "",
                    ylim=(min(levels) / 1.3, max(levels) * 1.3),
                    title=f"{name}: cost (- return) on validation episodes",
                )
                ax.xaxis.set_minor_formatter("")
                ax.xaxis.set_major_formatter("{x:g}")
                wide = max(levels) > WIDE * min(levels)
                ax.yaxis.set_major_locator(LogLocator(subs=(1,) if wide else (1, 2, 5)))
                ax.yaxis.set_major_formatter("{x:g}")
                ax.yaxis.set_minor_locator(NullLocator())
                handles, labels = ax.get_legend_handles_labels()
                lines |= dict(zip(labels, handles, strict=True))
        figure.legend(lines.values(), lines, loc="outside upper center", ncols=4, fontsize=8)
        figure.savefig(out / "curves.png", dpi=100)
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
        y = np.array([np.interp(x, one[axis], np.log(_cost(one[CURVE]))) for one in found])
        color = COLORS[algorithm]
        mean, low, high = np.exp(estimate(interquartile_mean, y.T, resamples=1000))
        ax.plot(x / unit, mean, color=color, lw=1.8, label=LABELS[algorithm])
        ax.plot(x / unit, np.exp(y).T, color=color, lw=0.6, alpha=0.6)
        if len(found) >= LEAST:
            ax.fill_between(x / unit, low, high, color=color, alpha=0.18, lw=0)
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
