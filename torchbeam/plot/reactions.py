"""Reactions: what supports exert on the beam, as arrows with numbers."""

from __future__ import annotations

from typing import Any

import torch

from ..core.arguments import instance
from ..scene.scene import Scene
from ..state.state_check import of_mesh
from .arrows import Arrows
from .axis import axis_curves, nodes_of, rows_of
from .canvas import GREY, Axes, numbers
from .limits import prepared, widened
from .symbols import ARROW, Symbols

COLOR = "C2"
ROUNDING = 1e-6  # of the largest force, or moment, of sections: a reaction below it is not drawn


def reactions(
    state: Any, ax: Axes | None = None, *, scene: Scene, plane: str | None = None
) -> Axes:
    """Draw the loads of the supports on the beam in one state, as arrows with numbers. Forces (N)
    are along the axes of frame a in the picture; moments are in N m.

    Args:
        state: one sample, of the nodal form
        ax: axes with a picture of the beam; empty or None = with its axis and supports
        scene: whose state it is
        plane: "xy", "xz" or "yz", as in `shape`

    Raises:
        ValueError: for a batch, a state of another scene, and as `shape`.

    Examples:
        >>> ax = tb.plot.reactions(tb.equilibrium(scene), scene=scene)
    """
    position, turn = nodes_of(state)
    instance("scene", scene, Scene)
    loads = of_mesh(state, scene, "a state").reaction.detach().double().cpu()
    if len(position) != 1 or loads.ndim != 2 or len(loads) != len(scene.supports):
        raise ValueError(
            f"a state with {len(position)} samples and the reactions of {loads.shape[-2]} supports "
            f"was given to reactions; one sample with those of {len(scene.supports)} is wanted"
        )
    ax, seen = prepared(ax, plane, position)
    pen = Symbols.of(ax, seen, scene, position, turn)
    if not ax.has_data():
        curve = axis_curves(rows_of(state), position, turn[..., 0])[0][:, seen]
        ax.plot(*numbers(curve).T, color=GREY, lw=2.0)
        pen.supports()
        pen.joints()
    arrows = Arrows(ax, seen, ARROW * pen.size, COLOR)
    forces, moments = (
        torch.where(load.abs() > ROUNDING * stress.abs().max(), load, 0.0)
        for load, stress in zip(
            loads.split(3, -1), state.stress.detach().double().cpu().split(3, -1), strict=True
        )
    )
    strongest, most = (x.abs().max().item() if len(x) else 0.0 for x in (forces, moments))
    for support, F, M in zip(scene.supports, forces, moments, strict=True):
        x, into = pen.position[support.node], pen.into(support.node)
        for part in torch.diag(F)[seen]:
            arrows.force(x, part, strongest, into)
        for part in torch.diag(M):
            arrows.moment(x, part, max(most, 1e-9 * strongest * pen.size))
    return widened(ax, seen)
