"""Block elimination: native loops that solve the sparse system of a `BlockPattern`, in each lane by
itself.

Rows are exchanged within a group, lane by lane: the row of the largest number in the column is
looked for by comparing, and the rows change places under a mask; a row that no lane has chosen is
passed over.

`BlockSigns` tell of each group, in each lane, whether the moves that its constraints leave are
stable. A group has moves, and behind them forces F of constraints G,

    K  F
    G  0

whose matrix, symmetric, has as many negative eigenvalues as constraints, and no more, if K is
positive definite where G x = 0. Each constraint is eliminated with the move that it says most of
(one pivot is negative and one positive, whatever K is); the other moves have to have positive
pivots. Forces that there are not stand for themselves: 1 on the diagonal. By the inertia of Schur
complements the whole matrix then is positive definite where all constraints hold: those of loops,
whose forces come last and are not looked at, take no move from a matrix that is so already.
"""

from __future__ import annotations

from .block_matrix import SYSTEM, BlockMatrix
from .llvm import Lanes
from .loop_text import Code

SIGNS = "ptr %panel", "i64 %n", "i64 %columns", "i64 %moves", "ptr %own", "ptr %to"


class BlockSigns(BlockMatrix):
    """Text of the function signs(ptr panel, i64 n, i64 columns, i64 moves, ptr own, ptr to), which
    puts 1 where a group's pivots have other signs, and leaves what is there else: of n unknowns, of
    which so many are moves; own: memory of n^2 numbers.
    """

    def _signs(self) -> str:
        code = Code("signs", [*SIGNS])
        V, zero = self.lanes.vector, self.lanes.constant(0.0)
        with code.loop(0, "%n") as i, code.loop(0, "%n") as j:
            # the symmetric part; between moves and forces what constraints say
            both = [code.compare("slt", k, "%moves") for k in (i, j)]
            symmetric = code.new(f"icmp eq i1 {both[0]}, {both[1]}")
            a, b = (self._load(code, self._in_panel(code, *at)) for at in ((i, j), (j, i)))
            b = code.new(f"select i1 {symmetric}, {V} {b}, {V} {a}")
            self._store(code, self._make(code, "fadd", a, b), self._place(code, i, j))
        left = code.slot()
        code.store("%moves", left)
        last = code.sub("%n", 1)
        with code.loop(last, code.sub("%moves", 1), -1) as k:
            there = code.new(f"fcmp oeq {V} {self._own(code, k, k)}, {zero}")
            with code.when(self._any(code, there)):
                self._constraint(code, k, left)
        with code.loop(code.sub(code.load(left), 1), -1, -1) as k:
            d = self._own(code, k, k)
            self._or_not(code, code.new(f"fcmp ogt {V} {d}, {zero}"))
            self._less_pivot(code, k)
        return code.text(internal=True)

    def _in_panel(self, code: Code, i: str, j: str) -> str:
        return self._at(code, "%panel", code.add(code.mul(i, "%columns"), j))

    def _place(self, code: Code, i: str, j: str) -> str:
        return self._at(code, "%own", code.add(code.mul(i, "%n"), j))

    def _own(self, code: Code, i: str, j: str) -> str:
        return self._load(code, self._place(code, i, j))

    def _or_not(self, code: Code, well: str) -> None:
        one = self.lanes.constant(1.0)
        self._store(code, self._select(code, well, self._load(code, "%to"), one), "%to")

    def _constraint(self, code: Code, k: str, left: str) -> None:
        """Eliminate constraint k with the move, of those that are left, that it says most of."""
        V, zero = self.lanes.vector, self.lanes.constant(0.0)
        last, best, chosen = code.sub(code.load(left), 1), code.slot(V), code.slot(V)
        code.store(zero, best, V)
        code.store(zero, chosen, V)
        with code.loop(0, code.load(left)) as c:
            size = self._size(code, self._own(code, k, c))
            larger = code.new(f"fcmp ogt {V} {size}, {code.load(best, V)}")
            number = self._number(code, c)
            code.store(self._select(code, larger, size, code.load(best, V)), best, V)
            code.store(self._select(code, larger, number, code.load(chosen, V)), chosen, V)
        with code.loop(0, last) as c:  # rows and columns change places
            mask = code.new(f"fcmp oeq {V} {code.load(chosen, V)}, {self._number(code, c)}")
            with code.when(self._any(code, mask)):
                for turned in (False, True):
                    with code.loop(0, "%n") as j:
                        pairs = [(j, x) if turned else (x, j) for x in (c, last)]
                        one, other = (self._place(code, *pair) for pair in pairs)
                        a, b = self._load(code, one), self._load(code, other)
                        self._store(code, self._select(code, mask, b, a), one)
                        self._store(code, self._select(code, mask, a, b), other)
        code.store(last, left)
        g, a = self._own(code, k, last), self._own(code, last, last)
        self._or_not(code, code.new(f"fcmp une {V} {g}, {zero}"))
        share = self._make(code, "fdiv", self.lanes.constant(1.0), g)
        half = self._make(code, "fmul", a, self._make(code, "fmul", share, share))
        half = self._make(code, "fmul", half, self.lanes.constant(0.5))
        # s_ij - s_ik b_j - b_i s_kj with b = s_l / g - s_k a / 2 g^2
        with code.loop(0, last) as j:
            b = self._make(code, "fmul", self._own(code, last, j), share)
            less = self._make(code, "fmul", self._own(code, k, j), half)
            self._store(code, self._make(code, "fsub", b, less), self._place(code, last, j))
        with code.loop(0, last) as i, code.loop(0, last) as j:
            x = self._own(code, i, j)
            for one, other in ((i, j), (j, i)):
                part = self._make(
                    code, "fmul", self._own(code, k, one), self._own(code, last, other)
                )
                x = self._make(code, "fsub", x, part)
            self._store(code, x, self._place(code, i, j))
        with code.loop("%moves", k) as i:
            factor = self._make(code, "fmul", self._own(code, i, last), share)
            with code.loop(0, last) as j:
                part = self._make(code, "fmul", factor, self._own(code, k, j))
                x = self._make(code, "fsub", self._own(code, i, j), part)
                self._store(code, x, self._place(code, i, j))

    def _less_pivot(self, code: Code, k: str) -> None:
        """The numbers before k, less what its elimination takes from them."""
        share = self._make(code, "fdiv", self.lanes.constant(1.0), self._own(code, k, k))
        with code.loop(0, k) as i:
            factor = self._make(code, "fmul", self._own(code, i, k), share)
            with code.loop(0, k) as j:
                part = self._make(code, "fmul", factor, self._own(code, k, j))
                x = self._make(code, "fsub", self._own(code, i, j), part)
                self._store(code, x, self._place(code, i, j))


class BlockElimination(BlockSigns):
    """Text of the functions of a `BlockMatrix`, and

    eliminate(ptr memory, ptr flags, ptr table, i64 groups)     see `BlockPattern.elimination`
    substitute(ptr memory, ptr flags, ptr table, i64 groups)    see `BlockPattern.substitution`

    signs: `eliminate` takes memory and a number of each lane besides, see `BlockSigns`.
    """

    def __init__(self, lanes: Lanes, w: int, part: int | None = None, signs: bool = False) -> None:
        super().__init__(lanes, w, part)
        self.signs = signs

    def functions(self) -> list[str]:
        more = self._pivot(), self._factor(), self._solve(), self._eliminate(), self._substitute()
        return [*super().functions(), *[self._signs()] * self.signs, *more]

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
        return code.text(internal=True)

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

    def _factor(self) -> str:
        """factor(panel, columns): the first w columns of w rows in triangular factors, with the
        inverses of what divides on the diagonal; rows change places as in `pivot`.
        """
        code, w = Code("factor", ["ptr %panel", "i64 %columns"]), self.w
        V = self.lanes.vector
        rows = [self._at(code, "%panel", code.mul("%columns", k)) for k in range(w)]
        for k in range(w):
            best = self._size(code, self._load(code, self._at(code, rows[k], k)))
            chosen = self.lanes.constant(float(k))
            for i in range(k + 1, w):
                size = self._size(code, self._load(code, self._at(code, rows[i], k)))
                larger = code.new(f"fcmp ogt {V} {size}, {best}")
                best = self._select(code, larger, size, best)
                chosen = self._select(code, larger, self.lanes.constant(float(i)), chosen)
            for i in range(k + 1, w):
                mask = code.new(f"fcmp oeq {V} {chosen}, {self.lanes.constant(float(i))}")
                with code.when(self._any(code, mask)), code.loop(0, "%columns") as j:
                    one, other = (self._at(code, rows[m], j) for m in (k, i))
                    a, b = self._load(code, one), self._load(code, other)
                    self._store(code, self._select(code, mask, b, a), one)
                    self._store(code, self._select(code, mask, a, b), other)
            at = self._at(code, rows[k], k)
            inverse = self._make(code, "fdiv", self.lanes.constant(1.0), self._load(code, at))
            self._store(code, inverse, at)
            row = [self._load(code, self._at(code, rows[k], j)) for j in range(k + 1, w)]
            for i in range(k + 1, w):
                at = self._at(code, rows[i], k)
                factor = self._make(code, "fmul", self._load(code, at), inverse)
                self._store(code, factor, at)
                for j, other in zip(range(k + 1, w), row, strict=True):
                    to = self._at(code, rows[i], j)
                    part = self._make(code, "fmul", factor, other)
                    self._store(code, self._make(code, "fsub", self._load(code, to), part), to)
        return code.text(internal=True)

    def _solve(self) -> str:
        """solve(panel, stride, first, columns): columns from `first` on by those factors."""
        arguments = ["ptr %panel", "i64 %stride", "i64 %first", "i64 %columns"]
        code, w = Code("solve", arguments), self.w
        rows = [self._at(code, "%panel", code.mul("%stride", k)) for k in range(w)]
        end = code.add("%first", "%columns")
        for j, lanes in self._columns(code, "%first", end):
            x = [self._load(code, self._at(code, row, j), lanes) for row in rows]

            def factor(i: int, k: int, lanes: Lanes = lanes) -> str:
                return self._in_all(code, self._load(code, self._at(code, rows[i], k)), lanes)

            def less(i: int, k: int, x: list[str] = x, lanes: Lanes = lanes) -> None:
                part = self._make(code, "fmul", factor(i, k), x[k], lanes)
                x[i] = self._make(code, "fsub", x[i], part, lanes)

            for k in range(w):
                for i in range(k + 1, w):
                    less(i, k)
            for k in reversed(range(w)):
                x[k] = self._make(code, "fmul", factor(k, k), x[k], lanes)
                for i in range(k):
                    less(i, k)
            for row, value in zip(rows, x, strict=True):
                self._store(code, value, self._at(code, row, j), lanes)
        return code.text(internal=True)

    def _eliminate(self) -> str:
        arguments = [*SYSTEM, "ptr %table", "i64 %groups", *["ptr %own", "ptr %to"] * self.signs]
        code, w = Code("eliminate", arguments), self.w
        with self._groups(code) as group:
            n, columns, begin, rows, units, moves = group[:6]
            panel = self._at(code, "%memory", begin)
            if self.signs:
                arguments = f"ptr {panel}, i64 {n}, i64 {columns}, i64 {moves}, ptr %own, ptr %to"
                with code.when(code.compare("sge", moves, 0)):
                    code.line(f'call void @"signs"({arguments})')
            single = code.compare("eq", n, w)
            with code.when(code.new(f"xor i1 {single}, true")):
                code.line(f'call void @"pivot"(ptr {panel}, i64 {n}, i64 {columns})')
            with code.when(single):
                code.line(f'call void @"factor"(ptr {panel}, i64 {columns})')
                solve = f'call void @"solve"(ptr {panel}, i64 {columns}'
                with code.loop(0, units) as k:
                    at = code.add(w, code.mul(k, w))
                    with code.when(self._is_there(code, code.add(begin, at))):
                        code.line(f"{solve}, i64 {at}, i64 {w})")
                code.line(f"{solve}, i64 {code.sub(columns, 1)}, i64 1)")
            with code.loop(0, rows) as i:
                row = group.row(code, i)
                factors = code.load(row)
                with code.when(self._is_there(code, factors)):
                    first = self._at(code, "%memory", factors)

                    def product(k: str, row: str = row) -> list[str]:
                        at = code.at(row, code.add(1, code.mul(k, 4)))
                        return [code.load(code.at(at, i)) for i in range(4)]

                    with code.loop(0, units) as k:
                        to, stride, column, width = product(k)
                        with code.when(self._is_there(code, code.add(begin, column))):
                            to = self._put(code, to, stride)
                            other = self._at(code, panel, column)
                            self._less_product(code, to, stride, first, n, n, other, columns, width)
                    to, stride, column, width = product(units)
                    to, other = self._at(code, "%memory", to), self._at(code, panel, column)
                    self._less_product(code, to, stride, first, n, n, other, columns, width)
        return code.text(internal=True)

    def _substitute(self) -> str:
        code = Code("substitute", [*SYSTEM, "ptr %table", "i64 %groups"])
        V, slot = self.lanes.vector, code.slot("ptr")
        total = code.slot(V)
        code.store("%table", slot, "ptr")
        with code.loop(0, "%groups"):
            entry = code.load(slot, "ptr")
            n, columns, begin, behind = (code.load(code.at(entry, k)) for k in range(4))
            panel, own = self._at(code, "%memory", begin), code.at(entry, 4)
            units, last = code.at(own, n), code.sub(columns, 1)
            with code.loop(0, n) as i:
                row = self._at(code, panel, code.mul(i, columns))
                code.store(self._load(code, self._at(code, row, last)), total, V)
                with code.loop(0, behind) as k:
                    at = code.add(n, code.mul(k, self.w))
                    with code.when(self._is_there(code, code.add(begin, at))):
                        known = self._at(code, "%memory", code.load(code.at(units, k)))
                        part = self._at(code, row, at)
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
        return code.text(internal=True)
