"""Native code for passes over nodes and elements: where the fields of records lie, the entries of
tables, calls of functions, masks, transfers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from ..compiler.block_elimination import BlockElimination
from ..compiler.denormals import flushing
from ..compiler.function import Function
from ..compiler.lane_loops import lane_loops
from ..compiler.llvm import Module
from ..compiler.loop_text import Code
from ..compiler.shared_ends import END
from .cell_sums import CellSums
from .conserving_functions import ENERGIES
from .interaction import INTERACTIONS, SIDES
from .layout import ELEMENTS, INTERFACE, MIDDLE, MULTIPLIERS, NODES, ONE, SUPPORTS, Layout
from .node_kinds import Kinds
from .tables import COUNTS, LISTS, WIDTH
from .transfers import Transfers

Place = tuple[Any, ...]  # a record, which of its rows, and a field of that, or all of it
Places = dict[str, "str | Place"]
# arguments of all programs
ALL = (
    *("inputs", "input_count", "outputs", "output_count", "samples", "steps", "elements"),
    *("supports", "memory", "first_group", "end_group", *LISTS, *COUNTS),
)
# how many rows there are of each sort
ROWS = {NODES: "nodes", ELEMENTS: "elements", SUPPORTS: "supports"}
ROWS |= {one.rows: f"{one.constants}_count" for one in INTERACTIONS}
ROWS |= {
    name: f"{name}_count" for name in (MULTIPLIERS, *(one.of for one in INTERACTIONS if one.of))
}


class DriverCode:
    """Text of `run(ptr args)`, with 64-bit integers and pointers in the order of `ARGS`, for
    functions by name; those of kinds of nodes, or of elements, end with the number of the kind.
    """

    ARGS: tuple[str, ...] = ALL
    # records of nodes and of elements that functions read
    AT_NODE: tuple[str, ...] = ("node", "state", "unknown", "told nodes")
    AT_ELEMENT = "element", "stress", "law", "element_state", "told elements"

    def __init__(
        self,
        module: Module,
        functions: dict[str, Function],
        layout: Layout,
        kinds: Kinds,
        held: bool,
        cells: int = 1,
    ) -> None:
        self.cells = cells  # lanes of a sample
        self.module, self.functions, self.layout, self.kinds, self.held = (
            module,
            functions,
            layout,
            kinds,
            held,
        )
        self.lanes, self.order = module.lanes, len(kinds.elements[0].ends) - 1
        self.bytes = self.lanes.count * self.lanes.bytes  # of a component
        self.code = Code("driver", ["ptr %args"])
        self.args: dict[str, str] = {}
        self.base: dict[str, str] = {}

    def text(self) -> str:
        """Definitions of `run` and of the small loops that it calls."""
        code = self.code
        for k, name in enumerate(self.ARGS):
            self.args[name] = code.load(code.at("%args", k))
        pointer = {
            name: code.new(f"inttoptr i64 {self.args[name]} to ptr") for name in ("memory", *LISTS)
        }
        self.args |= pointer
        for k, name in enumerate(self.layout.records):
            begin = code.mul(code.load(code.at(pointer["bases"], k)), self.bytes)
            self.base[name] = code.at(pointer["memory"], begin, "i8")
        with code.loop(self.args["first_group"], self.args["end_group"]) as group:
            self._group(code.mul(group, self.lanes.count // self.cells))
        driver = code.text().replace(") nounwind", ") noinline nounwind", 1)
        loops = lane_loops(self.lanes) + Transfers(self.lanes, self.cells).functions()
        if self.cells > 1:
            loops += CellSums(self.lanes, self.cells).functions()
        if self.has_interface:
            w = self.layout.records["move"].size
            loops += BlockElimination(self.lanes, w, self._part(), self.signed).functions()
        return "\n\n".join((*loops, driver, flushing("run", "driver")))

    @property
    def has_interface(self) -> bool:
        """Whether joints, tendons or pairs hold nodes, or there are bodies."""
        return INTERFACE in self.kinds.runs

    @property
    def has_midsides(self) -> bool:
        """Whether elements have a node between their ends."""
        return MIDDLE in self.layout.records

    @property
    def signed(self) -> bool:
        """Whether signs of the interface's pivots are asked for."""
        return "signs" in self.layout.records

    def _part(self) -> int | None:
        """Unknowns of a node by which pairs that touch couple; None = all, or there are none."""
        return None

    def _group(self, first: str) -> None:
        """All steps of the samples from the first of a group on."""
        raise NotImplementedError

    # Where fields lie

    def at(self, record: str, index: str | int = 0, field: str | None = None) -> str:
        """Pointer to a field of a record's row."""
        layout_record = self.layout.records[record]
        first = 0 if field is None else layout_record.place(field)
        if isinstance(index, int):
            return self.code.at(
                self.base[record], (index * layout_record.size + first) * self.bytes, "i8"
            )
        begin = self.code.mul(index, layout_record.size * self.bytes)
        return self.code.at(self.code.at(self.base[record], begin, "i8"), first * self.bytes, "i8")

    def _call(
        self,
        name: str,
        of: Callable[[str], str | Place] = str,
        to: Place | None = None,
        places: Places | None = None,
    ) -> None:
        """A function. places: where some of its fields lie, those that it gives with "> " before
        them; of: where the others do; to: the record and the row of those that it gives, None =
        `of` says that, too.
        """
        function, places = self.functions[name], places or {}

        def where(field: str) -> str:
            place = places.get(field)
            if place is None and to is not None and field[0] == ">":
                place = (*to, field[2:])
            return self._pointer(of(field) if place is None else place)

        given = (*function.inputs, *(f"> {field}" for field in function.outputs))
        self.code.call(name, *map(where, given))

    def _at_node(self, word: str, j: str, *given: Any, call: Callable | None = None) -> None:
        """The function of this word of the kind of node j, if that has one, with what `_call`, or
        `call`, takes behind what says where fields of nodes lie.
        """
        of = partial(self._of_node, j=j)
        self._of_its_kind(word, "kinds", len(self.kinds.nodes), j, call or self._call, of, *given)

    def _at_element(self, word: str, e: str, *given: Any, call: Callable | None = None) -> None:
        """The same of element e."""
        of, count = partial(self._of_element, e=e), len(self.kinds.elements)
        self._of_its_kind(word, "element_kinds", count, e, call or self._call, of, *given)

    def _of_its_kind(
        self, word: str, kinds: str, count: int, row: str, call: Callable, *given: Any
    ) -> None:
        with self._each(kinds, count, row) as numbers:
            for k in numbers:
                if (name := f"{word} {k}") in self.functions:
                    call(name, *given)

    @contextmanager
    def _rows_of(self, record: str) -> Iterator[str | int]:
        """Each row of a record."""
        rows = self.layout.records[record].rows
        if rows == ONE:
            yield 0
            return
        with self.code.loop(0, self.args[ROWS[rows]]) as k:
            yield k

    def _pointer(self, place: str | Place) -> str:
        return place if isinstance(place, str) else self.at(*place)

    def _size(self, place: Place) -> int:
        """Components that lie there."""
        record = self.layout.records[place[0]]
        return record.size if len(place) < 3 else record.fields[place[2]][1]

    def _zeros_in(self, *records: str) -> None:
        """Zeros in what there is of them."""
        for record in records:
            if record in self.layout.records:
                with self._rows_of(record) as k:
                    self._fill((record, k))

    def _has(self, record: str, field: str) -> bool:
        """Whether a record has a field, or one of its cotangents."""
        own, bars = self.layout.cotangent(record, field)
        return field in self.layout.fields(record) or bars in self.layout.fields(own)

    def _first_of(self, records: Iterable[str], field: str, row: str | int = 0) -> Place:
        """A field of the first of these records that has it; else of what all have in common."""
        for record in records:
            if self._has(record, field):
                return record, row, field
        return "common", 0, field

    def _of_node(self, field: str, j: str) -> Place:
        """A field that is held at a node, or by its support, or by all."""
        if self.held and self._has("support", field):
            return "support", self._support_of(j), field
        return self._first_of(self.AT_NODE, field, j)

    def _of_element(self, field: str, e: str) -> Place:
        """A field that is held by element e, or at one of its nodes, or by all."""
        side, _, name = field.partition(".")
        if side in SIDES[self.order]:
            return (
                ("at_end", self._turn(e, side))
                if name == END
                else self._of_node(name, self._node_of(e, side))
            )
        return self._first_of(self.AT_ELEMENT, field, e)

    def _at_end_node(self, name: str, node: str) -> Place:
        """A field of a node that something connects to others."""
        return ("free", node, name) if name == "free" else self._of_node(name, node)

    def _support_of(self, j: str) -> str:
        """Which support is that of node j; -1 where it has none."""
        return self.code.load(self.code.at(self.args["support_of"], j))

    def _node_of(self, e: str, side: str) -> str:
        """The node of element e that is called so."""
        first = self.code.load(self.code.at(self.args["element_nodes"], e))
        k = SIDES[self.order].index(side)
        return self.code.add(first, k) if k else first

    def _turn(self, e: str, side: str) -> str | int:
        """Where what that node gives is held."""
        return self._node_place(self._node_of(e, side)) if side in SIDES[1] else self.order

    def _node_place(self, node: str) -> str:
        """Where what a node gives is held: those up to the elements' order take turns."""
        return self.code.load(self.code.at(self.args["node_places"], node))

    def _between(self, e: str) -> str:
        """Where what element e leaves is held."""
        return self.code.load(self.code.at(self.args["element_places"], e))

    def _reach(self, node: str) -> str | int:
        """How far it is to the nodes that a node's row has blocks of: of a midside node its
        element's ends.
        """
        if not self.has_midsides:
            return 1
        code = self.code
        sides = (
            code.load(code.at(self.args[f"{side}_elements"], node)) for side in ("left", "right")
        )
        inside = code.compare("slt", code.new(f"and i64 {next(sides)}, {next(sides)}"), 0)
        return code.choose(inside, 1, self.order)

    def _near(self, node: str) -> dict[str, str]:
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

    def _move_of(self, node: str, ahead: int = 0) -> str:
        """Which of the nodes' moves is that of a node, or of one so far ahead; on either side of
        them some do not move.
        """
        return self.code.add(node, self.order + ahead)

    # Tables

    def _entry(self, table: str, k: str) -> str:
        """Pointer to entry k."""
        name = f"{table}_table" if f"{table}_table" in LISTS else table
        return self.code.at(self.args[name], self.code.mul(k, WIDTH[table]))

    @contextmanager
    def _entries(
        self, table: str, backward: bool = False, shared: bool | None = None
    ) -> Iterator[tuple[str, list[str]]]:
        """Each entry: its number and its integers. shared: of what cells share, or of a cell."""
        first, end = self._range(table, shared)
        given = (self.code.sub(end, 1), -1, -1) if backward else (first, end)
        with self.code.loop(*given) as k:
            yield k, self._integers(table, k)

    def _range(self, what: str, shared: bool | None = None) -> tuple[str | int, str]:
        """Numbers of entries, or edges: first and end; see `_entries`."""
        count = self.args[f"{what}_count"]
        if shared is None:
            return 0, count
        own = self.args["own_interface" if what == "interface" else "own_edges"]
        return (own, count) if shared else (0, own)

    @property
    def parts(self) -> tuple[bool | None, ...]:
        """All together; of cells what is theirs, and what all share."""
        return (False, True) if self.cells > 1 else (None,)

    def _integers(self, table: str, k: str) -> list[str]:
        """Of entry k."""
        entry = self._entry(table, k)
        return [self.code.load(self.code.at(entry, i)) for i in range(WIDTH[table])]

    def _matrix(self, first: str) -> str:
        """Where a number of the interface's system lies."""
        return self.at("matrix", first)

    @property
    def _system(self) -> str:
        """The matrix and its flags, which come behind it."""
        matrix = self.base["matrix"]
        flags = self.code.at(matrix, self.args["entry_count"], self.lanes.vector)
        return f"ptr {matrix}, ptr {flags}"

    def _on_block(self, name: str, first: str, stride: str, *given: str) -> None:
        """A function of `BlockElimination` on a block of the matrix."""
        more = "".join(f", ptr {x}" for x in given)
        self.code.line(f'call void @"{name}"({self._system}, i64 {first}, i64 {stride}{more})')

    def _add_block(self, first: str, stride: str, source: str, name: str = "block") -> None:
        self._on_block(f"add_{name}", first, stride, source)

    def _add_column(self, first: str, stride: str, source: str) -> None:
        self.code.line(
            f'call void @"add_column"(ptr {self._matrix(first)}, i64 {stride}, ptr {source})'
        )

    def _subtract_column(self, first: str, stride: str, a: str, b: str) -> None:
        """-= a b, of what lies together."""
        w, to = self.layout.records["move"].size, self._matrix(first)
        self.code.line(
            f'call void @"subtract"(ptr {to}, i64 {stride}, ptr {a}, i64 {w}, i64 {w}, ptr {b}, '
            "i64 1, i64 1)"
        )

    # Pieces

    def _over_cells(self, how: str, to: str, size: str | int = 1) -> None:
        """The "sum", the "largest" or the "least" of numbers over the cells of a sample, in each of
        its lanes.
        """
        if self.cells > 1:
            self._sized(f"{how} over cells", size, to)

    def _call_held(
        self, name: str, j: str, *call: Any, after: Callable[[], None] = lambda: None
    ) -> None:
        """See `_call`; a function of node j: where supports hold nodes, "held" in front of its
        name, and what comes `after` it at those.
        """
        if not self.held:
            self._call(name, *call)
            return
        code = self.code
        held = code.compare("ne", code.load(code.at(self.args["held"], j)), 0)
        with code.when(code.new(f"xor i1 {held}, true")):
            self._call(name, *call)
        with code.when(held):
            self._call(f"held {name}", *call)
            after()

    def _restore(self, record: str, then: Callable[[str], None] = lambda node: None) -> None:
        """Moves of midside nodes, if there are any, from what a record has for their elements'
        ends; `then`: what is to be done with each.
        """
        if not self.has_midsides:
            return
        with self.code.loop(0, self.args["elements"]) as e:
            node = self._node_of(e, "m")
            places = {
                "before": (record, self._move_of(node, -1)),
                "after": (record, self._move_of(node, 1)),
                "> move": ("move", self._move_of(node)),
                MIDDLE: ("middle", e),
            }
            self._call("restore", places=places)
            then(node)

    @contextmanager
    def _each(self, kinds: str, count: int, at: str) -> Iterator[Iterator[int]]:
        code = self.code
        kind = code.load(code.at(self.args[kinds], at))

        def each() -> Iterator[int]:
            for k in range(count):
                if count == 1:
                    yield k
                    continue
                with code.when(code.compare("eq", kind, k)):
                    yield k

        yield each()

    def _loaded(self, e: str) -> Iterator[int]:
        """The kind of element e, one kind after the other; what is written in a round runs where
        loads between the nodes of such an element do anything in one of the samples.
        """
        code = self.code
        with self._each("element_kinds", len(self.kinds.elements), e) as kinds:
            for k in kinds:
                if f"far {k}" not in self.functions:
                    continue
                self._call(f"far {k}", lambda f: self._of_element(f, e), ("change", 0))
                code.call("all", self.at("change", 0, "far"), result := code.slot())
                with code.when(code.compare("eq", code.load(result), 0)):
                    yield k

    def _add_load(self, name: str, e: str, to: Place) -> None:
        """Add what a function of the loads between the nodes of element e gives these to what the
        element itself gives them.
        """
        self._call(name, lambda f: self._of_element(f, e), ("change", 0))
        self._add(to, ("change", 0, to[0]))

    def _add_rise(self, name: str, e: str) -> None:
        """Add the energy that a function of such loads gives."""
        self._call(name, lambda f: self._of_element(f, e), ("change", 0))
        if "energy" in self.layout.records:
            self._add(("energy", 0, "rise"), ("change", 0, "rise"))

    def _sized(self, name: str, size: str | int | None, *places: str | Place) -> None:
        """A function of so many components, None = as many as the first place of a record has."""
        if size is None:
            size = next(self._size(x) for x in places if not isinstance(x, str))
        given = ", ".join(f"ptr {self._pointer(x)}" for x in places)
        self.code.line(f'call void @"{name}"({given}, i64 {size})')

    def _fill(self, to: str | Place, size: str | int | None = None) -> None:
        self._sized("zero", size, to)

    def _copy_to(self, to: str | Place, source: str | Place, size: int | None = None) -> None:
        self._sized("copy", size, to, source)

    def _blend(
        self, to: str | Place, source: str | Place, mask: str, size: int | None = None
    ) -> None:
        """Take the source where the mask is 0."""
        self._sized("keep", size, to, source, mask)

    def _sum(
        self, to: str | Place, source: str | Place, mask: str, size: int | None = None
    ) -> None:
        """Add the source where the mask is not 0."""
        self._sized("sum", size, to, source, mask)

    def _add(self, to: str | Place, source: str | Place, size: int | None = None) -> None:
        self._sized("add", size, to, source)

    def _take(
        self, to: str | Place, source: str | Place, mask: str, size: int | None = None
    ) -> None:
        """Take the source where the mask is not 0."""
        self._sized("take", size, to, source, mask)

    def _add_energies(self) -> None:
        """Of a node, or of an element, to those of the sample."""
        for name in ENERGIES if "energy" in self.layout.records else ():
            self._add(("energy", 0, name), ("change", 0, name))

    def _transfer(
        self, name: str, table: str, first: str, step: str | int, begin: str | int = 0
    ) -> None:
        """`gather`, `scatter`, or `drain` (scatter, and leave zeros), as a table says, at a step of
        those that begin so.
        """
        pointer = self.code.new(f"inttoptr i64 {self.args[table + 's']} to ptr")
        self.code.line(
            f'call void @"{name}"(ptr {pointer}, i64 {self.args[table + "_count"]}, ptr '
            f"{self.args['memory']}, "
            f"i64 {first}, i64 {self.args['samples']}, i64 {step}, i64 {begin})"
        )
