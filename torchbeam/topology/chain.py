"""Chain: the framework of one line of elements, by the name by which native code knows a beam that
nothing is joined to.
"""

from __future__ import annotations

from .framework import Graph


class Chain(Graph):
    """See `protocols.Topology`."""

    def __init__(self, order: int, element_count: int) -> None:
        super().__init__(order, (element_count,))
