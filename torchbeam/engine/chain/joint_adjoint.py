"""Native adjoint of joints; see `joint_driver`."""

from __future__ import annotations

from ..compiler.derivative import bar
from .joint_driver import JointCode
from .node_kinds import SIDES

STATE = "joint_state_bar"


class JointAdjoint(JointCode):
    """Cotangents of joints' states and constants, and of what they do to nodes."""

    def _joint_blocks(self, k: str, kind: int) -> None:
        """Blocks of the transposed matrix, and what is asked of the moves of its ends."""

        def where(f: str) -> str:
            side, _, name = f.partition(".")
            if f[0] == ">":
                return self.at("joint_blocks", k, f[2:])
            if name == "reaction":
                return self.at("push", self._move_of(self._joint_node(k, side)))
            return self.at("joint_asked", k) if f == "force_bar" else self._of_joint(f, k)

        self._call(f"joint blocks {kind}", where)
        if self.held:
            for side in self.kinds.joints[kind].sides:
                self._add(
                    self.at("asked", self._move_of(self._joint_node(k, side))),
                    self.at("joint_blocks", k, f"{side}.asked"),
                    self.layout.records["move"].size,
                )

    def _clear_joints(self) -> None:
        """Cotangents of their states and constants."""
        self._clear_records(STATE, "joint_bar")

    def _add_joints(self) -> None:
        """To the cotangents of their states those of what a step has made."""
        self._clear_records("joint_start_bar", "joint_asked")

        def add(k: str, kind: int) -> None:
            self._add(
                self.at(STATE, k), self.at("joint_state_grad", k), self.layout.records[STATE].size
            )

        self._each_joint(add, alike=True)

    def _joint_solutions(self) -> None:
        """Their forces, between the states of a step."""

        def solution(k: str, kind: int) -> None:
            self._call(
                f"joint solution {kind}",
                lambda f: (
                    self.at("joint_unknown", k)
                    if f[0] == ">"
                    else self.at("joint_after", k)
                    if f == "after_force"
                    else self._of_joint(f, k)
                ),
            )

        self._each_joint(solution)

    def _joint_energies(self) -> None:
        """To what the energy rises by: less the work of what acts in them."""

        def add(k: str, kind: int) -> None:
            self._call(
                f"ended joint {kind}",
                lambda f: self.at("change", 0, f[2:]) if f[0] == ">" else self._of_joint(f, k),
            )
            self._add(self.at("energy", 0, "rise"), self.at("change", 0, "rise"), 1)

        self._each_joint(add)

    def _joint_ends(self) -> None:
        """What the cotangents of their states at the end ask of the start, of nodes, of forces."""
        names = {bar("force"): "joint_force", bar("joints"): "joints"}

        def ends(k: str, kind: int) -> None:
            name = f"finish joint bar {kind}"
            self._call(
                name,
                lambda f: (
                    self.at("of_joint", 0, f[2:])
                    if f[0] == ">"
                    else self.at(STATE, k, names[f])
                    if f in names
                    else self.at("sample", 0, f)
                    if f == bar("work")
                    else self.at("energy", 0, f)
                    if f == bar("rise")
                    else self._of_joint(f, k)
                ),
            )
            self._spread_joint(name, k)

        self._each_joint(ends)

    def _joint_bars(self) -> None:
        """What the solution asks of their start and constants."""

        def bars(k: str, kind: int) -> None:
            places = {
                bar(f"{side}.push"): self.at("found", self._move_of(self._joint_node(k, side)))
                for side in SIDES[1]
            } | {bar("right"): self.at("joint_move", k)}
            self._call(
                f"joint bar {kind}",
                lambda f: (
                    self.at("of_joint", 0, f[2:])
                    if f[0] == ">"
                    else places[f]
                    if f in places
                    else self._of_joint(f, k)
                ),
            )
            self._spread_joint(f"joint bar {kind}", k)

        self._each_joint(bars)

    def _take_joints(self, good: str) -> None:
        """Cotangents of their states at the start, of what has gone well."""

        def take(k: str, kind: int) -> None:
            size = self.layout.records[STATE].size
            self._take(self.at(STATE, k), self.at("joint_start_bar", k), good, size)

        self._each_joint(take, alike=True)

    def _spread_joint(self, name: str, k: str) -> None:
        """Add the cotangents that a function of joint k gives to those of the start, of the
        constants, of its ends' motion and of its forces.
        """
        records = self.layout.records
        for out in self.functions[name].outputs:
            field, at = out.removesuffix("_bar"), k
            side, _, own = field.partition(".")
            if side in SIDES[1]:
                at = self._joint_node(k, side)
                record = f"{own.partition('.')[0]}_bar" if "." in own else "start_bar"
                record, field = (
                    ("unknown_bar", f"{own}_bar") if own in ("u", "m") else (record, own)
                )
                at = self._support_of(at) if record == "support_bar" else at
            elif field == "force":
                record = "joint_asked"
            elif field in ("joints", "last_force"):
                record = "joint_start_bar"
                field = "joints" if field == "joints" else "joint_force"
            else:
                record = f"{side}_bar"
                at = 0 if side == "common" else k
            if field in records[record].fields:
                self._sum(
                    self.at(record, at, field),
                    self.at("of_joint", 0, out),
                    self.at("sample", 0, "good"),
                    records[record].fields[field][1],
                )
