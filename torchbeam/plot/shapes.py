"""Shapes: pictures of the beam itself and its section axes."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..core.arguments import boolean, choice, instance
from ..scene.scene import Scene
from .axis import PLANES, axis_curves, nodes_of, rows_of
from .canvas import GREY, Axes, axes, check_axes, check_label, is_3d, line_style, numbers
from .solid_picture import SolidPicture

TRIAD = ("#c0392b", "#27ae60", "#2c5fb3")  # x, y, z


def shape(
    state: Any,
    ax: Axes | None = None,
    *,
    plane: str | None = None,
    scene: Scene | None = None,
    frames: bool = False,
    color: Any = None,
    label: str | None = None,
    nodes: bool = True,
    **line: Any,
) -> Axes:
    """Axis of the beam (m, frame a) in a state, or in each of a batch or trajectory, the first
    darkest. Of a structure all beams, with bodies as squares and joints as rings at the nodes that
    they connect, with a line between those that are apart.

    Args:
        state: of any form, with any leading axes
        plane: "xy", "xz" or "yz": seen along the third axis; None = in space, unless all lies in
            one of these planes
        scene: that it is a state of: beams are drawn as thick as contacts take them, or else as
            the rectangle of their EI and EA, with obstacles (of a batch the first sample's), the
            surfaces of bodies, and tendons, as far as limits say that are set; `color` is that of
            all, and what else there is for lines has no meaning. A state without the scene's
            batch axes has the radii of the first sample
        frames: draw the section axes of the nodes too: x red, y green, z blue
        nodes: mark the nodes;  color, label and further keywords: as matplotlib has them for lines

    Between nodes the curve is cubic, with the sections' x axes as its tangents.

    Raises:
        ValueError: for what is no state, a plane that is none, flat axes for a beam that lies
            in no plane, and a state of another scene.

    Examples:
        >>> ax = tb.plot.shape(solution.state)  # each instant, the first darkest
    """
    position, turn = nodes_of(state)
    boolean("frames", frames), boolean("nodes", nodes)
    check_label(label)
    if scene is not None:
        instance("scene", scene, Scene)
    ax, seen = prepared(ax, plane, position)
    solid = None if scene is None else SolidPicture.of(scene, state, ax, seen, color)
    if solid is not None:
        framed(ax, seen, solid.reach(state)[:, seen])
        solid.draw(state)
        if frames:
            _triads(ax, position, turn, seen)
        return ax
    rows = rows_of(state)
    curves = numbers(axis_curves(rows, position, turn[..., 0])[..., seen])
    dots = numbers(position[..., seen])
    for i, (curve, points) in enumerate(zip(curves, dots, strict=True)):
        shade = color if color is not None else "C0" if len(curves) == 1 else _shade(i, len(curves))
        style = line_style(line, color=shade, label=label if i == 0 else None, lw=1.8)
        (drawn,) = ax.plot(*curve.T, **style)
        if nodes:
            ax.plot(*points.T, "o", ms=2.5, color=drawn.get_color(), alpha=drawn.get_alpha())
        _mark(ax, state, points, drawn.get_color())
    if frames:
        _triads(ax, position, turn, seen)
    return even(ax, seen)


def _mark(ax: Axes, state: Any, points: Any, color: Any) -> None:
    """Bodies and joints of a structure with nodes at the points (nodes, 2 or 3)."""
    bodies = [part.first_node for part in getattr(state, "parts", ()) if part.body]
    if bodies:
        ax.plot(*points[bodies].T, "s", ms=9, color=color)
    for pair in getattr(state, "joined", ()):
        ends = points[[node for node in pair if node is not None]]
        ax.plot(*ends.T, "o", ms=6, mfc="none", mec="k", mew=0.8, color=GREY, ls="-", lw=0.8)


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
        axis.set_major_locator(_few(max(2, round(5 * size / max(sizes)))))
        axis.labelpad = 5
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


def _few(count: int) -> Any:
    """Locator of at most so many ticks."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(count)


def _triads(ax: Axes, position: Tensor, turn: Tensor, seen: list[int]) -> None:
    """Section axes turn (samples, N+1, 3, 3) drawn at the nodes (samples, N+1, 3)."""
    reach = 0.06 * torch.linalg.vector_norm(position.diff(dim=-2), dim=-1).sum(-1)[:, None, None]
    for i, color in enumerate(TRIAD):
        ends = numbers((position + reach * turn[..., i])[..., seen])
        starts = numbers(position[..., seen])
        for start, end in zip(*(x.reshape(-1, len(seen)) for x in (starts, ends)), strict=True):
            ax.plot(*zip(start, end, strict=True), color=color, lw=1)


def _shade(i: int, count: int) -> Any:
    """Colour of the i-th of `count` shapes."""
    from matplotlib import colormaps

    return colormaps["viridis"](0.9 * i / (count - 1))
