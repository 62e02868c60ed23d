"""Native code over rows of all sorts: where the fields of a row lie, the functions of its kind, and
loops.

A pair that is too far to touch, in all samples of a group, is told by one look, and left out; so
are loads between an element's nodes that do nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from math import isqrt

from ..compiler.function import Output
from ..compiler.shared_ends import END
from .interactions import all_kinds, kinds_of, present
from .kinds import same_code
from .layout import MIDDLE
from .record_code import ROWS, Place, Places, RecordCode
from .sorts import ELEMENT, LOAD, NODE, OWN, SIDES, Row, Sort
from .tendon_functions import TIE

NUMBER = "i32"  # as large as a number of the smallest dtype
MULTIPLIED = "multiplier", "multiplier_state"  # records of forces of constraints
WHOLE = 4  # in a row of a stretch's table: which of all it is of

Then = Callable[[Row], None]


class RowCode(RecordCode):
    """Fields, functions and loops of rows."""

    # records of nodes and of elements that functions read
    AT_NODE: tuple[str, ...] = ("node", "node_state", "unknown", "told nodes", "pose")
    AT_ELEMENT = "element", "stress", "law", "element_state", "told elements"

    @property
    def interactions(self) -> list[Sort]:
        """Those that there are."""
        return present(self.kinds)

    # Fields

    def field_of(self, field: str, row: Row) -> Place:
        """Where a field of a row lies: there, at one of its ends, or with what all have."""
        if row.of is NODE:
            return self.of_node(field, row.number)
        if row.of in (ELEMENT, LOAD):
            return self._of_element(field, row.number)
        return self.of_stretch(field, row.number) if row.of is TIE else self._of_edge(field, row)

    def of_node(self, field: str, j: str) -> Place:
        """A field that is held at a node, or by its support, or by all."""
        if self.held and self.has("support", field):
            return "support", self.integer("support_of", j), field
        return self.first_of(self.AT_NODE, field, j)

    def _of_element(self, field: str, e: str) -> Place:
        """A field that is held by element e, or at one of its nodes, or by all."""
        side, _, name = field.partition(".")
        if side in SIDES[self.order]:
            return (
                ("at_end", self.turn(e, side))
                if name == END
                else self.of_node(name, self.node_of(e, side))
            )
        return self.first_of(self.AT_ELEMENT, field, e)

    def _of_edge(self, field: str, row: Row) -> Place:
        """A field that is held by what acts between nodes, at one of its ends, or by all."""
        side, _, name = field.partition(".")
        if side in row.of.sides:
            return self._at_end_node(name, row.nodes[side])
        for record in MULTIPLIED:
            if row.own is not None and self.has(record, field):
                return record, row.own, field
        return self.first_of(
            (row.of.constants, *row.of.reads, f"{row.name} blocks"), field, row.number
        )

    def of_stretch(self, field: str, s: str) -> Place:
        """A field that is held by stretch s, at one of its ends, by what lies beyond, by the
        stretch before, or by all.
        """
        side, _, name = field.partition(".")
        if side in TIE.sides:
            node = self.code.load(self.code.at(self.entry("stretch", s), TIE.sides.index(side)))
            return self._at_end_node(name, node)
        if side in ("own", "last"):
            return self.of_pull(name, s if side == "own" else self.code.sub(s, 1))
        if side == "beyond":
            return "beyond", s, name
        if field == "start":
            return TIE.whole, self.integers("stretch", s)[WHOLE], TIE.of
        return self.first_of((*TIE.reads, TIE.constants, "tie blocks"), field, s)

    def of_pull(self, name: str, s: str) -> Place:
        """A field of a stretch's tension."""
        named = (x for x in ("pull", "next stretches") if name in self.layout.fields(x))
        return next(named, "at_stretch"), s, name

    def _at_end_node(self, name: str, node: str) -> Place:
        """A field of a node that something connects to others."""
        return ("free", node, name) if name == "free" else self.of_node(name, node)

    # Nodes and elements

    def node_of(self, e: str, side: str) -> str:
        """The node of element e that is called so."""
        first = self.integer("element_nodes", e)
        k = SIDES[self.order].index(side)
        return self.code.add(first, k) if k else first

    def turn(self, e: str, side: str) -> str | int:
        """Where what that node gives is held."""
        return self.node_place(self.node_of(e, side)) if side in SIDES[1] else self.order

    def node_place(self, node: str) -> str:
        """Where what a node gives is held: those up to the elements' order take turns."""
        return self.integer("node_places", node)

    def element_place(self, e: str) -> str:
        """Where what element e leaves is held."""
        return self.integer("element_places", e)

    def elements_at(self, node: str) -> dict[str, str]:
        """The elements on either side of a node; -1 where there is none."""
        return {side: self.integer(f"{side}_elements", node) for side in ("left", "right")}

    def move_of(self, node: str, ahead: int = 0) -> str:
        """Which of the nodes' moves is that of a node, or of one so far ahead; on either side of
        them some do not move.
        """
        return self.code.add(node, self.order + ahead)

    def free_near(self, node: str) -> Places:
        """What is free of the end before, of this one and of the next, where there are any."""
        code, order = self.code, self.order
        before, after = code.sub(node, order), code.add(node, order)
        before = code.choose(code.compare("slt", before, 0), 0, before)
        last = code.sub(self.args["nodes"], 1)
        after = code.choose(code.compare("sgt", after, last), last, after)
        return {
            f"free_{name}": self.at("free", at, "free")
            for name, at in (("before", before), ("here", node), ("after", after))
        }

    def call_held(
        self, name: str, j: str, *call: object, after: Callable[[], None] = lambda: None
    ) -> None:
        """See `call`; a function of node j: where supports hold nodes, "held" in front of its
        name, and what comes `after` it at those.
        """
        if not self.held:
            self.call(name, *call)
            return
        code = self.code
        held = code.compare("ne", self.integer("held", j), 0)
        with code.when(code.new(f"xor i1 {held}, true")):
            self.call(name, *call)
        with code.when(held):
            self.call(f"held {name}", *call)
            after()

    def restore(self, record: str, then: Callable[[str], None] = lambda node: None) -> None:
        """Moves of midside nodes, if there are any, from what a record has for their elements'
        ends; `then`: what is to be done with each.
        """
        if not self.has_midsides:
            return
        with self.code.loop(0, self.args["elements"]) as e:
            node = self.node_of(e, "m")
            places = {
                "before": (record, self.move_of(node, -1)),
                "after": (record, self.move_of(node, 1)),
                "> move": ("move", self.move_of(node)),
                MIDDLE: ("middle", e),
            }
            self.call("restore", places=places)
            then(node)

    # Functions

    def call_of(
        self, word: str, row: Row, to: Place | str | None = None, places: Places | None = None
    ) -> None:
        """The function of this word of a row, if its kind has one, with its fields; to: the record
        of those that it gives, or see `call`.
        """
        if isinstance(to, str):
            to = to, row.number if self.layout.records[to].rows == row.of.rows else 0
        self.by_name(
            word, row, partial(self.call, of=partial(self.field_of, row=row), to=to, places=places)
        )

    def by_name(self, word: str, row: Row, then: Callable[[str], None]) -> None:
        """then(name) of the function of this word of a row, if its kind has one."""
        for k in self.each_kind(row.of, row.number) if row.kind is None else (row.kind,):
            if (name := f"{word} {k}") in self.functions:
                then(name)

    def outputs_of(self, word: str, row: Row) -> dict[str, Output]:
        """What such functions give, which those of nodes, or of elements, have in common; nothing
        where there are none.
        """
        name = f"{word} {row.kind or 0}"
        return self.functions[name].outputs if name in self.functions else {}

    def each_kind(self, sort: Sort, number: str) -> Iterator[int]:
        """Kinds of a sort; what is written in a round runs for a row of that kind."""
        code, count = self.code, len(all_kinds(self.kinds, sort))
        kind = self.integer(sort.kinds, number)
        for k in range(count):
            if count == 1:
                yield k
                continue
            with code.when(code.compare("eq", kind, k)):
                yield k

    # Loops

    def each_row(self, sort: Sort, then: Then, shared: bool | None = None) -> None:
        """then(row) of each row of a sort; shared: see `entries`."""
        with self.code.loop(*self.range_of(ROWS[sort.rows], shared)) as number:
            if sort.functions is None:
                then(sort.at(number))
            else:
                self._edge(sort, number, then)

    def _edge(self, sort: Sort, number: str, then: Then) -> None:
        """A row of what acts between nodes."""
        code, entry = self.code, self.entry(sort.constants, number)
        nodes = {side: code.load(code.at(entry, k)) for k, side in enumerate(sort.sides)}
        kinds = all_kinds(self.kinds, sort)
        for k in self.each_kind(sort, number):
            function = same_code(kinds, k, sort.name)
            unit = code.load(code.at(entry, sort.width - 1)) if kinds[k].multiplied else None
            then(Row(sort, number, function, entry, nodes, kinds[k].sides, unit))

    def each_of(
        self, sort: Sort, then: Then, look: bool = False, shared: bool | None = None
    ) -> None:
        """The same of each row that acts, behind that of an element the loads between its nodes;
        look: which are far is found out, from the unknowns as they are.
        """
        if sort is ELEMENT:
            self.each_row(ELEMENT, lambda row: (then(row), self.each_load(row.number, then)))
        elif sort is NODE or (sort in self.interactions and not sort.far):
            self.each_row(sort, then, shared)
        elif sort in self.interactions:
            self._each_near(sort, then, look)

    def each_load(self, e: str, then: Then) -> None:
        """then(row) of the loads between the nodes of element e, where they do anything in one of
        the samples.
        """
        for k in self.each_kind(ELEMENT, e):
            if f"far {LOAD.name} {k}" not in self.functions:
                continue
            row = Row(LOAD, e, k)
            self.call_of(f"far {LOAD.name}", row, "change")
            with self.unless_all(self.at("change", 0, "far")):
                then(row)

    def _each_near(self, sort: Sort, then: Then, look: bool) -> None:
        code, count = self.code, self.at("near_count")
        if not look:
            with code.loop(0, self._number(count)) as n:
                self._edge(sort, self._number(self.at("near", n)), then)
            return
        code.store(0, count, NUMBER)

        def near(row: Row) -> None:
            blocks = f"{sort.name} blocks"
            self.call_of(f"far {sort.name}", row, blocks)
            with self.unless_all(self.at(blocks, row.number, "far")):
                k = self._number(count)
                for value, to in ((row.number, self.at("near", k)), (code.add(k, 1), count)):
                    code.store(code.new(f"trunc i64 {value} to {NUMBER}"), to, NUMBER)
                then(row)

        self.each_row(sort, near)

    def _number(self, pointer: str) -> str:
        """The integer that lies there."""
        return self.code.new(f"sext {NUMBER} {self.code.load(pointer, NUMBER)} to i64")

    # Blocks of what acts between nodes

    def coupled(self, row: Row) -> int:
        """So many of a node's unknowns its blocks are of."""
        return self._coupled(row.of, row.kind)

    def _coupled(self, sort: Sort, kind: int) -> int:
        outputs, first = self._blocks_of(sort, kind), 2 * sort.sides[0]
        return isqrt(len(outputs[first].nodes)) if first in outputs else self.width

    def _blocks_of(self, sort: Sort, kind: int) -> dict[str, Output]:
        """What the function of a kind gives: other kinds may have more."""
        name = f"{sort.name} {kind}"
        return self.functions[
            name if name in self.functions else f"{sort.name} blocks {kind}"
        ].outputs

    def part(self) -> int | None:
        sizes = {
            self._coupled(sort, k)
            for sort in self.interactions
            for k, _ in kinds_of(self.kinds, sort)
        }
        return min(sizes - {self.width}, default=None)

    def join(self, row: Row) -> None:
        """Its blocks, of what supports leave, and what is asked of its own unknowns."""
        free = f"free {row.name} {row.kind}"
        if free not in self.functions:
            self._join_blocks(row)
        else:
            code, none = self.code, -1
            for side in row.sides:
                none = code.new(f"and i64 {none}, {self.integer('support_of', row.nodes[side])}")
            held = code.compare("ne", none, -1)
            with code.when(held):
                self.call_of(f"free {row.name}", row, "change")
                self._join_blocks(row, self.functions[free].outputs)
            with code.when(code.new(f"xor i1 {held}, true")):
                self._join_blocks(row)
        if "rhs" in self._blocks_of(row.of, row.kind):
            width = row.of.width
            first, stride = (self.code.load(self.code.at(row.entry, width - k)) for k in (4, 3))
            with self._there(first):
                rhs = self.at(f"{row.name} blocks", row.number, "rhs")
                self.add_column(first, stride, rhs)

    def _join_blocks(self, row: Row, free: Container[str] = ()) -> None:
        code, sort, size = self.code, row.of, self.coupled(row)
        name = "block" if size == self.width else "part"
        for block in self._blocks_of(sort, row.kind):
            if block not in sort.blocks:
                continue
            place = sort.place(block)
            first, stride = (code.load(code.at(row.entry, place + k)) for k in range(2))
            source = (
                ("change", 0, block)
                if block in free
                else (f"{sort.name} blocks", row.number, block)
            )
            with self._there(first) if sort.unknowns else nullcontext():
                self.add_block(first, stride, self.at(*source), name)

    def _there(self, place: str) -> AbstractContextManager[None]:
        """What is written runs where a place is one."""
        return self.code.when(self.code.compare("sge", place, 0))

    def moves_of(self, row: Row) -> Places:
        """The moves of its ends, and those of its own unknowns, if it may have some."""
        moves: Places = {
            f"{side}.move": ("move", self.move_of(row.nodes[side])) for side in row.sides
        }
        return moves | ({f"{OWN}.move": self.solution_of(row)} if row.of.unknowns else {})

    def solution_of(self, row: Row) -> str:
        """The moves of its own unknowns."""
        return self.matrix(self.code.load(self.code.at(row.entry, row.of.width - 2)))

    # Multipliers

    def each_multiplier(self, then: Callable[[str], None]) -> None:
        """then(number) of each force of a constraint."""
        if self.kinds.multiplied:
            with self.rows_of("multiplier") as number:
                then(number)
