"""Native driver of structures: what is other than on a chain.

Balance first, of all nodes, elements and joints. Then runs of nodes between those of the interface
are eliminated in order, from the end that is free if there is one, and leave their blocks with the
interface's, whose system is solved by `BlockElimination`.
"""

from __future__ import annotations

from collections.abc import Callable

from ..compiler.split import HOISTED
from .driver import Driver
from .joint_functions import BLOCKS
from .node_kinds import SIDES
from .pair_driver import PairPasses
from .structure_code import COUNTS, TABLES
from .structures import GAPS
from .tendon_driver import TendonPasses


class StructurePasses(TendonPasses, PairPasses):
    """Balance, elimination and moves of an iteration of Newton's method."""

    def _pass(self) -> None:
        code, N = self.code, self.args["elements"]
        self._fill(self.at("sums"), self.layout.records["sums"].size)
        with code.loop(0, self.args["nodes"]) as j:
            self._node(j, j)
            self._fill(self.at("push", j), self.layout.records["push"].size)
        with code.loop(0, N) as e:
            with self._element_kind(e) as kinds:
                for k in kinds:
                    self._call(f"element {k}", lambda f: self._of_element(f, e))
            for name in ("force", "moment", "strain", "left_strain"):
                self._largest(name, "at_element")
            self._element_load(e)
            if self.order == 2:
                self._condense(e)
        self._each_joint(self._joint)
        self._tie()
        self._touch()
        self._eliminate()

    def _eliminate(self) -> None:
        """Of what nodes, elements and joints give."""
        code = self.code
        self._fill(self.base["matrix"], self.args["entry_count"])
        with self._entries("interface") as (p, entry):
            self._interface(p, entry)
        with self._entries("direct") as (_, (i, j, *places)):
            self._add_block(*places[:2], self.at("interface", i, "U"))
            self._add_block(*places[2:], self.at("interface", j, "L"))
        for manner in self.kinds.runs:
            if manner == "bordered":
                self._bordered_runs()
            else:
                self._runs(manner)
        if self.kinds.joints:
            with self._entries("joint") as (k, entry):
                self._join(k, entry)
        self._join_ties()
        self._join_pairs()
        code.line(
            f'call void @"eliminate"(ptr {self.base["matrix"]}, ptr {self.args["elimination"]}, '
            f"i64 {self.args['group_count']})"
        )

    def _each_joint(self, then: Callable[[str, int], None], alike: bool = False) -> None:
        """then(joint, its kind) of each; alike: the same of all kinds."""
        if not self.kinds.joints:
            return
        with self.code.loop(0, self.args["joint_count"]) as k:
            if alike:
                then(k, 0)
                return
            with self._joint_kind(k) as kinds:
                for kind in kinds:
                    then(k, kind)

    def _around(self, node: str) -> dict[str, str]:
        """What a row of a node takes beside what nodes and elements give."""
        return (self._near(node) if self.held else {}) | {"push": self.at("push", node)}

    def _row_kept(self, node: str) -> None:
        """Where a support holds a node: what its reaction takes."""
        self._keep_rows("at_row", node)

    def _row_judged(self) -> None:
        """Sizes of a row."""
        for name in self.layout.fields("sums"):
            self._largest(name, "at_row")

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

    def _sides_of(self, node: str) -> dict[str, str]:
        """What the elements on either side of a node leave, zeros where there is none."""
        code, sides = self.code, {"own": self.at("at_node", node)}
        for side in ("left", "right"):
            e = code.load(code.at(self.args[f"{side}_elements"], node))
            none = code.compare("slt", e, 0)
            there = self.at("between", code.choose(none, 0, e))
            sides[side] = code.choose(none, self.at("nothing"), there, "ptr")
        return sides

    def _interface(self, p: str, entry: list[str]) -> None:
        node, *places, _ = entry
        self._row_of("interface", node, ("interface", p), {})
        self._add_block(*places[:2], self.at("interface", p, "D"))
        self._add_column(*places[2:], self.at("interface", p, "right"))

    def _row_of(self, name: str, node: str, to: tuple[str, str], before: dict[str, str]) -> None:
        """Row of a node by the function `name`, from the row `before`; to: its record."""
        sides, places = self._sides_of(node), self._around(node) | before
        own = self.layout.records[to[0]].fields

        def where(f: str) -> str:
            if f[0] == ">":
                return self.at(*to, f[2:]) if f[2:] in own else self.at("at_row", 0, f[2:])
            return places[f] if f in places else sides[f.partition(".")[0]]

        self._call_held(name, node, where, lambda: self._row_kept(node))
        self._row_judged()

    def _run(self, first: str, t: str, step: int) -> tuple[str, str, str]:
        """Whether node t of a run is its first, the node, the one before."""
        code = self.code
        node = code.add(first, code.mul(t, step))
        is_first = code.compare("eq", t, 0)
        return is_first, node, code.choose(is_first, node, code.sub(node, step))

    def _before(self, fields: tuple[str, ...], is_first: str, node: str) -> dict[str, str]:
        """Fields of the row before, zeros in front of the first."""
        nothing = self.at("nothing")
        return {
            name: self.code.choose(is_first, nothing, self.at("row", node, name), "ptr")
            for name in fields
        }

    def _runs(self, table: str) -> None:
        """Runs with a free end, from there."""
        code, step = self.code, self.order if table == "forward" else -self.order
        name, coupling = ("row", "L") if table == "forward" else ("row backward", "U")
        with self._entries(table) as (_, (first, count, p, *places)):
            with code.loop(0, count) as t:
                is_first, node, before = self._run(first, t, step)
                self._row_of(
                    name, node, ("row", node), self._before(("ahead", "y"), is_first, before)
                )
            with code.when(code.compare("sge", p, 0)):
                last = code.add(first, code.mul(code.sub(count, 1), step))
                self._leave(self.at("interface", p, coupling), last, *places)

    def _leave(self, coupling: str, last: str, *places: str) -> None:
        """What a run leaves of the interface's row next to its last node."""
        w = self.layout.records["move"].size
        D, right = (self._matrix(place) for place in places[::2])
        self._subtract(D, places[1], coupling, self.at("row", last, "ahead"), w)
        self._subtract(right, places[3], coupling, self.at("row", last, "y"), 1)

    def _bordered_runs(self) -> None:
        """Runs between two nodes of the interface. E: the block of the first of these that the
        elimination has pushed before it.
        """
        code, w = self.code, self.layout.records["move"].size
        E, pushed = self.at("edge", 0, "E"), self.at("edge", 0, "pushed")
        with self._entries("bordered") as (_, entry):
            first, count, p, q, *places = entry
            before, after, (to_last, to_last_stride, to_first, to_first_stride) = (
                places[:4],
                places[4:8],
                places[8:],
            )
            self._copy_to(E, self.at("interface", p, "U"), w * w)
            with code.loop(0, count) as t:
                is_first, node, previous = self._run(first, t, self.order)
                fields = self._before(("ahead", "y"), is_first, previous)
                fields["side"] = code.choose(
                    is_first, self.at("edge", 0, "start"), self.at("row", previous, "side"), "ptr"
                )
                self._row_of("row bordered", node, ("row", node), fields)
                D, right = (self._matrix(place) for place in before[::2])
                self._subtract(D, before[1], E, self.at("row", node, "side"), w)
                self._subtract(right, before[3], E, self.at("row", node, "y"), 1)
                self._fill(pushed, w * w)
                self._subtract(pushed, w, E, self.at("row", node, "ahead"), w)
                self._copy_to(E, pushed, w * w)
            self._add_block(to_last, to_last_stride, E)
            last = code.add(first, code.mul(code.sub(count, 1), self.order))
            coupling = self.at("interface", q, "L")
            self._leave(coupling, last, *after)
            side = self.at("row", last, "side")
            self._subtract(self._matrix(to_first), to_first_stride, coupling, side, w)

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

    # Moves

    def _moves(self) -> None:
        code, w = self.code, self.layout.records["move"].size
        code.line(
            f'call void @"substitute"(ptr {self.base["matrix"]}, ptr {self.args["substitution"]}, '
            f"i64 {self.args['group_count']})"
        )
        with self._entries("interface") as (_, (node, *_, solution)):
            self._copy_to(self.at("move", self._move_of(node)), self._matrix(solution), w)
        if self.kinds.joints:
            with self._entries("joint") as (k, (*_, solution)):
                self._copy_to(self.at("joint_move", k), self._matrix(solution), w)
        for table, step in (("forward", self.order), ("backward", -self.order)):
            if table not in self.kinds.runs:
                continue
            with self._entries(table) as (_, (first, count, p, *_)):
                free = code.compare("slt", p, 0)
                with code.loop(code.sub(count, 1), -1, -1) as t:
                    node = code.add(first, code.mul(t, step))
                    end = code.new(f"and i1 {free}, {code.compare('eq', t, code.sub(count, 1))}")
                    after = self.at("move", self._move_of(code.add(node, step)))
                    places = {"next": code.choose(end, self.at("nothing"), after, "ptr")}
                    self._back_to("back", node, places)
        if "bordered" not in self.kinds.runs:
            return
        with self._entries("bordered") as (_, (first, count, *_)):
            front = self.at("move", self._move_of(code.sub(first, self.order)))
            with code.loop(code.sub(count, 1), -1, -1) as t:
                node = code.add(first, code.mul(t, self.order))
                after = self.at("move", self._move_of(code.add(node, self.order)))
                self._back_to("back bordered", node, {"next": after, "first": front})

    def _back_to(self, name: str, node: str, places: dict[str, str]) -> None:
        places = {**places, "> move": self.at("move", self._move_of(node))}
        self._call(name, lambda f: places.get(f) or self.at("row", node, f))

    # Joints

    def _clear_records(self, *names: str) -> None:
        """Zeros in records of joints."""
        if self.kinds.joints:
            with self.code.loop(0, self.args["joint_count"]) as k:
                for name in names:
                    self._fill(self.at(name, k), self.layout.records[name].size)

    def _start_joints(self) -> None:
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
        code, w = self.code, self.layout.records["move"].size
        with code.loop(0, self.args["joint_count"]) as k:
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
                            self._add(
                                self.at("support", support, "reaction"),
                                self.at("joint_reaction"),
                                w,
                            )

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
            self._sum(self.at("sample", 0, "work"), self.at("joint_change", 0, "work"), good, 1)
            if "energy" in self.layout.records:
                self._add(self.at("energy", 0, "rise"), self.at("joint_change", 0, "rise"), 1)


class StructureDriver(StructurePasses, Driver):
    """Steps of a structure."""

    ARGS = (*Driver.ARGS, *TABLES, *COUNTS)
