"""Native adjoint of interactions; see `interaction_driver`."""

from __future__ import annotations

from ..compiler.derivative import bar
from .driver_code import Place, Places
from .interaction import FINISHED, JOINT, PAIR
from .interaction_driver import Entry, InteractionCode

STATE = "joint_state_bar"
# where cotangents of what a joint reads are added up
OF_JOINT = {
    "force": ("joint_asked", "force"),
    "joints": ("joint_start_bar", "joints"),
    "last_force": ("joint_start_bar", "joint_force"),
}


class InteractionAdjoint(InteractionCode):
    """Cotangents of what interactions hold, and of what they do to nodes."""

    def _blocks(self, entry: Entry) -> None:
        """Blocks of the transposed matrix, and what is asked of the moves of its ends."""
        nodes, to = {side: self._move_of(entry.nodes[side]) for side in entry.sides}, entry.name
        places: Places = {f"{side}.reaction": ("push", node) for side, node in nodes.items()}
        if entry.of is JOINT:
            places["force_bar"] = ("joint_asked", entry.number)
        self._call_of(f"{to} blocks {entry.function}", entry, f"{to} blocks", places)
        size = self.coupled(entry.of, entry.function)
        for side, node in nodes.items() if self.held else ():
            asked = f"{to} blocks", entry.number, f"{side}.asked"
            self._add(("asked", node), asked, size)

    def _clear_interactions(self) -> None:
        """Cotangents of their constants, and of joints' states."""
        for one in self.interactions:
            self._clear(one, f"{one.constants}_bar")
        self._clear(JOINT, STATE)

    def _add_joints(self) -> None:
        """To the cotangents of their states those of what a step has made."""
        for record in ("joint_start_bar", "joint_asked"):
            self._clear(JOINT, record)
        self._each_row(JOINT, lambda k: self._add((STATE, k), ("joint_state_grad", k)))

    def _solutions(self) -> None:
        """Forces of joints between the states of a step, and which pairs are far."""
        self._each_of(PAIR, lambda entry: None, look=True)

        def solution(entry: Entry) -> None:
            after: Places = {"after_force": ("joint_after", entry.number)}
            self._call_of(f"joint solution {entry.function}", entry, "joint_unknown", after)

        self._each_of(JOINT, solution)

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
            if entry.of is JOINT:
                names = {"force": "joint_force", "joints": "joints"}
                places |= {bar(f): (STATE, entry.number, x) for f, x in names.items()}
            self._bar_of(f"finish {entry.name} bar {entry.function}", entry, places)

        for one in FINISHED:
            self._each_of(one, ends)

    def _interaction_bars(self) -> None:
        """What the solution asks of their start and constants."""

        def bars(entry: Entry) -> None:
            places = self._pushed_bars(entry)
            if entry.of is JOINT:
                places[bar("right")] = self._solution_of(JOINT, entry.number)
            self._bar_of(f"{entry.name} bar {entry.function}", entry, places)

        for one in FINISHED:
            self._each_of(one, bars)

    def _pushed_bars(self, entry: Entry) -> Places:
        """Cotangents of what it pushes its ends by."""
        return {
            bar(f"{side}.push"): ("found", self._move_of(entry.nodes[side])) for side in entry.sides
        }

    def _take_joints(self, good: str) -> None:
        """Cotangents of their states at the start, of what has gone well."""
        self._each_row(JOINT, lambda k: self._take((STATE, k), ("joint_start_bar", k), good))

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
        if field in OF_JOINT:
            record, field = OF_JOINT[field]
            return record, entry.number, field
        return self._bar_place(field, entry.number)
