"""Native driver of pairs that may touch: what is other in a structure that has some. A pair that
is too far to touch, in all samples of a group, is told by one look, and left out.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import isqrt

from .driver_code import DriverCode, Place, Places
from .layout import FLAGS
from .node_kinds import PAIR_SIDES
from .pair_functions import PAIR_BLOCKS

NUMBER = "i32"  # as large as a number of the smallest dtype


class PairCode(DriverCode):
    """Where the fields of pairs lie, and loops over them; pushes, blocks and work."""

    def _each_pair(self, then: Callable[[str, list[str], int], None], look: bool = False) -> None:
        """then(pair, its nodes, its kind) of each that is not far; look: which are is found out,
        from the unknowns as they are.
        """
        if not self.kinds.pairs:
            return
        code, count = self.code, self.at("near_count")
        if not look:
            number = self._integer(count)
            with code.loop(0, number) as n:
                self._pair_of_kind(self._integer(self.at("near", n)), then)
            return
        code.store(0, count, NUMBER)
        with code.loop(0, self.args["pair_count"]) as p:

            def near(p: str, nodes: list[str], k: int) -> None:
                self._call_pair(f"far pair {k}", p, nodes, ("pairs", p))
                code.call("all", self.at("pairs", p, "far"), result := code.slot())
                with code.when(code.compare("eq", code.load(result), 0)):
                    number = self._integer(count)
                    for value, to in ((p, self.at("near", number)), (code.add(number, 1), count)):
                        code.store(code.new(f"trunc i64 {value} to {NUMBER}"), to, NUMBER)
                    then(p, nodes, k)

            self._pair_of_kind(p, near)

    def _pair_of_kind(self, p: str, then: Callable[[str, list[str], int], None]) -> None:
        """then(pair, its nodes, its kind) of a pair."""
        nodes = self._pair_nodes(p)
        with self._each("pair_kinds", len(self.kinds.pairs), p) as kinds:
            for k in kinds:
                then(p, nodes, k)

    def _integer(self, pointer: str) -> str:
        """That lies there."""
        return self.code.new(f"sext {NUMBER} {self.code.load(pointer, NUMBER)} to i64")

    def coupled(self, k: int) -> int:
        """See `PairFunctions.coupled`."""
        name = f"pair {k}" if f"pair {k}" in self.functions else f"pair blocks {k}"
        return isqrt(len(self.functions[name].outputs["aa"].nodes))

    def _part(self) -> int | None:
        sizes = (self.coupled(k) for k in range(len(self.kinds.pairs)))
        return min(sizes, default=None)

    def _pair_nodes(self, p: str) -> list[str]:
        entry = self._entry("pair", p)
        return [self.code.load(self.code.at(entry, k)) for k in range(len(PAIR_SIDES))]

    def _pair_field(self, field: str, p: str, nodes: list[str]) -> str:
        """A field that is held by pair p, at one of its nodes, or by all."""
        side, _, name = field.partition(".")
        if field in PAIR_BLOCKS:
            return self.at("pairs", p, field)
        if side in PAIR_SIDES:
            return self._at_joint_node(name, nodes[PAIR_SIDES.index(side)])
        return self._first_of(("pair",), field, p)

    def _call_pair(
        self, name: str, p: str, nodes: list[str], to: Place, places: Places | None = None
    ) -> None:
        """A function of pair p, see `_call`."""
        self._call(name, lambda f: self._pair_field(f, p, nodes), to, places)

    def _join_pairs(self) -> None:
        """Their blocks, of what supports leave."""

        def join(p: str, nodes: list[str], k: int) -> None:
            if not self.held:
                self._join_pair(p, k, "pairs")
                return
            code, none = self.code, -1
            for node in nodes:
                none = code.new(f"and i64 {none}, {self._support_of(node)}")
            held = code.compare("ne", none, -1)
            with code.when(held):
                self._call_pair(f"free pair {k}", p, nodes, ("free_pair", 0))
                self._join_pair(p, k, "free_pair")
            with code.when(code.new(f"xor i1 {held}, true")):
                self._join_pair(p, k, "pairs")

        self._each_pair(join)

    def _join_pair(self, p: str, k: int, record: str) -> None:
        """Blocks of a record."""
        entry, code = self._entry("pair", p), self.code
        size = self.coupled(k)
        name = "block" if size == self.layout.records["move"].size else "part"
        for i, block in enumerate(PAIR_BLOCKS):
            place = len(PAIR_SIDES) + 2 * i
            at = (code.load(code.at(entry, place + n)) for n in range(2))
            row = p if record == "pairs" else 0
            self._add_block(*at, self.at(record, row, block), name)

    def _touch(self) -> None:
        """Pushes on the nodes, and blocks."""

        def touch(p: str, nodes: list[str], k: int) -> None:
            self._call_pair(f"pair {k}", p, nodes, ("pairs", p))
            for name in FLAGS:
                self.code.call("largest", self.at("sums", 0, name), self.at("pairs", p, name))
            for side, node in zip(PAIR_SIDES, nodes, strict=True):
                self._add(("push", node), ("pairs", p, f"{side}.push"), self.coupled(k))

        self._each_pair(touch, look=True)

    def _pair_reactions(self, support: str, node: str) -> None:
        """What pairs add to the reaction of a support, at a node."""
        push = "pair_reaction", 0, "reaction"

        def reaction(p: str, nodes: list[str], k: int) -> None:
            places: Places = {
                f"{side}.move": ("move", self._move_of(own))
                for side, own in zip(PAIR_SIDES, nodes, strict=True)
            }
            places["end_free"] = ("free", node)
            for side, own in zip(PAIR_SIDES, nodes, strict=True):
                with self.code.when(self.code.compare("eq", own, node)):
                    of = partial(self.at, "pairs", p)
                    self._call(f"pair reaction {k} {side}", of, push[:2], places)
                    self._add(("support", support, "reaction"), push)

        self._each_pair(reaction)

    def _finish_pairs(self, good: str) -> None:
        """Work."""

        def finish(p: str, nodes: list[str], k: int) -> None:
            self._call_pair(f"finish pair {k}", p, nodes, ("pair_change", 0))
            self._sum(("sample", 0, "work"), ("pair_change", 0, "work"), good)
            if "energy" in self.layout.records:
                self._add(("energy", 0, "rise"), ("pair_change", 0, "rise"))

        self._each_pair(finish, look=True)
