"""Kinds of nodes, of elements and of the ends of what acts between nodes, by which code differs."""

from __future__ import annotations

from typing import Any, NamedTuple

from torch import Tensor

from .sorts import SIDES


class SupportKind(NamedTuple):
    """Of a support, where something moves the beam: 1 for what it holds of its node's freedoms,
    else 0; whether it moves in frame a; whether it is a clamp.
    """

    fixed: tuple[float, ...]
    moves: bool
    clamp: bool


class PlacedKind(NamedTuple):
    """Of a support in an equilibrium, which puts its node where it has to be: what it holds;
    whether it has a displacement and a turn; the axis of its hinge.
    """

    fixed: tuple[float, ...]
    displaced: tuple[bool, bool]
    hinge: tuple[float, ...] | None


class EndKind(NamedTuple):
    """What holds a node of an element, see `NodeKind`."""

    hinge: tuple[float, ...] | None = None
    support: SupportKind | None = None


class NodeKind(NamedTuple):
    """What a node has beside what all have: numbers of the loads in `CommonConditions` that act
    there; the axis of its hinge, a mask in frame a, None = no hinge; its support, None = none, or
    nothing moves. In an equilibrium these two are in `placed`, of which elements know nothing.
    """

    acting: tuple[int, ...] = ()
    hinge: tuple[float, ...] | None = None
    support: SupportKind | None = None
    placed: PlacedKind | None = None

    @property
    def end(self) -> EndKind:
        """What elements know of it."""
        return EndKind(self.hinge, self.support)


class ElementKind(NamedTuple):
    """What holds the nodes of an element, in order; numbers of the loads in `CommonConditions` that
    act between them.
    """

    ends: tuple[EndKind, ...]
    loads: tuple[int, ...] = ()


# of what lies between nodes: `ends`, what holds these, None = the ground; `sides`, what those are
# called that are nodes; whether it has forces of constraints, `multiplied`; how many numbers of it
# a state has, `kept`; at how many points an iteration tells the next one something, `told`
BetweenKind = Any


def sides_of(ends: tuple[EndKind | None, ...]) -> tuple[str, ...]:
    """What the ends of two are called that are nodes."""
    return tuple(side for side, end in zip(SIDES[1], ends, strict=True) if end is not None)


def tuples_of(x: Tensor) -> tuple[Any, ...]:
    """As tuples of tuples."""

    def nested(rows: Any) -> Any:
        return tuple(map(nested, rows)) if isinstance(rows, list) else rows

    return nested(x.tolist())
