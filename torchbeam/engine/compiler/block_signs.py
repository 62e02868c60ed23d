"""Signs of the pivots of an elimination with constraints: native loops that tell, of each group of
a `BlockPattern` and in each lane, whether the moves that its constraints leave are stable.

A group has moves, and behind them forces F of constraints G,

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

from .block_matrix import BlockMatrix
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
