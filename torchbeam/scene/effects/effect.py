"""Effects in general: what a scene and its solvers ask of any of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

from torch import Tensor

from ...core.leaves import Tree


class Effect(Tree):
    """Base of all effects; what is asked of them is answered by attributes, these unless a class
    has its own.

    kind    "load", "strain", "inertia" or "eigenstrain": see `torchbeam.scene.effects`
    node    number of the node that it acts on, a class's attribute or a field; None = along the
            beam
    on      name of the part of a structure along which it acts, a field of effects without a node;
            None = of all of them
    inputs  `Input`s that it takes beside those in its leaves
    by_place  of one without a node: whether it differs along the beam
    by_mass   whether it acts on what has mass, bodies as well; else on beams alone, per length

    Raises TypeError, when the class is defined, for a field `node` without a value: it would take
    None from here.
    """

    kind: ClassVar[str] = ""
    node = None
    on = None
    inputs: ClassVar[Iterable] = ()
    by_place = True
    by_mass = False

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "node" in vars(cls).get("__annotations__", {}) and "node" not in vars(cls):
            raise TypeError(
                f"{cls.__name__}.node is a field without a value; node: int = dataclasses.field() "
                "is wanted, or a default"
            )

    def drawn_at(self, position: Tensor, rotation: Tensor) -> Effect:
        """Itself, in a scene whose node is drawn at position (..., 3) m with rotation (..., 4)."""
        return self


def of_library(effect: Any) -> bool:
    """Whether an effect's class is torchbeam's own."""
    return type(effect).__module__.startswith(f"{Effect.__module__.rpartition('.')[0]}.")
