"""Pictures of an identification: fit and residuals, correlations, profiles, designs."""

from __future__ import annotations

import textwrap
from typing import Any

import torch

from .canvas import GREY, Axes, axes, check_axes, drawable, grid, ink, numbers

BAND = 1.96  # deviations to either side
LABEL = 20  # letters of a line of a name beside a matrix


def fit(fit: Any) -> list[Axes]:
    """Data and model of a `Fit` over time, with residuals below: a column of two axes for each
    channel of several readings. The band about the model holds 95 % of readings: uncertainty of
    parameters and noise together. The band about zero residual is of noise alone. Measurements of a
    single reading are left out.

    Raises:
        ValueError: for a fit all of whose measurements are single readings.

    Examples:
        >>> x = torch.linspace(0, 1, 9)
        >>> fit = tb.identify(
        ...     lambda p: p["b"][..., None] * x, 2 * x + 0.01 * torch.cos(40 * x), {"b": 1.0}
        ... )
        >>> panels = tb.plot.fit(fit)
    """
    drawable("fit", fit, "a torchbeam.Fit", "readings", "names")
    series = [reading for reading in fit.readings if reading.data.ndim and len(reading.data) > 1]
    shown = [(reading, k, name) for reading in series for k, name in enumerate(reading.names)]
    if not shown:
        raise ValueError(
            "a fit to single readings was given to plot.fit; one with readings over time is wanted"
        )
    places = grid(2, len(shown), (5.0 * len(shown), 4.6))
    for column, (reading, k, name) in enumerate(shown):
        above, below = places[column], places[len(shown) + column]
        data, y = (reading.columns(v)[k] for v in (reading.data, reading.y))
        t = torch.arange(len(data)) if reading.times is None else reading.times
        noise = torch.ones_like(y) if reading.sigma is None else reading.columns(reading.sigma)[k]
        noise = noise * fit.scale
        deviation = torch.zeros_like(y)
        if reading.deviation is not None:
            deviation = reading.columns(reading.deviation)[k].nan_to_num()
        order = t.argsort()
        t, data, y, noise, deviation = (v[order] for v in (t, data, y, noise, deviation))
        room = BAND * (deviation.square() + noise.square()).sqrt()
        t, data, y, room, noise = map(numbers, (t, data, y, room, BAND * noise))
        above.fill_between(t, y - room, y + room, color="C0", alpha=0.2, lw=0)
        above.plot(t, data, ".", ms=4, color=GREY, label="data")
        above.plot(t, y, "C0", lw=1.2, label="model")
        below.fill_between(t, -noise, noise, color="0.9", lw=0)
        below.plot(t, data - y, ".", ms=4, color="C3")
        below.axhline(0, color=ink(below), lw=0.8)
        above.set(title=name, ylabel="reading")
        below.set(xlabel="sample" if reading.times is None else "time / s", ylabel="data - model")
        for axis in (above, below):
            axis.margins(x=0)
    places[0].legend(frameon=False, fontsize=8)
    return places


def correlation(fit: Any, ax: Axes | None = None) -> Axes:
    """Correlation matrix of the parameters of a `Fit`, as coloured numbers. Parameters that the
    data do not determine are grey.

    Examples:
        >>> x = torch.linspace(0, 1, 9)
        >>> model = lambda p: p["a"][..., None] + p["b"][..., None] * x
        >>> fit = tb.identify(model, 1 + 2 * x + 0.01 * torch.cos(40 * x), {"a": 0.5, "b": 1.0})
        >>> ax = tb.plot.correlation(fit)
    """
    drawable("fit", fit, "a torchbeam.Fit", "readings", "names")
    p, names = len(fit.names), [textwrap.fill(name, LABEL) for name in fit.names]
    ax = axes((2.2 + 0.62 * p, 1.8 + 0.62 * p)) if ax is None else check_axes(ax)
    determined = ~fit.open
    values = torch.where(determined[:, None] & determined, fit.correlation, torch.nan)
    ax.set_facecolor("0.85")
    ax.imshow(numbers(values), vmin=-1, vmax=1, cmap="RdBu_r")
    for i in range(p):
        for j in range(p):
            if determined[i] and determined[j]:
                value = values[i, j].item()
                color = "w" if abs(value) > 0.6 else "k"
                ax.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=8, color=color)
    ax.set_xticks(range(p), names, rotation=45, ha="right", rotation_mode="anchor", fontsize=8)
    ax.set_yticks(range(p), names, fontsize=8)
    return ax


def profile(profile: Any, ax: Axes | None = None) -> Axes:
    """Profile of one parameter, from `Fit.profile`: the rise of the least misfit over the value at
    which the parameter is held. The threshold and the interval are drawn.

    Examples:
        >>> x = torch.linspace(0, 1, 9)
        >>> fit = tb.identify(
        ...     lambda p: p["b"][..., None] * x, 2 * x + 0.01 * torch.cos(40 * x), {"b": 1.0}
        ... )
        >>> ax = tb.plot.profile(fit.profile("b")[0])
    """
    drawable("profile", profile, "one of `Fit.profile`", "interval", "rise", "threshold")
    ax = axes((4.6, 3.2)) if ax is None else check_axes(ax)
    low, high = profile.interval.tolist()
    good = torch.isfinite(profile.rise)
    ax.plot(numbers(profile.values[good]), numbers(profile.rise[good]), "C0.-", label="profile")
    best = int(profile.rise.argmin())
    for end in (low, high):
        if abs(end) != float("inf"):
            ax.plot([end, end], [0, profile.threshold], "C3", lw=1)
    ax.axhline(
        profile.threshold, color="C3", lw=0.8, ls="--", label=f"threshold {profile.threshold:.2f}"
    )
    ax.axvline(profile.values[best].item(), color=GREY, lw=0.8)
    top = float(profile.rise[good].max())
    ax.set(
        xlabel=profile.name, ylabel="rise of the misfit", ylim=(0, min(top, 3 * profile.threshold))
    )
    ax.legend(frameon=False, fontsize=8)
    return ax


def design(plan: Any) -> list[Axes]:
    """A `Design` in two pictures. The left picture shows the criterion after each chosen sensor.
    Lines show the criterion of all candidates, and the lower bound of any choice of as many. The
    right picture shows the factor by which the criterion rises without a chosen candidate. In grey:
    the factor with a further candidate.

    Examples:
        >>> model = lambda p: (p["F"][:, None] * torch.tensor([1.0, 4.0, 9.0])).unbind(-1)
        >>> places = {f"place {k}": tb.Measurement(torch.nan, 0.1) for k in range(3)}
        >>> panels = tb.plot.design(tb.design(model, places, {"F": 2.0}, sensors=2))
    """
    drawable("plan", plan, "a torchbeam.Design", "sensors", "change", "bound")
    left, right = grid(1, 2, (11.0, max(3.6, 1.2 + 0.2 * len(plan.change))))
    left.plot(range(1, len(plan.value) + 1), numbers(plan.value), "C0o-", label="chosen")
    for value, style, label in ((plan.bound, "--", "as many at best"), (plan.whole, ":", "all")):
        left.axhline(value, color=GREY, ls=style, lw=1, label=label)
    left.set_xticks(range(1, len(plan.value) + 1), plan.sensors, rotation=45, ha="right",
                    rotation_mode="anchor", fontsize=8)  # fmt: skip
    left.set(ylabel=f"{plan.criterion}-criterion, a deviation", ylim=(0, None))
    left.legend(frameon=False, fontsize=8)
    names = [*plan.change]
    factors = torch.tensor([plan.change[name] for name in names])
    factors = factors.clamp(max=10 * max([1.0, *factors[factors.isfinite()].tolist()]))
    colors = ["C0" if name in plan.measurements else GREY for name in names]
    right.barh(range(len(names)), numbers(factors - 1), left=1.0, color=colors)
    right.set_yticks(range(len(names)), names, fontsize=8)
    right.axvline(1.0, color=ink(right), lw=0.8)
    right.set(xlabel="factor of the criterion without it, or (grey) with it too")
    right.invert_yaxis()
    return [left, right]
