"""Native code over records: where their fields lie, the entries of tables, calls of functions,
masks, transfers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from ..compiler.block_elimination import BlockElimination
from ..compiler.denormals import flushing
from ..compiler.function import Functions
from ..compiler.lane_loops import LaneLoops
from ..compiler.llvm import Module
from ..compiler.loop_text import Code
from .cell_sums import CellSums
from .interaction_sorts import INTERACTIONS
from .kinds import Kinds
from .layout import ELEMENTS, INTERFACE, MIDDLE, MULTIPLIERS, NODES, ONE, SUPPORTS, Layout
from .tables import COUNTS, LISTS, WIDTH
from .transfers import Transfers

Place = tuple[Any, ...]  # a record, which of its rows, and a field of that, or all of it
Target = str | Place  # a pointer, or a place in a record
Places = dict[str, Target]
# arguments of all programs
ALL = (
    *("inputs", "input_count", "outputs", "output_count", "samples", "steps", "elements"),
    *("supports", "memory", "first_group", "end_group", *LISTS, *COUNTS),
)
# how many rows there are of each sort
ROWS = {NODES: "nodes", ELEMENTS: "elements", SUPPORTS: "supports"}
ROWS |= {sort.rows: f"{sort.constants}_count" for sort in INTERACTIONS}
ROWS |= {
    name: f"{name}_count" for name in (MULTIPLIERS, *(sort.of for sort in INTERACTIONS if sort.of))
}


class RecordCode:
    """Text of `run(ptr args)`, with 64-bit integers and pointers in the order of `ARGS`, for
    functions by name; those of kinds of rows end with the number of the kind.
    """

    ARGS: tuple[str, ...] = ALL

    def __init__(
        self,
        module: Module,
        functions: Functions,
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
            self.group(code.mul(group, self.lanes.count // self.cells))
        driver = code.text().replace(") nounwind", ") noinline nounwind", 1)
        loops = LaneLoops(self.lanes).functions() + Transfers(self.lanes, self.cells).functions()
        if self.cells > 1:
            loops += CellSums(self.lanes, self.cells).functions()
        if self.has_interface:
            loops += BlockElimination(self.lanes, self.width, self.part(), self.signed).functions()
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
    def has_energy(self) -> bool:
        """Whether energies are added up."""
        return "energy" in self.layout.records

    @property
    def signed(self) -> bool:
        """Whether signs of the interface's pivots are asked for."""
        return "signs" in self.layout.records

    @property
    def width(self) -> int:
        """Unknowns of a node."""
        return self.layout.records["move"].size

    def part(self) -> int | None:
        """Unknowns of a node by which pairs that touch couple; None = all, or there are none."""
        raise NotImplementedError

    def group(self, first: str) -> None:
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

    def number(self, pointer: str, k: int) -> str:
        """Pointer to number k of a field."""
        return self.code.at(pointer, k, self.lanes.vector)

    def call(
        self,
        name: str,
        of: Callable[[str], Target] = str,
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
            return self.pointer(of(field) if place is None else place)

        names = (*function.inputs, *(f"> {field}" for field in function.outputs))
        self.code.call(name, *map(where, names))

    @contextmanager
    def rows_of(self, record: str) -> Iterator[str | int]:
        """Each row of a record."""
        rows = self.layout.records[record].rows
        if rows == ONE:
            yield 0
            return
        with self.code.loop(0, self.args[ROWS[rows]]) as k:
            yield k

    def pointer(self, place: Target) -> str:
        return place if isinstance(place, str) else self.at(*place)

    def size_of(self, place: Place) -> int:
        """Components that lie there."""
        record = self.layout.records[place[0]]
        return record.size if len(place) < 3 else record.fields[place[2]][1]

    def zeros_in(self, *records: str) -> None:
        """Zeros in what there is of them."""
        for record in records:
            if record in self.layout.records:
                with self.rows_of(record) as k:
                    self.fill((record, k))

    def has(self, record: str, field: str) -> bool:
        """Whether a record has a field, or one of its cotangents."""
        bar, bars = self.layout.cotangent(record, field)
        return field in self.layout.fields(record) or bars in self.layout.fields(bar)

    def first_of(self, records: Iterable[str], field: str, row: str | int = 0) -> Place:
        """A field of the first of these records that has it; else of what all have in common."""
        for record in records:
            if self.has(record, field):
                return record, row, field
        return "common", 0, field

    # Tables

    def integer(self, name: str, k: str) -> str:
        """Integer k of a list."""
        return self.code.load(self.code.at(self.args[name], k))

    def entry(self, table: str, k: str) -> str:
        """Pointer to entry k."""
        name = f"{table}_table" if f"{table}_table" in LISTS else table
        return self.code.at(self.args[name], self.code.mul(k, WIDTH[table]))

    @contextmanager
    def entries(
        self, table: str, backward: bool = False, shared: bool | None = None
    ) -> Iterator[tuple[str, list[str]]]:
        """Each entry: its number and its integers. shared: of what cells share, or of a cell."""
        first, end = self.range_of(f"{table}_count", shared)
        bounds = (self.code.sub(end, 1), -1, -1) if backward else (first, end)
        with self.code.loop(*bounds) as k:
            yield k, self.integers(table, k)

    def range_of(self, count: str, shared: bool | None = None) -> tuple[str | int, str]:
        """Numbers of entries, or rows, of which there are so many: first and end; see `entries`."""
        if shared is None:
            return 0, self.args[count]
        own = self.args["own_interface" if count == "interface_count" else "own_edges"]
        return (own, self.args[count]) if shared else (0, own)

    @property
    def parts(self) -> tuple[bool | None, ...]:
        """All together; of cells what is theirs, and what all share."""
        return (False, True) if self.cells > 1 else (None,)

    def integers(self, table: str, k: str) -> list[str]:
        """Of entry k."""
        entry = self.entry(table, k)
        return [self.code.load(self.code.at(entry, i)) for i in range(WIDTH[table])]

    # The interface's system

    def matrix(self, first: str) -> str:
        """Where a number of it lies."""
        return self.at("matrix", first)

    @property
    def system(self) -> str:
        """The matrix and its flags, which come behind it."""
        matrix = self.base["matrix"]
        flags = self.code.at(matrix, self.args["entry_count"], self.lanes.vector)
        return f"ptr {matrix}, ptr {flags}"

    def on_block(self, name: str, first: str, stride: str, *pointers: str) -> None:
        """A function of `BlockElimination` on a block of the matrix."""
        more = "".join(f", ptr {x}" for x in pointers)
        self.code.line(f'call void @"{name}"({self.system}, i64 {first}, i64 {stride}{more})')

    def add_block(self, first: str, stride: str, source: str, name: str = "block") -> None:
        self.on_block(f"add_{name}", first, stride, source)

    def add_column(self, first: str, stride: str, source: str) -> None:
        self.code.line(
            f'call void @"add_column"(ptr {self.matrix(first)}, i64 {stride}, ptr {source})'
        )

    def subtract_column(self, first: str, stride: str, a: str, b: str) -> None:
        """-= a b, of what lies together."""
        w, to = self.width, self.matrix(first)
        self.code.line(
            f'call void @"subtract"(ptr {to}, i64 {stride}, ptr {a}, i64 {w}, i64 {w}, ptr {b}, '
            "i64 1, i64 1)"
        )

    # Pieces

    def over_cells(self, how: str, to: str, size: str | int = 1) -> None:
        """The "sum", the "largest" or the "least" of numbers over the cells of a sample, in each of
        its lanes.
        """
        if self.cells > 1:
            self.sized(f"{how} over cells", size, to)

    @contextmanager
    def unless_all(self, mask: str) -> Iterator[None]:
        """What is written runs where a mask is not set in all lanes."""
        self.code.call("all", mask, result := self.code.slot())
        with self.code.when(self.code.compare("eq", self.code.load(result), 0)):
            yield

    def sized(self, name: str, size: str | int | None, *places: Target) -> None:
        """A function of so many components, None = as many as the first place of a record has."""
        if size is None:
            size = next(self.size_of(x) for x in places if not isinstance(x, str))
        pointers = ", ".join(f"ptr {self.pointer(x)}" for x in places)
        self.code.line(f'call void @"{name}"({pointers}, i64 {size})')

    def fill(self, to: Target, size: str | int | None = None) -> None:
        self.sized("zero", size, to)

    def copy(self, to: Target, source: Target, size: str | int | None = None) -> None:
        self.sized("copy", size, to, source)

    def add(self, to: Target, source: Target, size: int | None = None) -> None:
        self.sized("add", size, to, source)

    def blend(self, to: Target, source: Target, mask: str, size: str | int | None = None) -> None:
        """Take the source where the mask is 0."""
        self.sized("keep", size, to, source, mask)

    def take(self, to: Target, source: Target, mask: str, size: int | None = None) -> None:
        """Take the source where the mask is not 0."""
        self.sized("take", size, to, source, mask)

    def add_where(self, to: Target, source: Target, mask: str, size: int | None = None) -> None:
        """Add the source where the mask is not 0."""
        self.sized("sum", size, to, source, mask)

    def transfer(
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
