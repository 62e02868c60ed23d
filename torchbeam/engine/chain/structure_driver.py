"""Native driver of structures: what is other than on a chain.

Balance first, of joints, and of the nodes and elements at them; then the elimination of
`StructureRuns`, which finds that of the others as it comes to them.
"""

from __future__ import annotations

from collections.abc import Callable

from ..compiler.split import HOISTED
from .driver import Driver
from .node_kinds import SIDES
from .pair_driver import PairPasses
from .structure_code import COUNTS, TABLES
from .structure_runs import StructureRuns
from .structures import GAPS


class StructurePasses(StructureRuns, PairPasses):
    """Balance of nodes, elements and joints in an iteration of Newton's method."""

    def _pass(self) -> None:
        self._fill(self.at("sums"), self.layout.records["sums"].size)
        with self._entries("interface") as (_, (node, *_)):
            self._fill(self.at("push", node), self.layout.records["push"].size)
        self._at_interface()
        for shared in self.parts:
            self._each_joint(self._joint, shared=shared)
            if shared is False:
                self._push_on_shared()
        self._tie()
        self._touch()
        self._eliminate()

    def _push_on_shared(self) -> None:
        """What the joints of all cells push the nodes that these share by."""
        first = self.args["own_nodes"]
        count = self.code.sub(self.args["nodes"], first)
        size = self.code.mul(count, self.layout.records["push"].size)
        self._over_cells("sum", self.at("push", first), size)

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

    # Joints

    def _clear_records(self, *names: str) -> None:
        """Zeros in records of joints."""
        if self.kinds.joints:
            with self.code.loop(0, self.args["joint_count"]) as k:
                for name in names:
                    self._fill(self.at(name, k), self.layout.records[name].size)

    def _start_joints(self) -> None:
        self._start_tendons()
        if self.kinds.joints:
            w = self.layout.records["move"].size
            with self.code.loop(0, self.args["joint_count"]) as k:
                self._copy_to(
                    self.at("joint_unknown", k), self.at("joint_state", k, "last_force"), w
                )

    def _joints_hoisted(self) -> None:
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
        """Of each of its ends that is there, of stretches of tendons, and of pairs."""
        self._tie_reactions(support, node)
        self._pair_reactions(support, node)
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

    def _search(self) -> None:
        self._agree()
        super()._search()

    def _judge(self) -> None:
        self._agree()
        super()._judge()

    def _agree(self) -> None:
        """Of what the cells of a sample are judged by."""
        self._over_cells("largest", self.at("sums"), self.layout.records["sums"].size)

    def _begin_work(self) -> None:
        """What there is of it, and what cells share, counts in the lane of the first."""
        if self.cells > 1:
            work, good = self.at("sample", 0, "work"), self.at("sample", 0, "good")
            self.code.call("first cell", work, work)
            self.code.call("first cell", self.at("sample", 0, "counted"), good)

    def _counted(self, good: str, row: str, own: str) -> str:
        """What has gone well, in whose lanes a row counts: what cells share counts in the first of
        them alone. own: how many rows are a cell's.
        """
        if self.cells == 1:
            return good
        shared = self.code.compare("sge", row, self.args[own])
        return self.code.choose(shared, self.at("sample", 0, "counted"), good, "ptr")

    def _unknowns(self) -> list[tuple[str, str, str]]:
        joints = [("joint_unknown", "last_joint_unknown", self.args["joint_count"])]
        return [*super()._unknowns(), *joints * bool(self.kinds.joints)]

    def _update_joints(self, over: str) -> None:
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
        if self.kinds.joints:
            w = self.layout.records["move"].size
            with self.code.loop(0, self.args["joint_count"]) as k:
                last = self.at("joint_state", k, "last_force")
                self._take(last, self.at("joint_unknown", k), good, w)

    def _finish_joints(self, good: str) -> None:
        self._finish_tendons(good)
        self._finish_pairs(good)
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


class StructureDriver(StructurePasses, Driver):
    """Steps of a structure."""

    ARGS = (*Driver.ARGS, *TABLES, *COUNTS)
