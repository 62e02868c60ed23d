"""Interactions: what acts between nodes, as native code knows it: `Joints`, stretches of `Tendons`,
pairs that may touch, couplings (an `Interaction` of a scene).

Each pushes the nodes at its ends, and may have unknowns of its own, called o; those of the one
before it are called p. A block of the matrix is called by its row and its column, each an end or
unknowns: "ij", "io", "oi", "oo".
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import NamedTuple

from ...nodal.model import Model
from .layout import COUPLINGS, JOINTS, PAIRS, STRETCHES, TENDONS

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


def _of_joints(model: Model) -> Edges:
    if not model.joints.count:
        return ()
    w, counts = model.space.unknowns, map(int, model.joints.held.sum(-1))
    pairs = zip(model.topology.joints, counts, strict=True)
    return tuple(Edge(nodes, count, count == w) for nodes, count in pairs)


def _of_stretches(model: Model) -> Edges:
    edges, tendons = [], model.tendons
    pairs = tendons.stretches
    for s, (k, e) in enumerate(pairs):
        first, last = s == 0 or pairs[s - 1][0] < k, s + 1 == len(pairs) or pairs[s + 1][0] > k
        rope, more = tendons.ropes[k], (int(first), int(last), k)
        alone = rope.stiffness is not None or rope.friction is not None
        edges.append(Edge(tendons.nodes[e : e + 2], None, False, alone, alone and not first, more))
    return tuple(edges)


def _of_pairs(model: Model) -> Edges:
    return tuple(map(Edge, getattr(model.touching, "nodes", ())))


def _of_couplings(model: Model) -> Edges:
    return tuple(Edge(one.nodes, one.unknowns or None) for one in model.scene.interactions)


class Interaction(NamedTuple):
    """name: of its functions and records; constants: of the record of its constants, of its table
    and its kinds; rows: of its records; state: records of what else it reads; sides: what its ends
    are called; edges: those of a model; unknowns: whether it has some of its own; chained: whether
    these are coupled to those of the one before; more: integers of a row of its table beside nodes
    and places; of: rows of what several may be of, by the last of these; celled: whether there may
    be some where a structure is made of cells; far: whether some may be too far to act; hoisted:
    whether what does not depend on the unknowns is found before the iterations; kept: the field of
    a state that has rows of it.
    """

    name: str
    constants: str
    rows: str
    state: tuple[str, ...]
    sides: tuple[str, ...]
    edges: Callable[[Model], Edges]
    unknowns: bool = False
    chained: bool = False
    more: int = 0
    of: str | None = None
    celled: bool = False
    far: bool = False
    hoisted: bool = False
    kept: str | None = None

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


JOINT = Interaction(
    *("joint", "joint", JOINTS, ("joint_state",), SIDES[1], _of_joints),
    unknowns=True,
    celled=True,
    hoisted=True,
    kept="joints",
)
TIE = Interaction(
    *("tie", "stretch", STRETCHES, ("pull", "told stretches", "at_stretch")),
    *(SIDES[1], _of_stretches),
    unknowns=True,
    chained=True,
    more=3,
    of=TENDONS,
)
PAIR = Interaction("pair", "pair", PAIRS, ("told pairs",), PAIR_SIDES, _of_pairs, far=True)
COUPLING = Interaction(
    *("coupling", "coupling", COUPLINGS, ("coupling_state",), PAIR_SIDES, _of_couplings),
    unknowns=True,
    kept="memory",
)
INTERACTIONS = JOINT, TIE, PAIR, COUPLING
FINISHED = PAIR, COUPLING, JOINT  # those with functions of their own at the end of a step
