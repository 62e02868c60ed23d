"""Setting: an element and a mesh, a method and a step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple


class ElementKind(NamedTuple):
    """Of a scene's elements: order and linked interpolation, as `remesh` takes them; the order of
    their error where the solution is smooth. For a first guess, as seen in soft rods: the error of
    a mesh of 8 intervals, the order in that range, and the CPU time of an interval, in linear
    elements'.
    """

    order: int
    linked: bool
    rate: float
    guess: float
    expected: float
    cost: float


class MethodKind(NamedTuple):
    """Of steps: the order of their error where the motion is smooth. For a first guess: the error's
    factor of (omega h)^order, in midpoint steps', the order that a single change is taken for, and
    the CPU time of a step, in midpoint steps'.
    """

    rate: float
    factor: float
    expected: float
    cost: float


ELEMENTS = {
    "linear": ElementKind(1, False, 2.0, 8e-3, 2.0, 1.0),
    "linked": ElementKind(1, True, 4.0, 1.5e-3, 2.3, 1.0),
    "order 2": ElementKind(2, False, 4.0, 1.5e-3, 3.5, 1.3),
}
METHODS = {
    "midpoint": MethodKind(2.0, 1.0, 2.0, 1.0),
    "midpoint4": MethodKind(4.0, 1.0, 3.0, 5.0),
    "generalized_alpha": MethodKind(2.0, 4.0, 2.0, 1.0),
}


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
