"""Acting loads: on which rows the loads of a scene act, and what they read there."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..scene.beam import Beam
from .line_loads import LineRule
from .rows import Rows
from .sample_check import written


class ActingLoad(NamedTuple):
    """A load; node: the row that it acts on, or the rows along which it does, None = all of them,
    or those of an interaction;
    what it reads of a node's motion; which of the internal states are its own, None = it has none;
    elements: along how many it acts, None = the beam's; functions: what a user wrote in it;
    rule: how nodes bear what is known along the beam, None = it is asked at nodes. Of `Conditions`
    the load holds numbers alone, see `LoadEffect.resolved`.
    """

    load: Any
    node: int | slice | tuple[int, ...] | None
    reads: frozenset[str]
    internal: slice | None
    elements: int | None = None
    functions: tuple[Any, ...] = ()
    rule: LineRule | None = None

    def acts_on(self, row: int) -> bool:
        if isinstance(self.node, slice):
            return self.node.start <= row < self.node.stop
        if isinstance(self.node, tuple):
            return row in self.node
        return self.node is None or self.node == row

    @property
    def along(self) -> bool:
        """Whether it acts along rows, per length."""
        return not isinstance(self.node, int)


def acting(
    rows: Rows, loads: tuple[Any, ...], sizes: tuple[int, ...], node: int | None = None
) -> tuple[ActingLoad, ...]:
    """Loads with so many internal states, one after the other; node: the row of those that act at
    one, None = as they say.
    """
    acting_loads, at = [], 0
    for load, size in zip(loads, sizes, strict=True):
        place = None if load.node is None else load.node % rows.node_count if node is None else node
        place = load.nodes if load.kind == "interaction" else place
        internal = slice(at, at + size) if size else None
        acting_loads.append(
            ActingLoad(load, place, rows.depends_on(load), internal, functions=written(load))
        )
        at += size
    return tuple(acting_loads)


def by_part(beam: Beam, act: ActingLoad) -> tuple[ActingLoad, ...]:
    """A load in the pieces in which it acts along the parts of a structure."""
    spans = beam.spans(act.load) if act.node is None else None
    if spans is None:
        return (act,)
    pieces, at = [], None if act.internal is None else act.internal.start
    for span in spans:
        size = 0 if at is None else act.load.internal * (span.nodes.stop - span.nodes.start)
        internal = slice(at, at + size) if size else None
        rows = span.stations if act.load.between_nodes else span.nodes
        pieces.append(act._replace(node=rows, elements=span.element_count, internal=internal))
        at = None if at is None else at + size
    return tuple(pieces)
