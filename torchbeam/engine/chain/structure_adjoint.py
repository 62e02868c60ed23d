"""Native adjoint of steps of structures: what is other than on a chain; see `structure_driver`."""

from __future__ import annotations

from ..compiler.derivative import bar
from .adjoint_driver import AdjointDriver
from .node_kinds import SIDES
from .pair_adjoint import PairAdjoint
from .structure_code import COUNTS, TABLES
from .structure_driver import StructurePasses
from .tendon_adjoint import TendonAdjoint

STATE = "joint_state_bar"


class StructureAdjoint(TendonAdjoint, PairAdjoint, StructurePasses, AdjointDriver):
    """Cotangents of structures, step by step backwards."""

    ARGS = (*AdjointDriver.ARGS, *TABLES, *COUNTS)

    def _transposed(self) -> None:
        code = self.code
        self._at_interface()
        self._each_joint(self._joint_blocks)
        self._tie_blocks()
        self._pair_blocks()
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
        self._clear_tendons()
        self._clear_pairs()
        self._clear_records(STATE, "joint_bar")

    def _add_joints(self) -> None:
        self._add_tendons()
        self._clear_records("joint_start_bar", "joint_asked")

        def add(k: str, kind: int) -> None:
            self._add(
                self.at(STATE, k), self.at("joint_state_grad", k), self.layout.records[STATE].size
            )

        self._each_joint(add, alike=True)

    def _joint_solutions(self) -> None:
        self._tensions()
        self._look_at_pairs()

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
        self._tendon_energies()
        self._pair_energies()

        def add(k: str, kind: int) -> None:
            self._call(
                f"ended joint {kind}",
                lambda f: self.at("change", 0, f[2:]) if f[0] == ">" else self._of_joint(f, k),
            )
            self._add(self.at("energy", 0, "rise"), self.at("change", 0, "rise"), 1)

        self._each_joint(add)

    def _joint_ends(self) -> None:
        self._tendon_ends()
        self._pair_ends()
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
        self._tie_bars()
        self._pair_bars()

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
        self._take_tendons(good)

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
