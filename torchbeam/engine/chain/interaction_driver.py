"""Native driver of interactions: their balance, their blocks, and what becomes of them in a step.

A pair that is too far to touch, in all samples of a group, is told by one look, and left out.
"""

from __future__ import annotations

from collections.abc import Callable, Container
from contextlib import AbstractContextManager, nullcontext
from math import isqrt
from typing import NamedTuple

from ..compiler.function import Output
from ..compiler.split import HOISTED
from .driver_code import DriverCode, Place, Places
from .interaction import OWN, Interaction
from .interactions import SUMS, all_kinds, kinds_of, present
from .node_kinds import alike

NUMBER = "i32"  # as large as a number of the smallest dtype
MULTIPLIED = "multiplier", "multiplier_state"  # records of forces of constraints


class Entry(NamedTuple):
    """An interaction in a loop: its number, its row of the table, the nodes at its ends, the number
    of its functions, what its ends are called that are nodes, and which of all multipliers its
    forces are; None = it has none.
    """

    of: Interaction
    number: str
    row: str
    nodes: dict[str, str]
    function: int
    sides: tuple[str, ...]
    own: str | None

    @property
    def name(self) -> str:
        return self.of.name


Then = Callable[[Entry], None]


class InteractionCode(DriverCode):
    """Where the fields of interactions lie, loops over them; their balance, their blocks, and what
    becomes of them in a step.
    """

    @property
    def interactions(self) -> list[Interaction]:
        """Those that there are."""
        return present(self.kinds)

    def _each_of(
        self, one: Interaction, then: Then, look: bool = False, shared: bool | None = None
    ) -> None:
        """then(entry) of each that is not far; look: which are is found out, from the unknowns as
        they are; shared: see `_range`.
        """
        if one not in self.interactions:
            return
        code = self.code
        if not one.far:
            with code.loop(*self._range(one.constants, shared)) as number:
                self._by_kind(one, number, then)
            return
        count = self.at("near_count")
        if not look:
            with code.loop(0, self._integer(count)) as n:
                self._by_kind(one, self._integer(self.at("near", n)), then)
            return
        code.store(0, count, NUMBER)

        def near(entry: Entry) -> None:
            self._call_of(f"far {one.name} {entry.function}", entry, f"{one.name} blocks")
            far = self.at(f"{one.name} blocks", entry.number, "far")
            code.call("all", far, result := code.slot())
            with code.when(code.compare("eq", code.load(result), 0)):
                k = self._integer(count)
                for value, to in ((entry.number, self.at("near", k)), (code.add(k, 1), count)):
                    code.store(code.new(f"trunc i64 {value} to {NUMBER}"), to, NUMBER)
                then(entry)

        with code.loop(0, self.args[f"{one.constants}_count"]) as number:
            self._by_kind(one, number, near)

    def _by_kind(self, one: Interaction, number: str, then: Then) -> None:
        code, row = self.code, self._entry(one.constants, number)
        nodes = {side: code.load(code.at(row, k)) for k, side in enumerate(one.sides)}
        own = all_kinds(self.kinds, one)
        with self._each(f"{one.constants}_kinds", len(own), number) as kinds:
            for k in kinds:
                function = alike(own, k, one.name)
                mine = code.load(code.at(row, one.width - 1)) if own[k].multiplied else None
                then(Entry(one, number, row, nodes, function, own[k].sides, mine))

    def _integer(self, pointer: str) -> str:
        """That lies there."""
        return self.code.new(f"sext {NUMBER} {self.code.load(pointer, NUMBER)} to i64")

    def _of_interaction(self, field: str, entry: Entry) -> Place:
        """A field that is held by an interaction, at one of its ends, or by all."""
        one, number = entry.of, entry.number
        side, _, name = field.partition(".")
        if side in one.sides:
            return self._at_end_node(name, entry.nodes[side])
        for record in MULTIPLIED:
            if entry.own is not None and self._has(record, field):
                return record, entry.own, field
        return self._first_of((one.constants, *one.state, f"{one.name} blocks"), field, number)

    def _call_of(self, name: str, entry: Entry, to: str, places: Places | None = None) -> None:
        """A function of an interaction, which gives fields of a record; places: of other fields."""
        number = entry.number if self.layout.records[to].rows == entry.of.rows else 0
        self._call(name, lambda f: self._of_interaction(f, entry), (to, number), places)

    def coupled(self, one: Interaction, function: int) -> int:
        """So many of a node's unknowns the blocks of such a function are of."""
        outputs, first = self._blocks_of(one, function), 2 * one.sides[0]
        return isqrt(len(outputs[first].nodes)) if first in outputs else self.width

    def _blocks_of(self, one: Interaction, function: int) -> dict[str, Output]:
        """What such a function gives: other kinds may have more."""
        name = f"{one.name} {function}"
        name = name if name in self.functions else f"{one.name} blocks {function}"
        return self.functions[name].outputs

    def _part(self) -> int | None:
        sizes = {
            self.coupled(one, k) for one in self.interactions for k, _ in kinds_of(self.kinds, one)
        }
        return min(sizes - {self.width}, default=None)

    @property
    def width(self) -> int:
        """Unknowns of a node."""
        return self.layout.records["move"].size

    # Blocks

    def _join(self, entry: Entry) -> None:
        """Its blocks, of what supports leave, and what is asked of its own unknowns."""
        free = f"free {entry.name} {entry.function}"
        if free not in self.functions:
            self._join_blocks(entry)
        else:
            code, none = self.code, -1
            for side in entry.sides:
                none = code.new(f"and i64 {none}, {self._support_of(entry.nodes[side])}")
            held = code.compare("ne", none, -1)
            with code.when(held):
                self._call_of(free, entry, "change")
                self._join_blocks(entry, self.functions[free].outputs)
            with code.when(code.new(f"xor i1 {held}, true")):
                self._join_blocks(entry)
        if "right" in self._blocks_of(entry.of, entry.function):
            width = entry.of.width
            first, stride = (self.code.load(self.code.at(entry.row, width - k)) for k in (4, 3))
            with self._there(first):
                right = self.at(f"{entry.name} blocks", entry.number, "right")
                self._add_column(first, stride, right)

    def _join_blocks(self, entry: Entry, free: Container[str] = ()) -> None:
        code, one, size = self.code, entry.of, self.coupled(entry.of, entry.function)
        name = "block" if size == self.width else "part"
        for block in self._blocks_of(one, entry.function):
            if block not in one.blocks:
                continue
            place = one.place(block)
            first, stride = (code.load(code.at(entry.row, place + k)) for k in range(2))
            source = (
                ("change", 0, block)
                if block in free
                else (f"{one.name} blocks", entry.number, block)
            )
            with self._there(first) if one.unknowns else nullcontext():
                self._add_block(first, stride, self.at(*source), name)

    def _there(self, place: str) -> AbstractContextManager[None]:
        """What is written runs where a place is one."""
        return self.code.when(self.code.compare("sge", place, 0))

    def _solution_of(self, entry: Entry) -> str:
        """The moves of its own unknowns."""
        return self._matrix(self.code.load(self.code.at(entry.row, entry.of.width - 2)))

    # Balance, and what becomes of them in a step

    def _push(self, entry: Entry) -> None:
        """Its balance and blocks, and its push on the nodes."""
        record, size = f"{entry.name} blocks", self.coupled(entry.of, entry.function)
        before = f"before {entry.name}"
        hoisted: Places = {}
        if before in self.layout.records:
            hoisted = {HOISTED: (before, entry.number)}
        self._call_of(f"{entry.name} {entry.function}", entry, record, hoisted)
        if "told" in self.functions[f"{entry.name} {entry.function}"].outputs:
            told, far = ((record, entry.number, name) for name in ("told", "far"))
            self._blend((f"next {entry.of.rows}", entry.number), told, self.at(*far))
        for side in entry.sides:
            push = record, entry.number, f"{side}.push"
            self._add(("push", entry.nodes[side]), push, size)
        for name in SUMS:
            if name in self.layout.fields(record):
                own = self.at(record, entry.number, name)
                self.code.call("largest", self.at("sums", 0, name), own)

    def _hoist(self, entry: Entry) -> None:
        """What does not depend on the unknowns."""
        self._call_of(f"before {entry.name} {entry.function}", entry, f"before {entry.name}")

    def _interaction_reactions(self, support: str, node: str) -> None:
        """What interactions add to the reaction of a support, at a node. Where cells share nodes,
        there are no others than those that cells have.
        """
        code, to = self.code, self.at("support", support, "reaction")
        total = to if self.cells == 1 else self.at("end_reaction", 0, "total")
        if self.cells > 1:
            self._fill(total, self.width)

        def reaction(entry: Entry) -> None:
            moves: Places = {
                f"{side}.move": ("move", self._move_of(entry.nodes[side])) for side in entry.sides
            }
            if entry.of.unknowns:
                moves[f"{OWN}.move"] = self._solution_of(entry)
            moves["end_free"] = ("free", node)
            for side in entry.sides:
                with code.when(code.compare("eq", entry.nodes[side], node)):
                    name = f"{entry.name} reaction {entry.function} {side}"
                    self._call_of(name, entry, "change", moves)
                    self._add(total, ("change", 0, "reaction"), self.width)

        for one in self.interactions:
            for shared in self.parts:
                self._each_of(one, reaction, shared=shared)
                if shared is False:
                    with code.when(code.compare("sge", node, self.args["own_nodes"])):
                        self._over_cells("sum", total, self.width)
        if self.cells > 1:
            self._add(to, total, self.width)

    def _finish_interaction(self, entry: Entry, good: str) -> None:
        """Its state after the step, of what has gone well, and its work."""
        self._call_of(f"finish {entry.name} {entry.function}", entry, "change")
        for name in self.layout.fields(f"{entry.name}_state"):
            self._take((f"{entry.name}_state", entry.number, name), ("change", 0, name), good)
        if entry.own is not None:
            self._take(("multiplier_state", entry.own, "last_force"), ("change", 0, "force"), good)
        own = self._counted(good, entry.number, "own_edges")
        self._sum(("sample", 0, "work"), ("change", 0, "work"), own)
        if "energy" in self.layout.records:
            self._add(("energy", 0, "rise"), ("change", 0, "rise"))

    # Forces of constraints, which are unknowns

    def _each_multiplier(self, then: Callable[[str], None]) -> None:
        """then(number) of each."""
        if self.kinds.multiplied:
            with self._rows_of("multiplier") as number:
                then(number)

    def _start_multipliers(self) -> None:
        """Those to start from."""
        self._each_multiplier(
            lambda k: self._copy_to(("multiplier", k), ("multiplier_state", k, "last_force"))
        )

    def _update_multipliers(self, over: str) -> None:
        """Those after the moves, but of samples that are over."""

        def update(k: str) -> None:
            move = self._matrix(self.code.load(self._entry("multipliers", k)))
            places: Places = {"force": ("multiplier", k), "move": move}
            self._call("multiplier update", to=("change", 0), places=places)
            self._blend(("multiplier", k), ("change", 0, "force"), over)

        self._each_multiplier(update)

    def _keep_multipliers(self, good: str) -> None:
        """Those of what has gone well."""
        self._each_multiplier(
            lambda k: self._take(("multiplier_state", k, "last_force"), ("multiplier", k), good)
        )

    def _counted(self, good: str, row: str, own: str) -> str:
        """What has gone well, in whose lanes a row counts."""
        raise NotImplementedError
