"""Report: the files that a study writes from those of its runs, for people and for programs."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from torchbeam.extend.commands import measured_on, sentence, table

from .cards import policies
from .curves import costs, curve, pictures
from .table import (
    LABELS,
    LEARNERS,
    LEVELS,
    LIBRARIES,
    LINEAR,
    OWN,
    Row,
    Run,
    aggregates,
    as_now,
    comparisons,
    level,
    rows,
)
from .tuned import PUBLISHED, TASKS

KNOWING = ("mpc-informed", "bound")  # no real controller can be
CONTROLLERS = ("linear", "mpc", "adaptive", *OWN, *KNOWING)
NAMES = {"linear": "the best linear controller", "adaptive": "AdaptiveMPC", **LABELS}
NAMES |= {"bound": "AdaptiveMPC, plant known"}
ESTIMATING = {"AdaptiveMPC": "adaptive", "bound": "bound"}  # as `training.adaptive` calls them
# tasks of these levels, by these entries
PLANTS = {"nominal": ("nominal", ""), "uncertain": ("uncertain", "")}
PLANTS |= {"outside": ("uncertain", "outside_")}


def report(out: Path) -> str:
    """Write results.json, results.csv, results.md, summary.md, libraries.md, budgets.md,
    aggregate.md, ahead.md, curves.png and costs.png (with matplotlib) and policies/; returns the
    Markdown of results.md. The summary has what `training.adaptive` has put beside the study, too.
    """
    runs = [json.loads(path.read_text()) for path in sorted((out / "runs").glob("*.json"))]
    curves = partial(curve, out / "runs")
    lines, compared, scores = rows(runs, curves), comparisons(runs, curves), aggregates(runs)
    # of each run; the runs may have been made side by side
    heading = measured_on(dtype=None, threads=1)
    tasks = {run["task"]: vars(TASKS[run["task"]]) for run in runs}
    content = {"tasks": tasks, "rows": lines, "comparisons": compared, "aggregates": scores}
    content["runs"] = runs
    (out / "results.json").write_text(json.dumps({**heading, **content}, indent=2) + "\n")
    if lines:
        with open(out / "results.csv", "w", newline="") as file:
            writer = csv.DictWriter(file, list(lines[0]))
            writer.writeheader()
            writer.writerows(lines)
    failed = sorted(path.stem for path in (out / "runs").glob("*.failed"))
    own = [row for row in compared if row["algorithm"] in OWN]
    summed = [row for row in lines if row["task"] not in PUBLISHED] + estimating(out)
    parts = {
        "summary": summary(summed),
        "libraries": grid(lines, ("ppo", "sb3-ppo", "skrl-ppo", "sac", "sb3-sac"), LIBRARIES),
        "budgets": budgets(lines),
        "aggregate": aggregate(scores),
        "ahead": ahead(own),
    }
    for name, part in parts.items():
        (out / f"{name}.md").write_text(f"{part}\n\n{sentence(heading)}\n")
    whole = markdown(lines), parts["aggregate"], ahead(compared)
    warnings = (*mixed(runs), *(f"{name}: failed" for name in failed))
    text = "\n\n".join((*whole, *warnings, sentence(heading)))
    (out / "results.md").write_text(text + "\n")
    policies(out, runs)
    try:
        import matplotlib
    except ImportError:
        return text
    matplotlib.use("Agg")
    pictures(out, runs)
    shown = {name: _plants(summed, name) for name in PLANTS}
    costs(out, shown, {name: entry for name, (_, entry) in PLANTS.items()}, NAMES, CONTROLLERS)
    return text


def markdown(lines: Sequence[Row]) -> str:
    """All numbers, a row a task and controller."""
    head = (
        *("task", "controller", "return", "success", "final error", "return outside"),
        *("success outside", "ahead of linear", "env steps", "training"),
        *("return at equal steps", "return at equal time"),
    )
    cells = [
        (
            row["task"],
            LABELS[row["algorithm"]],
            _said(row, "return"),
            _said(row, "success", 100, 0, " %"),
            _said(row, "final_error", 1e3, 1, " mm"),
            _said(row, "outside_return"),
            _said(row, "outside_success", 100, 0, " %"),
            _said(row, "better", 100, 0, " %"),
            f"{row['steps']:,.0f}" if row["steps"] else "",
            "" if row["seconds"] is None else f"{row['seconds']:.0f} s",
            _said(row, "return_at_steps"),
            _said(row, "return_at_seconds"),
        )
        for row in lines
    ]
    paragraphs = [table(head, cells, words=2)]
    for task in dict.fromkeys(row["task"] for row in lines):
        learned = [row for row in lines if row["task"] == task and row["seconds"] is not None]
        if learned:
            paragraphs.append(
                f"{task}: equal steps are {learned[0]['common_steps']:,.0f}, equal time is "
                f"{learned[0]['common_seconds']:.0f} CPU s of training on one thread; "
                f"{max(row['runs'] for row in learned)} seeds, interquartile mean [95 % interval]."
            )
    return "\n\n".join(paragraphs)


def estimating(out: Path) -> list[Row]:
    """Rows of controllers that estimate, from the files of `training.adaptive` beside the study."""
    found: dict[tuple[str, str], Row] = {}
    for folder, (_, entry) in (
        ("adaptive", PLANTS["uncertain"]),
        ("adaptive_outside", PLANTS["outside"]),
    ):
        path = out.parent / folder / "adaptive.json"
        for one in json.loads(path.read_text())["rows"] if path.exists() else ():
            if name := ESTIMATING.get(one["controller"]):
                blank = {"return": None, "outside_return": None, "seconds": None}
                task = f"{one['task']}-uncertain"
                row = found.setdefault((task, name), {"task": task, "algorithm": name, **blank})
                for measure, value in (("return", one["total"]), ("success", one["success"])):
                    names = (f"{entry}{measure}{end}" for end in ("", "_low", "_high"))
                    row |= dict.fromkeys(names, value)
    return [*found.values()]


def _plants(lines: Sequence[Row], plants: str) -> dict[str, dict[str, Row]]:
    """The rows of one of `PLANTS` by task and algorithm, the best of `LINEAR` among them."""
    of, entry = PLANTS[plants]
    own = [row for row in lines if level(row["task"]).partition(",")[0] == of]
    cells = _cells(own, f"{entry}return")
    for here in cells.values():
        if linear := [here[name] for name in LINEAR if name in here]:
            here["linear"] = max(linear, key=lambda row: row[f"{entry}return"])
    return cells


def summary(lines: Sequence[Row]) -> str:
    """A row a task of each of `PLANTS`, a column a controller, as `grid` has them."""
    cells = {plants: _plants(lines, plants) for plants in PLANTS}
    tasks = {(plants, task): here for plants, own in cells.items() for task, here in own.items()}
    shown = _shown(CONTROLLERS, tasks)
    found = [
        (plants, task.removesuffix("-uncertain"), *_line(here, shown, PLANTS[plants][1]))
        for (plants, task), here in tasks.items()
    ]
    return table(("plants", "task", *(NAMES[name] for name in shown)), found, words=2)


def grid(lines: Sequence[Row], controllers: Sequence[str], of: Sequence[str]) -> str:
    """A row a task: return, success and, of learners, the number of seeds by controller, the
    largest return in bold (but of `KNOWING`). Tasks without one of the algorithms `of` are left
    out.
    """
    cells = {t: here for t, here in _cells(lines, "return").items() if set(of) & here.keys()}
    shown = _shown(controllers, cells)
    found = [(task, *_line(here, shown, "")) for task, here in cells.items()]
    return table(("task", *(LABELS[name] for name in shown)), found, words=1)


def _line(here: dict[str, Row], shown: Sequence[str], prefix: str) -> list[str]:
    """Cells of a task."""
    real = [here[name][f"{prefix}return"] for name in shown if name in here and name not in KNOWING]
    best = max(real, default=None)
    return [_cell(here, name, prefix, best) if name in here else "" for name in shown]


def _cells(lines: Sequence[Row], entry: str) -> dict[str, dict[str, Row]]:
    """The rows that have such an entry, by task and algorithm."""
    cells: dict[str, dict[str, Row]] = {}
    for row in lines:
        if row[entry] is not None:
            cells.setdefault(row["task"], {})[row["algorithm"]] = row
    return cells


def _shown(algorithms: Sequence[str], cells: dict[Any, dict[str, Row]]) -> list[str]:
    """Those that any task has."""
    return [name for name in algorithms if any(name in here for here in cells.values())]


def _cell(here: dict[str, Row], name: str, prefix: str, best: float | None) -> str:
    row = here[name]
    text = _said(row, f"{prefix}return")
    first = row[f"{prefix}return"] == best and name not in KNOWING
    text = f"**{text}**" if first else text
    seeds = f" ({row['runs']})" if name in LEARNERS else ""
    which = f" ({LABELS[row['algorithm']].partition(' ')[0]})" if name == "linear" else ""
    return f"{text}, {100 * row[f'{prefix}success']:.0f} %{seeds}{which}"


def aggregate(scores: Sequence[Row]) -> str:
    """A row an algorithm: normalised scores by level, in round brackets their means."""
    columns = [
        (here, measure)
        for here in LEVELS
        for measure in ("score", "outside")
        if any((row["level"], row["measure"]) == (here, measure) for row in scores)
    ]
    cells = {(row["level"], row["measure"], row["algorithm"]): row for row in scores}
    shown = [name for name in LABELS if any(key[2] == name for key in cells)]
    head = [f"{here}{', plants outside' * (measure == 'outside')}" for here, measure in columns]
    found = []
    for name in shown:
        own = (cells.get((*column, name)) for column in columns)
        values = (_score(row) if row else "" for row in own)
        found.append((LABELS[name], *values))
    return table(("controller", *head), found, words=1)


def _score(row: Row) -> str:
    return f"{_said(row, 'score', 100, 1, ' %')} ({100 * row['mean']:.1f})"


def budgets(lines: Sequence[Row]) -> str:
    """A row a task: environment steps and training time of a run, by learner."""
    cells = _cells(lines, "seconds")
    shown = _shown(LEARNERS, cells)
    found = [
        (
            task,
            *(
                f"{here[name]['steps']:,.0f}, {here[name]['seconds']:.0f} s" if name in here else ""
                for name in shown
            ),
        )
        for task, here in cells.items()
    ]
    return table(("task", *(LABELS[name] for name in shown)), found, words=1)


def mixed(runs: Sequence[Run]) -> list[str]:
    """A sentence where runs of a task and algorithm are not alike but for their seeds."""
    kinds: dict[str, set[str]] = {}
    for run in map(as_now, runs):
        alike = {name: run.get(name) for name in ("budget", "environment", "episodes")}
        if run["algorithm"] in LEARNERS:
            alike["settings"] = {**run.get("settings", {}), "seed": None}
        group = kinds.setdefault(f"{run['task']} {LABELS[run['algorithm']]}", set())
        group.add(json.dumps(alike, sort_keys=True))
    names = [name for name, found in kinds.items() if len(found) > 1]
    if not names:
        return []
    return [
        "Not alike but for their seeds, in settings, budget, task, episodes or when they were "
        f"validated, are runs of {', '.join(names)}: python -m training.results makes them anew."
    ]


def ahead(compared: Sequence[Row]) -> str:
    """A row a pair: the probability that a seed of the one returns more."""
    found = [
        (
            row["level"],
            LABELS[row["algorithm"]],
            NAMES[row["over"]],
            str(len(row["tasks"])),
            _said(row, "probability", 100, 0, " %"),
            _said(row, "at_steps", 100, 0, " %"),
            _said(row, "at_seconds", 100, 0, " %"),
        )
        for row in compared
    ]
    head = ("level", "a seed of", "returns more than", "tasks", "whole budgets")
    return table((*head, "equal steps", "equal time"), found, words=3)


def _said(
    row: Row, name: str, factor: float = 1.0, digits: int | None = None, unit: str = ""
) -> str:
    """A statistic with its interval, where it has one."""
    if row[name] is None:
        return ""
    value, low, high = (factor * row[key] for key in (name, f"{name}_low", f"{name}_high"))
    digits = 1 + (abs(value) < 10) + (abs(value) < 1) if digits is None else digits
    interval = "" if not low < high else f" [{low:.{digits}f}, {high:.{digits}f}]"
    return f"{value:.{digits}f}{interval}{unit}"
