"""Native driver of structures: what is other than on a chain.

Balance first, of joints, and of the nodes and elements at them; then the elimination of
`StructureRuns`, which finds that of the others as it comes to them.
"""

from __future__ import annotations

from .driver import Driver
from .interaction import COUPLING, JOINT, PAIR
from .structure_code import COUNTS, TABLES
from .structure_runs import StructureRuns


class StructurePasses(StructureRuns):
    """Balance of nodes, elements and joints in an iteration of Newton's method."""

    def _pass(self) -> None:
        self._fill(self.at("sums"), self.layout.records["sums"].size)
        with self._entries("interface") as (_, (node, *_)):
            self._fill(self.at("push", node), self.layout.records["push"].size)
        self._at_interface()
        self._tensions()
        for one in self.interactions:
            for shared in self.parts:
                self._each_of(one, self._push, look=True, shared=shared)
                if shared is False:
                    self._push_on_shared()
        self._eliminate()

    def _push_on_shared(self) -> None:
        """What the joints of all cells push the nodes that these share by."""
        first = self.args["own_nodes"]
        count = self.code.sub(self.args["nodes"], first)
        size = self.code.mul(count, self.layout.records["push"].size)
        self._over_cells("sum", self.at("push", first), size)

    # Joints

    def _clear_records(self, *names: str) -> None:
        """Zeros in records of joints."""
        for name in names:
            self._clear(JOINT, name)

    def _start_joints(self) -> None:
        self._start_tendons()

        def start(k: str) -> None:
            last = self.at("joint_state", k, "last_force")
            self._copy_to(self.at("joint_unknown", k), last, self.width)

        self._each_row(JOINT, start)

    def _joints_hoisted(self) -> None:
        self._each_of(JOINT, self._hoist)

    def _joint_reactions(self, support: str, node: str) -> None:
        self._interaction_reactions(support, node)

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
        def update(k: str) -> None:
            places = {
                "force": self.at("joint_unknown", k),
                "move": self._solution_of(JOINT, k),
                "> force": self.at("joint change", 0, "force"),
            }
            self._call("joint update", lambda f: places[f])
            self._blend(places["force"], places["> force"], over, self.width)

        self._each_row(JOINT, update)

    def _keep_joints(self, good: str) -> None:
        def keep(k: str) -> None:
            last = self.at("joint_state", k, "last_force")
            self._take(last, self.at("joint_unknown", k), good, self.width)

        self._each_row(JOINT, keep)

    def _finish_joints(self, good: str) -> None:
        self._finish_tendons(good)
        for one in (PAIR, COUPLING, JOINT):
            self._each_of(one, lambda entry: self._finish_interaction(entry, good), look=True)


class StructureDriver(StructurePasses, Driver):
    """Steps of a structure."""

    ARGS = (*Driver.ARGS, *TABLES, *COUNTS)
