"""Native code for transfers between tensors and memory.

A table says what is taken from tensors, or written to them: rows of 64-bit integers in the order of
`ENTRY`.
"""

from __future__ import annotations

from ..compiler.llvm import Lanes
from ..compiler.loop_text import Code

# address of a tensor's first number; its strides in numbers, of samples, steps and rows, and how
# many steps have one place; how many rows and components there are; the first component's place in
# memory, and how many the record has; stride of the cells of a sample
ENTRY = (
    "pointer",
    "sample",
    "step",
    "every",
    "row",
    "rows",
    "components",
    "place",
    "row_size",
    "cell",
)


class Transfers:
    """Text of the functions `gather`, `scatter`, and `drain` (scatter, and leave zeros), which
    `RecordCode` calls.
    """

    NAMES = "gather", "scatter", "drain"

    def __init__(self, lanes: Lanes, cells: int = 1) -> None:
        self.lanes, self.cells = lanes, cells

    def functions(self) -> list[str]:
        return [self._function(name) for name in self.NAMES]

    def _function(self, name: str) -> str:
        """Numbers between tensors and memory, as a table says. What does not change from step to
        step is gathered at the first alone; what has one place for all steps, or for `every` few,
        is scattered at each, so that the last one's stays. Lanes beyond the samples have the last
        one's numbers, and are not scattered. Each sample has as many lanes as there are cells.
        """
        code = Code(
            name,
            [
                "ptr %table",
                "i64 %count",
                "ptr %memory",
                "i64 %first",
                "i64 %samples",
                "i64 %step",
                "i64 %begin",
            ],
        )
        scalar, W, bytes = self.lanes.scalar, self.lanes.count, self.lanes.count * self.lanes.bytes
        cells, count = self.cells, W // self.cells
        whole = code.compare("sle", code.add("%first", count), "%samples")
        if count * cells < W:
            whole = "false"
        last = code.sub("%samples", 1)
        with code.loop(0, "%count") as k:
            entry = code.at("%table", code.mul(k, len(ENTRY)))
            numbers = (code.load(code.at(entry, i)) for i in range(len(ENTRY)))
            pointer, sample, step, every, row, rows, components, place, size, cell = numbers
            slot = code.new(f"sdiv i64 %step, {every}")
            pointer = code.at(
                code.new(f"inttoptr i64 {pointer} to ptr"), code.mul(step, slot), scalar
            )
            of_lane = [min(lane // cells, count - 1) for lane in range(W)]
            inside = [code.compare("slt", code.add("%first", k), "%samples") for k in of_lane]
            samples = [
                code.choose(valid, code.add("%first", k), last)
                for valid, k in zip(inside, of_lane, strict=True)
            ]
            inside = [x if lane < count * cells else "false" for lane, x in enumerate(inside)]
            begins = [code.mul(one, sample) for one in samples]
            if cells > 1:
                begins = [
                    code.add(begin, code.mul(cell, lane % cells if lane < count * cells else 0))
                    for lane, begin in enumerate(begins)
                ]
            places = [code.at(pointer, begin, scalar) for begin in begins]
            same = code.compare(
                "eq", sample if cells == 1 else code.new(f"or i64 {sample}, {cell}"), 0
            )
            fresh = code.new(
                f"or i1 {code.compare('eq', '%step', '%begin')}, "
                f"{'true' if name == 'scatter' else code.compare('ne', step, 0)}"
            )
            with code.when(fresh), code.loop(0, rows) as r:
                there = code.mul(r, row)
                here = code.at("%memory", code.mul(code.add(place, code.mul(r, size)), bytes), "i8")
                places = [code.at(place, there, scalar) for place in places]
                if name == "gather":
                    self._read(code, places, here, components, same)
                else:
                    self._write(code, places, here, components, whole, inside)
                if name == "drain":
                    with code.loop(0, components) as c:
                        self._joined(code, ["0.0"] * W, here, c)
        return code.text(internal=True)

    def _read(self, code: Code, places: list[str], here: str, components: str, alike: str) -> None:
        """Components of each lane from its own place, or of all lanes, where they are alike, from
        one.
        """
        scalar = self.lanes.scalar
        with code.when(alike), code.loop(0, components) as c:
            self._joined(
                code, [code.load(code.at(places[0], c, scalar), scalar)] * len(places), here, c
            )
        with code.when(code.new(f"xor i1 {alike}, true")), code.loop(0, components) as c:
            self._joined(
                code, [code.load(code.at(place, c, scalar), scalar) for place in places], here, c
            )

    def _write(
        self,
        code: Code,
        places: list[str],
        here: str,
        components: str,
        whole: str,
        inside: list[str],
    ) -> None:
        """Components of each lane to its own place; of those inside, where not all are
        (`whole`).
        """
        scalar = self.lanes.scalar
        with code.when(whole), code.loop(0, components) as c:
            for place, value in zip(places, self._parted(code, here, c), strict=True):
                code.store(value, code.at(place, c, scalar), scalar)
        with code.when(code.new(f"xor i1 {whole}, true")), code.loop(0, components) as c:
            for place, is_inside, value in zip(
                places, inside, self._parted(code, here, c), strict=True
            ):
                with code.when(is_inside):
                    code.store(value, code.at(place, c, scalar), scalar)

    def _joined(self, code: Code, numbers: list[str], here: str, component: str) -> None:
        """A number in each lane of a component."""
        V, scalar = self.lanes.vector, self.lanes.scalar
        whole = numbers[0]
        if len(numbers) > 1:
            whole = "poison"
            for lane, number in enumerate(numbers):
                whole = code.new(f"insertelement {V} {whole}, {scalar} {number}, i64 {lane}")
        code.line(f"store {V} {whole}, ptr {code.at(here, component, V)}, align {self.lanes.bytes}")

    def _parted(self, code: Code, here: str, component: str) -> list[str]:
        """The numbers of all lanes of a component."""
        V, W = self.lanes.vector, self.lanes.count
        whole = code.new(f"load {V}, ptr {code.at(here, component, V)}, align {self.lanes.bytes}")
        return (
            [whole]
            if W == 1
            else [code.new(f"extractelement {V} {whole}, i64 {lane}") for lane in range(W)]
        )
