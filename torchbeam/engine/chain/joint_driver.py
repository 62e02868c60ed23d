"""Native driver of joints: their balance and blocks, reactions, forces, and state after a step."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from ..compiler.split import HOISTED
from .driver_code import DriverCode, Place, Places
from .joint_functions import BLOCKS
from .joints import GAPS
from .node_kinds import SIDES


class JointCode(DriverCode):
    """Where the fields of joints lie, and loops over them; their balance and blocks, and state."""

    def _each_joint(
        self,
        then: Callable[[str, int], Any],
        alike: bool = False,
        shared: bool | None = None,
        after: Callable[[str], None] = lambda k: None,
    ) -> None:
        """then(joint, its kind) of each, and `after` that; alike: the same of all kinds; shared:
        see `_range`.
        """
        if not self.kinds.joints:
            return
        with self.code.loop(*self._range("joint", shared)) as k:
            if alike:
                then(k, 0)
                return
            with self._each("joint_kinds", len(self.kinds.joints), k) as kinds:
                for kind in kinds:
                    then(k, kind)
            after(k)

    def _clear_records(self, *names: str) -> None:
        """Zeros in records of theirs."""
        self._of_joints(lambda k: [self._fill((name, k)) for name in names])

    def _of_joints(self, then: Callable[[str], Any]) -> None:
        """then(joint) of each."""
        self._each_joint(lambda k, kind: then(k), alike=True)

    def _call_joint(
        self, word: str, k: str, kind: int, to: Place | None = None, places: Places | None = None
    ) -> str:
        """The function of this word of joint k, of a kind, see `_call`; its name."""
        self._call(name := f"{word} {kind}", lambda f: self._of_joint(f, k), to, places)
        return name

    def _of_joint(self, field: str, k: str) -> str:
        """A field that is held by joint k, or at one of its ends, or by all."""
        side, _, name = field.partition(".")
        if side in SIDES[1]:
            return self._at_joint_node(name, self._joint_node(k, side))
        return self._first_of(("joint", "joint_state", "joint_unknown"), field, k)

    def _joint_node(self, k: str, side: str) -> str:
        table = self._entry("joint", k)
        return self.code.load(self.code.at(table, SIDES[1].index(side)))

    def _joint_moves(self, k: str) -> Places:
        """Of its ends, and of its forces."""
        moves: Places = {
            f"{side}.move": ("move", self._move_of(self._joint_node(k, side))) for side in SIDES[1]
        }
        return moves | {"joint.move": ("joint_move", k)}

    def _join(self, k: str, entry: list[str]) -> None:
        """Blocks of a joint, and what its constraints are to change by."""
        code = self.code
        for i, name in enumerate(BLOCKS):
            if name not in self.layout.records["joint_blocks"].fields:
                continue
            first, stride = entry[2 + 2 * i : 4 + 2 * i]
            with code.when(code.compare("sge", first, 0)):
                self._add_block(first, stride, self.at("joint_blocks", k, name))
        *_, first, stride, _ = entry
        self._add_column(first, stride, self.at("joint_blocks", k, "right"))

    def _joint(self, k: str, kind: int) -> None:
        """Its balance and blocks, and its push on the nodes."""
        places: Places = {f"> {name}": ("at_joint", 0, name) for name in GAPS}
        places[HOISTED] = ("before joint", k)
        self._call_joint("joint", k, kind, ("joint_blocks", k), places)
        for side in self.kinds.joints[kind].sides:
            self._add(("push", self._joint_node(k, side)), ("joint_blocks", k, f"{side}.push"))
        for name in GAPS:
            self._largest(name, "at_joint")

    def _start_joints(self) -> None:
        """Their forces to start from."""
        self._of_joints(
            lambda k: self._copy_to(("joint_unknown", k), ("joint_state", k, "last_force"))
        )

    def _joints_hoisted(self) -> None:
        """What does not depend on the unknowns."""
        self._each_joint(
            lambda k, kind: self._call_joint("before joint", k, kind, ("before joint", k))
        )

    def _joint_reactions(self, support: str, node: str) -> None:
        """What joints add to the reaction of a support, at a node."""
        if self.cells == 1 or not self.kinds.joints:
            self._reaction_of_joints(node, ("support", support, "reaction"))
            return
        code, total = self.code, ("joint_reaction", 0, "total")
        self._fill(total)
        for shared in self.parts:
            self._reaction_of_joints(node, total, shared)
            if not shared:
                with code.when(code.compare("sge", node, self.args["own_nodes"])):
                    self._over_cells("sum", self.at(*total), self._size(total))
        self._add(("support", support, "reaction"), total)

    def _reaction_of_joints(self, node: str, total: Place, shared: bool | None = None) -> None:
        """Added to a total."""
        code, push = self.code, ("joint_reaction", 0, "reaction")

        def react(k: str, kind: int) -> None:
            places = self._joint_moves(k) | {"end_free": ("free", node)}
            for side in self.kinds.joints[kind].sides:
                with code.when(code.compare("eq", self._joint_node(k, side), node)):
                    of = partial(self.at, "joint_blocks", k)
                    self._call(f"joint reaction {kind} {side}", of, push[:2], places)
                    self._add(total, push)

        self._each_joint(react, shared=shared)

    def _update_joints(self, over: str) -> None:
        """Their forces after the moves, but of samples that are over."""

        def update(k: str) -> None:
            places = {"force": ("joint_unknown", k), "move": ("joint_move", k)}
            self._call("joint update", to=("joint_change", 0), places=places)
            self._blend(("joint_unknown", k), ("joint_change", 0, "force"), over)

        self._of_joints(update)

    def _keep_joints(self, good: str) -> None:
        """Their forces, of what has gone well."""
        self._of_joints(
            lambda k: self._take(("joint_state", k, "last_force"), ("joint_unknown", k), good)
        )

    def _finish_joints(self, good: str) -> None:
        """Where they are at the end of the step, of what has gone well."""

        def finish(k: str, kind: int) -> None:
            self._call_joint("finish joint", k, kind, ("joint_change", 0))

        def take(k: str) -> None:
            for name, source in (("joints", "joints"), ("last_force", "force")):
                self._take(("joint_state", k, name), ("joint_change", 0, source), good)
            counted = self._counted(good, k, "own_joints")
            self._sum(("sample", 0, "work"), ("joint_change", 0, "work"), counted)
            if "energy" in self.layout.records:
                self._add(("energy", 0, "rise"), ("joint_change", 0, "rise"))

        self._each_joint(finish, after=take)
