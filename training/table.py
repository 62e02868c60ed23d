"""Table: what the runs of a study say, as rows of numbers. NAME is an interquartile mean or a
probability, NAME_low and NAME_high its 95 % interval over the seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from .statistics import estimate, improvement, interquartile_mean
from .tuned import PUBLISHED, STUDENT

Run = dict[str, Any]
Curve = dict[str, np.ndarray]
Row = dict[str, Any]
LABELS = {
    "zero": "no action",
    "static": "static feed-forward",
    "pd": "PD + static",
    "lqr": "LQR + static",
    "lqg": "LQG + static",
    "mpc": "MPC",
    "mpc-informed": "MPC, plant known",
    "optimum": "open-loop optimum",
    "resolved-rate": "ResolvedRate",
    "waypoints": "Waypoints",
    "via-point": "ViaPoint",
    "ppo": "PPO",
    "sac": "SAC",
    "shac": "SHAC",
    "student": "student of MPC (GRU)",
    "ppo-gru": "PPO (GRU)",
    "sac-gru": "SAC (GRU)",
    "shac-gru": "SHAC (GRU)",
    "sb3-ppo": "PPO (stable-baselines3)",
    "sb3-sac": "SAC (stable-baselines3)",
    "skrl-ppo": "PPO (skrl)",
}


def label(algorithm: str, task: str) -> str:
    """Of a learner or controller on a task: a student is that of its teacher."""
    teacher = STUDENT.get(task, {}).get("teacher") if algorithm == "student" else None
    return f"student of {teacher.partition('(')[0]}" if teacher else LABELS[algorithm]


LINEAR = ("pd", "lqr", "lqg")
OWN = ("ppo", "sac", "shac", "student", "ppo-gru", "sac-gru", "shac-gru")
LIBRARIES = ("sb3-ppo", "sb3-sac", "skrl-ppo")
LEARNERS = (*OWN, *LIBRARIES)
CURVE = "validation_return"  # of a learner's log
LEVELS = ("nominal", "uncertain", "nominal, 3D", "uncertain, 3D")
SHARES = ("within", "within_half")
AXES = ("steps", "seconds")


def as_now(run: Run) -> Run:
    """A run as it would be written now. Those of before have frames among the arguments of the
    environment, not among the learner's settings, and no memory. SHAC's rates fell over the budget,
    its last weights were kept, and it had no entropy and a single critic. Students learned at the
    task's own pace. What SAC called its memory were transitions of the past.
    """
    settings = run.get("settings", {})
    if run["algorithm"] == "student" and settings:
        settings = {"pace": 1, **settings}
        run = {**run, "settings": settings}
    if run["algorithm"] == "sac" and settings and "replay" not in settings:
        windows = {"replay": settings["memory"], "memory": 0, "window": 32, "burn": 8}
        settings = {**settings, **windows}
        run = {**run, "settings": settings}
    if run["algorithm"].startswith("shac") and settings:
        settings = {"average": 0, "critics": 1, "entropy": 0.0, **settings}
        run = {**run, "settings": settings}
    if "frames" in settings or "environment" not in run:
        return run
    arguments = dict(run["environment"]["arguments"])
    ours = {"frames": arguments.pop("frames", 0)}
    if run["algorithm"] in ("ppo", "shac"):
        ours["memory"] = 0
    if run["algorithm"] == "shac":
        ours["falling"] = run["budget"]["steps"]
    environment = {**run["environment"], "arguments": arguments}
    return {**run, "settings": {**settings, **ours}, "environment": environment}


def level(task: str) -> str:
    """One of `LEVELS`, or "published"."""
    if task in PUBLISHED:
        return "published"
    space = ", 3D" if "-3d" in task else ""
    return ("uncertain" if task.endswith("-uncertain") else "nominal") + space


def rows(runs: Sequence[Run], curves: Callable[[Run], Curve | None]) -> list[Row]:
    """One row a task and algorithm.

    outside_return, outside_success     on plants outside of the training range
    better                              probability that a seed returns more than the best of
                                        `LINEAR` there
    within, within_half                 see `evaluate`
    return_at_steps, return_at_seconds  the learning curves at the environment steps, and at the
                                        training time, that every run of every learner of the task
                                        has had; none where one has not been validated by then
    """
    table = []
    for task in dict.fromkeys(run["task"] for run in runs):
        here = [run for run in runs if run["task"] == task]
        learned = {id(run): found for run in here if (found := curves(run)) is not None}
        common = {axis: _common(learned.values(), axis) for axis in AXES}
        linear = [run["return"] for run in here if run["algorithm"] in LINEAR]
        for algorithm in sorted({run["algorithm"] for run in here}, key=list(LABELS).index):
            group = [run for run in here if run["algorithm"] == algorithm]
            found = [learned[id(run)] for run in group if id(run) in learned]
            row = {"task": task, "algorithm": algorithm, "runs": len(group)}
            for name in ("return", "success", "final_error", *SHARES):
                row |= _entry(name, interquartile_mean, [run[name] for run in group])
            outside = [run["outside"] for run in group if run["outside"]]
            for name in ("return", "success"):
                values = [[run[name] for run in outside]] if outside else []
                row |= _entry(f"outside_{name}", interquartile_mean, *values)
            best = [[run["return"] for run in group], [max(linear)]] if found and linear else []
            row |= _entry("better", improvement, *best)
            row["steps"] = mean([run["steps"] for run in group])
            row["seconds"] = mean([run["seconds"] for run in group]) if found else None
            for axis in AXES:
                row[f"common_{axis}"] = common[axis] if found else None
                at = _at(found, axis, common[axis])
                row |= _entry(f"return_at_{axis}", interquartile_mean, *[at] if at else [])
            row["episodes"] = group[0]["episodes"]
            row["ended"] = sum(run["ended"] for run in group)
            row["solver_failures"] = sum(run["solver_failures"] for run in group)
            table.append(row)
    return table


def comparisons(runs: Sequence[Run], curves: Callable[[Run], Curve | None]) -> list[Row]:
    """Of each pair of learners, and of each and the best linear controller ("linear"), at each
    `level`: the probability that a seed of the one returns more than one of the other, mean over
    the tasks that both have.

    probability                 by held-out episodes, each with its whole budget
    at_steps, at_seconds        by validation episodes, at the environment steps and the training
                                time of the shortest of their runs, of the tasks where all have been
                                validated by then
    """
    table = []
    for here in LEVELS:
        own = [run for run in runs if level(run["task"]) == here]
        groups: dict[str, dict[str, list[Run]]] = {}
        for run in own:
            if run["algorithm"] in LEARNERS:
                by_task = groups.setdefault(run["algorithm"], {})
                by_task.setdefault(run["task"], []).append(run)
        names = sorted(groups, key=list(LABELS).index)
        linear: dict[str, list[float]] = {}
        for run in own:
            if run["algorithm"] in LINEAR:
                linear[run["task"]] = [max([run["return"], *linear.get(run["task"], [])])]
        for one in names:
            pairs = {
                task: ([run["return"] for run in group], linear[task])
                for task, group in groups[one].items()
                if task in linear
            }
            table += _comparison(here, one, "linear", {"probability": pairs})
        for other, one in combinations(names, 2):
            both = {
                task: (groups[one][task], groups[other][task])
                for task in groups[one]
                if task in groups[other]
            }
            pairs = {
                task: tuple([run["return"] for run in side] for side in sides)
                for task, sides in both.items()
            }
            measures = {"probability": pairs}
            for axis in AXES:
                measures[f"at_{axis}"] = {
                    task: found
                    for task, sides in both.items()
                    if (found := _at_equal(sides, curves, axis)) is not None
                }
            table += _comparison(here, one, other, measures)
    return table


def _comparison(
    here: str, one: str, other: str, measures: dict[str, dict[str, Sequence[list[float]]]]
) -> list[Row]:
    """A row, or none where they share no task."""
    tasks = list(measures["probability"])
    if not tasks:
        return []
    row: Row = {"level": here, "algorithm": one, "over": other, "tasks": tasks}
    for name in ("probability", "at_steps", "at_seconds"):
        strata = [side for sides in measures.get(name, {}).values() for side in sides]
        row |= _entry(name, _mean_improvement, *strata)
    return [row]


def _mean_improvement(*groups: np.ndarray) -> np.ndarray:
    """Of the first over the second of each pair of groups, mean over the pairs."""
    pairs = zip(groups[::2], groups[1::2], strict=True)
    return np.mean([improvement(*pair) for pair in pairs], axis=0)


def aggregates(runs: Sequence[Run]) -> list[Row]:
    """Of each algorithm that has been run on all tasks of one of `LEVELS`: the interquartile mean
    over all tasks and seeds together, runs drawn anew within each task (Agarwal et al. 2021). As it
    leaves out the lowest and the highest quarter, a task in which all runs do badly may be in
    neither; `mean` leaves out nothing.

    score       of normalised returns: 0 is no action, 1 the best of the baselines there, MPC that
                knows the plant among them
    outside     likewise, with the returns outside of the training range
    """
    table = []
    for here in LEVELS:
        for measure in ("score", "outside"):
            returns: dict[str, dict[str, list[float]]] = {}
            for run in runs:
                scores = run["outside"] if measure == "outside" else run
                if level(run["task"]) == here and scores:
                    by_algorithm = returns.setdefault(run["task"], {})
                    by_algorithm.setdefault(run["algorithm"], []).append(scores["return"])
            normalised = [one for one in map(_normalised, returns.values()) if one]
            for algorithm in LABELS:
                strata = [one.get(algorithm, []) for one in normalised]
                if strata and all(strata):
                    row = {"level": here, "measure": measure, "algorithm": algorithm}
                    row |= {"tasks": len(strata), "runs": sum(map(len, strata))}
                    row |= {"mean": mean([mean(one) for one in strata])}
                    table.append(row | _entry("score", _pooled, *strata))
    return table


def _normalised(returns: dict[str, list[float]]) -> dict[str, list[float]]:
    """Returns of a task by algorithm, as scores; none where no baseline is better than no
    action.
    """
    low = returns.get("zero", [float("inf")])[0]
    high = max((x for name in returns if name not in LEARNERS for x in returns[name]), default=low)
    if not high > low:
        return {}
    return {name: [(x - low) / (high - low) for x in xs] for name, xs in returns.items()}


def _pooled(*strata: np.ndarray) -> np.ndarray:
    return interquartile_mean(np.concatenate(strata, -1))


def _common(curves: Any, axis: str) -> float | None:
    return min((float(curve[axis][-1]) for curve in curves), default=None)


def _at(curves: Sequence[Curve], axis: str, value: float | None) -> list[float] | None:
    """Their validation returns there; None where there are none, or one of them has not been
    validated by then since it began.
    """
    if not curves or any(value < curve[axis][1] for curve in curves):
        return None
    return [float(np.interp(value, curve[axis], curve[CURVE])) for curve in curves]


def _at_equal(
    sides: Sequence[Sequence[Run]], curves: Callable[[Run], Curve | None], axis: str
) -> list[list[float]] | None:
    """Validation returns of two groups of runs where the shortest of them ends; None where a log is
    missing, or one has not been validated by then.
    """
    logs = [[curves(run) for run in side] for side in sides]
    if any(log is None for side in logs for log in side):
        return None
    end = _common([log for side in logs for log in side], axis)
    found = [_at(side, axis, end) for side in logs]
    return None if None in found else found


def _entry(name: str, statistic: Callable[..., Any], *strata: list[float]) -> Row:
    """A statistic with its interval, in a row; None where there are no runs."""
    values = map(float, estimate(statistic, *strata)) if strata else (None,) * 3
    return dict(zip((name, f"{name}_low", f"{name}_high"), values, strict=True))


def mean(values: list[float]) -> float:
    return float(np.mean(values))
