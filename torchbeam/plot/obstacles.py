"""Obstacles in pictures of a beam."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import instance
from ..core.leaves import map_leaves
from ..math import quaternions as quat
from ..scene.effects.contact import Contact
from ..scene.effects.obstacles import Obstacle
from ..scene.scene import Scene
from ..state.state import State
from ..state.state_check import of_mesh
from .canvas import Axes, is_3d, numbers
from .shapes import PLANES

CELLS = 300  # of the picture, each way


def obstacles(
    scene: Scene,
    ax: Axes,
    *,
    plane: str,
    t: float = 0.0,
    color: Any = "0.85",
    state: State | None = None,
) -> Axes:
    """What is solid for the contacts of a scene at time t (s), of a batch its first sample, as a
    surface behind a picture `ax` of the `plane` ("xy", "xz" or "yz"), as far as that reaches: the
    cut through the middle of the undeformed beam. With a state, the surfaces of bodies as well,
    where they are in it, each cut through its centre.

    Raises:
        ValueError: for a plane that is none, for three-dimensional axes, and for a state of another
            structure.

    Examples:
        >>> floor = tb.Contact(tb.Plane((0, 0, -0.1), (0, 0, 1)), thickness=0.01, force=100.0)
        >>> lying = tb.Scene(beam, [tb.Gravity((0, 0, -9.81)), floor])
        >>> ax = tb.plot.shape(tb.rest(lying), plane="xz")
        >>> ax = tb.plot.obstacles(lying, ax, plane="xz")
    """
    instance("a scene", scene, Scene)
    if plane not in PLANES or is_3d(ax):
        given = f"plane = {plane!r}" if plane not in PLANES else "a three-dimensional picture"
        raise ValueError(
            f"{given} was given to obstacles; flat axes and one of "
            f"{', '.join(map(repr, PLANES))} are wanted"
        )
    first, second = PLANES[plane]
    limits, beam = (ax.get_xlim(), ax.get_ylim()), scene.beam
    across, up = (torch.linspace(*ends, CELLS).to(beam.nodes) for ends in limits)
    middle = beam.nodes.detach().flatten(0, -2).mean(0)
    x = middle.expand(CELLS, CELLS, 3).clone()
    x[..., first], x[..., second] = across, up[:, None]
    for obstacle in standing(scene, t):
        distance = obstacle.distance(x.flatten(0, -2)).reshape(CELLS, CELLS)
        cells = numbers(across), numbers(up), numbers(distance)
        ax.contourf(*cells, levels=[-torch.inf, 0.0], colors=[color], zorder=0)
    for centre, R, surface in () if state is None else surfaces(scene, state):
        at = x.clone()
        normal = ({0, 1, 2} - {first, second}).pop()
        at[..., normal] = centre[normal]
        distance = surface.distance((at.flatten(0, -2) - centre) @ R)
        cells = numbers(across), numbers(up), numbers(distance.reshape(-1, CELLS, CELLS)[0])
        ax.contourf(*cells, levels=[-torch.inf, 0.0], colors=[color], zorder=0)
    return ax


def standing(scene: Scene, t: float) -> Iterator[Obstacle]:
    """The obstacles of a scene's contacts at time t (s), each once, of the first sample."""
    beam = scene.beam
    now, s = torch.as_tensor(t).to(beam.nodes), beam.nodes.new_zeros(1)
    contacts = [load for load in scene.loads if isinstance(load, Contact)]
    own = {id(load.obstacle): load for load in contacts if load.obstacle is not None}
    for load in own.values():
        yield map_leaves(_first, load.resolved(s, now, {}, beam.element_count).obstacle)


def surfaces(scene: Scene, state: State) -> Iterator[tuple[Tensor, Tensor, Obstacle]]:
    """Of the bodies that have some, in the first sample: centre (3) m, axes (3, 3) and surface."""
    of_mesh(state, scene.beam, "a state")
    for part in scene.beam.parts:
        surface = scene.beam.surface(part.name) if part.body else None
        if surface is not None:
            centre = state.position.detach()[..., part.first_node, :].reshape(-1, 3)[0]
            q = state.rotation.detach()[..., part.first_node, :].reshape(-1, 4)[0]
            yield centre, quat.matrix(q), map_leaves(_first, surface)


def _first(x: Any, axes: int | None) -> Any:
    """Of a batch the first sample."""
    if not isinstance(x, Tensor) or axes is None:
        return x
    return x.detach().reshape(-1, *x.shape[x.ndim - axes :])[0]
