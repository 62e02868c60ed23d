"""Parts of a structure: beams and bodies by their names, and their rows among those of all."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch

from ..core.arguments import is_integer, whole
from ..core.validation import shown

# A node: its number, of a structure the name of a beam and the number there, or that of a body
# alone or with a point in its axes.
Place = int | str | tuple[str, Any]
FLAGS = ("rigid", "coupled", "offset", "rotary", "curved")  # what a `Beam` is declared to have


class Part(NamedTuple):
    """A beam or, without stations, a body: its name, its first node and how many it has; of its
    stations of stress likewise; declared: of a beam, its `FLAGS`.
    """

    name: str
    first_node: int
    node_count: int
    first_station: int
    station_count: int = 0
    declared: tuple[Any, ...] = ()

    @property
    def body(self) -> bool:
        return not self.station_count

    @property
    def nodes(self) -> slice:
        return slice(self.first_node, self.first_node + self.node_count)

    @property
    def stations(self) -> slice:
        return slice(self.first_station, self.first_station + self.station_count)

    def __str__(self) -> str:
        nodes = f"({self.name!r}, 0 to {self.node_count - 1})"
        return f"the body {self.name!r}" if self.body else nodes


class Span(NamedTuple):
    """Rows along which an effect acts: of nodes, of stations; of how many elements."""

    nodes: slice
    stations: slice
    element_count: int


class Row(int):
    """The row of a node of a structure; it prints as the user says the node, `given`."""

    given: Any

    def __new__(cls, row: int, given: Any) -> Row:
        new = super().__new__(cls, row)
        new.given = given
        return new

    def __repr__(self) -> str:
        return repr(self.given)

    __str__ = __repr__

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (int(self), self.given)


torch.serialization.add_safe_globals([Part, Row])


def check_node(name: str, node: Any) -> Any:
    """`node` if it is one: a whole number, which counts from the root; in a structure
    (name, number), or a body's name. ValueError otherwise.
    """
    if isinstance(node, str) or (_is_named(node) and is_integer(node[1])):
        return node
    if isinstance(node, tuple):
        raise ValueError(
            f"{name} = {shown(node)} was given; a whole number is wanted, or (name, whole "
            "number) in a structure"
        )
    whole(name, node)
    return node


def node_and_point(given: Any) -> tuple[Any, Any]:
    """(name of a body, point in its axes) as these two; a node and None otherwise."""
    return given if _is_named(given) and not isinstance(given[1], int) else (given, None)


def _is_named(given: Any) -> bool:
    """Whether it is (name, something)."""
    return isinstance(given, tuple) and len(given) == 2 and isinstance(given[0], str)


def row_of(parts: tuple[Part, ...], node: Any, name: str = "node") -> Row:
    """The row of a node, (name, number) or a body's name. Raises ValueError for none."""
    place = node.given if isinstance(node, Row) else node
    check_node(name, place)
    if isinstance(place, int) or not parts:
        what = "a structure" if parts else "a scene of one beam, which has no names"
        there = f": {nodes_of(parts)}" if parts else ""
        raise ValueError(
            f"{name} = {place!r} was given in {what}; one of its nodes is wanted{there}"
        )
    part_name, index = place if isinstance(place, tuple) else (place, None)
    part = {part.name: part for part in parts}.get(part_name)
    if part is None or part.body != (index is None):
        raise ValueError(
            f"{name} = {place!r} was given; the structure has the nodes {nodes_of(parts)}"
        )
    if index is not None and not -part.node_count <= index < part.node_count:
        raise ValueError(
            f"{name} = {place!r} was given; {part.name!r} has the nodes 0 to {part.node_count - 1}"
        )
    row = Row(part.first_node + (index or 0) % part.node_count, place)
    return node if node == row and isinstance(node, Row) else row


def part_of(parts: tuple[Part, ...], name: Any) -> Part:
    """The part of that name. Raises ValueError where there is none such."""
    matches = [part for part in parts if isinstance(name, str) and part.name == name]
    if not matches:
        names = ", ".join(repr(part.name) for part in parts)
        there = f"there are {names}" if parts else "a scene of one beam has no names"
        raise ValueError(f"the part {shown(name)} was asked for; {there}")
    return matches[0]


def one_beam(parts: tuple[Part, ...], name: str) -> None:
    """ValueError where the tip or the root of several parts is asked for."""
    if parts:
        names = [repr(part.name) for part in parts if not part.body]
        beams = ", ".join(names) or "none, bodies alone"
        raise ValueError(
            f"the {name} of a structure was asked for; [name].{name} of one of its beams is "
            f"wanted: {beams}"
        )


def end_of_element(beam: Any, node: Any, name: str, what: str) -> Row:
    """The row of a node between elements. Raises ValueError, with name and what, for others."""
    row = beam.row(node, name)
    first = beam.part_at(row).first_node if beam.parts else 0
    row = row if beam.parts else row % beam.node_count
    if (row - first) % beam.order:
        raise ValueError(
            f"{what} the node {row!r} was given, which lies within an element of order 2; the end "
            "of one, whose number is even, is wanted"
        )
    return row


def large_rotations(scene: Any, what: str) -> None:
    """ValueError where `what` is in a scene of small motions."""
    if scene.small:
        raise ValueError(
            f"small=True with {what} was given; large rotations (small=False) are wanted there"
        )


def nodes_of(parts: tuple[Part, ...]) -> str:
    """The nodes that there are, in words."""
    return ", ".join(map(str, parts))
