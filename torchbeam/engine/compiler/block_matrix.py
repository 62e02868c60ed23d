"""Blocks of the matrix of a `BlockPattern`: native loops that put them there, each by a flag."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from .llvm import FLAGS, Lanes
from .loop_text import Code

CHUNKS = 4, 2  # columns of one sample at once
SYSTEM = "ptr %memory", "ptr %flags"


class Group(NamedTuple):
    """Of a table of `BlockPattern.elimination`, as values of the code: n unknowns and the columns
    of its panel, which begins at `first`; how many rows are eliminated by it, which begin at
    `entry`, each of a `size`; how many units its columns behind the first n are; how many of the
    unknowns are moves, see `BlockSigns`.
    """

    n: str
    columns: str
    first: str
    rows: str
    units: str
    moves: str
    entry: str
    size: str

    def row(self, code: Code, i: str) -> str:
        return code.at(self.entry, code.mul(i, self.size))


class BlockMatrix:
    """Text of the functions

        clear(ptr memory, ptr flags, ptr table, i64 groups)     a matrix without blocks; table:
                                                                see `BlockPattern.elimination`
        add_block(ptr memory, ptr flags, i64 first, i64 stride, ptr source)     += source, (w, w)
        add_part(ptr memory, ptr flags, i64 first, i64 stride, ptr source)      the same of (part,
                                                                                part)
        subtract_block(ptr memory, ptr flags, i64 first, i64 stride, ptr a, ptr b)
                                                                -= a b, of (w, w) each
        there(ptr memory, ptr flags, i64 first, i64 stride)     zeros, if there is no block
        add_column(ptr to, i64 stride, ptr source)              to += source, (w, 1)
        subtract(ptr to, i64 to_stride, ptr a, i64 a_stride, i64 inner, ptr b, i64 b_stride,
                 i64 columns)                                   to -= a b

    for units of w unknowns. Numbers lie as [component][lane]. What couples single units has a flag,
    the byte of the number of its first component: while that is 0, there is no block, and nothing
    is computed by it, whatever lies there.
    """

    def __init__(self, lanes: Lanes, w: int, part: int | None = None) -> None:
        self.lanes, self.w, self.part = lanes, w, part or w

    def functions(self) -> list[str]:
        return [
            self._zero(),
            self._clear(),
            self._there(),
            self._add_block("block", self.w),
            self._add_block("part", self.part),
            self._add_column(),
            self._subtract(),
            self._subtract_block(),
        ]

    # Pieces

    def _at(self, code: Code, pointer: str, index: str | int) -> str:
        return code.at(pointer, index, self.lanes.vector)

    def _load(self, code: Code, pointer: str, lanes: Lanes | None = None) -> str:
        lanes = lanes or self.lanes
        return code.new(f"load {lanes.vector}, ptr {pointer}, align {lanes.bytes}")

    def _store(self, code: Code, value: str, pointer: str, lanes: Lanes | None = None) -> None:
        lanes = lanes or self.lanes
        code.line(f"store {lanes.vector} {value}, ptr {pointer}, align {lanes.bytes}")

    def _make(self, code: Code, operation: str, a: str, b: str, lanes: Lanes | None = None) -> str:
        return code.new(f"{operation} {FLAGS} {(lanes or self.lanes).vector} {a}, {b}")

    def _columns(self, code: Code, first: str | int, end: str) -> Iterator[tuple[str, Lanes]]:
        """What is written for each runs for all columns from `first` on: of one sample, whose
        numbers lie side by side, several columns at once, a lane each.
        """
        for count in CHUNKS if self.lanes.count == 1 else ():
            rest = code.new(f"and i64 {code.sub(end, first)}, {-count}")
            middle = code.add(first, rest)
            with code.loop(first, middle, count) as j:
                yield j, Lanes(count, self.lanes.dtype)
            first = middle
        with code.loop(first, end) as j:
            yield j, self.lanes

    def _in_all(self, code: Code, x: str, lanes: Lanes) -> str:
        """A number of one sample in the lanes of several columns."""
        if lanes is self.lanes:
            return x
        V, scalar, W = lanes.vector, lanes.scalar, lanes.count
        first = code.new(f"insertelement {V} poison, {scalar} {x}, i64 0")
        return code.new(f"shufflevector {V} {first}, {V} poison, <{W} x i32> zeroinitializer")

    def _size(self, code: Code, x: str) -> str:
        negative = code.new(f"fcmp olt {self.lanes.vector} {x}, {self.lanes.constant(0.0)}")
        return self._select(code, negative, code.new(f"fneg {self.lanes.vector} {x}"), x)

    def _select(self, code: Code, truth: str, a: str, b: str) -> str:
        V, T = self.lanes.vector, self.lanes.truth
        return code.new(f"select {T} {truth}, {V} {a}, {V} {b}")

    def _any(self, code: Code, truth: str) -> str:
        """Whether it holds in any lane."""
        if self.lanes.count == 1:
            return truth
        bits = f"i{self.lanes.count}"
        whole = code.new(f"bitcast {self.lanes.truth} {truth} to {bits}")
        return code.new(f"icmp ne {bits} {whole}, 0")

    def _number(self, code: Code, k: str) -> str:
        """An index in all lanes."""
        one = code.new(f"sitofp i64 {k} to {self.lanes.scalar}")
        if self.lanes.count == 1:
            return one
        return self._in_all(code, one, Lanes(self.lanes.count, self.lanes.dtype))

    # Functions

    def _zero(self) -> str:
        """zeros(to, stride, rows, columns)"""
        code = Code("zeros", ["ptr %to", "i64 %stride", "i64 %rows", "i64 %columns"])
        with code.loop(0, "%rows") as i:
            row = self._at(code, "%to", code.mul(i, "%stride"))
            for j, lanes in self._columns(code, 0, "%columns"):
                self._store(code, lanes.constant(0.0), self._at(code, row, j), lanes)
        return code.text(internal=True)

    def _clear_numbers(
        self, code: Code, to: str, stride: str | int, rows: str | int, columns: str | int
    ) -> None:
        arguments = f"ptr {to}, i64 {stride}, i64 {rows}, i64 {columns}"
        code.line(f'call void @"zeros"({arguments})')

    def _flag(self, code: Code, first: str | int) -> str:
        return code.at("%flags", first, "i8")

    def _is_there(self, code: Code, first: str | int) -> str:
        flag = code.load(self._flag(code, first), "i8")
        return code.new(f"icmp ne i8 {flag}, 0")

    @contextmanager
    def _groups(self, code: Code) -> Iterator[Group]:
        """What is written runs for each group of the table, one after the other."""
        slot = code.slot("ptr")
        code.store("%table", slot, "ptr")
        with code.loop(0, "%groups"):
            entry = code.load(slot, "ptr")
            n, columns, first, rows, count, moves = (code.load(code.at(entry, k)) for k in range(6))
            size, units = code.add(1, code.mul(count, 4)), code.sub(count, 1)
            group = Group(n, columns, first, rows, units, moves, code.at(entry, 6), size)
            yield group
            code.store(group.row(code, rows), slot, "ptr")

    def _clear(self) -> str:
        code = Code("clear", [*SYSTEM, "ptr %table", "i64 %groups"])
        with self._groups(code) as group:
            single = code.compare("eq", group.n, self.w)
            with code.when(single):
                self._clear_node(code, group)
            with code.when(code.new(f"xor i1 {single}, true")):
                self._clear_nodes(code, group)
        return code.text(internal=True)

    def _clear_node(self, code: Code, group: Group) -> None:
        """Of a group of one node: its own block is there, and no other."""
        n, columns, first = group[:3]
        panel = self._at(code, "%memory", first)
        self._clear_numbers(code, panel, columns, n, n)
        right = self._at(code, panel, code.sub(columns, 1))
        self._clear_numbers(code, right, columns, n, 1)
        code.store(1, self._flag(code, first), "i8")
        with code.loop(0, group.units) as k:
            at = code.add(first, code.add(n, code.mul(k, self.w)))
            code.store(0, self._flag(code, at), "i8")
        with code.loop(0, group.rows) as i:
            code.store(0, self._flag(code, code.load(group.row(code, i))), "i8")

    def _clear_nodes(self, code: Code, group: Group) -> None:
        """Of one of several: all blocks are there, and zero."""
        n, columns, first = group[:3]
        width = code.add(n, code.mul(group.units, self.w))
        self._clear_numbers(code, self._at(code, "%memory", first), columns, n, columns)
        self._all_there(code, first, columns, n, width)
        with code.loop(0, group.rows) as i:
            at = code.load(group.row(code, i))
            self._clear_numbers(code, self._at(code, "%memory", at), n, self.w, n)
            self._all_there(code, at, n, self.w, n)

    def _all_there(
        self, code: Code, first: str, stride: str, rows: str | int, columns: str
    ) -> None:
        """Flags of the blocks of so many rows and columns."""
        with code.loop(0, rows, self.w) as i, code.loop(0, columns, self.w) as j:
            at = code.add(first, code.add(code.mul(i, stride), j))
            code.store(1, self._flag(code, at), "i8")

    def _there(self) -> str:
        code = Code("there", [*SYSTEM, "i64 %first", "i64 %stride"])
        none = code.new(f"xor i1 {self._is_there(code, '%first')}, true")
        with code.when(none):
            self._clear_numbers(
                code, self._at(code, "%memory", "%first"), "%stride", self.w, self.w
            )
            code.store(1, self._flag(code, "%first"), "i8")
        return code.text(internal=True)

    def _put(self, code: Code, first: str, stride: str) -> str:
        """A block that is there, by its flag at `first`."""
        code.line(f'call void @"there"(ptr %memory, ptr %flags, i64 {first}, i64 {stride})')
        return self._at(code, "%memory", first)

    def _add_block(self, name: str, size: int) -> str:
        """A block that is not there is copied."""
        arguments = [*SYSTEM, "i64 %first", "i64 %stride", "ptr %source"]
        code = Code(f"add_{name}", arguments)

        def each(add: bool) -> None:
            to = self._at(code, "%memory", "%first")
            for i in range(size):
                row = self._at(code, to, code.mul("%stride", i))
                for j, lanes in self._columns(code, 0, size):
                    at = self._at(code, row, j)
                    source = self._at(code, "%source", code.add(i * size, j))
                    part = self._load(code, source, lanes)
                    if add:
                        part = self._make(code, "fadd", self._load(code, at, lanes), part, lanes)
                    self._store(code, part, at, lanes)

        there = self._is_there(code, "%first")
        with code.when(there):
            each(True)
        with code.when(code.new(f"xor i1 {there}, true")):
            if size < self.w:
                self._put(code, "%first", "%stride")
            code.store(1, self._flag(code, "%first"), "i8")
            each(False)
        return code.text(internal=True)

    def _add_column(self) -> str:
        code = Code("add_column", ["ptr %to", "i64 %stride", "ptr %source"])
        with code.loop(0, self.w) as i:
            at, source = self._at(code, "%to", code.mul(i, "%stride")), self._at(code, "%source", i)
            total = self._make(code, "fadd", self._load(code, at), self._load(code, source))
            self._store(code, total, at)
        return code.text(internal=True)

    def _subtract_block(self) -> str:
        arguments = [*SYSTEM, "i64 %first", "i64 %stride", "ptr %a", "ptr %b"]
        code = Code("subtract_block", arguments)
        to, w = self._put(code, "%first", "%stride"), self.w
        self._less_product(code, to, "%stride", "%a", w, w, "%b", w, w)
        return code.text(internal=True)

    def _less_product(self, code: Code, *places: str | int) -> None:
        kinds = ("ptr", "i64", "ptr", "i64", "i64", "ptr", "i64", "i64")
        text = ", ".join(f"{kind} {x}" for kind, x in zip(kinds, places, strict=True))
        code.line(f'call void @"subtract"({text})')

    def _subtract(self) -> str:
        """Column by column in registers, one for each row."""
        code = Code(
            "subtract",
            [
                "ptr %to",
                "i64 %to_stride",
                "ptr %a",
                "i64 %a_stride",
                "i64 %inner",
                "ptr %b",
                "i64 %b_stride",
                "i64 %columns",
            ],
        )
        rows = [self._at(code, "%to", code.mul("%to_stride", i)) for i in range(self.w)]
        factors = [self._at(code, "%a", code.mul("%a_stride", i)) for i in range(self.w)]
        for j, lanes in self._columns(code, 0, "%columns"):
            V = lanes.vector
            sums = [code.slot(V) for _ in rows]
            for row, total in zip(rows, sums, strict=True):
                code.store(self._load(code, self._at(code, row, j), lanes), total, V)
            column = self._at(code, "%b", j)
            with code.loop(0, "%inner") as k:
                at = self._at(code, column, code.mul(k, "%b_stride"))
                other = self._load(code, at, lanes)
                for factor, total in zip(factors, sums, strict=True):
                    one = self._in_all(code, self._load(code, self._at(code, factor, k)), lanes)
                    part = self._make(code, "fmul", one, other, lanes)
                    rest = self._make(code, "fsub", code.load(total, V), part, lanes)
                    code.store(rest, total, V)
            for row, total in zip(rows, sums, strict=True):
                self._store(code, code.load(total, V), self._at(code, row, j), lanes)
        return code.text(internal=True)
