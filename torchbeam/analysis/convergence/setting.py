"""Setting: an element and a mesh, a method and a step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple


class Element(NamedTuple):
    """Of a scene's elements: order and linked interpolation, as `remesh` takes them; the order of
    their error where the solution is smooth.
    """

    order: int
    linked: bool
    rate: float


ELEMENTS = {
    "linear": Element(1, False, 2.0),
    "linked": Element(1, True, 4.0),
    "order 2": Element(2, False, 4.0),
}
METHODS = {"midpoint": 2.0, "midpoint4": 4.0, "generalized_alpha": 2.0}  # order of the error


@dataclass(frozen=True)
class Setting:
    """How a scene is discretised.

    element   a name of `ELEMENTS`;  elements: their number
    method    of steps, None in statics;  step  s
    """

    element: str
    elements: int
    method: str | None = None
    step: float | None = None

    @property
    def intervals(self) -> int:
        """Between neighbouring nodes."""
        return self.elements * ELEMENTS[self.element].order

    @property
    def mesh(self) -> dict[str, Any]:
        """Keywords of `remesh`."""
        element = ELEMENTS[self.element]
        return dict(elements=self.elements, order=element.order, linked=element.linked)

    @property
    def steps(self) -> dict[str, Any]:
        """Keywords of `simulate`; none in statics."""
        return {} if self.method is None else dict(method=self.method, step=self.step)

    def __str__(self) -> str:
        mesh = f"{self.elements} {self.element} elements"
        return mesh if self.method is None else f"{mesh}, {self.method}, step {self.step:.6g} s"
