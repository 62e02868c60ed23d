"""Native adjoint of steps of structures: what is other than on a chain; see `structure_driver`."""

from __future__ import annotations

from ..compiler.derivative import bar
from .adjoint_driver import AdjointDriver
from .interaction import COUPLING, JOINT, PAIR
from .interaction_driver import Entry
from .structure_code import COUNTS, TABLES
from .structure_driver import StructurePasses
from .tendon_adjoint import TendonAdjoint

STATE = "joint_state_bar"
# where cotangents of what a joint reads are added up
OF_JOINT = {
    "force": ("joint_asked", "force"),
    "joints": ("joint_start_bar", "joints"),
    "last_force": ("joint_start_bar", "joint_force"),
}


class StructureAdjoint(TendonAdjoint, StructurePasses, AdjointDriver):
    """Cotangents of structures, step by step backwards."""

    ARGS = (*AdjointDriver.ARGS, *TABLES, *COUNTS)

    def _transposed(self) -> None:
        code = self.code
        self._at_interface()
        for one in self.interactions:
            self._each_of(one, self._blocks)
        self._eliminate()
        self._moves()
        with code.loop(0, self.args["nodes"]) as j:
            self._balance_bar(j)

    def _around(self, node: str) -> dict[str, str]:
        around = {"right": self.at("asked", self._move_of(node))}
        if self.held:
            around |= self._near(node) | {
                f"push_{name}": self.at("push", self._move_of(node, k))
                for name, k in (("before", -self.order), ("here", 0), ("after", self.order))
            }
        return around

    def _row_kept(self, node: str) -> None:
        """Reactions are those of the steps."""

    def _row_judged(self, name: str) -> None:
        """Nothing is."""

    def _blocks(self, entry: Entry) -> None:
        """Blocks of the transposed matrix, and what is asked of the moves of its ends."""
        nodes, record = {side: self._move_of(entry.nodes[side]) for side in entry.sides}, entry.name
        places = {f"{side}.reaction": self.at("push", node) for side, node in nodes.items()}
        if entry.of is JOINT:
            places["force_bar"] = self.at("joint_asked", entry.number)
        self._call_of(f"{record} blocks {entry.function}", entry, f"{record} blocks", places)
        for side, node in nodes.items() if self.held else ():
            asked = self.at(f"{record} blocks", entry.number, f"{side}.asked")
            self._add(self.at("asked", node), asked, self.coupled(entry.of, entry.function))

    def _clear_joints(self) -> None:
        self._clear_tendons()
        for one in self.interactions:
            self._clear(one, f"{one.constants}_bar")
        self._clear(JOINT, STATE)

    def _add_joints(self) -> None:
        self._add_tendons()
        self._clear_records("joint_start_bar", "joint_asked")

        def add(k: str) -> None:
            size = self.layout.records[STATE].size
            self._add(self.at(STATE, k), self.at("joint_state_grad", k), size)

        self._each_row(JOINT, add)

    def _joint_solutions(self) -> None:
        self._tensions()
        self._each_of(PAIR, lambda entry: None, look=True)  # which are far

        def solution(entry: Entry) -> None:
            after = {"after_force": self.at("joint_after", entry.number)}
            self._call_of(f"joint solution {entry.function}", entry, "joint_unknown", after)

        self._each_of(JOINT, solution)

    def _joint_energies(self) -> None:
        self._tendon_energies()

        def add(entry: Entry) -> None:
            change = f"{entry.name} change"
            self._call_of(f"ended {entry.name} {entry.function}", entry, change)
            self._add(self.at("energy", 0, "rise"), self.at(change, 0, "rise"), 1)

        for one in (PAIR, COUPLING, JOINT):
            self._each_of(one, add)

    def _joint_ends(self) -> None:
        self._tendon_ends()

        def ends(entry: Entry) -> None:
            places = {bar("work"): self.at("sample", 0, bar("work"))}
            if "energy" in self.layout.records:
                places[bar("rise")] = self.at("energy", 0, bar("rise"))
            if entry.of is JOINT:
                names = {"force": "joint_force", "joints": "joints"}
                places |= {bar(f): self.at(STATE, entry.number, x) for f, x in names.items()}
            self._bar_of(f"finish {entry.name} bar {entry.function}", entry, places)

        for one in (PAIR, COUPLING, JOINT):
            self._each_of(one, ends)

    def _joint_bars(self) -> None:
        self._tie_bars()

        def bars(entry: Entry) -> None:
            places = {
                bar(f"{side}.push"): self.at("found", self._move_of(entry.nodes[side]))
                for side in entry.sides
            }
            if entry.of is JOINT:
                places[bar("right")] = self._solution_of(JOINT, entry.number)
            self._bar_of(f"{entry.name} bar {entry.function}", entry, places)

        for one in (PAIR, COUPLING, JOINT):
            self._each_of(one, bars)

    def _take_joints(self, good: str) -> None:
        self._take_tendons(good)

        def take(k: str) -> None:
            size = self.layout.records[STATE].size
            self._take(self.at(STATE, k), self.at("joint_start_bar", k), good, size)

        self._each_row(JOINT, take)

    def _bar_of(self, name: str, entry: Entry, places: dict[str, str]) -> None:
        """A derivative, with cotangents at `places`, and what it gives added to those of where its
        fields are.
        """
        record = f"of {entry.name}"
        self._call_of(name, entry, record, places)
        for out in self.functions[name].outputs:
            to, row, field = self._cotangent_of(out.removesuffix("_bar"), entry)
            if field in self.layout.fields(to):
                size, good = self.layout.fields(to)[field][1], self.at("sample", 0, "good")
                self._sum(self.at(to, row, field), self.at(record, 0, out), good, size)

    def _cotangent_of(self, field: str, entry: Entry) -> tuple[str, str | int, str]:
        """Record, row and field of the cotangent of a field: of the start, of constants, of the
        motion of an end, of forces.
        """
        side, _, own = field.partition(".")
        if side in entry.of.sides:
            return self._at_node_bar(own, entry.nodes[side])
        if field in OF_JOINT:
            record, field = OF_JOINT[field]
            return record, entry.number, field
        return f"{side}_bar", 0 if side == "common" else entry.number, field
