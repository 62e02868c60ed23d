"""Figures: what was learned, in one picture and one animation."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
import torch
from PIL import Image

from torchbeam.extend.commands import written

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from .episodes import CLOSE, WINDOW, Record

HELD = 600  # ms, the last picture of the animation
COLORS = {
    "nothing": "#b8b8b8",
    "static force": "#7f7f7f",
    "PD + static force": "#e08214",
    "learned": "#1b6ca8",
}
STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "legend.frameon": False,
}


def picture(records: dict[str, Record], result: dict, path: Path) -> None:
    """Learning curve, distances, one episode's tip paths and forces, the strip's shapes, and the
    spread over the targets.
    """
    with plt.rc_context(STYLE):
        figure, axes = plt.subplot_mosaic(
            [["learning", "distances", "spread"], ["shapes", "paths", "forces"]],
            figsize=(14, 7.2),
            height_ratios=(1.1, 1),
            width_ratios=(1.15, 1, 1),
            layout="constrained",
        )
        figure.suptitle(result["sentence"], x=0.01, ha="left", fontsize=11)
        one = example(records["learned"])
        _learning(axes["learning"], result)
        _distances(axes["distances"], records)
        _spread(axes["spread"], records)
        _shapes(axes["shapes"], records["learned"], one)
        _paths(axes["paths"], records, one)
        _forces(axes["forces"], records, one)
        with written(path) as part:
            figure.savefig(part, dpi=130, format="png")
        plt.close(figure)


def example(record: Record) -> int:
    """The episode to show: a target far off in both directions."""
    away = (record.target - record.nodes[0, :, -1]).abs()
    return int((away[:, 1] / away[:, 1].max() * away[:, 2] / away[:, 2].max()).argmax())


def _time(record: Record, start: int = 1) -> torch.Tensor:
    return torch.arange(start, len(record.distance) + 1) * record.interval


def _learning(ax: plt.Axes, result: dict) -> None:
    updates = [entry["update"] + 1 for entry in result["learning"]]
    ax.semilogy(
        updates,
        [1e3 * entry["final_distance_m"] for entry in result["learning"]],
        color=COLORS["learned"],
    )
    for name in ("static force", "PD + static force"):
        level = 1e3 * result["scores"][name]["final_distance_m"]
        ax.axhline(level, color=COLORS[name], ls="--", lw=1)
        ax.annotate(
            name.replace(" + ", " +\n") + ",\nunseen targets",
            (1.0, level),
            xycoords=("axes fraction", "data"),  # beside the axes, where no curve runs
            xytext=(4, 0),
            textcoords="offset points",
            ha="left",
            va="center",
            color=COLORS[name],
            fontsize=8,
        )
    ax.set(
        title=f"Learning: mean over {result['settings']['batch']} training episodes, varied strips",
        xlabel="update",
        ylabel=f"final distance, mean of last {WINDOW} s (mm)",
    )


def _distances(ax: plt.Axes, records: dict[str, Record]) -> None:
    for name, record in records.items():
        t, d = _time(record), 1e3 * record.distance
        ax.semilogy(t, d.median(1).values, color=COLORS[name], label=name)
        low, high = torch.quantile(d, torch.tensor([0.1, 0.9], dtype=d.dtype), dim=1)
        ax.fill_between(t, low, high, color=COLORS[name], alpha=0.15, lw=0)
    ax.axhline(1e3 * CLOSE * record.length, color="k", lw=0.6, ls=":")
    ax.annotate(
        "2 % of\nlength",
        (1.0, 1e3 * CLOSE * record.length),
        xycoords=("axes fraction", "data"),
        xytext=(4, 0),
        textcoords="offset points",
        va="center",
        fontsize=8,
    )
    ax.set(
        title=f"{d.shape[1]} unseen targets: median, 10 to 90 %",
        xlabel="time (s)",
        ylabel="tip to target (mm)",
    )
    ax.set_ylim(bottom=1e-2)
    ax.legend(loc="lower left", fontsize=8)


def _spread(ax: plt.Axes, records: dict[str, Record]) -> None:
    for name, record in records.items():
        final = (1e3 * record.final).sort().values
        ax.semilogx(
            final, torch.arange(1, len(final) + 1) / len(final), color=COLORS[name], label=name
        )
    ax.set(
        title="Share of unseen targets reached",
        xlabel="final distance (mm)",
        ylabel="share at or below",
        ylim=(0, 1.02),
    )


def _shapes(ax: plt.Axes, record: Record, one: int) -> None:
    nodes = smooth(record.nodes[:, one])
    last = min(20, len(nodes) - 1)
    for k in range(last + 1):
        ax.plot(nodes[k, :, 0], nodes[k, :, 1], color=plt.cm.viridis(k / last), lw=1.2)
    ax.plot(*record.target[one, :2], "x", color="crimson", ms=9, mew=2, zorder=5)
    ax.plot(0, 0, "s", color="k", ms=7)
    scale = plt.Normalize(0, last * record.interval)
    plt.colorbar(
        plt.cm.ScalarMappable(scale, "viridis"),
        ax=ax,
        orientation="horizontal",
        shrink=0.7,
        aspect=40,
        label="time (s)",
    )
    ax.set(
        title="Learned: the strip from above (true proportions)",
        xlabel="x (m)",
        ylabel="y (m)",
        aspect="equal",
    )


def _paths(ax: plt.Axes, records: dict[str, Record], one: int) -> None:
    for name, record in records.items():
        if name != "nothing":
            tip = record.nodes[:, one, -1]
            ax.plot(tip[:, 1], tip[:, 2], color=COLORS[name], label=name, marker=".", ms=3, lw=1)
    ax.plot(*record.target[one, 1:], "x", color="crimson", ms=9, mew=2, zorder=5, label="target")
    ax.set(title="The same target: the tip seen along the strip", xlabel="y (m)", ylabel="z (m)")
    ax.legend(fontsize=8)


def _forces(ax: plt.Axes, records: dict[str, Record], one: int) -> None:
    for name in ("PD + static force", "learned"):
        force = records[name].force[:, one]
        for i, (axis, style) in enumerate((("y", "-"), ("z", "--"))):
            ax.step(
                _time(records[name], 1) - records[name].interval,
                force[:, i],
                style,
                where="post",
                color=COLORS[name],
                label=f"{name}, {axis}",
            )
    ax.set(title="The same target: tip force", xlabel="time (s)", ylabel="N")
    ax.legend(fontsize=8)


def smooth(nodes: torch.Tensor, points: int = 8) -> torch.Tensor:
    """(..., N+1, 3) -> (..., points * N + 1, 3): cubics through the nodes, clamped along x at the
    root; for the eye only.
    """
    inner = (nodes[..., 2:, :] - nodes[..., :-2, :]) / 2
    chord = nodes.diff(dim=-2)
    root = torch.zeros_like(chord[..., :1, :])
    root[..., 0] = chord[..., :1, :].norm(dim=-1)
    tip = (3 * chord[..., -1:, :] - (inner if nodes.shape[-2] > 2 else root)[..., -1:, :]) / 2
    slope = torch.cat((root, inner, tip), -2)
    s = torch.arange(points, dtype=nodes.dtype)[:, None] / points
    a, b, m, n = (
        x[..., None, :]
        for x in (nodes[..., :-1, :], nodes[..., 1:, :], slope[..., :-1, :], slope[..., 1:, :])
    )
    curve = a + s * m + s**2 * (3 * (b - a) - 2 * m - n) + s**3 * (m + n - 2 * (b - a))
    return torch.cat((curve.flatten(-3, -2), nodes[..., -1:, :]), -2)


def animation(records: dict[str, Record], path: Path, stride: int = 1) -> None:
    """The strip under each controller, from above and from the side, at half speed. What stands
    still is drawn once.
    """
    with plt.rc_context(STYLE):
        one = example(records["learned"])
        shown = [name for name in records if name != "nothing"]
        figure, (top, side) = plt.subplots(
            2, 1, figsize=(6.4, 5.2), height_ratios=(3, 1.3), layout="constrained", dpi=90
        )
        everything = torch.cat([records[name].nodes[:, one] for name in shown])
        low, high = everything.amin((0, 1)) - 0.05, everything.amax((0, 1)) + 0.05
        record, lines, trails, moving = records["learned"], {}, {}, []
        shapes = {name: smooth(records[name].nodes[:, one]) for name in shown}
        for ax, axis, label in ((top, 1, "y (m), from above"), (side, 2, "z (m), from the side")):
            ax.set(
                xlim=(-0.03, high[0].item()),
                ylim=(low[axis].item(), high[axis].item()),
                aspect="equal",
                ylabel=label,
            )
            ax.plot(0, 0, "s", color="k", ms=7)
            for name in shown:
                lines[ax, name] = ax.plot(
                    [], [], color=COLORS[name], lw=2.2 if name == "learned" else 1.5, label=name
                )[0]
                trails[ax, name] = ax.plot([], [], color=COLORS[name], lw=0.6, alpha=0.7)[0]
                moving += [lines[ax, name], trails[ax, name]]
            moving += ax.plot(*record.target[one, [0, axis]], "x", color="crimson", ms=9, mew=2)
        top.legend(loc="upper left", fontsize=8)
        side.set_xlabel("x (m)")
        title = top.set_title("t = 0.00 s (half speed)")
        figure.draw_without_rendering()  # places the axes
        figure.set_layout_engine("none")
        for artist in (*moving, title):
            artist.set_animated(True)
        figure.canvas.draw()
        still, pictures = figure.canvas.copy_from_bbox(figure.bbox), []
        for k in range(0, len(record.nodes), stride):
            for ax, axis in ((top, 1), (side, 2)):
                for name in shown:
                    shape = shapes[name]
                    lines[ax, name].set_data(shape[k, :, 0], shape[k, :, axis])
                    trails[ax, name].set_data(shape[: k + 1, -1, 0], shape[: k + 1, -1, axis])
            title.set_text(f"t = {k * record.interval:.2f} s (half speed)")
            figure.canvas.restore_region(still)
            for artist in (*moving, title):
                artist.axes.draw_artist(artist)
            pictures.append(Image.fromarray(np.array(figure.canvas.buffer_rgba())[..., :3]))
        plt.close(figure)
    colors = pictures[-1].quantize(method=Image.Quantize.MAXCOVERAGE)
    pictures = [each.quantize(palette=colors, dither=Image.Dither.NONE) for each in pictures]
    lasts = [round(2000 * stride * record.interval)] * (len(pictures) - 1) + [HELD]  # ms
    with written(path, path.suffix) as part:
        pictures[0].save(part, save_all=True, append_images=pictures[1:], duration=lasts, loop=0)
