"""Layout of a step's memory: records of fields, one of each node or element, and what of them is
taken from tensors.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from ..compiler.function import Functions

# rows of a record
NODES, ELEMENTS, SUPPORTS, MOVES, ONE = "nodes", "elements", "supports", "moves", "one"
# nodes at which something acts, numbers of the system that these make
INTERFACE, ENTRIES = "interface", "entries"
STRETCHES, PAIRS = "stretches", "pairs"  # of ropes, and of what may touch
# what these are called beside the stress of elements, whose rows they follow in a state
FORCES = "multiplier_force"
MULTIPLIERS = "multipliers"  # forces of constraints, see `nodal.multipliers`
# where what nodes and elements give is held: by turns while a run of nodes is eliminated, and of
# those at the interface for as long as the elimination takes
NODE_PLACES, ELEMENT_PLACES = "node places", "element places"
SIGNS = "signs"  # numbers of the largest group of unknowns, of whose pivots signs are asked
# packed: what a node gives its row, an element its ends' rows, and its stress
OWN, BETWEEN, LAW = "own", "between", "law"
# what an element of three nodes gives their rows, and what its midside node follows by
INNER, MIDDLE = "inner", "middle"
GIVEN = {1: BETWEEN, 2: INNER}  # what elements of an order give
REACTIONS = {"found": "reaction_bar", "last": "reaction_start_bar"}  # cotangents of a support's
# what gives what an iteration tells the next one, and of which rows
TOLD = {"tension next": STRETCHES, "element load": ELEMENTS, "node": NODES, "pair": PAIRS}
FLAGS = "passed_through", "near"  # of what may touch, see `StepProblem`


@dataclass
class Record:
    """Fields one after the other: name -> (first component, components); `rows` says how many
    records there are.
    """

    name: str
    rows: str
    fields: dict[str, tuple[int, int]] = field(default_factory=dict)
    size: int = 0

    def add(self, name: str, components: int) -> None:
        """A field, unless it is there. Raises ValueError where it is, and smaller."""
        if name not in self.fields:
            self.fields[name] = self.size, components
            self.size += components
        elif self.fields[name][1] < components:
            raise ValueError(
                f"{components} numbers of {name!r} in {self.name!r} were given, which has "
                f"{self.fields[name][1]}; no more are wanted"
            )

    def place(self, name: str) -> int:
        return self.fields[name][0]


class Layout:
    """Records by name. Where they begin is told by `bases`: the same code serves any number of
    elements.
    """

    def __init__(self) -> None:
        self.records: dict[str, Record] = {}

    def record(self, name: str, rows: str, fields: Iterable[tuple[str, int]] = ()) -> Record:
        record = self.records.setdefault(name, Record(name, rows))
        for one, components in fields:
            record.add(one, components)
        return record

    def fields(self, record: str) -> dict[str, tuple[int, int]]:
        """Of a record; none where there is none of that name."""
        return self.records[record].fields if record in self.records else {}

    def cotangent(self, record: str, field: str) -> tuple[str, str]:
        """Record and field of the cotangent of a field: of a state, at the start of a step."""
        if record == "support" and field in REACTIONS:
            return REACTIONS[field], "reaction"
        start = f"{record}_start_bar"
        return start if start in self.records else f"{record}_bar", field

    @property
    def states(self) -> list[str]:
        """Parts of a state that have cotangents, see `cotangents`."""
        return [name.removesuffix("_grad") for name in self.records if name.endswith("_grad")]

    def bases(self, counts: dict[str, int]) -> tuple[list[int], int]:
        """First component of each record's first row, in order; components in all. counts: how many
        rows there are of each sort, see `counts`.
        """
        bases, at = [], 0
        for record in self.records.values():
            bases.append(at)
            at += record.size * counts[record.rows]
        return bases, at

    def numbers(self) -> list[list[Any]]:
        """As plain lists, names and integers."""
        return [
            [record.name, record.rows, [[name, size] for name, (_, size) in record.fields.items()]]
            for record in self.records.values()
        ]

    @classmethod
    def of(cls, numbers: list[list[Any]]) -> Layout:
        """From such lists. Raises ValueError, TypeError for others."""
        layout = cls()
        for name, rows, fields in numbers:
            layout.record(str(name), str(rows), [(str(field), int(size)) for field, size in fields])
        return layout


def cotangents(layout: Layout, name: str, rows: str, fields: list[tuple[str, int]]) -> None:
    """Records of the cotangents of a part of the state: of what a step has made, of its end, and of
    its start.
    """
    for what in ("grad", "bar", "start_bar"):
        layout.record(f"{name}_{what}", rows, fields)


def sizes(functions: Functions, name: str) -> dict[str, int]:
    """Components of a function's outputs."""
    return {field: len(out.nodes) for field, out in functions[name].outputs.items()}


def most(functions: Functions) -> dict[str, int]:
    """Components of what functions give, by field the most that one of them has."""
    there: dict[str, int] = {}
    for name in functions:
        for out, size in sizes(functions, name).items():
            there[out] = max(size, there.get(out, 0))
    return there


def largest(functions: Functions, name: str) -> dict[str, int]:
    """Components of the outputs of the functions of this name of all kinds ("name 0", ...), the
    most that one of them has.
    """
    return most({k: x for k, x in functions.items() if k.removeprefix(f"{name} ").isdigit()})


def counts(order: int, nodes: int, elements: int, supports: int, **more: int) -> dict[str, int]:
    """How many rows there are of each sort, of elements of this order; of the nodes' moves an
    element's more on either side. more: others.
    """
    return {
        NODES: nodes,
        ELEMENTS: elements,
        SUPPORTS: supports,
        MOVES: nodes + 2 * order,
        ONE: 1,
        **more,
    }
