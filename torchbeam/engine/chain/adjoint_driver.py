"""Native adjoint of steps: from the last to the first, cotangents of a state become those of the
one before.

With the residual g (balance and strain gaps), the solution follows x' = -K^-1 g', so that a
cotangent goes through the transposed matrix once, and from there through the derivatives of g by
the start and the constants. Nothing is kept of a step but the states that it lies between. One pass
over the elements makes the rows of the transposed system, which are eliminated as they come;
another takes what its solution asks of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from ..compiler.derivative import bar
from ..compiler.shared_ends import END
from .elimination_driver import Elimination
from .interaction_sorts import BALANCES, ENDS
from .method_functions import ENERGIES
from .record_code import ALL, Place, Places
from .sorts import ELEMENT, LOAD, NODE, SIDES, Row
from .tendon_driver import TensionBars, Tensions
from .tendon_functions import TIE


class AdjointDriver(Elimination):
    """Cotangents, step by step backwards."""

    ARGS = (*ALL, "stepwises", "stepwise_count")

    def __init__(self, *of: Any) -> None:
        super().__init__(*of)
        self.tensions = Tensions(self)
        self.tension_bars = TensionBars(self, self.tensions, self._backward)

    def group(self, first: str) -> None:
        code = self.code
        last = code.sub(self.args["steps"], 1)
        self.zeros_in(*(name for name in self.layout.records if name.endswith("_bar")))
        for name in self._of_samples("_bar"):
            self.fill(("sample", 0, name))
        with code.loop(last, -1, -1) as step:
            self.transfer("gather", "input", first, step, last)
            self._step()
            self.transfer("drain", "stepwise", first, step, last)
        self.transfer("scatter", "output", first, 0)

    def _backward(self, name: str, of: Callable[[str], Place], ends: Places) -> None:
        """The derivative of a function whose fields lie at `of`, from the cotangents of what it
        gives, at `ends`; what that asks of the fields is added to their cotangents.
        """
        self.call(name, of, ("change", 0), {bar(field): place for field, place in ends.items()})
        for out, value in self.functions[name].outputs.items():
            record, row, field = of(out.removesuffix("_bar"))
            to, field = self.layout.cotangent(record, field)
            good = self.at("sample", 0, "good")
            self.add_where((to, row, field), ("change", 0, out), good, len(value.nodes))

    def _backward_of(self, word: str, row: Row, ends: Places) -> None:
        """The derivative of the function of this word of a row, if its kind has one."""
        of = partial(self.field_of, row=row)
        self.by_name(word, row, lambda name: self._backward(name, of, ends))

    def _through(self, sorts: tuple, then: Callable[[Row], None]) -> None:
        """then(row), which asks something of its start, of each row of all sorts."""
        for sort in sorts:
            self.each_of(sort, then)
            if sort is TIE:
                self.tension_bars.back()

    def _step(self) -> None:
        code, nodes = self.code, self.args["nodes"]
        states = self.layout.states
        for name in states:
            with self.rows_of(f"{name}_bar") as k:
                self.add((f"{name}_bar", k), (f"{name}_grad", k))
        for to, source in zip(self._of_samples("_bar"), self._of_samples("_grad"), strict=True):
            self.add(("sample", 0, to), ("sample", 0, source))
        self.zeros_in(*(f"{name}_start_bar" for name in states), "unknown_bar", "multiplier_bar")
        self.fill(("nothing", 0))
        with code.loop(0, self.move_of(nodes, self.order)) as j:
            for record in ("asked", "push", "move", "found"):
                self.fill((record, j))
        self._solutions()
        if self.has_energy:
            self._energies()
        self._through(ENDS, self._end_bars)
        self.each_row(NODE, self._unknown_bars)
        if self.held:
            with code.loop(0, self.args["supports"]) as k:
                node = self.integer("support_nodes", k)
                places: Places = {"reaction_bar": ("reaction_bar", k), "free": ("free", node)}
                self.call("push", to=("push", self.move_of(node)), places=places)
        self._transposed()
        self.restore("found", self._balance_bar)
        self._through(BALANCES, self._balance_bars)
        good = self.at("sample", 0, "good")
        for name in states:  # of what has gone well, those of the state at the start
            with self.rows_of(f"{name}_bar") as k:
                self.take((f"{name}_bar", k), (f"{name}_start_bar", k), good)

    def _of_samples(self, what: str) -> list[str]:
        """Cotangents of a sample's fields."""
        return [name for name in self.layout.records["sample"].fields if name.endswith(what)]

    # Of the end of a step

    def _end_bars(self, row: Row) -> None:
        """What the cotangents of a row's state at the end, of its work and its energies ask of the
        start, and of unknowns.
        """
        if row.of is TIE:
            self.tension_bars.read(row.number)
        state = ELEMENT.state if row.of is LOAD else row.of.state
        bars = f"{state}_bar"
        ends: Places = {field: (bars, row.number, field) for field in self.layout.fields(bars)}
        ends |= {name: ("energy", 0, bar(name)) for name in ENERGIES}
        ends["work"] = "sample", 0, bar("work")
        if row.own is not None:
            ends["force"] = "multiplier_state_bar", row.own, "last_force"
        self._backward_of(f"finish {row.name} bar", row, ends)

    def _unknown_bars(self, row: Row) -> None:
        """What the cotangents of a node's unknowns ask of its move."""
        places: Places = {
            bar(name): ("unknown_bar", row.number, name) for name in self.layout.fields("unknown")
        }
        places[f"> {bar('move')}"] = ("asked", self.move_of(row.number))
        self.call_of("update bar", row, places=places)

    def _energies(self) -> None:
        """The scale of the velocities, and the cotangents of what it is made from and of the
        velocities before.
        """
        good, ended = self.at("sample", 0, "good"), self.layout.fields("ended")
        self.fill(("energy", 0))

        def add(row: Row) -> None:
            word = f"ended {row.name}"
            there = ended if row.of is NODE else ()
            self.call_of(word, row, "change", {f"> {f}": ("ended", row.number, f) for f in there})
            for name in ENERGIES:
                if name in self.outputs_of(word, row):
                    self.add(("energy", 0, name), ("change", 0, name))

        for sort in BALANCES:
            self.each_of(sort, add)

        def of(field: str) -> str:
            name = field.removeprefix("> ")
            return self.at("sample" if name.startswith("defect") else "energy", 0, name)

        self.call("project", of)
        with self.code.loop(0, self.args["nodes"]) as j:
            places: Places = {name: ("ended", j, name) for name in ended}
            places |= {bar(name): (f"{NODE.state}_bar", j, name) for name in ended}
            places["scale"] = ("energy", 0, "scale")
            self.call("scaled bar", to=("change", 0), places=places)
            for name in ended:
                self.take((f"{NODE.state}_bar", j, name), ("change", 0, bar(name)), good)
            self.add(("energy", 0, "scale_bar"), ("change", 0, "scale_bar"))
        self.call("project bar", of, places={"> defect_bar": ("change", 0, "defect_bar")})
        self.take(("sample", 0, "defect_bar"), ("change", 0, "defect_bar"), good)

    # Of the solution

    def _solutions(self) -> None:
        """Unknowns, tensions and forces of constraints between the states of a step, and which
        pairs are far.
        """
        with self.code.loop(0, self.args["nodes"]) as j:

            def of(f: str) -> Place:
                return ("after", j, f) if f.startswith("after") else self.of_node(f, j)

            self.call("solution", of, ("unknown", j))
        self.tensions.find()

        def solution(row: Row) -> None:
            if row.own is not None:
                places: Places = {
                    "after_force": ("multiplier_after", row.own),
                    "> force": ("multiplier", row.own),
                }
                self.call_of(f"{row.name} solution", row, places=places)

        for sort in self.interactions:
            if sort.unknowns or sort.far:
                self.each_of(sort, solution, look=True)

    def _transposed(self) -> None:
        """The transposed system, and the cotangents of the balances."""
        if self.has_interface:
            self.at_interface()
        for sort in self.interactions:
            self.each_of(sort, self._blocks)
        self.eliminate()
        self.moves()
        with self.code.loop(0, self.args["nodes"]) as j:
            self._balance_bar(j)

    def _blocks(self, row: Row) -> None:
        """Blocks of the transposed matrix, and what is asked of the moves of its ends."""
        nodes, to = {x: self.move_of(row.nodes[x]) for x in row.sides}, f"{row.name} blocks"
        places: Places = {f"{side}.reaction": ("push", node) for side, node in nodes.items()}
        if row.own is not None:
            places["force_bar"] = ("multiplier_bar", row.own)
        self.call_of(to, row, to, places)
        for side, node in nodes.items() if self.held else ():
            self.add(("asked", node), (to, row.number, f"{side}.asked"), self.coupled(row))

    def give(self, e: str, to: Place) -> None:
        """With it, what its stress's cotangent asks of its nodes' moves."""
        row = ELEMENT.at(e)
        self.call_of("element blocks", row, "law", {f"> {to[0]}": to})

        def load(row: Row) -> None:
            self.call_of(f"{row.name} blocks", row, "change")
            self.add(to, ("change", 0, to[0]))

        self.each_load(e, load)
        places: Places = {
            f"> {bar('gap')}": ("law", e, "gap_bar"),
            bar("stress"): ("stress_bar", e),
        }
        self.call("stress bar", partial(self.field_of, row=row), ("change", 0), places)
        for side in SIDES[self.order]:
            self._ask(self.node_of(e, side), bar(f"{side}.move"))

    def _ask(self, node: str, field: str) -> None:
        """Add a field to what is asked of a node's move."""
        self.add(("asked", self.move_of(node)), ("change", 0, field))

    def at_midside(self, node: str) -> Places:
        move = self.move_of(node)
        return {"rhs": ("asked", move), "push": ("push", move)}

    def condensed(self, e: str) -> None:
        for side in SIDES[1]:
            self._ask(self.node_of(e, side), f"rhs_{side}")

    def node(self, j: str, turn: str | int) -> None:
        """Of node j: what it adds to the matrix, and what is computed there for the elements at
        it.
        """
        self.call_of("node blocks", NODE.at(j), ("at_node", turn), {f"> {END}": ("at_end", turn)})

    def around(self, node: str) -> Places:
        around: Places = {"rhs": ("asked", self.move_of(node))}
        if self.held:
            around |= self.free_near(node) | {
                f"push_{name}": ("push", self.move_of(node, k))
                for name, k in (("before", -self.order), ("here", 0), ("after", self.order))
            }
        return around

    def _balance_bar(self, j: str) -> None:
        """Of node j, whose move is known."""
        at = self.move_of(j)
        places = {"move": ("move", at), "push": ("push", at), "free": ("free", j)}
        places[f"> {bar('balance')}"] = ("found", at)
        self.call("balance_bar", places=places)

    def _balance_bars(self, row: Row) -> None:
        """What the solution asks of a row: of its start, and of its constants."""
        if row.of is TIE:
            self.tension_bars.clear(row.number)
        self._backward_of(f"{row.name} bar", row, self._balances(row))

    def _balances(self, row: Row) -> Places:
        """Cotangents of what a row gives its nodes, and of what its unknowns are to close."""

        def found(node: str) -> Place:
            return "found", self.move_of(node)

        if row.of is NODE:
            return {"balance": found(row.number)}
        if row.of not in (ELEMENT, LOAD):
            ends: Places = {f"{side}.push": found(row.nodes[side]) for side in row.sides}
            return ends | ({} if row.own is None else {"rhs": self.solution_of(row)})
        sides = {side: found(self.node_of(row.number, side)) for side in SIDES[self.order]}
        gap = "law", row.number, "gap_bar"
        if row.of is ELEMENT:
            places: Places = {bar(side): at for side, at in sides.items()}
            of = partial(self.field_of, row=row)
            self.call("pushed bar", of, ("change", 0), places)
            self.add(gap, ("change", 0, "gap_bar"))
        return {f"{side}.balance": at for side, at in sides.items()} | {"gap": gap}
