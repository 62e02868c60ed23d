"""The numbers that every contact has, whatever touches: `Contact` and `SelfContact`."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field
from typing import Any, TypeVar

from torch import Tensor

from ...core.arguments import boolean, count
from ...core.declared import optional
from ...core.leaves import Tree, leaf, option, with_values
from ...core.validation import Value, concrete, positive, refusal
from ...math.element_shapes import SHAPES
from ..parts import large_rotations
from ..stations import Table
from .load_point import LoadEffect

Self = TypeVar("Self", bound="ContactTerms")
POINTS = 2  # places in an element, or a piece of a beam, that touches a solid


@dataclass(frozen=True)
class AtPoints(Tree):
    """A radius (..., points) m at the points of a contact themselves."""

    value: Tensor = leaf(1)


def radius_value(name: str, value: Any) -> Any:
    """A radius checked: a number (...), a `Table` of one along the beam, or None. Raises ValueError
    for what is negative, and for a Table of several numbers at each place.
    """
    if not isinstance(value, Table):
        return optional(name, value)
    if value.width is not None:
        raise refusal(f"{name} as a Table of width {value.width}", "one number at each place")
    positive(name, value.values, zero=True)
    return value


def widest(radius: Tensor | Table) -> Tensor:
    """(...) m, the largest along the beam."""
    return radius.values.amax(-1) if isinstance(radius, Table) else radius


def thinnest(radius: Tensor | Table) -> Tensor:
    """(...) m, the smallest along the beam."""
    return radius.values.amin(-1) if isinstance(radius, Table) else radius


@dataclass(frozen=True)
class ContactTerms(LoadEffect):
    """See `Contact`."""

    _: KW_ONLY
    thickness: Value = leaf(0, default=None, positive=True)
    force: Value | None = leaf(0, default=None, positive=True)
    stiffness: Value | None = leaf(0, default=None, positive=True)
    radius: Value | Table | None = leaf(0, default=None, check=radius_value)
    friction: Value | None = leaf(0, default=None, check=optional)
    slip_speed: Value | None = leaf(0, default=None, positive=True)
    damping: Value | None = leaf(0, default=None, check=optional)
    points: int | None = option(count, default=None)
    push_out: bool = option(boolean, default=False)
    # those of the numbers that the scene says, see `with_defaults`
    follows: tuple[str, ...] = field(default=(), init=False)

    wants_frame = True
    by_place = True  # bodies have no length
    partner = None  # name of the other part, of a contact of two, or of a beam with itself
    other_radius = None

    def __post_init__(self) -> None:
        if self.force is not None and self.stiffness is not None:
            raise refusal(f"{self.called} with a force and a stiffness", "one of them")
        super().__post_init__()
        if self.friction is not None and self.slip_speed is None:
            raise ValueError(
                f"{self.called} with friction and no slip_speed was given; the speed is wanted "
                "below which surfaces creep"
            )

    @property
    def kind(self) -> str:
        return "load" if self.partner is None else "pair"

    def placed(self, beam: Any) -> ContactTerms:
        """Itself, in a beam or a structure. Raises ValueError for parts that are not there."""
        return self

    def check(self, scene: Any) -> None:
        """Of two parts in a scene: raises ValueError for small motions, beams of order 2, and radii
        that change by more than the length along the beam, where no place is nearest.
        """
        for radius in (self.radius, self.other_radius):
            if isinstance(radius, Table):
                steep = radius.values.diff(dim=-1).abs() >= radius.s.diff(dim=-1)
                if concrete(steep.detach()).any():
                    raise ValueError(
                        f"{self.called} of two parts with a radius that changes by as much as the "
                        "length along the beam was given; one that changes by less is wanted there"
                    )
        large_rotations(scene, f"{self.called} of two parts")
        if SHAPES[scene.beam.order].midside:
            raise ValueError(
                f"{self.called} of beams of order 2 with each other was given; order=1 is wanted "
                "there"
            )

    touches = resists = True

    @property
    def rubs(self) -> bool:
        return self.friction is not None

    @property
    def lossy(self) -> bool:
        """Whether it takes energy."""
        return self.friction is not None or self.damping is not None

    def at_points(self: Self, s: Tensor) -> Self:
        """The same at points with the arclengths s (..., points) m, with the radius that it has
        there; itself where that is the same all along.
        """
        if not isinstance(self.radius, Table):
            return self
        return with_values(self, radius=AtPoints(self.radius.ramps(s)))

    @property
    def at_its_widest(self: Self) -> Self:
        """The same with its largest radius all along."""
        if not isinstance(self.radius, Table):
            return self
        return with_values(self, radius=widest(self.radius))

    @property
    def slope(self) -> Tensor:
        """(...) N/m^2, how steeply the pressure rises where surfaces meet."""
        return 2 * self.force / self.thickness if self.stiffness is None else self.stiffness
