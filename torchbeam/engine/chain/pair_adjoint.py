"""Native adjoint of pairs that may touch; see `pair_driver`."""

from __future__ import annotations

from ..compiler.derivative import bar
from .node_kinds import PAIR_SIDES
from .pair_driver import PairCode


class PairAdjoint(PairCode):
    """Cotangents of pairs' constants, and of what they do to nodes."""

    def _clear_pairs(self) -> None:
        if self.kinds.pairs and "pair_bar" in self.layout.records:
            with self.code.loop(0, self.args["pair_count"]) as p:
                self._fill(self.at("pair_bar", p), self.layout.records["pair_bar"].size)

    def _look_at_pairs(self) -> None:
        """Which are far, between the states of a step."""
        self._each_pair(lambda p, nodes, k: None, look=True)

    def _pair_energies(self) -> None:
        """To what the energy rises by: less the work of pairs."""

        def add(p: str, nodes: list[str], k: int) -> None:
            self._call_pair(f"ended pair {k}", p, nodes, "pair_change")
            self._add(self.at("energy", 0, "rise"), self.at("pair_change", 0, "rise"), 1)

        self._each_pair(add)

    def _pair_ends(self) -> None:
        """What the cotangent of the work asks of the start and of the moves."""

        def ends(p: str, nodes: list[str], k: int) -> None:
            places = {bar("work"): self.at("sample", 0, bar("work"))}
            if "energy" in self.layout.records:
                places[bar("rise")] = self.at("energy", 0, bar("rise"))
            self._pair_bar(f"finish pair bar {k}", p, nodes, places)

        self._each_pair(ends)

    def _pair_blocks(self) -> None:
        """Blocks of the transposed matrix, and what is asked of the moves of nodes."""

        def blocks(p: str, nodes: list[str], k: int) -> None:
            at = dict(zip(PAIR_SIDES, nodes, strict=True))

            def where(f: str) -> str:
                side, _, name = f.partition(".")
                if f[0] == ">":
                    return self.at("pairs", p, f[2:])
                if name == "reaction":
                    return self.at("push", self._move_of(at[side]))
                return self._pair_field(f, p, nodes)

            self._call(f"pair blocks {k}", where)
            for side, node in at.items() if self.held else ():
                asked = self.at("asked", self._move_of(node))
                self._add(asked, self.at("pairs", p, f"{side}.asked"), self.coupled(k))

        self._each_pair(blocks)

    def _pair_bars(self) -> None:
        """What the solution asks of the start and of the constants."""

        def bars(p: str, nodes: list[str], k: int) -> None:
            places = {
                bar(f"{side}.push"): self.at("found", self._move_of(node))
                for side, node in zip(PAIR_SIDES, nodes, strict=True)
            }
            self._pair_bar(f"pair bar {k}", p, nodes, places)

        self._each_pair(bars)

    def _pair_bar(self, name: str, p: str, nodes: list[str], places: dict[str, str]) -> None:
        """A derivative of pair p, with cotangents at `places`, and what it gives added to those of
        where its fields are.
        """

        def where(f: str) -> str:
            if f[0] == ">":
                return self.at("of_pair", 0, f[2:])
            return places[f] if f in places else self._pair_field(f, p, nodes)

        self._call(name, where)
        records = self.layout.records
        for out in self.functions[name].outputs:
            field = out.removesuffix("_bar")
            side, _, own = field.partition(".")
            record, at = f"{side}_bar", 0 if side == "common" else p
            if side in PAIR_SIDES:
                at, field = nodes[PAIR_SIDES.index(side)], own
                record = f"{own.partition('.')[0]}_bar" if "." in own else "start_bar"
                at = self._support_of(at) if record == "support_bar" else at
                if own in ("u", "m"):
                    record, field = "unknown_bar", bar(own)
            if field in self.layout.fields(record):
                to, size = self.at(record, at, field), records[record].fields[field][1]
                good = self.at("sample", 0, "good")
                self._sum(to, self.at("of_pair", 0, out), good, size)
