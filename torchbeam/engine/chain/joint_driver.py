"""Native driver of joints: their balance and blocks, reactions, forces, and state after a step."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from ..compiler.split import HOISTED
from .driver_code import DriverCode
from .joint_functions import BLOCKS
from .joints import GAPS
from .node_kinds import SIDES


class JointCode(DriverCode):
    """Where the fields of joints lie, loops over them, and their blocks in the matrix."""

    def _each_joint(
        self, then: Callable[[str, int], None], alike: bool = False, shared: bool | None = None
    ) -> None:
        """then(joint, its kind) of each; alike: the same of all kinds; shared: see `_range`."""
        if not self.kinds.joints:
            return
        with self.code.loop(*self._range("joint", shared)) as k:
            if alike:
                then(k, 0)
                return
            with self._joint_kind(k) as kinds:
                for kind in kinds:
                    then(k, kind)

    def _clear_records(self, *names: str) -> None:
        """Zeros in records of theirs."""
        if self.kinds.joints:
            with self.code.loop(0, self.args["joint_count"]) as k:
                for name in names:
                    self._fill(self.at(name, k), self.layout.records[name].size)

    def _of_joint(self, field: str, k: str) -> str:
        """A field that is held by joint k, or at one of its ends, or by all."""
        side, _, name = field.partition(".")
        if side in SIDES[1]:
            return self._at_joint_node(name, self._joint_node(k, side))
        for record in ("joint", "joint_state", "joint_unknown"):
            if field in self.layout.fields(record):
                return self.at(record, k, field)
        return self.at("common", 0, field)

    def _joint_node(self, k: str, side: str) -> str:
        table = self._entry("joint", k)
        return self.code.load(self.code.at(table, SIDES[1].index(side)))

    def _joint_kind(self, k: str) -> Iterator[int]:
        return self._each("joint_kinds", len(self.kinds.joints), k)

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


class JointPasses(JointCode):
    """Balance of joints, and their state."""

    def _joint(self, k: str, kind: int) -> None:
        """Its balance and blocks, and its push on the nodes."""

        def where(f: str) -> str:
            name = f[2:]
            if f[0] == ">":
                record = ("at_joint", 0) if name in GAPS else ("joint_blocks", k)
                return self.at(*record, name)
            return self.at("before joint", k) if f == HOISTED else self._of_joint(f, k)

        self._call(f"joint {kind}", where)
        for side in self.kinds.joints[kind].sides:
            push = self.at("push", self._joint_node(k, side))
            size = self.layout.records["push"].size
            self._add(push, self.at("joint_blocks", k, f"{side}.push"), size)
        for name in GAPS:
            self._largest(name, "at_joint")

    def _start_joints(self) -> None:
        """Their forces to start from."""
        if self.kinds.joints:
            w = self.layout.records["move"].size
            with self.code.loop(0, self.args["joint_count"]) as k:
                self._copy_to(
                    self.at("joint_unknown", k), self.at("joint_state", k, "last_force"), w
                )

    def _joints_hoisted(self) -> None:
        """What does not depend on the unknowns."""
        if self.kinds.joints:
            with self.code.loop(0, self.args["joint_count"]) as k, self._joint_kind(k) as kinds:
                for kind in kinds:
                    self._call(
                        f"before joint {kind}",
                        lambda f: (
                            self.at("before joint", k) if f[0] == ">" else self._of_joint(f, k)
                        ),
                    )

    def _joint_reactions(self, support: str, node: str) -> None:
        """What joints add to the reaction of a support, at a node."""
        if not self.kinds.joints:
            return
        if self.cells == 1:
            self._reaction_of_joints(node, self.at("support", support, "reaction"))
            return
        code, size = self.code, self.layout.records["move"].size
        total = self.at("joint_reaction", 0, "total")
        self._fill(total, size)
        for shared in self.parts:
            self._reaction_of_joints(node, total, shared)
            if not shared:
                with code.when(code.compare("sge", node, self.args["own_nodes"])):
                    self._over_cells("sum", total, size)
        self._add(self.at("support", support, "reaction"), total, size)

    def _reaction_of_joints(self, node: str, total: str, shared: bool | None = None) -> None:
        """Added to a total."""
        code, w = self.code, self.layout.records["move"].size
        with code.loop(*self._range("joint", shared)) as k:
            moves = {
                f"{side}.move": self.at("move", self._move_of(self._joint_node(k, side)))
                for side in SIDES[1]
            } | {"joint.move": self.at("joint_move", k)}

            def where(f: str) -> str:
                if f == "end_free":
                    return self.at("free", node, "free")
                if f[0] == ">":
                    return self.at("joint_reaction", 0, f[2:])
                return moves[f] if f in moves else self.at("joint_blocks", k, f)

            with self._joint_kind(k) as kinds:
                for kind in kinds:
                    for side in self.kinds.joints[kind].sides:
                        here = code.compare("eq", self._joint_node(k, side), node)
                        with code.when(here):
                            self._call(f"joint reaction {kind} {side}", where)
                            self._add(total, self.at("joint_reaction"), w)

    def _update_joints(self, over: str) -> None:
        """Their forces after the moves, but of samples that are over."""
        if not self.kinds.joints:
            return
        w = self.layout.records["move"].size
        with self.code.loop(0, self.args["joint_count"]) as k:
            places = {
                "force": self.at("joint_unknown", k),
                "move": self.at("joint_move", k),
                "> force": self.at("joint_change", 0, "force"),
            }
            self._call("joint update", lambda f: places[f])
            self._blend(places["force"], places["> force"], over, w)

    def _keep_joints(self, good: str) -> None:
        """Their forces, of what has gone well."""
        if self.kinds.joints:
            w = self.layout.records["move"].size
            with self.code.loop(0, self.args["joint_count"]) as k:
                last = self.at("joint_state", k, "last_force")
                self._take(last, self.at("joint_unknown", k), good, w)

    def _finish_joints(self, good: str) -> None:
        """Where they are at the end of the step, of what has gone well."""
        if not self.kinds.joints:
            return
        fields = self.layout.records["joint_state"].fields
        with self.code.loop(0, self.args["joint_count"]) as k:
            with self._joint_kind(k) as kinds:
                for kind in kinds:
                    self._call(
                        f"finish joint {kind}",
                        lambda f: (
                            self.at("joint_change", 0, f[2:])
                            if f[0] == ">"
                            else self._of_joint(f, k)
                        ),
                    )
            for name, source in (("joints", "joints"), ("last_force", "force")):
                self._take(
                    self.at("joint_state", k, name),
                    self.at("joint_change", 0, source),
                    good,
                    fields[name][1],
                )
            counted = self._counted(good, k, "own_joints")
            self._sum(self.at("sample", 0, "work"), self.at("joint_change", 0, "work"), counted, 1)
            if "energy" in self.layout.records:
                self._add(self.at("energy", 0, "rise"), self.at("joint_change", 0, "rise"), 1)
