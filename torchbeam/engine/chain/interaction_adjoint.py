"""Native adjoint of interactions; see `interaction_driver`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from .driver_code import Place, Places
from .interaction import FINISHED
from .interaction_driver import Entry, InteractionCode


class InteractionAdjoint(InteractionCode):
    """Cotangents of what interactions hold, and of what they do to nodes."""

    def _blocks(self, entry: Entry) -> None:
        """Blocks of the transposed matrix, and what is asked of the moves of its ends."""
        nodes, to = {side: self._move_of(entry.nodes[side]) for side in entry.sides}, entry.name
        places: Places = {f"{side}.reaction": ("push", node) for side, node in nodes.items()}
        if entry.own is not None:
            places["force_bar"] = ("multiplier_bar", entry.own)
        self._call_of(f"{to} blocks {entry.function}", entry, f"{to} blocks", places)
        size = self.coupled(entry.of, entry.function)
        for side, node in nodes.items() if self.held else ():
            asked = f"{to} blocks", entry.number, f"{side}.asked"
            self._add(("asked", node), asked, size)

    def _backward(self, name: str, of: Callable[[str], Place], ends: Places) -> None:
        """A derivative."""
        raise NotImplementedError

    def _made(self, record: str, row: str) -> Places:
        """Cotangents of what a step has made."""
        raise NotImplementedError

    def _solutions(self) -> None:
        """Forces of constraints between the states of a step, and which pairs are far."""

        def solution(entry: Entry) -> None:
            if entry.own is not None:
                places: Places = {
                    "after_force": ("multiplier_after", entry.own),
                    "> force": ("multiplier", entry.own),
                }
                name = f"{entry.name} solution {entry.function}"
                self._call(name, lambda f: self._of_interaction(f, entry), places=places)

        for one in self.interactions:
            if one.unknowns or one.far:
                self._each_of(one, solution, look=True)

    def _interaction_energies(self) -> None:
        """To what the energy rises by: less the work of what acts in them."""

        def add(entry: Entry) -> None:
            self._call_of(f"ended {entry.name} {entry.function}", entry, "change")
            self._add(("energy", 0, "rise"), ("change", 0, "rise"))

        for one in FINISHED:
            self._each_of(one, add)

    def _interaction_ends(self) -> None:
        """What the cotangents of their work, and of their states at the end, ask of the start, of
        nodes, of forces.
        """

        def ends(entry: Entry) -> None:
            made = self._made(f"{entry.name}_state", entry.number)
            if entry.own is not None:
                made["force"] = ("multiplier_state_bar", entry.own, "last_force")
            self._bars_of(f"finish {entry.name} bar {entry.function}", entry, made)

        for one in FINISHED:
            self._each_of(one, ends)

    def _interaction_bars(self) -> None:
        """What the solution asks of their start and constants."""

        def bars(entry: Entry) -> None:
            ends = self._pushed_bars(entry)
            if entry.own is not None:
                ends["right"] = self._solution_of(entry)
            self._bars_of(f"{entry.name} bar {entry.function}", entry, ends)

        for one in FINISHED:
            self._each_of(one, bars)

    def _bars_of(self, name: str, entry: Entry, ends: Places) -> None:
        self._backward(name, partial(self._of_interaction, entry=entry), ends)

    def _pushed_bars(self, entry: Entry) -> Places:
        """Cotangents of what it pushes its ends by."""
        return {f"{side}.push": ("found", self._move_of(entry.nodes[side])) for side in entry.sides}
