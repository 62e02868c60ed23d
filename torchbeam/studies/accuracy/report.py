"""Report of work and precision: tables and pictures."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ...core.results import table
from ...plot.canvas import grid, save
from ..common_case import KINDS
from .errors import Errors
from .measurement import Row
from .motions import MOTIONS, Motion
from .references import Reference
from .settings import BASE, FORMS, METHODS, TARGETS, Setting

LOOKS = {"midpoint": "-", "midpoint4": "--", "generalized_alpha": ":", "adaptive": "-."}  # of lines, by method
MARKS = {"linear": ("o", "C0"), "linked": ("s", "C1"), "order 2": ("^", "C2")}
ABOUT = (
    "Motions: {motions}. Error: RMS distance of the tip from a reference over its RMS displacement. Times are CPU time of "
    "one thread, of a call of `simulate`, least of the repeats (medians are in the CSV). Base: linear elements and equal "
    "midpoint steps with no more than the wanted error; where the time did not suffice for such a run (~), the time of its "
    "finest one times its error over the wanted one, which is less than it would be. A mesh and a number of steps were "
    "chosen so that what each is off by adds up to the wanted error at the least cost; that the two cancel in some pairs is "
    "not made use of."
)
BATCHES = "In a batch (of {batch}; of adaptive steps as many as there was time for): CPU ms a sample."
EVERY = "CPU ms by element and method, alone, and (elements, steps or rtol); the base is the first line of each motion."
EXPLICIT = (
    "Explicit methods, rtol = {rtol:g} (rk4: as many steps as are stable), at the finest mesh that there was time for; ~: "
    "scaled up from the first part of the motion, whose whole nobody would wait for."
)
PEERS = "Other programs in the common dynamic case, beside the cheapest setting here of no larger error, 3D and plane."
REFERENCES = "The references are known to: {said}. Errors below twice that are not looked for."
ORDERS = "sudden", "coupled", "silicone"  # motions of the picture of orders


def best(rows: Iterable[Row], target: float, cost: Callable[[Row], float | None] = lambda row: row.seconds) -> Row | None:
    """The cheapest row of an error, or a smaller one."""
    found = [row for row in rows if row.error is not None and row.error <= target and cost(row) is not None]
    return min(found, key=cost, default=None)


def base(rows: Sequence[Row], target: float, cost: Callable[[Row], float | None]) -> tuple[float, bool, Row] | None:
    """What the second-order setting costs at an error, whether that is measured, and its row."""
    of_base = [row for row in rows if (row.element, row.method) == BASE]
    if (found := best(of_base, target, cost)) is not None:
        return cost(found), True, found
    known = [row for row in of_base if row.error is not None and cost(row) is not None]
    if not known:
        return None
    finest = min(known, key=lambda row: row.error)
    return cost(finest) * finest.error / target, False, finest


def markdown(rows: Sequence[Row], known: Mapping[str, Reference], others: Sequence[Mapping[str, Any]]) -> str:
    motions = [motion for motion in MOTIONS if any(row.motion == motion.name for row in rows)]
    implicit = [row for row in rows if row.method in METHODS]
    batch = max((row.batch for row in implicit if row.batch), default=0)
    parts = [ABOUT.format(motions="; ".join(f"**{m.name}**, {m.about}" for m in motions)), _cheapest(motions, implicit),
             BATCHES.format(batch=batch), _batches(motions, implicit), EVERY, _every(motions, implicit)]
    if any(row.element in FORMS for row in rows):
        rtol = next(row.fineness for row in rows if row.element in FORMS and row.method != "rk4")
        parts += [EXPLICIT.format(rtol=rtol), _explicit(rows)]
    if others:
        parts += [PEERS, _peers(implicit, others)]
    said = "; ".join(f"{name} {one.agreement:.1e} (gradient {one.gradient_agreement:.1e})" for name, one in known.items())
    return "\n\n".join((*parts, REFERENCES.format(said=said)))


def _setting(row: Row) -> str:
    return f"{row.element}, {row.method}, {_fineness(row)}"


def _fineness(row: Row) -> str:
    setting = Setting(row.element, row.method, row.elements, row.fineness)
    return f"{row.elements}, {setting.fineness_text()}"


def _ms(seconds: float | None, exact: bool = True) -> str:
    return "" if seconds is None else f"{'' if exact else '~'}{1e3 * seconds:.3g}"


def _ratio(over: float | None, under: float | None, exact: bool = True) -> str:
    return "" if not over or not under else f"{'' if exact else '~'}{over / under:.3g}"


def _percent(value: float | None) -> str:
    return "" if value is None else f"{100 * value:.2g} %" if value >= 5e-4 else f"{value:.1e}".replace("e-0", "e-")


def _target(value: float) -> str:
    return f"{100 * value:g} %" if value >= 1e-3 else f"{value:.0e}".replace("e-0", "e-")


def _cheapest(motions: Sequence[Motion], rows: Sequence[Row]) -> str:
    lines = []
    for motion in motions:
        own = [row for row in rows if row.motion == motion.name]
        for target in TARGETS:
            row, second = best(own, target), base(own, target, lambda row: row.seconds)
            if row is None or second is None:
                continue
            cost, exact, finest = second
            lines.append((motion.name, motion.kind, _target(target), _setting(row), _percent(row.error), _ms(row.seconds),
                          _fineness(finest) if exact else "", _ms(cost, exact), _ratio(cost, row.seconds, exact),
                          _ratio(row.gradient, row.seconds), _percent(row.gradient_error)))
    head = ("motion", "kind", "wanted", "cheapest (elements, steps)", "its error", "ms", "base", "its ms", "times faster",
            "gradient over forward", "its error")
    return table(head, lines, words=4)


def _batches(motions: Sequence[Motion], rows: Sequence[Row]) -> str:
    lines = []
    for motion in motions:
        own = [row for row in rows if row.motion == motion.name]
        for target in TARGETS:
            row, second = (find(own, target, lambda row: row.batch_seconds) for find in (best, base))
            if row is None or second is None:
                continue
            cost, exact, _ = second
            lines.append((motion.name, _target(target), _setting(row), _ms(row.batch_seconds), _ms(cost, exact),
                          _ratio(cost, row.batch_seconds, exact), _ratio(row.batch_gradient, row.batch_seconds)))
    head = "motion", "wanted", "cheapest setting", "ms a sample", "base: ms a sample", "times faster", "gradient over forward"
    return table(head, lines, words=3)


def _every(motions: Sequence[Motion], rows: Sequence[Row]) -> str:
    lines = []
    for motion in motions:
        for element in KINDS:
            for method in METHODS:
                own = [row for row in rows if (row.motion, row.element, row.method) == (motion.name, element, method)]
                found = [best(own, target) for target in TARGETS]
                if any(found):
                    said = ("" if row is None else f"{_ms(row.seconds)} ({_fineness(row)})" for row in found)
                    lines.append((motion.name, element, method, *said))
                elif own and (note := next((row.note for row in own if row.note), "")):
                    lines.append((motion.name, element, method, note.partition(";")[0], *[""] * (len(TARGETS) - 1)))
    return table(("motion", "element", "method", *map(_target, TARGETS)), lines, words=3)


def _explicit(rows: Sequence[Row]) -> str:
    last: dict[tuple[str, str, str], Row] = {}
    for row in rows:
        if row.element in FORMS:
            last[row.motion, row.element, row.method] = row
    lines = [(row.motion, row.element, row.method, f"{row.elements}", "" if row.steps is None else f"{row.steps}",
              row.note.partition(";")[0] if row.error is None and row.note else _percent(row.error),
              "" if row.seconds is None else f"{'~' if row.scaled > 1 else ''}{row.seconds:.3g}", _percent(row.gradient_error),
              _ratio(row.gradient, row.seconds)) for row in last.values()]
    head = ("motion", "form", "method", "elements", "evaluations", "error", "CPU s", "error of the gradient",
            "gradient over forward")
    return table(head, lines, words=3)


def _peers(rows: Sequence[Row], others: Sequence[Mapping[str, Any]]) -> str:
    lines = []
    for one in others:
        ours = [best((row for row in rows if row.motion == name), one["error"]) for name in ("sudden", "sudden, plane")]
        if not one["error"] < 1:
            continue
        said = ("" if row is None else f"{_ms(row.seconds)} ({_setting(row)})" for row in ours)
        lines.append((f"{one['peer']}, {one['space']}", f"{one['elements']}", f"{one['step_ms']:g}", _percent(one["error"]),
                      _ms(one["best_cpu_s"]), *said))
    return table(("program", "elements", "step, ms", "error", "ms", "here, 3D: ms", "here, plane: ms"), lines, words=1)


def pictures(rows: Sequence[Row], curves: Mapping[str, Errors], known: Mapping[str, Reference],
             others: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """accuracy.png: error over CPU time, a panel a motion; orders.png: errors of meshes and steps. None without matplotlib."""
    try:
        _work(rows, known, others, folder / "accuracy.png")
        _orders(curves, folder / "orders.png")
    except ImportError:
        print("matplotlib is not installed (extra 'plot'): no pictures", file=sys.stderr)


def _work(rows: Sequence[Row], known: Mapping[str, Reference], others: Sequence[Mapping[str, Any]], path: Path) -> None:
    motions = [motion for motion in MOTIONS if any(row.motion == motion.name for row in rows)]
    columns = min(3, len(motions))
    panels = grid(-(-len(motions) // columns), columns, (5.2 * columns, 4.2 * -(-len(motions) // columns)))
    for axis in panels[len(motions):]:
        axis.set_visible(False)
    for axis, motion in zip(panels, motions, strict=False):
        own = [row for row in rows if row.motion == motion.name and row.error is not None]
        for element, (mark, colour) in MARKS.items():
            for method, line in LOOKS.items():
                points = sorted((row.seconds, row.error) for row in own
                                if (row.element, row.method) == (element, method) and row.seconds is not None)
                if points:
                    axis.plot(*zip(*points, strict=True), line, marker=mark, color=colour, ms=4, lw=1.2, mfc="white")
        points = [(row.seconds, row.error) for row in own if row.element in FORMS]
        axis.plot(*(zip(*points, strict=True) if points else ((), ())), "x", color="0.4", ms=5)
        for k, one in enumerate(dict.fromkeys(one["peer"] for one in others if motion.name.startswith("sudden"))):
            points = sorted((row["best_cpu_s"], row["error"]) for row in others if row["peer"] == one and row["error"] < 1)
            axis.plot(*zip(*points, strict=True), marker="*Pd"[k % 3], color="k", ms=7, lw=0.8, label=one)
        limit = known[motion.reference].agreement
        if own and limit > 0.1 * min(row.error for row in own):  # what the reference is known to
            axis.axhline(limit, color="0.7", lw=0.8, ls=":")
        axis.set(xscale="log", yscale="log", title=f"{motion.name} ({motion.kind})", xlabel="CPU time / s",
                 ylabel="relative error of the tip")
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=7, frameon=False, loc="lower left")
    for element, (mark, colour) in MARKS.items():
        panels[0].plot([], [], marker=mark, color=colour, ms=4, lw=1.2, mfc="white", label=element)
    for method, line in LOOKS.items():
        panels[0].plot([], [], line, color="0.3", lw=1.2, label=method)
    panels[0].plot([], [], "x", color="0.4", ms=5, label="explicit")
    panels[0].legend(fontsize=7, frameon=False, ncols=2, loc="lower left")
    save(panels[0], path)


def _orders(curves: Mapping[str, Errors], path: Path) -> None:
    shown = [name for name in ORDERS if name in curves] or list(curves)[:1]
    panels = grid(2, len(shown), (4.6 * len(shown), 7.2))
    for k, name in enumerate(shown):
        space, steps = panels[k], panels[len(shown) + k]
        for element, of in curves[name].space.items():
            mark, colour = MARKS[element]
            points = [(one.cost, one.error) for one in of]
            space.plot(*zip(*points, strict=True), marker=mark, color=colour, ms=4, lw=1.2, mfc="white", label=element)
        for method, of in curves[name].time.items():
            points = [(one.cost * 20, one.error) for one in of if one.error < 1]
            if points:
                steps.plot(*zip(*points, strict=True), LOOKS[method], marker=".", lw=1.2, label=method)
        space.set(xscale="log", yscale="log", title=name, xlabel="nodes", ylabel="error of the mesh")
        steps.set(xscale="log", yscale="log", xlabel="CPU s, 16 elements", ylabel="error of the steps")
        space.legend(fontsize=7, frameon=False)
        steps.legend(fontsize=7, frameon=False)
    save(panels[0], path)
