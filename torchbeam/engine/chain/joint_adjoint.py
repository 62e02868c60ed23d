"""Native adjoint of joints; see `joint_driver`."""

from __future__ import annotations

from ..compiler.derivative import bar
from .driver_code import Places
from .joint_driver import JointCode
from .node_kinds import SIDES

STATE = "joint_state_bar"


class JointAdjoint(JointCode):
    """Cotangents of joints' states and constants, and of what they do to nodes."""

    def _joint_blocks(self, k: str, kind: int) -> None:
        """Blocks of the transposed matrix, and what is asked of the moves of its ends."""
        sides = self.kinds.joints[kind].sides
        places: Places = {
            f"{side}.reaction": ("push", self._move_of(self._joint_node(k, side))) for side in sides
        }
        places[bar("force")] = ("joint_asked", k)
        self._call_joint("joint blocks", k, kind, ("joint_blocks", k), places)
        for side in sides if self.held else ():
            asked = "asked", self._move_of(self._joint_node(k, side))
            self._add(asked, ("joint_blocks", k, f"{side}.asked"))

    def _clear_joints(self) -> None:
        """Cotangents of their states and constants."""
        self._clear_records(STATE, "joint_bar")

    def _add_joints(self) -> None:
        """To the cotangents of their states those of what a step has made."""
        self._clear_records("joint_start_bar", "joint_asked")
        self._of_joints(lambda k: self._add((STATE, k), ("joint_state_grad", k)))

    def _joint_solutions(self) -> None:
        """Their forces, between the states of a step."""

        def solution(k: str, kind: int) -> None:
            places = {"after_force": ("joint_after", k), "> force": ("joint_unknown", k)}
            self._call_joint("joint solution", k, kind, places=places)

        self._each_joint(solution)

    def _joint_energies(self) -> None:
        """To what the energy rises by: less the work of what acts in them."""

        def add(k: str, kind: int) -> None:
            self._call_joint("ended joint", k, kind, ("change", 0))
            self._add(("energy", 0, "rise"), ("change", 0, "rise"))

        self._each_joint(add)

    def _joint_ends(self) -> None:
        """What the cotangents of their states at the end ask of the start, of nodes, of forces."""

        def ends(k: str, kind: int) -> None:
            places = {
                bar("force"): (STATE, k, "joint_force"),
                bar("joints"): (STATE, k, "joints"),
                bar("work"): ("sample", 0, bar("work")),
                bar("rise"): ("energy", 0, bar("rise")),
            }
            to = "of_joint", 0
            self._spread_joint(self._call_joint("finish joint bar", k, kind, to, places), k)

        self._each_joint(ends)

    def _joint_bars(self) -> None:
        """What the solution asks of their start and constants."""

        def bars(k: str, kind: int) -> None:
            places: Places = {
                bar(f"{side}.push"): ("found", self._move_of(self._joint_node(k, side)))
                for side in SIDES[1]
            }
            places[bar("right")] = ("joint_move", k)
            self._spread_joint(self._call_joint("joint bar", k, kind, ("of_joint", 0), places), k)

        self._each_joint(bars)

    def _take_joints(self, good: str) -> None:
        """Cotangents of their states at the start, of what has gone well."""
        self._of_joints(lambda k: self._take((STATE, k), ("joint_start_bar", k), good))

    def _spread_joint(self, name: str, k: str) -> None:
        """Add the cotangents that a function of joint k gives to those of the start, of the
        constants, of its ends' motion and of its forces.
        """
        own = {
            "force": ("joint_asked", k, "force"),
            "joints": ("joint_start_bar", k, "joints"),
            "last_force": ("joint_start_bar", k, "joint_force"),
        }
        for out in self.functions[name].outputs:
            field = out.removesuffix("_bar")
            side, _, at_end = field.partition(".")
            if side in SIDES[1]:
                place = self._node_bar(at_end, self._joint_node(k, side))
            else:
                place = own.get(field) or self._own_bar(field, k)
            if place is not None:
                self._sum(place, ("of_joint", 0, out), self.at("sample", 0, "good"))
