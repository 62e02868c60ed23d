"""Obstacles, and the surfaces of bodies and beams, in pictures of a beam."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import instance, instant
from ..core.leaves import map_leaves
from ..core.validation import broadcast, shown
from ..scene.effects.contact import Contact
from ..scene.effects.contact_terms import ContactTerms
from ..scene.effects.obstacle import Obstacle
from ..scene.effects.obstacles import Sphere
from ..scene.parts import Part
from ..scene.scene import Scene
from ..state.state import State
from ..state.state_check import of_mesh
from .axis import PLANES, nodes_of
from .canvas import Axes, check_axes, is_3d, numbers

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
    """Draw the obstacles of a scene's contacts at time t (s) on a picture `ax`, up to its limits.
    They are cut by the `plane` ("xy", "xz" or "yz") through the middle of the undeformed beam. A
    batch shows its first sample. A state adds the surfaces of bodies at their places in it, each
    cut through its centre.

    Raises:
        ValueError: for an unknown plane, three-dimensional axes, and a state of another structure.

    Examples:
        >>> floor = tb.Contact(tb.Plane((0, 0, -0.1), (0, 0, 1)), thickness=0.01, force=100.0)
        >>> lying = tb.Scene(beam, [tb.Gravity((0, 0, -9.81)), floor])
        >>> ax = tb.plot.shape(tb.rest(lying), plane="xz")
        >>> ax = tb.plot.obstacles(lying, ax, plane="xz")
    """
    instance("a scene", scene, Scene)
    known = isinstance(plane, str) and plane in PLANES
    if is_3d(check_axes(ax)) or not known:
        kind = f"plane = {shown(plane)}" if not known else "a three-dimensional picture"
        raise ValueError(
            f"{kind} was given to obstacles; flat axes and one of "
            f"{', '.join(map(repr, PLANES))} are wanted"
        )
    middle = scene.beam.nodes.detach().flatten(0, -2).mean(0)
    for obstacle in standing(scene, t):
        cut(ax, plane, middle, obstacle.distance, color)
    for centre, R, surface in () if state is None else surfaces(scene, state):
        cut(ax, plane, centre, in_axes(surface, centre, R), color)
    return ax


def cut(
    ax: Axes, plane: str, through: Tensor, distance: Callable[[Tensor], Tensor], color: Any
) -> None:
    """What is solid, by its distance (n, 1) m from points (n, 3) m, in a plane on flat axes."""
    first, second = PLANES[plane]
    across, up = (
        torch.linspace(*ends, CELLS, dtype=torch.float64).to(through)
        for ends in (ax.get_xlim(), ax.get_ylim())
    )
    x = through.expand(CELLS, CELLS, 3).clone()
    x[..., first], x[..., second] = across, up[:, None]
    cells = distance(x.flatten(0, -2)).reshape(CELLS, CELLS)
    ax.contourf(
        *map(numbers, (across, up, cells)), levels=[-torch.inf, 0.0], colors=[color], zorder=0
    )


def in_axes(surface: Obstacle, centre: Tensor, R: Tensor) -> Callable[[Tensor], Tensor]:
    """The distance from a surface in axes R (3, 3) about a centre (3) m."""
    return lambda x: surface.distance((x - centre) @ R)


def standing(scene: Scene, t: float) -> Iterator[Obstacle]:
    """The obstacles of a scene's contacts at time t (s), each once, of the first sample."""
    beam = scene.beam
    now, s = instant("t", t, beam.nodes), beam.nodes.new_zeros(1)
    contacts = [load for load in scene.loads if isinstance(load, Contact)]
    loads = {id(load.obstacle): load for load in contacts if load.obstacle is not None}
    for load in loads.values():
        yield map_leaves(
            lambda x, axes: _sample(x, axes, (), 0),
            load.resolved(s, now, {}, beam.element_count).obstacle,
        )


def surfaces(scene: Scene, state: State) -> Iterator[tuple[Tensor, Tensor, Obstacle]]:
    """Of the bodies that have some, in the first sample: centre (3) m, axes (3, 3) and surface."""
    state = of_mesh(state, scene, "a state")
    position, R = (x[0] for x in nodes_of(state))
    for part in scene.beam.parts:
        surface = surface_of(scene, part) if part.body else None
        if surface is not None:
            yield position[part.first_node], R[part.first_node], surface


def surface_of(
    scene: Scene, body: Part, batch: Sequence[int] = (), sample: int = 0
) -> Obstacle | None:
    """Of a body, in a sample: its own, or the ball by which contacts take it; None = neither."""
    surface = scene.beam.surface(body.name)
    if surface is not None:
        return map_leaves(lambda x, axes: _sample(x, axes, batch, sample), surface)
    return ball_of(scene, body, batch, sample)


def ball_of(
    scene: Scene, part: Part | None, batch: Sequence[int] = (), sample: int = 0
) -> Sphere | None:
    """By which contacts take a body, or the first node of a beam; None = none names a radius."""
    radius = radius_of(scene, part, scene.beam.nodes.new_zeros(1), batch, sample)
    return None if radius is None else Sphere(torch.zeros(3).to(radius), radius[0])


def radius_of(
    scene: Scene, part: Part | None, s: Tensor, batch: Sequence[int] = (), sample: int = 0
) -> Tensor | None:
    """The radii (n) m by which contacts take a part at places s (n) m along it, in a sample of a
    batch, the largest if they differ; None = none of them names one. A beam by itself is no part.
    """
    names = {None} if part is None else {part.name} if part.body else {part.name, None}
    radii = []
    for contact in scene.effects:
        if isinstance(contact, ContactTerms):
            other = getattr(contact, "other_radius", None)
            taken = {contact.partner: contact.radius if other is None else other}
            taken = {k: v for k, v in taken.items() if k is not None} | {contact.on: contact.radius}
            radii += [r for on, r in taken.items() if on in names and r is not None]
    along = [r(s) if callable(r) else torch.as_tensor(r).to(s)[..., None] + 0 * s for r in radii]
    return torch.stack([_sample(r, 1, batch, sample) for r in along]).amax(0) if along else None


def _sample(x: Any, axes: int | None, batch: Sequence[int], sample: int) -> Any:
    """Of a batch one sample; without its axes the first. Raises ValueError for another batch."""
    if not isinstance(x, Tensor) or axes is None:
        return x
    lead, last_axes = x.shape[: x.ndim - axes], x.shape[x.ndim - axes :]
    if batch:
        lead = broadcast("a scene and a state", lead, torch.Size(batch))
    return x.detach().expand((*lead, *last_axes)).reshape(-1, *last_axes)[sample]
