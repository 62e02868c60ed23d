"""Curves: readings and energies over time, equilibria over load, frequencies over speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import choice, instance, listed, number
from ..core.validation import converted, finite, refusal, shown
from ..sensors import Sensor
from ..state.solution import Solution
from .canvas import GREY, Axes, check_label, drawable, drawn_on, ink, line_style, numbers


def history(
    solution: Solution,
    sensor: Sensor,
    ax: Axes | None = None,
    *,
    label: str | None = None,
    **line: Any,
) -> Axes:
    """Readings of a sensor, in its unit, over time (s): one line for each number of the reading.
    Samples of a batch are thin lines, in one colour for each number.

    Args:
        label: text in front of the sensor's own labels
        line: keywords of matplotlib's lines

    Examples:
        >>> ax = tb.plot.history(solution, tb.sensors.TipPosition()["z"], label="tip")
    """
    instance("solution", solution, Solution)
    instance("sensor", sensor, Sensor)
    ax = drawn_on(ax)
    t, values = numbers(solution.t), sensor.flat(solution.state).detach()
    if not values.numel():
        raise ValueError(
            f"a solution with the batch axes {tuple(solution.status.shape)}, without a sample, was "
            "given to a picture; one or more are wanted"
        )
    values = values.reshape(len(t), -1, sensor.size)
    count = values.shape[1]
    crowd = dict(alpha=max(0.15, count**-0.5), lw=0.8) if count > 1 else dict(lw=1.5)
    check_label(label)
    for k, name in enumerate(sensor.labels):
        style = line_style(line, color=ax._get_lines.get_next_color(), **crowd)
        lines = ax.plot(t, numbers(values[..., k]), **style)
        lines[0].set_label(_label(sensor, name, label))
    ax.set(xlabel="time / s", ylabel=_with_unit(sensor))
    ax.margins(x=0)
    if sensor.size > 1 or label:
        _legend(ax)
    return ax


def energies(solution: Solution, ax: Axes | None = None) -> Axes:
    """Energies (J) of one sample over time (s): kinetic, strain, their sum, and the loads' work.
    The gap between the sum and the work is the loss by damping. Raises ValueError for a batch.

    Examples:
        >>> ax = tb.plot.energies(solution)
    """
    instance("solution", solution, Solution)
    ax = drawn_on(ax)
    t, energy = numbers(solution.t), solution.energy
    if energy.kinetic.ndim != 1:
        raise ValueError(
            f"a batch {tuple(energy.kinetic.shape[1:])} of solutions was given to energies; one "
            "sample is wanted"
        )
    total = energy.kinetic + energy.strain
    for x, text, look in (
        (energy.kinetic, "kinetic", dict(color="C0", lw=1)),
        (energy.strain, "strain", dict(color="C1", lw=1)),
        (total, "kinetic + strain", dict(color=ink(ax), lw=1.8)),
        (energy.work, "work of the loads", dict(color="C3", lw=1.5, ls="--")),
    ):
        if x is not None:
            ax.plot(t, numbers(x), label=text, **look)
    ax.set(xlabel="time / s", ylabel="energy / J")
    ax.margins(x=0)
    return _legend(ax)


def load_path(
    path: Any,
    sensor: Sensor,
    ax: Axes | None = None,
    *,
    label: str | None = None,
    name: str = "load factor",
    **line: Any,
) -> Axes:
    """Load-displacement curve: the load factor over a sensor's readings along a path of equilibria.
    Unstable equilibria are dashed. A dot marks a limit point, a cross marks a branch point. Each
    number of the sensor and each sample of a batch has its line.

    Args:
        path: result of `tb.path`: factor (P, ...), state, stable, valid and kind of P equilibria in
            path order
        name: label of the load's axis

    Examples:
        >>> arch = tb.Scene(tb.Beam.arc(1.0, 1.0, 8, strip), [tb.TipLoad(force=(0, 0, -2.0))])
        >>> ax = tb.plot.load_path(tb.path(arch, 1.0), tb.sensors.TipPosition()["z"])
    """
    drawable("path", path, "a torchbeam.Path", "factor", "stable", "kind")
    drawable("sensor", sensor, "a sensor", "flat", "labels")
    ax, label = drawn_on(ax), check_label(label)
    P = len(path.factor)
    factor, good, valid, kind = (
        torch.as_tensor(x).detach().cpu().reshape(P, -1)
        for x in (path.factor, path.stable, path.valid, path.kind)
    )
    values = sensor.flat(path.state).detach().cpu().reshape(P, -1, sensor.size)
    for k, part in enumerate(sensor.labels):
        color = ax._get_lines.get_next_color()
        text = _label(sensor, part, label)
        for i in range(factor.shape[1]):
            n = int(valid[:, i].sum())
            x, y, firm = numbers(values[:n, i, k]), numbers(factor[:n, i]), good[:n, i]
            cuts = [0, *((firm[1:] != firm[:-1]).nonzero()[:, 0] + 1).tolist(), n]
            for first, last in pairwise(cuts):
                piece = slice(max(first - 1, 0), last)
                dash = "-" if firm[first] else "--"
                ax.plot(x[piece], y[piece], **line_style(line, color=color, lw=1.6, ls=dash))
            for which, mark in ((1, "o"), (2, "x")):
                there = (kind[:n, i] == which).numpy()
                ax.plot(x[there], y[there], mark, color=color, ms=5)
        ax.plot([], [], color=color, label=text)
    ax.set(xlabel=_with_unit(sensor), ylabel=name)
    return _legend(ax) if sensor.size > 1 or label else ax


# of a Campbell diagram: of a speed and of a frequency, by rad/s, and their names
SPEED_UNITS = {
    "rad/s": (1.0, 1.0, "(rad/s)", "(rad/s)"),
    "rpm": (30 / math.pi, 0.5 / math.pi, "rpm", "Hz"),
}


def campbell(
    speed: Tensor,
    frequency: Tensor,
    ax: Axes | None = None,
    *,
    orders: Sequence[int] = (1, 2, 3),
    names: Sequence[str] | None = None,
    unit: str = "rad/s",
) -> Axes:
    """Campbell diagram (Campbell 1924): frequencies of a beam over its speed of rotation, with rays
    at multiples of that speed. Where a ray crosses a curve, that order of the rotation excites that
    mode.

    Args:
        speed: (n,) rad/s
        frequency: (n, count) rad/s
        orders: multiples of the speed
        names: of the modes, for a legend
        unit: of the picture: "rad/s", or "rpm", with frequencies in Hz

    Raises:
        ValueError: for other shapes.

    Examples:
        >>> speed = torch.tensor([0.0, 10.0, 20.0])  # rad/s
        >>> rotating = tb.Scene(
        ...     beam, frame=tb.Frame(angular_velocity=speed[:, None] * torch.tensor([0, 0, 1.0]))
        ... )
        >>> ax = tb.plot.campbell(speed, tb.modes(rotating, count=3).frequency)
    """
    ax = drawn_on(ax)
    x, y = (
        numbers(finite(name, converted(v, torch.float64)))
        for name, v in (("speed", speed), ("frequency", frequency))
    )
    if x.ndim != 1 or y.ndim != 2 or len(x) != len(y):
        raise ValueError(
            f"speeds {x.shape} and frequencies {y.shape} were given to campbell; (n,) and (n, "
            "count) are wanted"
        )
    choice("unit", unit, tuple(SPEED_UNITS))
    of_speed, of_frequency, by, seen = SPEED_UNITS[unit]
    x, y, slope = of_speed * x, of_frequency * y, of_frequency / of_speed
    names = None if names is None else listed(names)
    if names is not None and (
        len(names) < y.shape[1] or not all(isinstance(n, str) for n in names)
    ):
        raise refusal(f"names = {shown(names)}", f"{y.shape[1]} texts", are=True)
    for k, curve in enumerate(y.T):
        ax.plot(x, curve, color=f"C{k % 10}", lw=1.6, label=None if names is None else names[k])
    top = 1.05 * y.max()
    for order in (number("an order", order) for order in listed(orders)):
        rise = order * slope
        end = min(x.max(), top / rise)
        ax.plot([0, end], [0, rise * end], color=GREY, lw=0.8, ls=":")
        look = dict(color="0.4", fontsize=8, va="center" if end == x.max() else "bottom")
        place = dict(textcoords="offset points", annotation_clip=False)
        ax.annotate(f"{order:g}/rev", (end, rise * end), (2, 0), **place, **look)
    ax.set(xlabel=f"speed / {by}", ylabel=f"frequency / {seen}")
    ax.set(xlim=(0, x.max()), ylim=(0, top))
    return ax if names is None else legend_above(ax)


def legend_above(ax: Axes) -> Axes:
    """The axes with a legend over them, where it covers no curve and no ray's name."""
    look = dict(frameon=False, fontsize=8, borderpad=0, columnspacing=1.2)
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1.06), ncols=3, **look)
    return ax


def _label(sensor: Sensor, name: str, label: str | None) -> str:
    """Of one of its numbers, behind what a user calls the line."""
    return " ".join(filter(None, (label, name if sensor.size > 1 or label is None else None)))


def _with_unit(sensor: Sensor) -> str:
    return f"{sensor.name}{'' if sensor.unit == '1' else f' / {sensor.unit}'}"


def _legend(ax: Axes) -> Axes:
    """The axes with a legend."""
    ax.legend(frameon=False, fontsize=8)
    return ax


def tried(best: Any, ax: Axes | None = None) -> Axes:
    """Settings that `tb.converge` has tried: error against CPU time. Each element has a colour and
    each method a mark. A ring marks the chosen setting, a line the wanted error.

    Examples:
        >>> best = tb.converge(
        ...     scene, None, lambda state: state.tip.position, rtol=0.05, solve=tb.equilibrium
        ... )
        >>> ax = tb.plot.tried(best)
    """
    drawable("best", best, "a torchbeam.Convergence", "table", "settings")
    ax = drawn_on(ax)
    kinds: dict[tuple[str, str | None], list[Any]] = {}
    for run in best.table:
        kinds.setdefault((run.setting.element, run.setting.method), []).append(run)
    colours = {e: f"C{k}" for k, e in enumerate(dict.fromkeys(e for e, _ in kinds))}
    marks = dict(zip(dict.fromkeys(m for _, m in kinds), "os^", strict=False))
    for (element, method), runs in kinds.items():
        shown = [(1e3 * run.seconds, run.error) for run in runs if 0 < run.error < float("inf")]
        if shown:
            label = element if method is None else f"{element}, {method}"
            mark, color = marks[method], colours[element]
            ax.plot(*zip(*shown, strict=True), mark, color=color, label=label)
    chosen = next(run for run in best.table if run.chosen)
    if chosen.error > 0:
        ring = dict(ms=13, mfc="none", color=ink(ax), label=f"chosen: {best.settings}")
        ax.plot(1e3 * chosen.seconds, chosen.error, "o", **ring)
    ax.axhline(best.rtol, color=GREY, lw=0.8)
    ax.set(xscale="log", yscale="log", xlabel="CPU time / ms", ylabel="relative error")
    ax.legend(fontsize="small")
    return ax
