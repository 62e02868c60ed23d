"""Native driver of a step: for each group of samples, a lane each, Newton's method on a chain, step
by step.

One iteration is one pass over the chain. Its rows, those of the ends of elements, are eliminated as
they come: end v + 1, the element before it, of whose nodes the one between its ends is eliminated
at once, then row v from end v and from the elements on either side (records of two rows, which take
turns), so that no block of the matrix is kept. Back substitution, and the updates of unknowns that
are not over yet. Everything that is computed is in the functions of `LocalFunctions`; here is only
in which order, and where their fields lie.
"""

from __future__ import annotations

from ..compiler.shared_ends import END
from ..compiler.split import HOISTED
from .chain_code import ChainCode
from .layout import BETWEEN, FLAGS, INNER, LAW, MIDDLE, OWN
from .node_kinds import SIDES

SUMS = ("force", "moment", "strain", "left_force", "left_moment", "left_strain")
SQUARES = ("square_force", "square_moment")


class Driver(ChainCode):
    """Steps of Newton's method."""

    ARGS = (
        "inputs",
        "input_count",
        "outputs",
        "output_count",
        "samples",
        "steps",
        "elements",
        "memory",
        "bases",
        "kinds",
        "element_kinds",
        "held",
        "support_of",
        "support_nodes",
        "supports",
        "limit",
        "first_group",
        "end_group",
    )

    def _group(self, first: str) -> None:
        with self.code.loop(0, self.args["steps"]) as step:
            self._transfer("gather", "input", first, step)
            self._step()
            self._transfer("scatter", "output", first, step)

    # A step

    def _step(self) -> None:
        code, N = self.code, self.args["elements"]
        with code.loop(0, self.args["nodes"]) as j:
            with self._kind(j) as kinds:
                for k in kinds:
                    self._call(
                        f"predictor {k}",
                        lambda f: (
                            self.at("unknown", j, f[2:]) if f[0] == ">" else self._of_node(f, j)
                        ),
                    )
        self._hoisted()
        with code.loop(0, N) as e:
            self._copy_to(
                self.at("stress", e), self.at("start_stress", e), self.layout.records["stress"].size
            )
        self._start_joints()
        for name in ("over", "done"):
            code.call("opposite", self.at("sample", 0, name), self.at("sample", 0, "moving"))
        self._border()
        self._newton()
        self._finish()

    def _hoisted(self) -> None:
        """What does not depend on the unknowns."""
        code, N = self.code, self.args["elements"]
        with code.loop(0, self.args["nodes"]) as j:
            with self._kind(j) as kinds:
                for k in kinds:
                    self._call(
                        f"before node {k}",
                        lambda f: self.at("before node", j) if f[0] == ">" else self._of_node(f, j),
                    )
        with code.loop(0, N) as e:
            with self._element_kind(e) as kinds:
                for k in kinds:
                    self._call(f"before element {k}", lambda f: self._of_element(f, e))
        self._joints_hoisted()

    def _border(self) -> None:
        """What is on either side of the chain: nothing, which does not move."""
        size = self.layout.records["move"].size
        self._fill(self.at("move", 0), size)
        self._fill(self.at("move", self._move_of(self.args["nodes"], self.order - 1)), size)
        self._fill(self.at("nothing"), self.layout.records["nothing"].size)

    def _newton(self) -> None:
        """Iterations, until all samples are over."""
        code = self.code
        for name in ("before", "iterations"):
            self._fill(self.at("sample", 0, name), 1)
        if "secant" in self.layout.records["common"].fields:
            self._fill(self.at("common", 0, "secant"), 1)
        count = code.slot()
        code.store(0, count)
        with code.until() as ends:
            self._pass()
            if "search" in self.functions:
                self._search()
                self._back("still")
                self._take_back()
            else:
                self._back()
            self._judge()
            iterations = code.add(code.load(count), 1)
            code.store(iterations, count)
            code.call("all", self.at("sample", 0, "over"), result := code.slot())
            ends.append(
                code.new(
                    f"or i1 {code.compare('sge', iterations, self.args['limit'])}, "
                    f"{code.compare('ne', code.load(result), 0)}"
                )
            )

    def _pass(self) -> None:
        """Balance and elimination, from the first node to the last."""
        code, N = self.code, self.args["elements"]
        self._fill(self.at("sums"), self.layout.records["sums"].size)
        self._node("0", 0)
        with code.loop(0, code.add(N, 1)) as v:
            last, left, right = self._sides(v)
            with code.when(code.new(f"xor i1 {last}, true")):
                self._node(self._node_of(v, "j"), self._turn(v, "j"))
                self._element(v)
            self._row(v, left, right)
            for name in self.layout.records["sums"].fields:
                self._largest(name, "at_row")

    def _element(self, e: str) -> None:
        """Balance of element e, and of its midside node."""
        if self.order == 2:
            self._node(self._node_of(e, "m"), self._turn(e, "m"))
        with self._element_kind(e) as kinds:
            for k in kinds:
                self._call(f"element {k}", lambda f: self._of_element(f, e))
        for name in ("force", "moment", "strain", "left_strain"):
            self._largest(name, "at_element")
        self._element_load(e)
        if self.order == 2:
            self._condense(e)

    def _element_load(self, e: str) -> None:
        """What loads between the nodes of element e add to what it gives them."""
        packed = BETWEEN if self.order == 1 else INNER
        with self._element_kind(e) as kinds:
            for k in kinds:
                for _ in self._touching(k, e):
                    self._add_load(f"element load {k}", e, self._of_element(f"> {packed}", e))
                    for name in ("force", "moment", *FLAGS):
                        self._largest(name, "at_load")

    def _node(self, j: str, turn: str | int) -> None:
        """Balance of node j, and what is computed there for the elements at it."""
        with self._kind(j) as kinds:
            for k in kinds:
                self._call(
                    f"node {k}",
                    lambda f: (
                        self.at("at_end", turn)
                        if f == f"> {END}"
                        else self.at("at_node", turn)
                        if f[0] == ">"
                        else self.at("before node", j)
                        if f == HOISTED
                        else self._of_node(f, j)
                    ),
                )

    def _condense(self, e: str) -> None:
        """What element e gives its ends, once its midside node is eliminated."""
        node = self._node_of(e, "m")
        places = {
            "element.inner": ("inner",),
            f"own.{OWN}": ("at_node", self._turn(e, "m")),
            "free": ("free", node),
            f"> {BETWEEN}": ("between", self._between(e)),
            f"> {MIDDLE}": ("middle", e),
        }
        self._call_held(
            "condense",
            node,
            lambda f: self.at(*places.get(f, ("at_middle", 0, f[2:]))),
            lambda: self._keep_rows("at_middle", node),
        )
        for name in self.layout.records["sums"].fields:
            self._largest(name, "at_middle")

    def _keep_rows(self, record: str, node: str) -> None:
        """Where a support holds a node: the node's rows, for the reaction."""
        support = self._support_of(node)
        with self.code.when(self.code.compare("sge", support, 0)):
            for name in ("rows", "asked"):
                self._copy_to(
                    self.at("support", support, name),
                    self.at(record, 0, name),
                    self.layout.records["support"].fields[name][1],
                )

    def _of_element(self, field: str, e: str) -> str:
        if field.removeprefix("> ") == HOISTED:
            return self.at("before element", e)
        if field[0] == ">":
            places = {
                BETWEEN: ("between", self._between(e)),
                INNER: ("inner",),
                LAW: ("strain_law", e),
            }
            return self.at(*places.get(field[2:], ("at_element", 0, field[2:])))
        return super()._of_element(field, e)

    def _row(self, v: str, left: str, right: str) -> None:
        near, node = self._near(v) if self.held else {}, self._end(v)
        sides = {"left": left, "right": right, "own": self.at("at_node", self._odd(v))}

        def where(field: str) -> str:
            side, name = field.partition(".")[0], field[2:]
            if field[0] == ">":
                return (
                    self.at("row", v, name)
                    if name in self.layout.records["row"].fields
                    else self.at("at_row", 0, name)
                )
            if side in sides:
                return sides[side]
            return near[field] if field in near else self._row_before(field, v)

        self._call_held("row", node, where, lambda: self._keep_rows("at_row", node))

    def _moves(self) -> None:
        """From the last end to the first; see `_move_of`."""
        with self.code.loop(self.args["elements"], -1, -1) as v:
            node = self._end(v)
            places = {"next": self._move_of(node, self.order), "> move": self._move_of(node)}
            self._call(
                "back",
                lambda f: (
                    self.at("move", places[f], "move") if f in places else self.at("row", v, f)
                ),
            )

    def _back(self, still: str = "over") -> None:
        """Moves, those of midside nodes last; what follows from them, but of samples that are
        `still`, by a field of these.
        """
        code, N = self.code, self.args["elements"]
        self._moves()
        self._restore("move")
        over = self.at("sample", 0, still)
        if self.held:
            with code.loop(0, self.args["supports"]) as k:
                node = code.load(code.at(self.args["support_nodes"], k))
                reach = self._reach(node)
                here = self._move_of(node)
                places = {
                    "before": code.sub(here, reach),
                    "here": here,
                    "after": code.add(here, reach),
                }

                def of_support(
                    f: str, k: str = k, node: str = node, places: dict[str, str] = places
                ) -> str:
                    if f in places:
                        return self.at("move", places[f], "move")
                    return (
                        self.at("free", node, "free")
                        if f == "free"
                        else self.at("support", k, f.removeprefix("> "))
                    )

                self._call("reaction", of_support)
                self._joint_reactions(k, node)
                self._blend(
                    self.at("support", k, "found"),
                    self.at("support", k, "reaction"),
                    over,
                    self.layout.records["support"].fields["reaction"][1],
                )
        with code.loop(0, N) as e:
            moves = {
                f"{side}.move": self._move_of(self._node_of(e, side)) for side in SIDES[self.order]
            }

            def of_law(f: str) -> str:
                if f in moves:
                    return self.at("move", moves[f], "move")
                if f[0] == ">":
                    return self.at("change", 0, "stress")
                for record in ("stress", "strain_law", "element"):
                    if f in self.layout.records[record].fields:
                        return self.at(record, e, f)
                return self.at("common", 0, f)

            self._call("stress", of_law)
            self._blend(
                self.at("stress", e),
                self.at("change", 0, "stress"),
                over,
                self.layout.records["stress"].size,
            )
        with code.loop(0, self.args["nodes"]) as j:
            with self._kind(j) as kinds:
                for k in kinds:
                    self._call(
                        f"update {k}",
                        lambda f: (
                            self.at("change", 0, f[2:])
                            if f[0] == ">"
                            else self.at("move", self._move_of(j), "move")
                            if f == "move"
                            else self._of_node(f, j)
                        ),
                    )
            for name, (_, size) in self.layout.records["unknown"].fields.items():
                self._blend(self.at("unknown", j, name), self.at("change", 0, name), over, size)
        self._update_joints(over)

    def _search(self) -> None:
        """Which samples take their last step back; of the others, what the next begins from."""
        self._call_of_sample("search")
        back = self.at("sample", 0, "back")
        for name, last, count in self._unknowns():
            with self.code.loop(0, count) as k:
                size = self.layout.records[name].size
                self._blend(self.at(last, k), self.at(name, k), back, size)

    def _take_back(self) -> None:
        """Part of the way back, of samples that take it."""
        code = self.code
        code.call("all", self.at("sample", 0, "forth"), result := code.slot())
        with code.when(code.compare("eq", code.load(result), 0)):
            forth = self.at("sample", 0, "forth")
            for name, last, count in self._unknowns():
                with code.loop(0, count) as k:
                    self._part_back(name, last, k)
                    size = self.layout.records[name].size
                    self._blend(self.at(name, k), self.at(f"{name}_back"), forth, size)

    def _part_back(self, name: str, last: str, k: str) -> None:
        def where(f: str) -> str:
            if f == "ratio":
                return self.at("sample", 0, f)
            if f[0] == ">":
                return self.at(f"{name}_back", 0, f[2:] if name == "unknown" else None)
            if f.startswith("to"):
                return self.at(name, k, f[3:] or None)
            return self.at(last, k, f if name == "unknown" else None)

        self._call("between" if name == "unknown" else f"part {name}", where)

    def _unknowns(self) -> list[tuple[str, str, str]]:
        """Records of unknowns, of what they were before the last step, and how many there are."""
        args = self.args
        return [
            ("unknown", "last_unknown", args["nodes"]),
            ("stress", "last_stress", args["elements"]),
        ]

    # Joints, of which a chain has none: see `StructurePasses`

    def _clear_records(self, *names: str) -> None:
        """Zeros in records of theirs."""

    def _start_joints(self) -> None:
        """Their forces to start from."""

    def _joints_hoisted(self) -> None:
        """What does not depend on the unknowns."""

    def _joint_reactions(self, support: str, node: str) -> None:
        """What they add to the reaction of a support, at a node."""

    def _update_joints(self, over: str) -> None:
        """Their forces after the moves, but of samples that are over."""

    def _keep_joints(self, good: str) -> None:
        """Their forces, of what has gone well."""

    def _finish_joints(self, good: str) -> None:
        """Where they are at the end of the step, of what has gone well."""

    def _judge(self) -> None:
        self._call_of_sample("judge")

    def _call_of_sample(self, name: str) -> None:
        """A function of what is of a sample, whose outputs are, too."""

        def where(f: str) -> str:
            if f[0] == ">":
                return self.at("judged", 0, f[2:])
            record = (
                "sums"
                if f in self.layout.records["sums"].fields
                else "sample"
                if f in self.layout.records["sample"].fields
                else "common"
            )
            return self.at(record, 0, f)

        self._call(name, where)
        for output in self.functions[name].outputs:
            to = "common" if output == "secant" else "sample"
            self._copy_to(self.at(to, 0, output), self.at("judged", 0, output), 1)

    def _largest(self, name: str, record: str) -> None:
        """Of what a record has of a sum; of squares the sum itself."""
        if name not in self.layout.records[record].fields:
            return
        to, own = self.at("sums", 0, name), self.at(record, 0, name)
        if name in SQUARES:
            self._add(to, own, 1)
        else:
            self.code.call("largest", to, own)

    def _finish(self) -> None:
        code, N, nodes = self.code, self.args["elements"], self.args["nodes"]
        records = self.layout.records
        cosine = self.at("sample", 0, "cosine")
        with code.loop(0, nodes) as j:
            self._call(
                "cosine",
                lambda f: (
                    self.at("change", 0, "cosine") if f[0] == ">" else self.at("unknown", j, f)
                ),
            )
            with code.when(code.compare("eq", j, 0)):
                self._copy_to(cosine, self.at("change", 0, "cosine"), 1)
            code.call("least", cosine, self.at("change", 0, "cosine"))
        self._over_cells("least", cosine)
        places = {"before": "last_status", "> status": "found_status", "> moving": "good"}
        self._call(
            "outcome",
            lambda f: (
                self.at("common", 0, f)
                if f in records["common"].fields
                else self.at("sums", 0, f)
                if f in records["sums"].fields
                else self.at("sample", 0, places.get(f, f))
            ),
        )
        for name, source in (("last_status", "found_status"), ("moving", "good")):
            self._copy_to(self.at("sample", 0, name), self.at("sample", 0, source), 1)
        good, work = self.at("sample", 0, "good"), self.at("sample", 0, "work")
        self._begin_work()
        if "energy" in records:
            self._fill(self.at("energy"), records["energy"].size)
        if "finish element 0" in self.functions:
            with code.loop(0, N) as e:
                with self._element_kind(e) as kinds:
                    for k in kinds:
                        self._call(
                            f"finish element {k}",
                            lambda f: (
                                self.at("change", 0, f[2:])
                                if f[0] == ">"
                                else self._of_element(f, e)
                            ),
                        )
                for name, (_, size) in self.layout.fields("element_state").items():
                    self._take(
                        self.at("element_state", e, name), self.at("change", 0, name), good, size
                    )
                self._add_energies()
        if "at_load" in records:
            with code.loop(0, N) as e:
                self._finish_element_load(e, good)
        self._finish_joints(good)
        with code.loop(0, nodes) as j:
            with self._kind(j) as kinds:
                for k in kinds:
                    self._call(
                        f"finish {k}",
                        lambda f: (
                            self.at("change", 0, f[2:]) if f[0] == ">" else self._of_node(f, j)
                        ),
                    )
            for name, (_, size) in records["state"].fields.items():
                self._take(self.at("state", j, name), self.at("change", 0, name), good, size)
            self._sum(work, self.at("change", 0, "work"), self._counted(good, j, "own_nodes"), 1)
            self._add_energies()
        self._over_cells("sum", work)
        if "energy" in records:
            self._project(good)
        self._keep_forces(good)

    def _begin_work(self) -> None:
        """Before what a step adds to the work of a sample."""

    def _counted(self, good: str, row: str, own: str) -> str:
        """What has gone well."""
        return good

    def _finish_element_load(self, e: str, good: str) -> None:
        """Work of the loads between the nodes of element e."""
        with self._element_kind(e) as kinds:
            for k in kinds:
                for _ in self._touching(k, e):
                    self._add_rise(f"finish element load {k}", e)
                    self._sum(self.at("sample", 0, "work"), self.at("change", 0, "work"), good, 1)

    def _keep_forces(self, good: str) -> None:
        """Stress, and the loads of supports, of what has gone well."""
        records = self.layout.records
        with self.code.loop(0, self.args["elements"]) as e:
            self._take(
                self.at("start_stress", e), self.at("stress", e), good, records["stress"].size
            )
        if self.held:
            with self.code.loop(0, self.args["supports"]) as k:
                self._take(
                    self.at("support", k, "last"),
                    self.at("support", k, "found"),
                    good,
                    records["support"].fields["last"][1],
                )

    def _project(self, good: str) -> None:
        """Scale the velocities of the step's end."""
        code, fields = self.code, self.layout.records["state"].fields
        self._call(
            "project",
            lambda f: (
                self.at("energy", 0, "scale")
                if f == "> scale"
                else self.at("change", 0, "defect")
                if f[0] == ">"
                else self.at("sample" if f == "defect" else "energy", 0, f)
            ),
        )
        self._take(self.at("sample", 0, "defect"), self.at("change", 0, "defect"), good, 1)
        with code.loop(0, self.args["nodes"]) as j:
            self._call(
                "scaled",
                lambda f: (
                    self.at("change", 0, f[2:])
                    if f[0] == ">"
                    else self.at("energy", 0, f)
                    if f == "scale"
                    else self.at("state", j, f)
                ),
            )
            for name in ("velocity", "spin"):
                self._take(
                    self.at("state", j, name), self.at("change", 0, name), good, fields[name][1]
                )
