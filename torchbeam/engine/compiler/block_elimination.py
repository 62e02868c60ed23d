"""Block elimination: native loops that solve the sparse system of a `BlockPattern`, in each lane by
itself.

Rows are exchanged within a group, lane by lane: the row of the largest number in the column is
looked for by comparing, and the rows change places under a mask; a row that no lane has chosen is
passed over.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from .llvm import FLAGS, Lanes
from .loop_text import Code

CHUNKS = 4, 2  # columns of one sample at once


class BlockElimination:
    """Text of the functions

        eliminate(ptr memory, ptr table, i64 groups)    see `BlockPattern.elimination`
        substitute(ptr memory, ptr table, i64 groups)   see `BlockPattern.substitution`
        add_block(ptr to, i64 stride, ptr source)           to += source, (w, w)
        add_part(ptr to, i64 stride, ptr source)            the same of (part, part)
        add_column(ptr to, i64 stride, ptr source)          to += source, (w, 1)
        subtract(ptr to, i64 to_stride, ptr a, i64 a_stride, i64 inner, ptr b, i64 b_stride,
                 i64 columns)                               to -= a b

    for units of w unknowns. Numbers lie as [component][lane].
    """

    def __init__(self, lanes: Lanes, w: int, part: int | None = None) -> None:
        self.lanes, self.w, self.part = lanes, w, part or w

    def functions(self) -> list[str]:
        return [
            self._add("block", self.w, self.w),
            self._add("part", self.part, self.part),
            self._add("column", self.w, 1),
            self._subtract(),
            self._pivot(),
            self._some(),
            self._eliminate(),
            self._substitute(),
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

    def _add(self, name: str, rows: int, columns: int) -> str:
        code = Code(f"add_{name}", ["ptr %to", "i64 %stride", "ptr %source"])
        with code.loop(0, rows) as i:
            row, source = (
                self._at(code, "%to", code.mul(i, "%stride")),
                self._at(code, "%source", code.mul(i, columns)),
            )
            for k in range(columns):
                at = self._at(code, row, k)
                part = self._load(code, self._at(code, source, k))
                self._store(code, self._make(code, "fadd", self._load(code, at), part), at)
        return _internal(code)

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
        return _internal(code)

    def _pivot(self) -> str:
        """pivot(panel, n, columns): A^-1 of the first n columns times the others, in their place.
        Factors of rows that are zero in all lanes are passed over.
        """
        code = Code("pivot", ["ptr %panel", "i64 %n", "i64 %columns"])
        V, zero = self.lanes.vector, self.lanes.constant(0.0)
        best, chosen = code.slot(V), code.slot(V)

        def row(k: str) -> str:
            return self._at(code, "%panel", code.mul(k, "%columns"))

        with code.loop(0, "%n") as k:
            here, after = row(k), code.add(k, 1)
            code.store(self._size(code, self._load(code, self._at(code, here, k))), best, V)
            code.store(self._number(code, k), chosen, V)
            with code.loop(after, "%n") as i:
                size = self._size(code, self._load(code, self._at(code, row(i), k)))
                larger = code.new(f"fcmp ogt {V} {size}, {code.load(best, V)}")
                number = self._number(code, i)
                code.store(self._select(code, larger, size, code.load(best, V)), best, V)
                code.store(self._select(code, larger, number, code.load(chosen, V)), chosen, V)
            with code.loop(after, "%n") as i:
                mask = code.new(f"fcmp oeq {V} {code.load(chosen, V)}, {self._number(code, i)}")
                with code.when(self._any(code, mask)):
                    there = row(i)
                    with code.loop(k, "%columns") as j:
                        one, other = self._at(code, here, j), self._at(code, there, j)
                        a, b = self._load(code, one), self._load(code, other)
                        self._store(code, self._select(code, mask, b, a), one)
                        self._store(code, self._select(code, mask, a, b), other)
            inverse = self._make(
                code, "fdiv", self.lanes.constant(1.0), self._load(code, self._at(code, here, k))
            )
            for j, lanes in self._columns(code, after, "%columns"):
                at, by = self._at(code, here, j), self._in_all(code, inverse, lanes)
                scaled = self._make(code, "fmul", self._load(code, at, lanes), by, lanes)
                self._store(code, scaled, at, lanes)
            with code.loop(after, "%n") as i:
                self._row_less(code, row(i), here, k, after, zero)
        last = code.sub("%n", 1)
        with code.loop(last, 0, -1) as k:
            with code.loop(0, k) as i:
                self._row_less(code, row(i), row(k), k, "%n", zero)
        return _internal(code)

    def _row_less(self, code: Code, row: str, pivot: str, k: str, first: str, zero: str) -> None:
        """A row from a column on, less its factor at column k times the pivot's."""
        factor = self._load(code, self._at(code, row, k))
        there = code.new(f"fcmp une {self.lanes.vector} {factor}, {zero}")
        with code.when(self._any(code, there)):
            for j, lanes in self._columns(code, first, "%columns"):
                at, other = self._at(code, row, j), self._at(code, pivot, j)
                by = self._in_all(code, factor, lanes)
                part = self._make(code, "fmul", by, self._load(code, other, lanes), lanes)
                rest = self._make(code, "fsub", self._load(code, at, lanes), part, lanes)
                self._store(code, rest, at, lanes)

    def _some(self) -> str:
        """some(a, stride, rows, columns, result): 1 where a number is other than zero in any lane,
        else 0; by the first row that has one.
        """
        given = ["ptr %a", "i64 %stride", "i64 %rows", "i64 %columns", "ptr %result"]
        code = Code("some", given)
        row, truth = code.slot(), code.slot("i1")
        code.store(0, row)
        code.store("false", truth, "i1")
        with code.until() as ends:
            i = code.load(row)
            here = self._at(code, "%a", code.mul(i, "%stride"))
            with code.loop(0, "%columns") as j:
                x = self._load(code, self._at(code, here, j))
                zero = self.lanes.constant(0.0)
                other = self._any(code, code.new(f"fcmp une {self.lanes.vector} {x}, {zero}"))
                either = code.new(f"or i1 {code.load(truth, 'i1')}, {other}")
                code.store(either, truth, "i1")
            code.store(after := code.add(i, 1), row)
            last = code.compare("sge", after, "%rows")
            ends.append(code.new(f"or i1 {code.load(truth, 'i1')}, {last}"))
        code.store(code.choose(code.load(truth, "i1"), 1, 0), "%result")
        return _internal(code)

    @contextmanager
    def _unless_zero(
        self, code: Code, a: str, stride: str, rows: str | int, columns: str | int
    ) -> Iterator[None]:
        """What is written is passed over where a block is zero in all lanes: what may couple, and
        does not now.
        """
        result = code.slot()
        code.line(
            f'call void @"some"(ptr {a}, i64 {stride}, i64 {rows}, i64 {columns}, ptr {result})'
        )
        with code.when(code.compare("eq", code.load(result), 1)):
            yield

    def _eliminate(self) -> str:
        code = Code("eliminate", ["ptr %memory", "ptr %table", "i64 %groups"])
        slot = code.slot("ptr")
        code.store("%table", slot, "ptr")
        with code.loop(0, "%groups"):
            entry = code.load(slot, "ptr")
            n, columns, panel, rows, count = (code.load(code.at(entry, k)) for k in range(5))
            panel = self._at(code, "%memory", panel)
            code.line(f'call void @"pivot"(ptr {panel}, i64 {n}, i64 {columns})')
            entry, size = code.at(entry, 5), code.add(1, code.mul(count, 4))
            with code.loop(0, rows) as i:
                row = code.at(entry, code.mul(i, size))
                first = self._at(code, "%memory", code.load(row))
                with self._unless_zero(code, first, n, self.w, n), code.loop(0, count) as k:
                    product = code.at(row, code.add(1, code.mul(k, 4)))
                    to, stride, column, width = (code.load(code.at(product, i)) for i in range(4))
                    to, column = self._at(code, "%memory", to), self._at(code, panel, column)
                    with self._unless_zero(code, column, columns, n, width):
                        code.line(
                            f'call void @"subtract"(ptr {to}, i64 {stride}, ptr {first}, i64 {n}, '
                            f"i64 {n}, ptr {column}, i64 {columns}, i64 {width})"
                        )
            code.store(code.at(entry, code.mul(rows, size)), slot, "ptr")
        return _internal(code)

    def _substitute(self) -> str:
        code = Code("substitute", ["ptr %memory", "ptr %table", "i64 %groups"])
        V, slot = self.lanes.vector, code.slot("ptr")
        total = code.slot(V)
        code.store("%table", slot, "ptr")
        with code.loop(0, "%groups"):
            entry = code.load(slot, "ptr")
            n, columns, panel, behind = (code.load(code.at(entry, k)) for k in range(4))
            panel, own = self._at(code, "%memory", panel), code.at(entry, 4)
            units, last = code.at(own, n), code.sub(columns, 1)
            with code.loop(0, n) as i:
                row = self._at(code, panel, code.mul(i, columns))
                code.store(self._load(code, self._at(code, row, last)), total, V)
                with code.loop(0, behind) as k:
                    known = self._at(code, "%memory", code.load(code.at(units, k)))
                    part = self._at(code, row, code.add(n, code.mul(k, self.w)))
                    for c in range(self.w):
                        product = self._make(
                            code,
                            "fmul",
                            self._load(code, self._at(code, part, c)),
                            self._load(code, self._at(code, known, c)),
                        )
                        rest = self._make(code, "fsub", code.load(total, V), product)
                        code.store(rest, total, V)
                to = self._at(code, "%memory", code.load(code.at(own, i)))
                self._store(code, code.load(total, V), to)
            code.store(code.at(units, behind), slot, "ptr")
        return _internal(code)


def _internal(code: Code) -> str:
    return code.text().replace("define void", "define internal void")
