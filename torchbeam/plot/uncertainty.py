"""Uncertainty: histograms with intervals, convergence, tornado tables, bands of histories."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import listed
from ..core.validation import Value, converted
from .canvas import Axes, axes, check_axes, check_label, drawable, drawn_on, ink, numbers


def histogram(
    samples: Any,
    ax: Axes | None = None,
    *,
    bins: int = 60,
    levels: Sequence[float] = (0.05, 0.5, 0.95),
    interval: float = 0.95,
    label: str | None = None,
    name: str = "y",
) -> Axes:
    """Density of y, a number for each sample, with its mean and quantiles. Each has a strip as wide
    as its interval.

    Args:
        samples: result of `tb.monte_carlo` or `tb.monte_carlo_stream`
        levels: of the quantiles;  interval: confidence level;  name: of y, with its unit

    Raises:
        ValueError: for a y of several numbers.

    Examples:
        >>> samples = tb.monte_carlo(deflection, laws, 256, replicates=16, by_name=True)
        >>> ax = tb.plot.histogram(samples, name="deflection / m")
    """
    drawable("samples", samples, "torchbeam.Samples or a Stream", "mean_interval", "quantile")
    check_label(label)
    ax, levels = drawn_on(ax), listed(levels)
    mean, quantile = samples.mean_interval(interval), samples.quantile(levels, interval)
    if mean.estimate.numel() != 1:
        raise ValueError(
            f"a y {tuple(mean.estimate.shape)} was given to histogram; one number a sample is "
            "wanted"
        )
    look: dict[str, Any] = dict(color="C0", alpha=0.6, label=label)
    if hasattr(samples, "good"):
        ax.hist(numbers(samples.good.reshape(-1)), bins=bins, density=True, **look)
    else:
        whole = samples.all
        least, largest = whole.least.item(), whole.largest.item()
        room = 0.5 * (least == largest)  # of one value, as matplotlib has it
        edges = torch.linspace(least - room, largest + room, bins + 1, dtype=torch.float64)
        share = samples.histogram(edges).reshape(-1)
        ax.stairs(numbers(share / edges.diff()), numbers(edges), fill=True, **look)
    top = ax.get_ylim()[1]
    marks = [("mean", ink(ax), *(x.item() for x in mean))]
    marks += [
        (f"{100 * level:g} %", "C1", *(x[k].item() for x in quantile))
        for k, level in enumerate(levels)
    ]
    for text, color, centre, low, high in marks:
        ax.axvline(centre, color=color, lw=1, ls="-" if text == "mean" else "--")
        if math.isfinite(low) and math.isfinite(high):
            ax.axvspan(low, high, color=color, alpha=0.25, lw=0)
        above = top * (1.06 if text == "mean" else 1.01)
        ax.text(centre, above, text, color=color, ha="center", va="bottom", fontsize=8)
    ax.set(xlabel=name, ylabel="probability density", ylim=(0, top))
    if samples.failed:
        lost: dict[str, Any] = dict(transform=ax.transAxes, ha="right", va="top", fontsize=8)
        ax.text(0.99, 0.97, f"{samples.failed} failed", **lost)
    if label:
        ax.legend(frameon=False, fontsize=8)
    return ax


def convergence(runs: Any, reference: Value | None = None, ax: Axes | None = None) -> Axes:
    """Error of the mean over the number of samples, by run, each with the slope of a line through
    its latter half.

    Args:
        runs: result of `tb.monte_carlo`, of replicates or of independent samples, or several by
            labels, label -> result; y is one number
        reference: the true mean, None = the mean of each run's samples

    Raises:
        ValueError: for a y of several numbers, and for one Sobol sequence.

    Examples:
        >>> samples = tb.monte_carlo(deflection, laws, 1024, replicates=16, by_name=True)
        >>> ax = tb.plot.convergence({"Sobol": samples})
    """
    runs = {"samples": runs} if hasattr(runs, "convergence") else runs
    drawable("runs", runs, "torchbeam.Samples, or label -> torchbeam.Samples", "items")
    ax = drawn_on(ax)
    for k, (label, samples) in enumerate(runs.items()):
        drawable("a run", samples, "torchbeam.Samples", "convergence")
        n, error = samples.convergence(reference)
        if error.ndim != 1:
            raise ValueError(
                f"a y {tuple(error.shape[1:])} was given to convergence; one number a sample is "
                "wanted"
            )
        half = slice(len(n) // 2, None)
        x, y = n[half].double().log(), error[half].log()
        slope = ((x - x.mean()) * (y - y.mean())).sum() / (x - x.mean()).square().sum()
        fit = (y.mean() + slope * (x - x.mean())).exp()
        label = f"{label}: slope {slope.item():.2f}"
        ax.loglog(numbers(n), numbers(error), "o", color=f"C{k}", ms=4, label=label)
        ax.loglog(numbers(n[half]), numbers(fit), color=f"C{k}", lw=1)
    ax.set(xlabel="samples", ylabel="RMS error of the mean")
    ax.legend(frameon=False, fontsize=8)
    return ax


def tornado(table: Any, ax: Axes | None = None, *, name: str = "y") -> Axes:
    """Bars of a `tb.tornado` table, the largest on top: from y at the low quantile of a parameter
    to y at its high one.

    Raises:
        ValueError: for a y of several numbers.

    Examples:
        >>> ax = tb.plot.tornado(tb.tornado(deflection, laws, by_name=True), name="deflection / m")
    """
    drawable("table", table, "a torchbeam.Tornado", "names", "base", "rows")
    ax = axes((6.0, 1.2 + 0.35 * len(table.names))) if ax is None else check_axes(ax)
    if table.base.numel() != 1:
        raise ValueError(
            f"a y {tuple(table.base.shape)} was given to tornado; one number is wanted"
        )
    base, rows = table.base.item(), range(len(table.names) - 1, -1, -1)
    ends = (("low", "C0", table.low), ("high", "C1", table.high))
    values = zip(*(x.reshape(-1).tolist() for *_, x in ends), strict=True)
    for row, both in zip(rows, values, strict=True):
        for (word, color, _), y in zip(ends, both, strict=True):
            label = word if row == rows[0] else None
            ax.barh(row, y - base, left=base, height=0.6, color=color, label=label)
    ax.axvline(base, color=ink(ax), lw=1)
    ax.set_yticks(list(rows), table.names)
    ax.set(xlabel=name)
    ax.legend(frameon=False, fontsize=8, title="parameter", title_fontsize=8)
    return ax


def bands(
    t: Tensor,
    samples: Any,
    ax: Axes | None = None,
    *,
    level: float = 0.9,
    interval: float | None = 0.95,
    label: str | None = None,
    name: str = "y",
    color: str = "C0",
) -> Axes:
    """Median and band of histories y (n, time) over t (time,) s. Thin lines are the ends of their
    confidence intervals, instant by instant.

    Args:
        level: share of the samples within the band;  interval: confidence level, None = no thin
            lines

    Raises:
        ValueError: for another y.

    Examples:
        >>> t = torch.linspace(0, 1, 11)
        >>> samples = tb.monte_carlo(
        ...     lambda P: P[:, None] * t, {"P": laws["P"]}, 256, replicates=16, by_name=True
        ... )
        >>> ax = tb.plot.bands(t, samples, name="deflection / m")
    """
    ax = drawn_on(ax)
    t = converted(t, torch.float64)
    drawable("samples", samples, "torchbeam.Samples", "bands")
    check_label(label)
    band = samples.bands(level, 0.95 if interval is None else interval)
    if band.estimate.shape != (3, *t.shape) or t.ndim != 1:
        raise ValueError(
            f"t {tuple(t.shape)} and y {tuple(band.estimate.shape[1:])} were given to bands; "
            "(time,) is wanted"
        )
    low, middle, high = (numbers(x) for x in band.estimate)
    ax.fill_between(
        numbers(t), low, high, color=color, alpha=0.25, lw=0, label=f"{100 * level:g} % of samples"
    )
    ax.plot(numbers(t), middle, color=color, lw=1.6, label=label or "median")
    if interval is not None:
        for part in (band.low, band.high):
            for line in part:
                ax.plot(numbers(t), numbers(line), color=color, lw=0.6, ls=":")
    ax.set(xlabel="time / s", ylabel=name)
    ax.margins(x=0)
    ax.legend(frameon=False, fontsize=8)
    return ax
