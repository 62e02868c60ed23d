"""Native code for passes over a structure: where its fields lie, and the entries of its tables."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from ..compiler.block_elimination import BlockElimination
from .cell_sums import CellSums
from .chain_code import POINTERS, ChainCode
from .interaction import INTERACTIONS
from .node_kinds import SIDES

TABLES = (
    "joint_kinds",
    "element_nodes",
    "left_elements",
    "right_elements",
    "node_places",
    "element_places",
    "kept_nodes",
    "kept_elements",
    "interface",
    "direct",
    "forward",
    "backward",
    "bordered",
    "following",
    "joint_table",
    "stretch_kinds",
    "stretch_table",
    "pair_kinds",
    "pair_table",
    "coupling_kinds",
    "coupling_table",
    "elimination",
    "substitution",
)
COUNTS = (
    "nodes",
    "kept_node_count",
    "kept_element_count",
    "interface_count",
    "direct_count",
    "forward_count",
    "backward_count",
    "bordered_count",
    "following_count",
    "joint_count",
    "stretch_count",
    "pair_count",
    "coupling_count",
    "entry_count",
    "group_count",
    "first_groups",
    "last_groups",
    "last_table",
    "shared_groups",
    "shared_table",
    "shared_first",
    "shared_size",
    "own_nodes",
    "own_interface",
    "own_joints",
)
# integers of an entry
WIDTH = {
    "interface": 6,
    "direct": 6,
    "forward": 7,
    "backward": 7,
    "bordered": 16,
    "following": 20,
    **{one.constants: one.width for one in INTERACTIONS},
}


class StructureCode(ChainCode):
    """Where the fields of a structure lie."""

    POINTERS = (*POINTERS, *TABLES)

    def _nodes(self) -> None:
        """They are told."""

    def _loops(self) -> list[str]:
        w = self.layout.records["move"].size
        over_cells = CellSums(self.lanes, self.cells).functions() if self.cells > 1 else []
        elimination = BlockElimination(self.lanes, w, self._part(), self.signed)
        return [*super()._loops(), *over_cells, *elimination.functions()]

    @property
    def signed(self) -> bool:
        """Whether signs of the interface's pivots are asked for."""
        return "signs" in self.layout.records

    def _part(self) -> int | None:
        """Unknowns of a node by which pairs that touch couple; None = all, or there are none."""
        return None

    def _over_cells(self, how: str, to: str, size: str | int = 1) -> None:
        if self.cells > 1:
            self._sized(f"{how} over cells", size, to)

    def _node_of(self, e: str, side: str) -> str:
        first = self.code.load(self.code.at(self.args["element_nodes"], e))
        k = SIDES[self.order].index(side)
        return self.code.add(first, k) if k else first

    def _turn(self, e: str, side: str) -> str | int:
        return self._node_place(self._node_of(e, side)) if side in SIDES[1] else self.order

    def _node_place(self, node: str) -> str:
        """Where what a node gives is held: those up to the elements' order take turns."""
        return self.code.load(self.code.at(self.args["node_places"], node))

    def _between(self, e: str) -> str:
        return self.code.load(self.code.at(self.args["element_places"], e))

    def _reach(self, node: str) -> str | int:
        if self.order == 1:
            return 1
        code = self.code
        sides = (
            code.load(code.at(self.args[f"{side}_elements"], node)) for side in ("left", "right")
        )
        inside = code.compare("slt", code.new(f"and i64 {next(sides)}, {next(sides)}"), 0)
        return code.choose(inside, 1, self.order)

    def _near(self, node: str) -> dict[str, str]:
        code, order = self.code, self.order
        before, after = code.sub(node, order), code.add(node, order)
        before = code.choose(code.compare("slt", before, 0), 0, before)
        last = code.sub(self.args["nodes"], 1)
        after = code.choose(code.compare("sgt", after, last), last, after)
        return {
            f"free_{name}": self.at("free", at, "free")
            for name, at in (("before", before), ("here", node), ("after", after))
        }

    # Tables

    def _entry(self, table: str, k: str) -> str:
        """Pointer to entry k."""
        name = f"{table}_table" if f"{table}_table" in TABLES else table
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
        """Numbers of entries, or joints: first and end; see `_entries`."""
        count = self.args[f"{what}_count"]
        if shared is None:
            return 0, count
        own = self.args["own_interface" if what == "interface" else "own_joints"]
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
