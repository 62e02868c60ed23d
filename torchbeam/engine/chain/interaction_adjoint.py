"""Native adjoint of interactions; see `interaction_driver`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from ..compiler.derivative import bar
from .driver_code import Place, Places
from .interaction import FINISHED
from .interaction_driver import Entry, InteractionCode
from .layout import FORCES

# where cotangents of forces of constraints are added up
OF_FORCES = {"force": ("multiplier_asked", "force"), "last_force": ("multiplier_start_bar", FORCES)}
MULTIPLIER = "multiplier"


class InteractionAdjoint(InteractionCode):
    """Cotangents of what interactions hold, and of what they do to nodes."""

    def _blocks(self, entry: Entry) -> None:
        """Blocks of the transposed matrix, and what is asked of the moves of its ends."""
        nodes, to = {side: self._move_of(entry.nodes[side]) for side in entry.sides}, entry.name
        places: Places = {f"{side}.reaction": ("push", node) for side, node in nodes.items()}
        if entry.own is not None:
            places["force_bar"] = ("multiplier_asked", entry.own)
        self._call_of(f"{to} blocks {entry.function}", entry, f"{to} blocks", places)
        size = self.coupled(entry.of, entry.function)
        for side, node in nodes.items() if self.held else ():
            asked = f"{to} blocks", entry.number, f"{side}.asked"
            self._add(("asked", node), asked, size)

    def _clear_interactions(self) -> None:
        """Cotangents of their constants, and of their states."""
        for one in self.interactions:
            self._clear(one, f"{one.constants}_bar")
        for name, each in self._states().items():
            each(lambda k, name=name: self._fill((f"{name}_state_bar", k)))

    def _states(self) -> dict[str, Callable[[Callable[[str], None]], None]]:
        """What has a state, by name, and loops over its rows."""
        states = {
            one.name: partial(self._each_row, one)
            for one in self.interactions
            if f"{one.name}_state_bar" in self.layout.records
        }
        return states | ({MULTIPLIER: self._each_multiplier} if self.kinds.multiplied else {})

    def _add_states(self) -> None:
        """To the cotangents of their states those of what a step has made."""
        self._clear_multipliers("multiplier_asked")
        for name, each in self._states().items():
            each(lambda k, name=name: self._fill((f"{name}_start_bar", k)))
            each(
                lambda k, name=name: self._add((f"{name}_state_bar", k), (f"{name}_state_grad", k))
            )

    def _solutions(self) -> None:
        """Forces of constraints between the states of a step, and which pairs are far."""

        def solution(entry: Entry) -> None:
            if entry.own is not None:
                places: Places = {
                    "after_force": ("multiplier_after", entry.own),
                    "> force": (MULTIPLIER, entry.own),
                }
                name = f"{entry.name} solution {entry.function}"
                self._call(name, lambda f: self._of_interaction(f, entry), places=places)

        for one in self.interactions:
            if one.unknowns or one.far:
                self._each_of(one, solution, look=True)

    def _interaction_energies(self) -> None:
        """To what the energy rises by: less the work of what acts in them."""

        def add(entry: Entry) -> None:
            change = f"{entry.name} change"
            self._call_of(f"ended {entry.name} {entry.function}", entry, change)
            self._add(("energy", 0, "rise"), (change, 0, "rise"))

        for one in FINISHED:
            self._each_of(one, add)

    def _interaction_ends(self) -> None:
        """What the cotangents of their work, and of joints' states at the end, ask of the start, of
        nodes, of forces.
        """

        def ends(entry: Entry) -> None:
            places: Places = {bar("work"): ("sample", 0, bar("work"))}
            if "energy" in self.layout.records:
                places[bar("rise")] = ("energy", 0, bar("rise"))
            state = f"{entry.name}_state_bar"
            places |= {bar(f): (state, entry.number, f) for f in self.layout.fields(state)}
            if entry.own is not None:
                places[bar("force")] = ("multiplier_state_bar", entry.own)
            self._bar_of(f"finish {entry.name} bar {entry.function}", entry, places)

        for one in FINISHED:
            self._each_of(one, ends)

    def _interaction_bars(self) -> None:
        """What the solution asks of their start and constants."""

        def bars(entry: Entry) -> None:
            places = self._pushed_bars(entry)
            if entry.own is not None:
                places[bar("right")] = self._solution_of(entry)
            self._bar_of(f"{entry.name} bar {entry.function}", entry, places)

        for one in FINISHED:
            self._each_of(one, bars)

    def _pushed_bars(self, entry: Entry) -> Places:
        """Cotangents of what it pushes its ends by."""
        return {
            bar(f"{side}.push"): ("found", self._move_of(entry.nodes[side])) for side in entry.sides
        }

    def _take_states(self, good: str) -> None:
        """Cotangents of their states at the start, of what has gone well."""
        for name, each in self._states().items():
            each(
                lambda k, name=name: self._take(
                    (f"{name}_state_bar", k), (f"{name}_start_bar", k), good
                )
            )

    def _bar_of(self, name: str, entry: Entry, places: Places) -> None:
        """A derivative, with cotangents at `places`, and what it gives added to those of where its
        fields are.
        """
        record = f"of {entry.name}"
        self._call_of(name, entry, record, places)
        for out in self.functions[name].outputs:
            to = self._cotangent_of(out.removesuffix("_bar"), entry)
            if to is not None:
                self._sum(to, (record, 0, out), self.at("sample", 0, "good"))

    def _cotangent_of(self, field: str, entry: Entry) -> Place | None:
        """Where the cotangent of a field is added up: of the start, of constants, of the motion of
        an end, of forces; None = nobody asks for it.
        """
        side, _, own = field.partition(".")
        if side in entry.of.sides:
            return self._bar_place(own, entry.nodes[side])
        if entry.own is not None and field in OF_FORCES:
            record, field = OF_FORCES[field]
            return record, entry.own, field
        if field in self.layout.fields(f"{entry.name}_start_bar"):
            return f"{entry.name}_start_bar", entry.number, field
        return self._bar_place(field, entry.number)
