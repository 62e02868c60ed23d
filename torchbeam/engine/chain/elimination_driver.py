"""Native elimination: the rows of runs of nodes, which are made as they are eliminated, and of the
nodes between them. A beam is one run.

Runs are eliminated in order, from the end that is free if there is one, and leave their blocks with
the interface's, whose system is solved by `BlockElimination`; runs that go on from one of its nodes
are in between.
"""

from __future__ import annotations

from collections.abc import Callable

from .layout import BETWEEN, INNER, MIDDLE, OWN
from .record_code import Place, Places
from .row_code import RowCode


class Elimination(RowCode):
    """Elimination, and moves: of what `node` and `give`, and what connects nodes, give."""

    def eliminate(self) -> None:
        """Of what nodes, elements and interactions give. What cells share comes last, with what
        each of them leaves there.
        """
        if self.has_interface:
            self._groups("clear", self.args["group_count"])
            self._rows_at_interface(self.parts[0])
            with self.entries("direct") as (_, (i, j, *places)):
                self.add_block(*places[:2], self.at("interface", i, "U"))
                self.add_block(*places[2:], self.at("interface", j, "L"))
        for manner in ("forward", "backward"):
            if manner in self.kinds.runs:
                self._runs(manner)
        if not self.has_interface:
            return
        if "bordered" in self.kinds.runs:
            self._bordered_runs()
        for sort in self.interactions:
            if not sort.celled:
                self.each_of(sort, self.join)
        self._each_following(self._begin_following)
        self._groups("eliminate", self.args["first_groups"])
        self._each_following(self._following_run)
        if self.cells > 1:
            shared = self.matrix(self.args["shared_first"])
            self.over_cells("sum", shared, self.args["shared_size"])
            self._rows_at_interface(True)
            self._groups("eliminate", self.args["shared_groups"], self.args["shared_table"])

    def at_interface(self) -> None:
        """What nodes and elements give that are at the interface, or next to it."""
        for what, then in (("node", self._place_node), ("element", self._element)):
            with self.code.loop(0, self.args[f"kept_{what}_count"]) as k:
                then(self.integer(f"kept_{what}s", k))

    def _place_node(self, node: str) -> None:
        self.node(node, self.node_place(node))

    def _nodes_of_run(
        self, first: str, count: str, step: int, row: Callable[[str, str, str], None]
    ) -> None:
        """row(whether it is the first, the node, the one before) of each node of a run, when all is
        there that its row takes.
        """
        code = self.code
        self._node_of_run(first)
        with code.loop(0, count) as t:
            node = code.add(first, code.mul(t, step))
            with code.when(code.compare("slt", t, code.sub(count, 1))):
                self._node_of_run(code.add(node, step))
                side = "right" if step > 0 else "left"
                self._element(self.integer(f"{side}_elements", node))
            is_first = code.compare("eq", t, 0)
            row(is_first, node, code.choose(is_first, node, code.sub(node, step)))

    def _node_of_run(self, node: str) -> None:
        """What a node gives, unless that is held since `at_interface`."""
        place = self.node_place(node)
        if not self.has_interface:
            self.node(node, place)
            return
        with self.code.when(self.code.compare("slt", place, self.order + 1)):
            self.node(node, place)

    def _rows_at_interface(self, shared: bool | None) -> None:
        """Rows of the interface, with interactions that cells may have."""
        with self.entries("interface", shared=shared) as (p, entry):
            self._interface(p, entry)
        for sort in self.interactions:
            if sort.celled:
                self.each_of(sort, self.join, shared=shared)

    def node(self, j: str, turn: str | int) -> None:
        """What node j gives its row, and the elements at it, where it is held."""
        raise NotImplementedError

    def _element(self, e: str) -> None:
        """What element e gives the rows of its ends, once its midside node is eliminated."""
        if not self.has_midsides:
            self.give(e, (BETWEEN, self.element_place(e)))
            return
        self.node(self.node_of(e, "m"), self.turn(e, "m"))
        self.give(e, (INNER, 0))
        node = self.node_of(e, "m")
        places = {
            "element.inner": (INNER, 0),
            f"own.{OWN}": ("at_node", self.turn(e, "m")),
            "free": ("free", node),
            f"> {BETWEEN}": (BETWEEN, self.element_place(e)),
            f"> {MIDDLE}": (MIDDLE, e),
            **self.at_midside(node),
        }
        call = str, ("change", 0), places
        self.call_held("condense", node, *call, after=lambda: self.row_kept(node))
        self.condensed(e)

    def give(self, e: str, to: Place) -> None:
        """What element e itself gives its nodes."""
        raise NotImplementedError

    def at_midside(self, node: str) -> Places:
        """What eliminating a midside node takes beside what it and its element give."""
        return {}

    def condensed(self, e: str) -> None:
        """What else follows from having eliminated the midside node of element e."""

    def around(self, node: str) -> Places:
        """What a row of a node takes beside what nodes and elements give."""
        raise NotImplementedError

    def row_kept(self, node: str) -> None:
        """Where a support holds a node: what its reaction takes."""

    def row_judged(self, name: str) -> None:
        """Sizes of a row, as its function of this name gives them."""

    def _sides_of(self, node: str) -> dict[str, str]:
        """What the elements on either side of a node leave, zeros where there is none."""
        code, sides = self.code, {"own": self.at("at_node", self.node_place(node))}
        for side in ("left", "right"):
            e = self.integer(f"{side}_elements", node)
            none = code.compare("slt", e, 0)
            there = self.at("between", self.element_place(code.choose(none, 0, e)))
            sides[side] = code.choose(none, self.at("nothing"), there, "ptr")
        return sides

    def _interface(self, p: str, entry: list[str]) -> None:
        node, *places, _ = entry
        self._row_of("interface", node, ("interface", p), {})
        self.add_block(*places[:2], self.at("interface", p, "D"))
        self.add_column(*places[2:], self.at("interface", p, "rhs"))

    def _row_of(self, name: str, node: str, to: Place, before: Places) -> None:
        """Row of a node by the function `name`, from the row `before`; to: its record."""
        sides, places = self._sides_of(node), self.around(node) | before
        places |= {f"> {field}": (*to, field) for field in self.layout.fields(to[0])}
        call = (lambda f: sides[f.partition(".")[0]]), ("change", 0), places
        self.call_held(name, node, *call, after=lambda: self.row_kept(node))
        self.row_judged(name)

    def _groups(self, name: str, count: str, first: str | int = 0) -> None:
        """Clear, eliminate, or substitute, so many groups, whose table begins there."""
        table = self.args["substitution" if name == "substitute" else "elimination"]
        table = self.code.at(table, first)
        more = ""
        if name == "eliminate" and self.signed:
            more = f", ptr {self.at('signs')}, ptr {self.at('sums', 0, 'indefinite')}"
        self.code.line(f'call void @"{name}"({self.system}, ptr {table}, i64 {count}{more})')

    def _before(self, is_first: str, node: str) -> dict[str, str]:
        """Fields of the row before, zeros in front of the first."""
        nothing = self.at("nothing")
        return {
            name: self.code.choose(is_first, nothing, self.at("row", node, name), "ptr")
            for name in ("ahead", "y")
        }

    def _runs(self, table: str) -> None:
        """Runs with a free end, from there."""
        code = self.code
        name, coupling, step = self._direction(table)

        def row(is_first: str, node: str, before: str) -> None:
            fields = self._before(is_first, before)
            self._row_of(name, node, ("row", node), fields)

        with self.entries(table) as (_, (first, count, p, *places)):
            self._nodes_of_run(first, count, step, row)
            if self.has_interface:
                with code.when(code.compare("sge", p, 0)):
                    last = code.add(first, code.mul(code.sub(count, 1), step))
                    self._leave(self.at("interface", p, coupling), last, *places)

    def _each_following(
        self, then: Callable[[str, list[str]], None], backward: bool = False
    ) -> None:
        """then(manner, its entry) of each run that goes on from a node which is eliminated."""
        manners = [x for x in self.kinds.runs if x.startswith("following")]
        if not manners:
            return
        code = self.code
        with self.entries("following", backward) as (_, entry):
            for manner in manners:
                if len(manners) == 1:
                    then(manner, entry)
                    continue
                with code.when(code.compare("eq", entry[2], 1 if manner == manners[1] else -1)):
                    then(manner, entry)

    def _begin_following(self, manner: str, entry: list[str]) -> None:
        """What couples the node before a run to it."""
        _, _, _, p, *places = entry
        coupling = "U" if manner == "following forward" else "L"
        self.add_block(*places[:2], self.at("interface", p, coupling))

    def _following_run(self, manner: str, entry: list[str]) -> None:
        """A run, from the row that groups have left, and the groups behind it."""
        code, w, vector = self.code, self.width, self.lanes.vector
        first, count, _, _, _, _, ahead, stride, y, q, *places, _, _ = entry
        name, coupling, step = self._direction(manner)
        node = code.sub(first, step)
        to, right = (self.at("row", node, field) for field in ("ahead", "y"))
        self.on_block("there", ahead, stride)
        for k in range(w):
            at = code.mul(stride, k)
            self.copy(code.at(to, k * w, vector), self.matrix(code.add(ahead, at)), w)
            self.copy(code.at(right, k, vector), self.matrix(code.add(y, at)), 1)

        def row(_: str, node: str, __: str) -> None:
            before = {f: self.at("row", code.sub(node, step), f) for f in ("ahead", "y")}
            self._row_of(name, node, ("row", node), before)

        self._nodes_of_run(first, count, step, row)
        last = code.add(first, code.mul(code.sub(count, 1), step))
        self._leave(self.at("interface", q, coupling), last, *places[:4])
        self._groups("eliminate", *places[6:])

    def _follow_back(self, manner: str, entry: list[str]) -> None:
        """The moves of such a run, and of the groups before it."""
        code, w = self.code, self.width
        (first, count), (solution, own, _, _, *groups) = entry[:2], entry[-6:]
        _, _, step = self._direction(manner)
        with code.loop(code.sub(count, 1), -1, -1) as t:
            node = code.add(first, code.mul(t, step))
            last = code.compare("eq", t, code.sub(count, 1))
            after = self.at("move", self.move_of(code.add(node, step)))
            self._back_to(
                "back", node, {"next": code.choose(last, self.matrix(solution), after, "ptr")}
            )
        self.copy(self.matrix(own), self.at("move", self.move_of(first)), w)
        self._groups("substitute", *groups)

    def _direction(self, manner: str) -> tuple[str, str, int]:
        """Of a run: the function of its rows, what couples the node behind it to its last, and how
        far its nodes are apart.
        """
        if manner.endswith("forward"):
            return "row forward", "L", self.order
        return "row backward", "U", -self.order

    def _leave(self, coupling: str, last: str, *places: str) -> None:
        """What a run leaves of the interface's row next to its last node."""
        self.on_block("subtract_block", *places[:2], coupling, self.at("row", last, "ahead"))
        self.subtract_column(*places[2:], coupling, self.at("row", last, "y"))

    def _bordered_runs(self) -> None:
        """Runs between two nodes of the interface. E: the block of the first of these that the
        elimination has pushed before it.
        """
        code, w = self.code, self.width
        E, pushed = self.at("edge", 0, "E"), self.at("edge", 0, "pushed")
        with self.entries("bordered") as (_, entry):
            first, count, p, q, *places = entry
            before, after, (to_last, to_last_stride, to_first, to_first_stride) = (
                places[:4],
                places[4:8],
                places[8:],
            )
            self.copy(E, self.at("interface", p, "U"), w * w)

            def row(is_first: str, node: str, previous: str, before: list[str] = before) -> None:
                fields = self._before(is_first, previous)
                fields["side"] = code.choose(
                    is_first, self.at("edge", 0, "start"), self.at("row", previous, "side"), "ptr"
                )
                self._row_of("row bordered", node, ("row", node), fields)
                side, y, ahead = (self.at("row", node, name) for name in ("side", "y", "ahead"))
                self.on_block("subtract_block", *before[:2], E, side)
                self.subtract_column(*before[2:], E, y)
                self.fill(pushed, w * w)
                arguments = f"ptr {pushed}, i64 {w}, ptr {E}, i64 {w}, i64 {w}, ptr {ahead}"
                code.line(f'call void @"subtract"({arguments}, i64 {w}, i64 {w})')
                self.copy(E, pushed, w * w)

            self._nodes_of_run(first, count, self.order, row)
            self.add_block(to_last, to_last_stride, E)
            last = code.add(first, code.mul(code.sub(count, 1), self.order))
            coupling = self.at("interface", q, "L")
            self._leave(coupling, last, *after)
            side = self.at("row", last, "side")
            self.on_block("subtract_block", to_first, to_first_stride, coupling, side)

    def moves(self) -> None:
        """Of all nodes but those between the ends of an element."""
        code, w = self.code, self.width
        if self.cells > 1:
            self._groups("substitute", self.args["shared_groups"])
        if self.has_interface:
            self._groups("substitute", self.args["last_groups"], self.args["last_table"])
            self._each_following(self._follow_back, backward=True)
            with self.entries("interface") as (_, (node, *_, solution)):
                self.copy(self.at("move", self.move_of(node)), self.matrix(solution), w)
        for table in ("forward", "backward"):
            if table not in self.kinds.runs:
                continue
            _, _, step = self._direction(table)
            with self.entries(table) as (_, (first, count, p, *_)):
                free = code.compare("slt", p, 0)
                with code.loop(code.sub(count, 1), -1, -1) as t:
                    node = code.add(first, code.mul(t, step))
                    end = code.new(f"and i1 {free}, {code.compare('eq', t, code.sub(count, 1))}")
                    after = self.at("move", self.move_of(code.add(node, step)))
                    places = {"next": code.choose(end, self.at("nothing"), after, "ptr")}
                    self._back_to("back", node, places)
        if "bordered" not in self.kinds.runs:
            return
        with self.entries("bordered") as (_, (first, count, *_)):
            front = self.at("move", self.move_of(code.sub(first, self.order)))
            with code.loop(code.sub(count, 1), -1, -1) as t:
                node = code.add(first, code.mul(t, self.order))
                after = self.at("move", self.move_of(code.add(node, self.order)))
                self._back_to("back bordered", node, {"next": after, "first": front})

    def _back_to(self, name: str, node: str, places: Places) -> None:
        to = "move", self.move_of(node)
        self.call(name, lambda f: self.at("row", node, f), to, places)
