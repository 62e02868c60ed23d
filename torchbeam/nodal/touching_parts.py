"""Parts of a scene that touch each other, and at which places along them; a part that touches the
surface of a body is a `PartContact` whose one piece is that surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from ..core.validation import concrete
from ..scene.effects.contact_terms import POINTS, ContactTerms
from ..scene.effects.load_point import ROTATION, SPIN, VELOCITY
from ..scene.effects.obstacle import Obstacle
from ..scene.parts import part_of
from ..scene.scene import Scene
from ..scene.stations import Table
from .between_nodes import BetweenNodes
from .centreline import control_shares, piece_nodes
from .coordinates.spatial import Spatial
from .surface_pairs import SurfacePairs, numbers_of
from .touching import Nearby, PairLaw, PartContact
from .touching_forces import ScenePairs
from .touching_pairs import TouchingPairs


@dataclass(frozen=True)
class TouchingSurface(PartContact):
    """Places along a beam, or the centre of a ball, and the surface of a body, in its axes. Which
    of them may touch is asked of the ball about the body that its surface is in, however it turns.
    """

    surface: Obstacle

    @property
    def profiles(self) -> tuple[Tensor | Table, Tensor]:
        law, none = self.contact, self.s.new_zeros(())
        radii = (law.radius, law.other_radius) if self.first else (law.other_radius, law.radius)
        return next((x for x in radii if x is not None), none), none

    @property
    def points(self) -> int:
        return self.contact.points or POINTS

    @property
    def law(self) -> PairLaw:
        return super().law._replace(surface=type(self.surface))

    @property
    def reads(self) -> frozenset[str]:
        return frozenset({ROTATION} | ({VELOCITY, SPIN} if self.lossy else set()))

    def pairs(self, near: Nearby) -> TouchingPairs:
        rows, shape = vars(super().pairs(near)), self.surface
        return SurfacePairs(**rows, shape=type(shape), numbers=numbers_of(shape)[..., None, :])

    @property
    def reach(self) -> Tensor:
        return super().reach + concrete(self.surface.reach.detach())


def touching_of(scene: Scene, space: Spatial, s: Tensor) -> BetweenNodes:
    """Of a scene; s (..., N+1) m, arclength of its nodes."""
    if not scene.pairs:
        return BetweenNodes()
    each = [
        part_contact
        for k, pair in enumerate(scene.pairs)
        for part_contact in _both(scene, pair, k, s)
    ]
    eye = torch.eye(space.unknowns, dtype=scene.dtype, device=scene.device)
    return ScenePairs(space, space.embed(eye), tuple(each))


def _both(scene: Scene, pair: ContactTerms, k: int, s: Tensor) -> list[PartContact]:
    """From each of two beams to the other, of which each has half of the force; from a body to a
    beam, or to a body; from a beam to itself.
    """
    first, second = (_nodes(scene, name) for name in (pair.on, pair.partner))
    shapes = [_surface(scene, name) for name in (pair.on, pair.partner)]
    if any(shapes):  # places on what has none
        if shapes[0] is not None:
            return [_one(pair, k, s, second, first, 1.0, False, shapes[0])]
        return [_one(pair, k, s, first, second, 1.0, True, shapes[1])]
    if first == second:
        return [_one(pair, k, s, first, second, 0.5)]
    if len(second) == 1:
        return [_one(pair, k, s, second, first, 1.0, False)]
    if len(first) == 1:
        return [_one(pair, k, s, first, second, 1.0)]
    return [_one(pair, k, s, first, second, 0.5), _one(pair, k, s, second, first, 0.5, False)]


def _surface(scene: Scene, name: str | None) -> Obstacle | None:
    shape = scene.beam.surface(name) if scene.beam.parts and name is not None else None
    return None if shape is None else shape.in_body


def _nodes(scene: Scene, name: str | None) -> range:
    if name is None:
        beams = [part for part in scene.beam.parts if not part.body]
        return range(beams[0].node_count if beams else scene.beam.node_count)
    part = part_of(scene.beam.parts, name)
    return range(part.first_node, part.first_node + part.node_count)


def _one(
    pair: ContactTerms,
    k: int,
    s: Tensor,
    first: range,
    second: range,
    share: float,
    is_first: bool = True,
    surface: Obstacle | None = None,
) -> PartContact:
    """Places along the first nodes, and pieces of the second, or the surface of a body there."""
    ends = s.new_zeros(len(second), 2)
    ends[0, 0] = ends[-1, 1] = 1.0
    kind = PartContact if surface is None else partial(TouchingSurface, surface=surface)
    return kind(
        contact=pair,
        pair=k,
        first=is_first,
        along=(first.start, len(first)),
        share=share,
        itself=first == second,
        pieces=piece_nodes(second.start, len(second)),
        control=s.new_tensor(control_shares(len(second))),
        ends=ends,
        s=s,
    )
