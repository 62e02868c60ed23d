"""Native code for what the lanes of a sample's cells agree about: sums, largest and least numbers
over them, in the order of the cells, the same in each of these lanes.
"""

from __future__ import annotations

from collections.abc import Callable

from ..compiler.llvm import Lanes
from ..compiler.loop_text import Code


class CellSums:
    """Text of the functions "sum over cells", "largest over cells", "least over cells" (ptr to,
    i64 size), of components in their place, and "first cell" (ptr to, ptr source): the source in
    the lane of each sample's first cell, zero in others. Lanes lie cell by cell, sample by sample;
    those that are left over follow the last sample's.
    """

    def __init__(self, lanes: Lanes, cells: int) -> None:
        self.lanes, self.cells = lanes, cells
        last = lanes.count // cells - 1
        # by lane that of its sample's first cell
        self.firsts = [min(k // cells, last) * cells for k in range(lanes.count)]

    def functions(self) -> list[str]:
        V, T = self.lanes.vector, self.lanes.truth

        def extreme(compared: str) -> Callable[[Code, str, str], str]:
            def merged(code: Code, a: str, b: str) -> str:
                chosen = code.new(f"fcmp {compared} {V} {a}, {b}")
                broken = code.new(f"fcmp uno {V} {a}, {a}")
                a_is = code.new(f"or {T} {chosen}, {broken}")
                return code.new(f"select {T} {a_is}, {V} {a}, {V} {b}")

            return merged

        return [
            self._over("sum", lambda code, a, b: code.new(f"fadd {V} {a}, {b}")),
            self._over("largest", extreme("ogt")),
            self._over("least", extreme("olt")),
            self._first(),
        ]

    def _over(self, name: str, merged: Callable[[Code, str, str], str]) -> str:
        code, V, W = Code(f"{name} over cells", ["ptr %to", "i64 %size"]), *self._types()
        with code.loop(0, "%size") as k:
            at = code.at("%to", k, V)
            whole = code.new(f"load {V}, ptr {at}, align {self.lanes.bytes}")
            total = None
            for cell in range(self.cells):
                mask = ", ".join(f"i32 {first + cell}" for first in self.firsts)
                part = code.new(f"shufflevector {V} {whole}, {V} poison, <{W} x i32> <{mask}>")
                total = part if total is None else merged(code, total, part)
            code.line(f"store {V} {total}, ptr {at}, align {self.lanes.bytes}")
        return code.text(internal=True)

    def _first(self) -> str:
        code, V, W = Code("first cell", ["ptr %to", "ptr %source"]), *self._types()
        used = W // self.cells * self.cells
        first = [k == cell and k < used for k, cell in enumerate(self.firsts)]
        mask = ", ".join(f"i1 {'true' if x else 'false'}" for x in first)
        source = code.new(f"load {V}, ptr %source, align {self.lanes.bytes}")
        zero = self.lanes.constant(0.0)
        chosen = code.new(f"select {self.lanes.truth} <{mask}>, {V} {source}, {V} {zero}")
        code.line(f"store {V} {chosen}, ptr %to, align {self.lanes.bytes}")
        return code.text(internal=True)

    def _types(self) -> tuple[str, int]:
        return self.lanes.vector, self.lanes.count
