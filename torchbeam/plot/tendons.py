"""Tendons: the ropes of a scene, in a picture of the beams that they pull."""

from __future__ import annotations

from typing import Any

from ..core.arguments import instance
from ..core.validation import shown
from ..scene.scene import Scene
from ..state.state import State
from .axis import PLANES
from .canvas import Axes, check_axes, check_label, ink, is_3d, line_style, numbers


def tendons(
    scene: Scene,
    state: Any,
    ax: Axes,
    *,
    plane: str | None = None,
    color: Any = None,
    label: str | None = None,
    **line: Any,
) -> Axes:
    """Draw the tendons of a scene on a picture `ax` of its `shape`, as dashed lines with rings at
    the eyelets. The state may have batch axes or be a trajectory.

    Args:
        plane: "xy", "xz" or "yz" of a flat picture; None = in space
        color, label: of the lines, as further keywords of matplotlib; None = that of the labels

    Raises:
        ValueError: for a scene without tendons, a state of another scene, and another plane than
            that of the axes.

    Examples:
        >>> rope = tb.Tendon([(None, (0, 0, 0.05)), (-1, (0, 0, 0.05))], tension=1.0)
        >>> pulled = tb.Scene(beam, [rope])
        >>> state = tb.equilibrium(pulled)
        >>> ax = tb.plot.tendons(pulled, state, tb.plot.shape(state, plane="xz"), plane="xz")
    """
    instance("a scene", scene, Scene)
    if not scene.tendons:
        raise ValueError("a scene without tendons was given to tendons; one with some is wanted")
    known = plane is None or (isinstance(plane, str) and plane in PLANES)
    if not known or (plane is None) != is_3d(check_axes(ax)):
        raise ValueError(
            f"plane = {shown(plane)} was given to tendons; one of {', '.join(map(repr, PLANES))} "
            "is wanted of flat axes, None of three-dimensional ones"
        )
    check_label(label)
    position, rotation = instance("a state", state, State).position, state.rotation
    if position.shape[-2] != scene.beam.nodes.shape[-2]:
        raise ValueError(
            f"a state with {position.shape[-2]} nodes was given to tendons of a scene with "
            f"{scene.beam.nodes.shape[-2]}; as many are wanted"
        )
    seen = [0, 1, 2] if plane is None else list(PLANES[plane])
    color = ink(ax) if color is None else color
    usual = dict(color=color, lw=1.0, ls="--", marker="o", ms=4, mfc="none", mew=0.8)
    style = line_style(line, **usual)
    for tendon in scene.tendons:
        eyelets = tendon.at(position.detach(), rotation.detach())[..., seen].detach()
        for points in numbers(eyelets.reshape(-1, *eyelets.shape[-2:])):
            ax.plot(*points.T, label=label, **style)
            label = None
    return ax
