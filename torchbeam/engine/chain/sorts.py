"""Sorts of rows: what a structure is made of, as native code knows it. Nodes; elements, and the
loads between their nodes; and what acts between nodes, see `interaction_sorts`.

Each has a balance, which a step is to close, and an end, which becomes of it. What acts between
nodes pushes those at its ends, and may have unknowns of its own, called o; those of the one before
it are called p. A block of the matrix is called by its row and its column, each an end or unknowns:
"ij", "io", "oi", "oo".
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from types import MappingProxyType
from typing import Any, NamedTuple

from .layout import ELEMENTS, NODES

OWN, LAST = "o", "p"
SIDES = {1: ("i", "j"), 2: ("i", "m", "j")}  # what the nodes of an element are called, by its order
PAIR_SIDES = ("a", "b", "c", "d", "e", "f")  # those of a pair that may touch


class Edge(NamedTuple):
    """Of an interaction, what is coupled: its nodes, None = the ground; how many constraints forces
    of its own hold, None = it has none; whether these have no block of their own, and determine all
    moves of a node; whether it has other unknowns, and whether these are coupled to those of the
    one before; more integers of its row of a table.
    """

    nodes: tuple[int | None, ...]
    held: int | None = None
    firm: bool = False
    alone: bool = False
    chained: bool = False
    more: tuple[int, ...] = ()


Edges = tuple[Edge, ...]


class Sort(NamedTuple):
    """name: of its functions and records; constants: of the record of its constants, of its table
    and its kinds; rows: of its records; reads: records of what else it reads; shared: the number of
    its rows that are a cell's, the others being shared by all, None = all are.

    Of what acts between nodes also sides: what its ends are called; functions: the class of its
    functions, see `InteractionFunctions`; unknowns: whether it has some of its own; chained:
    whether these are coupled to those of the one before; more: integers of a row of its table
    beside nodes and places; of: rows of what several may be of, by the last of these; celled:
    whether there may be some where a structure is made of cells; far: whether some may be too far
    to act; early: whether what does not depend on the unknowns is found before they are; kept: the
    field of a state that has rows of it.
    """

    name: str
    constants: str
    rows: str
    reads: tuple[str, ...] = ()
    shared: str | None = None
    sides: tuple[str, ...] = ()
    functions: Any = None
    unknowns: bool = False
    chained: bool = False
    more: int = 0
    of: str | None = None
    celled: bool = False
    far: bool = False
    early: bool = False
    kept: str | None = None

    @property
    def state(self) -> str:
        """The record of what a state has of it, where there is any."""
        return f"{self.name}_state"

    @property
    def whole(self) -> str:
        """The record of what a state has of those that rows are of."""
        return f"{self.of}_state"

    @property
    def kinds(self) -> str:
        """The list of the numbers of its rows' kinds."""
        return f"{self.constants}_kinds"

    @property
    def blocks(self) -> tuple[str, ...]:
        """All that it may have."""
        letters = (*self.sides, OWN) if self.unknowns else self.sides
        chained = (OWN + LAST, LAST + OWN) if self.chained else ()
        return (*map("".join, product(letters, repeat=2)), *chained)

    @property
    def width(self) -> int:
        """Integers of a row of its table: its nodes, more, of each block the place and stride, and
        of its unknowns those of the right-hand side, where the solution is, and which of all
        multipliers they are.
        """
        return len(self.sides) + self.more + 2 * len(self.blocks) + 4 * self.unknowns

    def place(self, block: str) -> int:
        """Which integer of a row is the first of a block."""
        return len(self.sides) + self.more + 2 * self.blocks.index(block)

    def at(self, number: str) -> Row:
        """The row of this number."""
        return Row(self, number)


class Row(NamedTuple):
    """A row in a loop of code: its sort and its number; the number of its kind, None = that is
    asked for where a function is called. Of what acts between nodes also its row of the table, the
    nodes at its ends, what its ends are called that are nodes, and which of all multipliers its
    forces are, None = it has none.
    """

    of: Sort
    number: str
    kind: int | None = None
    entry: str = ""
    nodes: Mapping[str, str] = MappingProxyType({})
    sides: tuple[str, ...] = ()
    own: str | None = None

    @property
    def name(self) -> str:
        return self.of.name


NODE = Sort("node", "node", NODES, shared="own_nodes")
ELEMENT = Sort("element", "element", ELEMENTS)
LOAD = Sort("element load", "element", ELEMENTS)  # loads between an element's nodes: they follow it
