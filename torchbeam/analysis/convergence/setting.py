"""Setting: an element and a mesh, a method and a step; limits of a search for one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from ...core.arguments import choice, listed, number
from ...core.arguments import count as check_count
from ...core.arguments import level_of as check_level
from ...core.arguments import tolerance as check_tolerance


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


class Limits(NamedTuple):
    """Limits of a search.

    Args:
        share: of a batch's samples whose error is to be that small; all share one setting
        elements, methods: that may be chosen: "linear", "linked", "order 2"; "midpoint",
            "midpoint4", "generalized_alpha"
        most_elements, most_steps: beyond which nothing is chosen
        seconds: of CPU time, which all runs together are not to exceed
    """

    share: float
    elements: list[str]
    methods: list[str]
    most_elements: int
    most_steps: int
    seconds: float

    def checked(self) -> Limits:
        """With each name once. Raises ValueError for what is none of these."""
        if number("share", self.share) != 1:
            check_level("share", self.share)
        for name, known in (("elements", ELEMENTS), ("methods", METHODS)):
            for each in listed(getattr(self, name)) or (None,):
                choice(f"one of {name}", each, known)
        check_count("most_elements", self.most_elements, 4)
        check_count("most_steps", self.most_steps, 2)
        check_tolerance("seconds", self.seconds)
        elements, methods = (list(dict.fromkeys(listed(x))) for x in (self.elements, self.methods))
        return self._replace(
            share=float(self.share), elements=elements, methods=methods, seconds=float(self.seconds)
        )
