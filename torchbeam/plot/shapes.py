"""Shapes: pictures of the beam itself and its section axes."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..core.arguments import boolean, instance, tolerance
from ..core.validation import refusal
from ..scene.scene import Scene
from ..state.state import State
from ..state.state_check import of_mesh
from .axis import axis_curves, nodes_of, rows_of
from .canvas import GREY, Axes, check_label, ink, line_style, numbers
from .limits import even, framed, prepared
from .magnified import magnified, undeformed_state
from .solid_picture import SolidPicture
from .symbols import Symbols

TRIAD = ("#c0392b", "#27ae60", "#2c5fb3")  # x, y, z
EDGE_ON = 0.1  # of a section axis: it is hardly seen


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
    symbols: bool = False,
    undeformed: bool = False,
    magnify: float = 1.0,
    **line: Any,
) -> Axes:
    """Axis of the beam (m, frame a) in a state, or in each state of a batch or trajectory, the
    first darkest. A structure shows all beams. Bodies are squares, joints are rings at the nodes
    that they connect, with a line between distant nodes. Between nodes the curve is cubic, with the
    sections' x axes as its tangents.

    Args:
        state: of any form, with any leading axes
        plane: "xy", "xz" or "yz": seen along the third axis; None = in space, unless all lies in
            one of these planes
        scene: whose state it is. Beams get the thickness of their contacts, or else the rectangle
            that has their EI and EA. Obstacles (of the first sample), surfaces of bodies and
            tendons are drawn within the limits that were set. `color` is the colour of all parts;
            other keywords of lines have no effect. A state without batch has the first radii
        frames: draw section axes at the nodes, x red, y green, z blue, named at the last node
        symbols: of the scene's supports, joints and loads, see `symbols`
        undeformed: draw the undeformed axis too, in grey
        magnify: factor of the displacements
        nodes: mark the nodes
        color, label, **line: as for lines of matplotlib

    Raises:
        ValueError: for another type than a state, an unknown plane, flat axes for a beam that lies
            in no plane, a state of another scene, or a missing undeformed beam.

    Examples:
        >>> ax = tb.plot.shape(solution.state)  # each instant, the first darkest
    """
    nodes_of(state)
    options = dict(frames=frames, nodes=nodes, symbols=symbols, undeformed=undeformed)
    for name, value in options.items():
        boolean(name, value)
    check_label(label)
    if scene is not None:
        of_mesh(state, instance("scene", scene, Scene), "a state")
    elif symbols:
        raise refusal("symbols=True without a scene", "scene=, whose state it is,")
    picture = state
    if tolerance("magnify", magnify) != 1:
        picture = magnified(state, undeformed_state(state, scene), magnify)
    position, turn = nodes_of(picture)
    ax, seen = prepared(ax, plane, position)
    if undeformed or magnify != 1:
        _draw_undeformed(ax, seen, undeformed_state(state, scene), magnify, color)
    if symbols:
        Symbols.of(ax, seen, scene, position, turn).draw(state)
    solid = None if scene is None else SolidPicture.of(scene, picture, ax, seen, color)
    if solid is not None:
        framed(ax, seen, solid.reach(picture)[:, seen])
        solid.draw(picture)
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


def _draw_undeformed(ax: Axes, seen: list[int], at_rest: State, magnify: float, color: Any) -> None:
    """The undeformed axis, of a batch the first sample's, and what is magnified, in a legend."""
    position, turn = nodes_of(at_rest)
    curve = axis_curves(rows_of(at_rest), position[:1], turn[:1, ..., 0])[0]
    ax.plot(*numbers(curve[:, seen]).T, color=GREY, lw=1.5, label="undeformed")
    if magnify != 1:
        shade, text = "C0" if color is None else color, f"displacements times {magnify:g}"
        ax.plot(*([] for _ in seen), color=shade, lw=1.8, label=text)
    ax.legend(frameon=False, fontsize=8)


def _mark(ax: Axes, state: Any, points: Any, color: Any) -> None:
    """Bodies and joints of a structure with nodes at the points (nodes, 2 or 3)."""
    bodies = [part.first_node for part in getattr(state, "parts", ()) if part.body]
    if bodies:
        ax.plot(*points[bodies].T, "s", ms=9, color=color)
    for pair in getattr(state, "joined", ()):
        ends = points[[node for node in pair if node is not None]]
        ax.plot(*ends.T, "o", ms=6, mfc="none", mec=ink(ax), mew=0.8, color=GREY, ls="-", lw=0.8)


def _triads(ax: Axes, position: Tensor, turn: Tensor, seen: list[int]) -> None:
    """Section axes turn (samples, N+1, 3, 3) drawn at the nodes (samples, N+1, 3), with their names
    at the last.
    """
    reach = 0.06 * torch.linalg.vector_norm(position.diff(dim=-2), dim=-1).sum(-1)[:, None, None]
    for i, color in enumerate(TRIAD):
        ends = numbers((position + reach * turn[..., i])[..., seen])
        starts = numbers(position[..., seen])
        for start, end in zip(*(x.reshape(-1, len(seen)) for x in (starts, ends)), strict=True):
            ax.plot(*zip(start, end, strict=True), color=color, lw=1)
        if turn[0, -1, seen, i].norm() > EDGE_ON:
            ax.text(*ends[0, -1].tolist(), "xyz"[i], color=color, fontsize=8)


def _shade(i: int, count: int) -> Any:
    """Colour of the i-th of `count` shapes."""
    from matplotlib import colormaps

    return colormaps["viridis"](0.9 * i / (count - 1))
