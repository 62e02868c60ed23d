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

from ..compiler.derivative import bar
from ..compiler.shared_ends import END
from .conserving_functions import ENERGIES
from .driver_code import ALL, Place, Places
from .elimination_driver import Elimination
from .interaction import SIDES
from .tendon_adjoint import TendonAdjoint


class AdjointDriver(TendonAdjoint, Elimination):
    """Cotangents, step by step backwards."""

    ARGS = (*ALL, "stepwises", "stepwise_count")

    def _group(self, first: str) -> None:
        code = self.code
        last = code.sub(self.args["steps"], 1)
        self._zeros_in(*(name for name in self.layout.records if name.endswith("_bar")))
        for name in self._of_samples("_bar"):
            self._fill(("sample", 0, name))
        with code.loop(last, -1, -1) as step:
            self._transfer("gather", "input", first, step, last)
            self._step()
            self._transfer("drain", "stepwise", first, step, last)
        self._transfer("scatter", "output", first, 0)

    def _backward(self, name: str, of: Callable[[str], Place], ends: Places) -> None:
        """The derivative of a function whose fields lie at `of`, from the cotangents of what it
        gives, at `ends`; what that asks of the fields is added to their cotangents.
        """
        self._call(name, of, ("change", 0), {bar(field): place for field, place in ends.items()})
        for out, value in self.functions[name].outputs.items():
            record, row, field = of(out.removesuffix("_bar"))
            to, field = self.layout.cotangent(record, field)
            good = self.at("sample", 0, "good")
            self._sum((to, row, field), ("change", 0, out), good, len(value.nodes))

    def _made(self, record: str, row: str) -> Places:
        """Cotangents of what a step has made: of a part of the state, work, and energies."""
        bars = f"{record}_bar"
        ends: Places = {field: (bars, row, field) for field in self.layout.fields(bars)}
        ends |= {name: ("energy", 0, bar(name)) for name in ENERGIES}
        return ends | {"work": ("sample", 0, bar("work"))}

    def _step(self) -> None:
        code, N, nodes = self.code, self.args["elements"], self.args["nodes"]
        states = self.layout.states
        for name in states:
            with self._rows_of(f"{name}_bar") as k:
                self._add((f"{name}_bar", k), (f"{name}_grad", k))
        for to, source in zip(self._of_samples("_bar"), self._of_samples("_grad"), strict=True):
            self._add(("sample", 0, to), ("sample", 0, source))
        self._zeros_in(*(f"{name}_start_bar" for name in states), "unknown_bar", "multiplier_bar")
        self._fill(("nothing", 0))
        with code.loop(0, self._move_of(nodes, self.order)) as j:
            for record in ("asked", "push", "move", "found"):
                self._fill((record, j))
        with code.loop(0, nodes) as j:
            self._solution(j)
        self._tensions()
        self._solutions()
        if "energy" in self.layout.records:
            self._energies()
        with code.loop(0, N) as e:
            self._back_to_element("finish element", e, self._made("element_state", e))
        self._tendon_ends()
        self._interaction_ends()
        with code.loop(0, nodes) as j:
            self._at_node("finish bar", j, self._made("state", j), call=self._backward)
            places: Places = {
                bar(name): ("unknown_bar", j, name) for name in self.layout.fields("unknown")
            }
            places[f"> {bar('move')}"] = ("asked", self._move_of(j))
            self._at_node("update bar", j, None, places)
        if self.held:
            with code.loop(0, self.args["supports"]) as k:
                node = code.load(code.at(self.args["support_nodes"], k))
                places = {"reaction_bar": ("reaction_bar", k), "free": ("free", node)}
                self._call("push", to=("push", self._move_of(node)), places=places)
        self._transposed()
        self._restore("found", self._balance_bar)
        with code.loop(0, N) as e:
            self._element_bar(e)
        with code.loop(0, nodes) as j:
            ends: Places = {"balance": ("found", self._move_of(j))}
            self._at_node("node bar", j, ends, call=self._backward)
        self._tie_bars()
        self._interaction_bars()
        good = self.at("sample", 0, "good")
        for name in states:  # of what has gone well, those of the state at the start
            with self._rows_of(f"{name}_bar") as k:
                self._take((f"{name}_bar", k), (f"{name}_start_bar", k), good)

    def _transposed(self) -> None:
        """The transposed system, and the cotangents of the balances."""
        if self.has_interface:
            self._at_interface()
        for one in self.interactions:
            self._each_of(one, self._blocks)
        self._eliminate()
        self._moves()
        with self.code.loop(0, self.args["nodes"]) as j:
            self._balance_bar(j)

    def _around(self, node: str) -> Places:
        around: Places = {"right": ("asked", self._move_of(node))}
        if self.held:
            around |= self._near(node) | {
                f"push_{name}": ("push", self._move_of(node, k))
                for name, k in (("before", -self.order), ("here", 0), ("after", self.order))
            }
        return around

    def _balance_bar(self, j: str) -> None:
        """Of node j, whose move is known."""
        at = self._move_of(j)
        places = {"move": ("move", at), "push": ("push", at), "free": ("free", j)}
        places[f"> {bar('balance')}"] = ("found", at)
        self._call("balance_bar", places=places)

    def _solution(self, j: str) -> None:
        """Of a node: the solution between its states."""

        def of(f: str) -> Place:
            return ("after", j, f) if f.startswith("after") else self._of_node(f, j)

        self._call("solution", of, ("unknown", j))

    def _back_to_element(self, word: str, e: str, ends: Places) -> None:
        """Derivatives of element e, and of the loads between its nodes."""
        self._at_element(f"{word} bar", e, ends, call=self._backward)
        for k in self._loaded(e):
            self._backward(f"{word} load bar {k}", partial(self._of_element, e=e), ends)

    def _of_samples(self, what: str) -> list[str]:
        """Cotangents of a sample's fields."""
        return [name for name in self.layout.records["sample"].fields if name.endswith(what)]

    def _energies(self) -> None:
        """The scale of the velocities, and the cotangents of what it is made from and of the
        velocities before.
        """
        code, nodes = self.code, self.args["nodes"]
        good, ended = self.at("sample", 0, "good"), self.layout.fields("ended")
        self._fill(("energy", 0))
        with code.loop(0, self.args["elements"]) as e:
            self._at_element("ended element", e, ("change", 0))
            self._add_energies()
            for k in self._loaded(e):
                self._add_rise(f"ended element load {k}", e)
        with code.loop(0, nodes) as j:
            self._at_node("ended", j, ("change", 0), {f"> {f}": ("ended", j, f) for f in ended})
            self._add_energies()
        self._tendon_energies()
        self._interaction_energies()

        def of(field: str) -> str:
            name = field.removeprefix("> ")
            return self.at("sample" if name.startswith("defect") else "energy", 0, name)

        self._call("project", of)
        with code.loop(0, nodes) as j:
            places: Places = {name: ("ended", j, name) for name in ended}
            places |= {bar(name): ("state_bar", j, name) for name in ended}
            places["scale"] = ("energy", 0, "scale")
            self._call("scaled bar", to=("change", 0), places=places)
            for name in ended:
                self._take(("state_bar", j, name), ("change", 0, bar(name)), good)
            self._add(("energy", 0, "scale_bar"), ("change", 0, "scale_bar"))
        self._call("project bar", of, places={"> defect_bar": ("change", 0, "defect_bar")})
        self._take(("sample", 0, "defect_bar"), ("change", 0, "defect_bar"), good)

    def _give(self, e: str, to: Place) -> None:
        """With it, what its stress's cotangent asks of its nodes' moves."""
        self._at_element("blocks", e, ("law", e), {f"> {to[0]}": to})
        for k in self._loaded(e):
            self._add_load(f"load blocks {k}", e, to)
        places: Places = {
            f"> {bar('gap')}": ("law", e, "gap_bar"),
            bar("stress"): ("stress_bar", e),
        }
        self._call("stress bar", lambda f: self._of_element(f, e), ("change", 0), places)
        for side in SIDES[self.order]:
            self._ask(self._node_of(e, side), bar(f"{side}.move"))

    def _ask(self, node: str, field: str) -> None:
        """Add a field to what is asked of a node's move."""
        self._add(("asked", self._move_of(node)), ("change", 0, field))

    def _at_midside(self, node: str) -> Places:
        move = self._move_of(node)
        return {"right": ("asked", move), "push": ("push", move)}

    def _condensed(self, e: str) -> None:
        for side in SIDES[1]:
            self._ask(self._node_of(e, side), f"right_{side}")

    def _node(self, j: str, turn: str | int) -> None:
        """Of node j: what it adds to the matrix, and what is computed there for the elements at
        it.
        """
        self._at_node("block", j, ("at_node", turn), {f"> {END}": ("at_end", turn)})

    def _element_bar(self, e: str) -> None:
        """What the solution asks of an element: of its gap through the balance, then of its start
        and its constants.
        """
        sides = SIDES[self.order]
        found = {side: ("found", self._move_of(self._node_of(e, side))) for side in sides}
        places: Places = {bar(side): at for side, at in found.items()}
        self._call("pushed bar", lambda f: self._of_element(f, e), ("change", 0), places)
        self._add(("law", e, "gap_bar"), ("change", 0, "gap_bar"))
        ends: Places = {f"{side}.balance": at for side, at in found.items()}
        self._back_to_element("element", e, ends | {"gap": ("law", e, "gap_bar")})
