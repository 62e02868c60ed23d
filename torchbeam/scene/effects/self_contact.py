"""`SelfContact` of a beam."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from ...core.validation import refusal, shown
from ..parts import part_of
from .contact_terms import ContactTerms


@dataclass(frozen=True)
class SelfContact(ContactTerms):
    """Contact of a beam with itself: `SelfContact(...)`, in a structure `SelfContact("arm", ...)`.

    Args:
        on: name of the beam in a structure
        apart: least distance along the beam, in radii, of two places that may touch

    Other arguments are those of `Contact`; a radius is needed.

    Raises:
        ValueError: as `Contact` does, without a radius, or for `apart` that is not above 0.

    Examples:
        >>> coil = tb.Scene(
        ...     tb.Beam.arc(0.1, 5.0, 12, strip),
        ...     [tb.SelfContact(radius=0.002, thickness=0.002, force=10.0)],
        ... )
        >>> tb.rest(coil).tip.position  # m
        tensor([-0.0959,  0.0716,  0.0000])
    """

    on: str | None = None
    apart: float = 6.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.radius is None:
            raise refusal("SelfContact without a radius", "a length above 0")
        apart = self.apart
        if (
            isinstance(apart, bool)
            or not isinstance(apart, (int, float))
            or not 0 < apart < math.inf
        ):
            raise refusal(f"SelfContact's apart = {shown(apart)}", "a number above 0")
        if self.on is not None and not isinstance(self.on, str):
            raise ValueError(
                f"{shown(self.on)} was given to SelfContact; the name of a beam is wanted"
            )

    @property
    def kind(self) -> str:
        return "pair"

    @property
    def partner(self) -> str | None:
        return self.on

    def placed(self, beam: Any) -> SelfContact:
        if self.on is None and len([part for part in beam.parts if not part.body]) > 1:
            raise ValueError(
                "SelfContact without a name was given in a structure of several beams; the name "
                "of one is wanted"
            )
        if self.on is not None and part_of(beam.parts, self.on).body:
            raise refusal(f"SelfContact of {self.on!r}", "that is a body, and a beam")
        return self
