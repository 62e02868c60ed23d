"""Curves of learning: from the logs of a study's runs, and as a picture."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .statistics import FEWEST, estimate, interquartile_mean
from .table import CURVE, LABELS, Row, Run
from .tuned import DEFAULT, PUBLISHED, TASKS

WIDE = 1e3  # ratio of costs from which powers of ten alone are labelled
COLORS = {
    "ppo": "#e08214",
    "sac": "#4d9221",
    "shac": "#1b6ca8",
    "student": "#762a83",
    "ppo-gru": "#c51b7d",
    "sac-gru": "#35978f",
    "shac-gru": "#01665e",
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
    "resolved-rate": "--",
}


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


def pictures(out: Path, runs: list[Run]) -> None:
    """curves.png, where there is anything to be seen; published tasks have one of their own."""
    learned = {run["task"] for run in runs if run["seconds"] is not None}
    names = [name for name in TASKS if name in learned and name not in PUBLISHED]
    if names:
        picture(out, runs, "curves.png", names)


def picture(
    out: Path, runs: list[Run], file: str, names: list[str], labels: dict[str, str] = LABELS
) -> None:
    """Cost (minus the return on validation episodes) against steps and against training time, one
    row a task, logarithmic: the interquartile mean over seeds of its logarithm with a 95 % band,
    from five seeds on, and each seed. Of published tasks the return itself, which may be positive.
    """
    import matplotlib.pyplot as plt
    from matplotlib.ticker import LogLocator, NullLocator

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
                key=lambda run: list(labels).index(run["algorithm"]),
            )
            for ax, axis, unit, label in (
                (pair[0], "steps", 1e3, "environment steps (thousands)"),
                (pair[1], "seconds", 1, "training, one thread (CPU s)"),
            ):
                levels = _levels(ax, here, labels)
                levels += _curves(ax, out, here, labels, axis, unit)
                ax.set(xscale="log", xlabel=label if name == names[-1] else "")
                ax.xaxis.set_minor_formatter("")
                ax.xaxis.set_major_formatter("{x:g}")
                handles, texts = ax.get_legend_handles_labels()
                lines |= dict(zip(texts, handles, strict=True))
                if name in PUBLISHED:
                    ax.set_title(f"{name}: return on validation episodes")
                    ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
                    continue
                ax.set(
                    yscale="log",
                    ylim=(min(levels) / 1.3, max(levels) * 1.3),
                    title=f"{name}: cost (- return) on validation episodes",
                )
                wide = max(levels) > WIDE * min(levels)
                ax.yaxis.set_major_locator(LogLocator(subs=(1,) if wide else (1, 2, 5)))
                ax.yaxis.set_major_formatter("{x:g}")
                ax.yaxis.set_minor_locator(NullLocator())
        figure.legend(lines.values(), lines, loc="outside upper center", ncols=4, fontsize=8)
        figure.savefig(out / file, dpi=100)
        plt.close(figure)


PLANTS = {"nominal": "#7f7f7f", "uncertain": "#1b6ca8", "outside": "#c51b7d"}  # as `report` has


def costs(
    out: Path,
    shown: dict[str, dict[str, dict[str, Row]]],
    entries: dict[str, str],
    names: dict[str, str],
    order: Sequence[str],
) -> None:
    """costs.png: minus the return on held-out episodes, logarithmic, of tasks in the plane that
    have an uncertain level: a panel a task, a line a controller, a dot for each of the plants that
    `shown` has (rows by task and algorithm, of which `entries` is the prefix), with its interval.
    """
    import matplotlib.pyplot as plt
    from matplotlib.ticker import LogLocator, NullLocator

    tasks = [name for name in DEFAULT if f"{name}-uncertain" in shown["uncertain"]]
    if not tasks:
        return
    known = {name for cells in shown.values() for here in cells.values() for name in here}
    order = [name for name in order if name in known]
    size = (2.2 * len(tasks) + 1.6, 0.24 * len(order) + 1.3)
    figure, axes = plt.subplots(
        1, len(tasks), figsize=size, sharey=True, squeeze=False, layout="constrained"
    )
    for ax, task in zip(axes[0], tasks, strict=True):
        for plants, color in PLANTS.items():
            here = shown[plants].get(task, {}) | shown[plants].get(f"{task}-uncertain", {})
            entry = f"{entries[plants]}return"
            for k, name in enumerate(order):
                if name in here:
                    low, cost, high = (
                        -here[name][f"{entry}{end}"] for end in ("_high", "", "_low")
                    )
                    ax.plot([low, high], [k, k], color=color, lw=3, alpha=0.5)
                    ax.plot(cost, k, "o", ms=4.5, color=color, label=plants)
        ax.set(xscale="log", title=task, xlabel="cost (- return)")
        ax.set_yticks(range(len(order)), [names[name] for name in order])
        low, high = ax.get_xlim()
        ax.xaxis.set_major_locator(LogLocator(subs=(1,) if high > 30 * low else (1, 1.5, 2, 3, 5)))
        ax.xaxis.set_major_formatter("{x:g}")
        ax.xaxis.set_minor_locator(NullLocator())
        ax.grid(axis="both", color="0.92")
        ax.set_axisbelow(True)
    axes[0, 0].invert_yaxis()
    handles, texts = axes[0, 0].get_legend_handles_labels()
    lines = dict(zip(texts, handles, strict=True))
    figure.legend(lines.values(), lines, loc="outside upper center", ncols=3)
    figure.savefig(out / "costs.png", dpi=100)
    plt.close(figure)


def _curves(
    ax: Any, out: Path, runs: list[Run], labels: dict[str, str], axis: str, unit: float
) -> list[float]:
    """Draw the learners; returns some of their costs (of published tasks, returns)."""
    levels = []
    there, back = _SCALES[runs[0]["task"] in PUBLISHED]
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
        y = np.array([np.interp(x, one[axis], there(one[CURVE])) for one in found])
        color = COLORS[algorithm]
        mean, low, high = (back(one) for one in estimate(interquartile_mean, y.T, resamples=1000))
        ax.plot(x / unit, mean, color=color, lw=1.8, label=labels[algorithm])
        ax.plot(x / unit, back(y).T, color=color, lw=0.6, alpha=0.6)
        if len(found) >= FEWEST:
            ax.fill_between(x / unit, low, high, color=color, alpha=0.18, lw=0)
        levels += [back(y).min(), back(y).max()]
    return levels


def _levels(ax: Any, runs: list[Run], labels: dict[str, str]) -> list[float]:
    """Draw the baselines as lines across, by the same episodes; returns their costs (of published
    tasks, returns).
    """
    levels: list[float] = []
    for run in runs:
        if run["algorithm"] in STYLES and CURVE in run:
            value = run[CURVE] if run["task"] in PUBLISHED else _cost(run[CURVE])
            levels.append(float(value))
            ax.axhline(
                levels[-1],
                color="0.35",
                ls=STYLES[run["algorithm"]],
                lw=1,
                label=labels[run["algorithm"]],
            )
    return levels


def _cost(value: Any) -> Any:
    return np.maximum(-np.asarray(value), 1e-6)


# of cost and of the return of published tasks: what is averaged over seeds, and back
_SCALES = {False: (lambda value: np.log(_cost(value)), np.exp), True: (np.asarray, np.asarray)}
