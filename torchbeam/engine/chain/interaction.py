"""Interactions: what acts between nodes, as native code knows it: `Joints`, stretches of `Tendons`,
pairs that may touch, couplings (an `Interaction` of a scene).

Each pushes the nodes at its ends, and may have unknowns of its own, called o; those of the one
before it are called p. A block of the matrix is called by its row and its column, each an end or
unknowns: "ij", "io", "oi", "oo".
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

from .layout import COUPLINGS, JOINTS, PAIRS, STRETCHES
from .node_kinds import PAIR_SIDES, SIDES

OWN, LAST = "o", "p"


class Interaction(NamedTuple):
    """name: of its functions and records; constants: of the record of its constants, of its table
    and its kinds; rows: of its records; state: records of what else it reads; sides: what its ends
    are called; unknowns: whether it has some of its own; chained: whether these are coupled to
    those of the one before; more: integers of a row of its table beside nodes and places.
    """

    name: str
    constants: str
    rows: str
    state: tuple[str, ...]
    sides: tuple[str, ...]
    unknowns: bool = False
    chained: bool = False
    more: int = 0

    @property
    def blocks(self) -> tuple[str, ...]:
        """All that it may have."""
        letters = (*self.sides, OWN) if self.unknowns else self.sides
        chained = (OWN + LAST, LAST + OWN) if self.chained else ()
        return (*map("".join, product(letters, repeat=2)), *chained)

    @property
    def width(self) -> int:
        """Integers of a row of its table: its nodes, more, of each block the place and stride, and
        of its unknowns those of the right-hand side, and where the solution is.
        """
        return len(self.sides) + self.more + 2 * len(self.blocks) + 3 * self.unknowns

    def place(self, block: str) -> int:
        """Which integer of a row is the first of a block."""
        return len(self.sides) + self.more + 2 * self.blocks.index(block)


JOINT = Interaction("joint", "joint", JOINTS, ("joint_state", "joint_unknown"), SIDES[1], True)
TIE = Interaction(
    "tie", "stretch", STRETCHES, ("pull", "told", "at_stretch"), SIDES[1], True, True, 3
)
PAIR = Interaction("pair", "pair", PAIRS, (), PAIR_SIDES)
COUPLING = Interaction("coupling", "coupling", COUPLINGS, (), PAIR_SIDES)
INTERACTIONS = JOINT, TIE, PAIR, COUPLING
FINISHED = PAIR, COUPLING, JOINT  # those with functions of their own at the end of a step
