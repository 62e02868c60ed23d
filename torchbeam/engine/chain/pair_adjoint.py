"""Native adjoint of pairs that may touch; see `pair_driver`."""

from __future__ import annotations

from ..compiler.derivative import bar
from .driver_code import Places
from .node_kinds import PAIR_SIDES
from .pair_driver import PairCode


class PairAdjoint(PairCode):
    """Cotangents of pairs' constants, and of what they do to nodes."""

    def _clear_pairs(self) -> None:
        if self.kinds.pairs and "pair_bar" in self.layout.records:
            with self.code.loop(0, self.args["pair_count"]) as p:
                self._fill(("pair_bar", p))

    def _look_at_pairs(self) -> None:
        """Which are far, between the states of a step."""
        self._each_pair(lambda p, nodes, k: None, look=True)

    def _pair_energies(self) -> None:
        """To what the energy rises by: less the work of pairs."""

        def add(p: str, nodes: list[str], k: int) -> None:
            self._call_pair(f"ended pair {k}", p, nodes, ("pair_change", 0))
            self._add(("energy", 0, "rise"), ("pair_change", 0, "rise"))

        self._each_pair(add)

    def _pair_ends(self) -> None:
        """What the cotangent of the work asks of the start and of the moves."""

        def ends(p: str, nodes: list[str], k: int) -> None:
            places = {
                bar("work"): ("sample", 0, bar("work")),
                bar("rise"): ("energy", 0, bar("rise")),
            }
            self._pair_bar(f"finish pair bar {k}", p, nodes, places)

        self._each_pair(ends)

    def _pair_blocks(self) -> None:
        """Blocks of the transposed matrix, and what is asked of the moves of nodes."""

        def blocks(p: str, nodes: list[str], k: int) -> None:
            at = {side: self._move_of(node) for side, node in zip(PAIR_SIDES, nodes, strict=True)}
            places: Places = {f"{side}.reaction": ("push", move) for side, move in at.items()}
            self._call_pair(f"pair blocks {k}", p, nodes, ("pairs", p), places)
            for side, move in at.items() if self.held else ():
                self._add(("asked", move), ("pairs", p, f"{side}.asked"), self.coupled(k))

        self._each_pair(blocks)

    def _pair_bars(self) -> None:
        """What the solution asks of the start and of the constants."""

        def bars(p: str, nodes: list[str], k: int) -> None:
            places = {
                bar(f"{side}.push"): ("found", self._move_of(node))
                for side, node in zip(PAIR_SIDES, nodes, strict=True)
            }
            self._pair_bar(f"pair bar {k}", p, nodes, places)

        self._each_pair(bars)

    def _pair_bar(self, name: str, p: str, nodes: list[str], places: Places) -> None:
        """A derivative of pair p, with cotangents at `places`, and what it gives added to those of
        where its fields are.
        """
        self._call_pair(name, p, nodes, ("of_pair", 0), places)
        for out in self.functions[name].outputs:
            field = out.removesuffix("_bar")
            side, _, own = field.partition(".")
            if side in PAIR_SIDES:
                place = self._node_bar(own, nodes[PAIR_SIDES.index(side)])
            else:
                place = self._own_bar(field, p)
            if place is not None:
                self._sum(place, ("of_pair", 0, out), self.at("sample", 0, "good"))
