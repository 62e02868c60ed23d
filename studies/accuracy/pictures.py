"""Pictures: error over CPU time, and errors of meshes and of steps over how fine they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torchbeam.plot.canvas import grid, save

from .errors import Errors
from .measurement import AccuracyRun
from .motions import MOTIONS
from .references import Reference
from .settings import FORMS

# of lines, by method
LOOKS = {"midpoint": "-", "midpoint4": "--", "generalized_alpha": ":", "adaptive": "-."}
MARKS = {"linear": ("o", "C0"), "linked": ("s", "C1"), "order 2": ("^", "C2")}
LINE: dict[str, Any] = dict(ms=4, lw=1.2, mfc="white")
ORDERS = "sudden", "coupled", "silicone"  # motions of the picture of orders


def pictures(
    rows: Sequence[AccuracyRun],
    curves: Mapping[str, Errors],
    known: Mapping[str, Reference],
    others: Sequence[Mapping[str, Any]],
    folder: Path,
) -> None:
    """accuracy.png: error over CPU time, a panel a motion; orders.png: errors of meshes and steps.
    Raises ImportError without matplotlib.
    """
    _work(rows, known, others, folder / "accuracy.png")
    _orders(curves, folder / "orders.png")


def _work(
    rows: Sequence[AccuracyRun],
    known: Mapping[str, Reference],
    others: Sequence[Mapping[str, Any]],
    path: Path,
) -> None:
    motions = [motion for motion in MOTIONS if any(row.motion == motion.name for row in rows)]
    columns = min(3, len(motions))
    panels = grid(
        -(-len(motions) // columns), columns, (5.2 * columns, 4.2 * -(-len(motions) // columns))
    )
    for axis in panels[len(motions) :]:
        axis.set_visible(False)
    for axis, motion in zip(panels, motions, strict=False):
        own = [row for row in rows if row.motion == motion.name and row.error is not None]
        for element, (mark, colour) in MARKS.items():
            for method, line in LOOKS.items():
                points = sorted(
                    (row.seconds, row.error)
                    for row in own
                    if (row.element, row.method) == (element, method) and row.seconds is not None
                )
                if points:
                    axis.plot(*zip(*points, strict=True), line, marker=mark, color=colour, **LINE)
        points = [(row.seconds, row.error) for row in own if row.element in FORMS]
        axis.plot(*(zip(*points, strict=True) if points else ((), ())), "x", color="0.4", ms=5)
        for k, one in enumerate(
            dict.fromkeys(other["peer"] for other in others if motion.name.startswith("sudden"))
        ):
            points = sorted(
                (row["best_cpu_s"], row["error"])
                for row in others
                if row["peer"] == one and row["error"] < 1
            )
            axis.plot(
                *zip(*points, strict=True), marker="*Pd"[k % 3], color="k", ms=7, lw=0.8, label=one
            )
        limit = known[motion.reference].agreement
        if own and limit > 0.1 * min(row.error for row in own):  # what the reference is known to
            axis.axhline(limit, color="0.7", lw=0.8, ls=":")
        axis.set(
            xscale="log", yscale="log", title=f"{motion.name} ({motion.kind})",
            xlabel="CPU time / s", ylabel="relative error of the tip",
        )  # fmt: skip
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=7, frameon=False, loc="lower left")
    for element, (mark, colour) in MARKS.items():
        panels[0].plot([], [], marker=mark, color=colour, label=element, **LINE)
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
            style = dict(marker=mark, color=colour, label=element, **LINE)
            space.plot(*zip(*points, strict=True), **style)
        for method, of in curves[name].time.items():
            points = [(one.cost * 20, one.error) for one in of if one.error < 1]
            if points:
                steps.plot(
                    *zip(*points, strict=True), LOOKS[method], marker=".", lw=1.2, label=method
                )
        space.set(
            xscale="log", yscale="log", title=name, xlabel="nodes", ylabel="error of the mesh"
        )
        steps.set(
            xscale="log", yscale="log", xlabel="CPU s, 16 elements", ylabel="error of the steps"
        )
        space.legend(fontsize=7, frameon=False)
        steps.legend(fontsize=7, frameon=False)
    save(panels[0], path)
