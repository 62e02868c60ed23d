"""Native adjoint of steps: from the last to the first, cotangents of a state become those of the
one before.

With the residual g (balance and strain gaps), the solution follows x' = -K^-1 g', so that a
cotangent goes through the transposed matrix once, and from there through the derivatives of g by
the start and the constants. Nothing is kept of a step but the states that it lies between. One pass
over the elements makes the rows of the transposed system, which are eliminated as they come;
another takes what its solution asks of them.
"""

from __future__ import annotations

from ..compiler.derivative import bar
from ..compiler.shared_ends import END
from .chain_code import ChainCode
from .layout import BETWEEN, INNER, MIDDLE, OWN
from .node_kinds import SIDES, without_side


class AdjointDriver(ChainCode):
    """Cotangents, step by step backwards."""

    ARGS = (
        "inputs",
        "input_count",
        "outputs",
        "output_count",
        "stepwises",
        "stepwise_count",
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
        "first_group",
        "end_group",
    )

    def _group(self, first: str) -> None:
        code, N, nodes = self.code, self.args["elements"], self.args["nodes"]
        last = code.sub(self.args["steps"], 1)
        supports = [
            (f"{of}_bar", self.args["supports"]) for of in ("reaction", "support") * self.held
        ]
        more = [("element_state_bar", N)] * ("element_state" in self.layout.records)
        for record, count in (
            ("state_bar", nodes),
            ("stress_bar", N),
            *more,
            *supports,
            ("node_bar", nodes),
            ("element_bar", N),
            ("common_bar", 1),
        ):
            with code.loop(0, count) as k:
                self._fill(self.at(record, k), self.layout.records[record].size)
        for name in self._of_samples("_bar"):
            self._fill(self.at("sample", 0, name), 1)
        self._clear_joints()
        with code.loop(last, -1, -1) as step:
            self._transfer("gather", "input", first, step, last)
            self._step()
            self._transfer("drain", "stepwise", first, step, last)
        self._transfer("scatter", "output", first, 0)

    def _step(self) -> None:
        code, N, nodes = self.code, self.args["elements"], self.args["nodes"]
        moves = self.layout.records["move"].size
        rates = "element_state" in self.layout.records
        for to, source, count in (
            ("state_bar", "state_grad", nodes),
            ("stress_bar", "stress_grad", N),
            *((("element_state_bar", "element_state_grad", N),) if rates else ()),
            *((("reaction_bar", "reaction_grad", self.args["supports"]),) if self.held else ()),
        ):
            with code.loop(0, count) as k:
                self._add(self.at(to, k), self.at(source, k), self.layout.records[to].size)
        for to, source in zip(self._of_samples("_bar"), self._of_samples("_grad"), strict=True):
            self._add(self.at("sample", 0, to), self.at("sample", 0, source), 1)
        self._add_joints()
        self._fill(self.at("nothing"), self.layout.records["nothing"].size)
        with code.loop(0, self._move_of(nodes, self.order)) as j:
            for record in ("asked", "push", "move", "found"):
                self._fill(self.at(record, j), moves)
        if self.held:
            with code.loop(0, self.args["supports"]) as k:
                self._fill(self.at("last_bar", k), moves)
        with code.loop(0, nodes) as j:
            self._solution(j)
        self._joint_solutions()
        if "energy" in self.layout.records:
            self._energies()
        if "finish element bar 0" in self.functions or "at_load" in self.layout.records:
            with code.loop(0, N) as e:
                self._element_ends(e)
        self._joint_ends()
        with code.loop(0, nodes) as j:
            self._ends(j)
        if self.held:
            with code.loop(0, self.args["supports"]) as k:
                node = code.load(code.at(self.args["support_nodes"], k))
                places = {
                    "reaction_bar": self.at("reaction_bar", k),
                    "free": self.at("free", node),
                    "> push": self.at("push", self._move_of(node)),
                }
                self._call("push", lambda f: places[f])
        self._transposed()
        self._restore("found", self._balance_bar)
        with code.loop(0, N) as e:
            self._element_bar(e)
        with code.loop(0, nodes) as j:
            with self._kind(j) as kinds:
                for k in kinds:
                    self._call(
                        f"node bar {k}",
                        lambda f: (
                            self.at("change", 0, f[2:])
                            if f[0] == ">"
                            else self.at("found", self._move_of(j))
                            if f == bar("balance")
                            else self._of_node(f, j)
                        ),
                    )
                    self._spread(f"node bar {k}", j)
        self._joint_bars()
        good = self.at("sample", 0, "good")
        with code.loop(0, nodes) as j:
            self._take(
                self.at("state_bar", j),
                self.at("start_bar", j),
                good,
                self.layout.records["state_bar"].size,
            )
        with code.loop(0, N) as e:
            self._take(
                self.at("stress_bar", e),
                self.at("nothing"),
                good,
                self.layout.records["stress_bar"].size,
            )
            if rates:
                self._take(
                    self.at("element_state_bar", e),
                    self.at("element_state_start_bar", e),
                    good,
                    self.layout.records["element_state"].size,
                )
        if self.held:
            with code.loop(0, self.args["supports"]) as k:
                self._take(self.at("reaction_bar", k), self.at("last_bar", k), good, moves)
        self._take_joints(good)

    def _transposed(self) -> None:
        """The transposed system, and the cotangents of the balances of elements' ends."""
        code, N = self.code, self.args["elements"]
        self._node("0", 0)
        with code.loop(0, code.add(N, 1)) as v:
            self._row(v)
        with code.loop(N, -1, -1) as v:
            node = self._end(v)
            places = {"next": self._move_of(node, self.order), "> move": self._move_of(node)}
            self._call(
                "back",
                lambda f: self.at("move", places[f]) if f in places else self.at("row", v, f),
            )
            self._balance_bar(node)

    # Joints, of which a chain has none: see `StructureAdjoint`

    def _clear_joints(self) -> None:
        """Cotangents of joints' states and constants."""

    def _add_joints(self) -> None:
        """To the cotangents of joints' states those of what a step has made."""

    def _joint_solutions(self) -> None:
        """Their forces, between the states of a step."""

    def _joint_energies(self) -> None:
        """To what the energy rises by: less the work of what acts in them."""

    def _joint_ends(self) -> None:
        """What the cotangents of their states at the end ask of the start, of nodes, of forces."""

    def _joint_bars(self) -> None:
        """What the solution asks of their start and constants."""

    def _take_joints(self, good: str) -> None:
        """Cotangents of their states at the start, of what has gone well."""

    def _balance_bar(self, j: str) -> None:
        """Of node j, whose move is known."""
        at = self._move_of(j)
        places = {
            "move": ("move", at),
            "push": ("push", at),
            "free": ("free", j),
            f"> {bar('balance')}": ("found", at),
        }
        self._call("balance_bar", lambda f: self.at(*places[f]))

    def _solution(self, j: str) -> None:
        """Of a node: the solution between its states."""
        records = self.layout.records
        self._call(
            "solution",
            lambda f: (
                self.at("unknown", j, f[2:])
                if f[0] == ">"
                else self.at("after", j, f)
                if f.startswith("after")
                else self._of_node(f, j)
            ),
        )
        for name in ("start_bar", "unknown_bar"):
            if name in records:
                self._fill(self.at(name, j), records[name].size)

    def _element_ends(self, e: str) -> None:
        """What the cotangents of an element's state at the end ask of its start and of its
        nodes.
        """
        records = self.layout.records
        if "element_state" in records:
            self._fill(self.at("element_state_start_bar", e), records["element_state"].size)

        def where(f: str) -> str:
            if f[0] == ">":
                return self.at("of_element", 0, f[2:])
            if not f.endswith("_bar"):
                return self._of_element(f, e)
            for record in ("sample", "energy"):
                if f in self.layout.fields(record):
                    return self.at(record, 0, f)
            return self.at("element_state_bar", e, f.removesuffix("_bar"))

        with self._element_kind(e) as kinds:
            for k in kinds:
                if f"finish element bar {k}" in self.functions:
                    self._call(f"finish element bar {k}", where)
                    self._spread(f"finish element bar {k}", e)
                for _ in self._touching(k, e):
                    self._call(f"finish element load bar {k}", where)
                    self._spread(f"finish element load bar {k}", e)

    def _of_samples(self, what: str) -> list[str]:
        """Cotangents of a sample's fields."""
        return [name for name in self.layout.records["sample"].fields if name.endswith(what)]

    def _energies(self) -> None:
        """The scale of the velocities, and the cotangents of what it is made from and of the
        velocities before.
        """
        code, N, nodes = self.code, self.args["elements"], self.args["nodes"]
        records = self.layout.records
        good = self.at("sample", 0, "good")
        self._fill(self.at("energy"), records["energy"].size)

        with code.loop(0, N) as e:
            with self._element_kind(e) as kinds:
                for k in kinds:
                    self._call(
                        f"ended element {k}",
                        lambda f: (
                            self.at("change", 0, f[2:]) if f[0] == ">" else self._of_element(f, e)
                        ),
                    )
            self._add_energies()
            with self._element_kind(e) as kinds:
                for k in kinds:
                    for _ in self._touching(k, e):
                        self._add_rise(f"ended element load {k}", e)
        with code.loop(0, nodes) as j:
            with self._kind(j) as kinds:
                for k in kinds:
                    self._call(
                        f"ended {k}",
                        lambda f: (
                            self._of_node(f, j)
                            if f[0] != ">"
                            else self.at("ended", j, f[2:])
                            if f[2:] in records["ended"].fields
                            else self.at("change", 0, f[2:])
                        ),
                    )
            self._add_energies()
        self._joint_energies()

        def of_sample(f: str) -> str:
            name = f.removeprefix("> ")
            return self.at(
                "change"
                if f == "> defect_bar"
                else "sample"
                if name.startswith("defect")
                else "energy",
                0,
                name,
            )

        self._call("project", of_sample)
        with code.loop(0, nodes) as j:
            self._call(
                "scaled bar",
                lambda f: (
                    self.at("change", 0, f[2:])
                    if f[0] == ">"
                    else self.at("energy", 0, f)
                    if f == "scale"
                    else self.at("ended", j, f)
                    if f in records["ended"].fields
                    else self.at("state_bar", j, f.removesuffix("_bar"))
                ),
            )
            for name, (_, size) in records["ended"].fields.items():
                self._take(
                    self.at("state_bar", j, name), self.at("change", 0, f"{name}_bar"), good, size
                )
            self._add(self.at("energy", 0, "scale_bar"), self.at("change", 0, "scale_bar"), 1)
        self._call("project bar", of_sample)
        self._take(self.at("sample", 0, "defect_bar"), self.at("change", 0, "defect_bar"), good, 1)

    def _ends(self, j: str) -> None:
        """Of a node: what its end's cotangents ask of the start and of the move."""

        def where(f: str) -> str:
            if f[0] == ">":
                return self.at("change", 0, f[2:])
            name = f.removesuffix("_bar")
            if f == name:
                return self._of_node(f, j)
            whole = {"work": "sample", "kinetic": "energy", "rise": "energy"}
            return self.at(whole[name], 0, f) if name in whole else self.at("state_bar", j, name)

        with self._kind(j) as kinds:
            for k in kinds:
                self._call(f"finish bar {k}", where)
                self._spread(f"finish bar {k}", j)
                for name, (_, size) in self.layout.fields("unknown_bar").items():
                    self._add(self.at("change", 0, name), self.at("unknown_bar", j, name), size)
                if f"update bar {k}" in self.functions:
                    self._call(
                        f"update bar {k}",
                        lambda f: (
                            self.at("asked", self._move_of(j))
                            if f[0] == ">"
                            else self.at("change", 0, f)
                            if f.endswith("_bar")
                            else self._of_node(f, j)
                        ),
                    )

    def _element(self, e: str) -> None:
        """Of an element: what it and its midside node add to the matrix, and what its stress's
        cotangent asks of its nodes' moves.
        """
        if self.order == 2:
            self._node(self._node_of(e, "m"), self._turn(e, "m"))
        packed = {f"> {BETWEEN}": ("between", self._between(e)), f"> {INNER}": ("inner",)}
        with self._element_kind(e) as kinds:
            for k in kinds:
                self._call(
                    f"blocks {k}",
                    lambda f: (
                        self.at(*packed[f])
                        if f in packed
                        else self.at("law", e, f[2:])
                        if f[0] == ">"
                        else self._of_element(f, e)
                    ),
                )
                for _ in self._touching(k, e):
                    at = packed[f"> {BETWEEN if self.order == 1 else INNER}"]
                    self._add_load(f"load blocks {k}", e, self.at(*at))
        places = {f"> {bar('gap')}": ("law", e, "gap_bar"), bar("stress"): ("stress_bar", e)}
        self._call(
            "stress bar",
            lambda f: (
                self.at(*places[f])
                if f in places
                else self.at("change", 0, f[2:])
                if f[0] == ">"
                else self._of_element(f, e)
            ),
        )
        for side in SIDES[self.order]:
            self._ask(self._node_of(e, side), bar(f"{side}.move"), "change")
        if self.order == 2:
            self._condense(e)

    def _ask(self, node: str, field: str, record: str) -> None:
        """Add a field to what is asked of a node's move."""
        self._add(
            self.at("asked", self._move_of(node)),
            self.at(record, 0, field),
            self.layout.records["move"].size,
        )

    def _condense(self, e: str) -> None:
        """What element e gives its ends, and asks of them, once its midside node is eliminated."""
        node = self._node_of(e, "m")
        move = self._move_of(node)
        places = {
            "element.inner": ("inner",),
            f"own.{OWN}": ("at_node", self._turn(e, "m")),
            "right": ("asked", move),
            "free": ("free", node),
            "push": ("push", move),
            f"> {BETWEEN}": ("between", self._between(e)),
            f"> {MIDDLE}": ("middle", e),
        }
        self._call_held(
            "condense", node, lambda f: self.at(*places.get(f, ("at_middle", 0, f[2:])))
        )
        for side in SIDES[1]:
            self._ask(self._node_of(e, side), f"right_{side}", "at_middle")

    def _node(self, j: str, turn: str | int) -> None:
        """Of node j: what it adds to the matrix, and what is computed there for the elements at
        it.
        """
        with self._kind(j) as kinds:
            for k in kinds:
                self._call(
                    f"block {k}",
                    lambda f: (
                        self.at("at_end" if f == f"> {END}" else "at_node", turn)
                        if f[0] == ">"
                        else self._of_node(f, j)
                    ),
                )

    def _row(self, v: str) -> None:
        code, node = self.code, self._end(v)
        last, left, right = self._sides(v)
        with code.when(code.new(f"xor i1 {last}, true")):
            self._node(self._node_of(v, "j"), self._turn(v, "j"))
            self._element(v)
        sides = {"left": left, "right": right, "own": self.at("at_node", self._odd(v))}
        near, order = self._near(v) if self.held else {}, self.order
        if self.held:
            near |= {
                f"push_{name}": self.at("push", self._move_of(node, k))
                for name, k in (("before", -order), ("here", 0), ("after", order))
            }

        def where(field: str) -> str:
            side, dot, _ = field.partition(".")
            if field[0] == ">":
                return self.at("row", v, field[2:])
            if dot and side in sides:
                return sides[side]
            if field == "right":
                return self.at("asked", self._move_of(node))
            return near[field] if field in near else self._row_before(field, v)

        self._call_held("row", node, where)

    def _element_bar(self, e: str) -> None:
        """What the solution asks of an element: of its gap through the balance, then of its start
        and its constants.
        """
        places = {
            side: self.at("found", self._move_of(self._node_of(e, side)))
            for side in SIDES[self.order]
        }
        pushed = {bar(side): place for side, place in places.items()}
        self._call(
            "pushed bar",
            lambda f: (
                self.at("change", 0, "gap_bar")
                if f[0] == ">"
                else pushed[f]
                if f in pushed
                else self._of_element(f, e)
            ),
        )
        self._add(
            self.at("law", e, "gap_bar"),
            self.at("change", 0, "gap_bar"),
            self.layout.records["stress"].size,
        )
        given = {bar("gap"): self.at("law", e, "gap_bar")}
        given |= {bar(f"{side}.balance"): place for side, place in places.items()}
        with self._element_kind(e) as kinds:
            for k in kinds:
                self._call(
                    f"element bar {k}",
                    lambda f: (
                        self.at("of_element", 0, f[2:])
                        if f[0] == ">"
                        else given[f]
                        if f in given
                        else self._of_element(f, e)
                    ),
                )
                self._spread(f"element bar {k}", e)
                for _ in self._touching(k, e):
                    self._call(
                        f"element load bar {k}",
                        lambda f: (
                            self.at("of_element", 0, f[2:])
                            if f[0] == ">"
                            else given[f]
                            if f in given
                            else self._of_element(f, e)
                        ),
                    )
                    self._spread(f"element load bar {k}", e)

    def _spread(self, name: str, j: str) -> None:
        """Add the cotangents that a function gives to those of the start, of the constants and of
        the step's reaction; u's and m's stay.
        """
        records = self.layout.records
        source = "of_element" if name.startswith(("element", "finish element")) else "change"
        for out in self.functions[name].outputs:
            field, at = out.removesuffix("_bar"), j
            if field != without_side(field):
                at, field = self._node_of(j, field[0]), without_side(field)
            record = field.partition(".")[0] + "_bar" if "." in field else "start_bar"
            if field in ("found", "last"):
                record, field = "reaction_bar" if field == "found" else "last_bar", "reaction"
            if field in self.layout.fields("element_state"):
                record = "element_state_start_bar"
            elif source == "of_element" and field in ("u", "m"):
                record, field = "unknown_bar", f"{field}_bar"
            if field in records[record].fields:
                on_support = record in ("support_bar", "reaction_bar", "last_bar")
                row = 0 if record == "common_bar" else self._support_of(at) if on_support else at
                self._sum(
                    self.at(record, row, field),
                    self.at(source, 0, out),
                    self.at("sample", 0, "good"),
                    records[record].fields[field][1],
                )
