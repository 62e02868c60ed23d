"""Limits of pictures: which coordinates axes show, at which scale, with how much room."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.arguments import choice
from .axis import PLANES
from .canvas import Axes, axes, check_axes, is_3d, numbers


def prepared(ax: Axes | None, plane: str | None, position: Tensor) -> tuple[Axes, list[int]]:
    """Axes, and which coordinates they show of positions (samples, N+1, 3); raises as `shape`."""
    choice("plane", plane, (*PLANES, None))
    if ax is not None and is_3d(check_axes(ax)):
        return ax, [0, 1, 2]
    if plane is None:
        extent = position.flatten(0, -2).amax(0) - position.flatten(0, -2).amin(0)
        least = 1e-6 * extent.max()
        flat = [name for name, pair in PLANES.items() if extent[3 - sum(pair)] <= least]
        if not flat and ax is not None:
            raise ValueError(
                "flat axes were given for a beam that is in no plane of two coordinates; say plane="
            )
        at = [pair for pair in flat if extent[list(PLANES[pair])].min() > 0] or flat
        plane = at[0] if at else None
    seen = [0, 1, 2] if plane is None else list(PLANES[plane])
    if ax is None:
        ax = axes((6, 5) if plane is None else (6, 3.8), three=plane is None)
    return ax, seen


def extent(position: Tensor) -> float:
    """Size m of what has nodes at position (..., N+1, 3) m."""
    points = position.flatten(0, -2)
    return torch.linalg.vector_norm(points.amax(0) - points.amin(0)).item()


def even(ax: Axes, seen: list[int]) -> Axes:
    """The axes with equal scales, names, and room around what was drawn."""
    names = (ax.set_xlabel, ax.set_ylabel, *([ax.set_zlabel] if is_3d(ax) else []))
    for set_label, i in zip(names, seen, strict=True):
        set_label(f"{'xyz'[i]} / m")
    if not is_3d(ax):
        ax.set_aspect("equal", adjustable="datalim")
        return ax
    from matplotlib.ticker import MaxNLocator

    flat, deep = ax.xy_dataLim, ax.zz_dataLim  # of all that was drawn
    least, most = (flat.x0, flat.y0, deep.x0), (flat.x1, flat.y1, deep.x1)
    half = max(0.3 * max(b - a for a, b in zip(least, most, strict=True)), 1e-12)
    sizes = []
    for set_limits, a, b in zip((ax.set_xlim, ax.set_ylim, ax.set_zlim), least, most, strict=True):
        middle, reach = (a + b) / 2, max((b - a) / 2 * 1.05, half / 2)
        set_limits(middle - reach, middle + reach)
        sizes.append(reach)
    ax.set_box_aspect(sizes)
    for axis, size in zip((ax.xaxis, ax.yaxis, ax.zaxis), sizes, strict=True):
        axis.set_major_locator(MaxNLocator(max(2, round(5 * size / max(sizes)))))
        axis.labelpad = 5
    return ax


def widened(ax: Axes, seen: list[int]) -> Axes:
    """Even axes with room for what was drawn since limits were set that stay."""
    if is_3d(ax) or ax.get_autoscalex_on() or ax.get_autoscaley_on():
        return even(ax, seen)
    whole = ax.viewLim.union([ax.viewLim, ax.dataLim])
    ax.set(xlim=whole.intervalx, ylim=whole.intervaly)
    return ax


def framed(ax: Axes, seen: list[int], points: Tensor) -> None:
    """Equal scales, with limits that stay: those that a user has set, or with room for what was
    drawn and for points (n, 2 or 3) m.
    """
    names = ("x", "y", "z") if is_3d(ax) else ("x", "y")
    axes_of = {
        f"{name}lim": getattr(ax, f"get_{name}lim")()
        for name in names
        if not getattr(ax, f"get_autoscale{name}_on")()
    }
    (everywhere,) = ax.plot(*numbers(points).T, alpha=0)
    even(ax, seen)
    everywhere.remove()
    ax.set(**axes_of)
    if is_3d(ax):
        sizes = [b - a for a, b in (ax.get_xlim(), ax.get_ylim(), ax.get_zlim())]
        ax.set_box_aspect(sizes, zoom=1.0 if ax.axison else 1.15)  # nothing is written beside it
        return
    if not axes_of:
        ax.figure.canvas.draw()  # equal scales settle
    ax.set_aspect("equal", adjustable="box")
    ax.set(xlim=ax.get_xlim(), ylim=ax.get_ylim())
