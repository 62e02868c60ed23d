"""A part that touches the surface of a body: `PartContact` whose one piece is that surface."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from ..core.validation import concrete
from ..scene.effects.load_point import ROTATION, SPIN, VELOCITY
from ..scene.effects.obstacle import Obstacle
from ..scene.stations import Table
from .surface_pairs import SurfacePairs, numbers_of
from .touching import Nearby, PairLaw, PartContact
from .touching_pairs import TouchingPairs

POINTS = 2  # places in a piece of a beam, as of an obstacle


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
