"""Native adjoint of steps: from the last to the first, cotangents of a state become those of the
one before.

With the residual g (balance and strain gaps), the solution follows x' = -K^-1 g', so that a
cotangent goes through the transposed matrix once, and from there through the derivatives of g by
the start and the constants. Nothing is kept of a step but the states that it lies between. One pass
over the elements makes the rows of the transposed system, which are eliminated as they come;
another takes what its solution asks of them.
"""

from __future__ import annotations

from functools import partial

from ..compiler.derivative import bar
from ..compiler.shared_ends import END
from .conserving_functions import ENERGIES
from .driver_code import ALL, Place, Places
from .elimination_driver import Elimination
from .interaction import SIDES
from .node_kinds import without_side
from .tendon_adjoint import TendonAdjoint


class AdjointDriver(TendonAdjoint, Elimination):
    """Cotangents, step by step backwards."""

    ARGS = (*ALL, "stepwises", "stepwise_count")

    def _group(self, first: str) -> None:
        code, args = self.code, self.args
        last = code.sub(args["steps"], 1)
        counts = {"node_bar": args["nodes"], "element_bar": args["elements"], "common_bar": 1}
        supports = {"support_bar": args["supports"]} if self.held else {}
        for record, count in (self._state_counts("_bar") | supports | counts).items():
            with code.loop(0, count) as k:
                self._fill((record, k))
        for name in self._of_samples("_bar"):
            self._fill(("sample", 0, name))
        self._clear_tendons()
        self._clear_interactions()
        with code.loop(last, -1, -1) as step:
            self._transfer("gather", "input", first, step, last)
            self._step()
            self._transfer("drain", "stepwise", first, step, last)
        self._transfer("scatter", "output", first, 0)

    def _state_counts(self, what: str) -> dict[str, str]:
        """Records of the "_bar" or "_grad" of a state, and how many rows they have."""
        args = self.args
        counts = {"state": args["nodes"], "stress": args["elements"]}
        counts |= {"element_state": args["elements"]} if self._has_rates else {}
        counts |= {"reaction": args["supports"]} if self.held else {}
        return {f"{name}{what}": count for name, count in counts.items()}

    @property
    def _has_rates(self) -> bool:
        """Whether elements have a state beside their stress."""
        return "element_state" in self.layout.records

    def _step(self) -> None:
        code, N, nodes = self.code, self.args["elements"], self.args["nodes"]
        for to, count in self._state_counts("_bar").items():
            with code.loop(0, count) as k:
                self._add((to, k), (to.replace("_bar", "_grad"), k))
        for to, source in zip(self._of_samples("_bar"), self._of_samples("_grad"), strict=True):
            self._add(("sample", 0, to), ("sample", 0, source))
        self._add_tendons()
        self._add_states()
        self._fill(("nothing", 0))
        with code.loop(0, self._move_of(nodes, self.order)) as j:
            for record in ("asked", "push", "move", "found"):
                self._fill((record, j))
        if self.held:
            with code.loop(0, self.args["supports"]) as k:
                self._fill(("last_bar", k))
        with code.loop(0, nodes) as j:
            self._solution(j)
        self._tensions()
        self._solutions()
        if "energy" in self.layout.records:
            self._energies()
        with code.loop(0, N) as e:
            self._element_ends(e)
        self._tendon_ends()
        self._interaction_ends()
        with code.loop(0, nodes) as j:
            self._ends(j)
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
            places = {bar("balance"): ("found", self._move_of(j))}
            spread = partial(self._spread, j=j)
            self._at_node("node bar", j, ("change", 0), places, then=spread)
        self._tie_bars()
        self._interaction_bars()
        self._take_start(self.at("sample", 0, "good"))

    def _take_start(self, good: str) -> None:
        """Cotangents of the state at the start, of what has gone well."""
        starts = {
            "state_bar": "start_bar",
            "element_state_bar": "element_state_start_bar",
            "reaction_bar": "last_bar",
        }
        for to, count in self._state_counts("_bar").items():
            with self.code.loop(0, count) as k:
                source = (starts[to], k) if to in starts else ("nothing", 0)
                self._take((to, k), source, good)
        self._take_tendons(good)
        self._take_states(good)

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

        def of(f: str) -> str:
            return self.at("after", j, f) if f.startswith("after") else self._of_node(f, j)

        self._call("solution", of, ("unknown", j))
        for name in ("start_bar", "unknown_bar"):
            if name in self.layout.records:
                self._fill((name, j))

    def _element_ends(self, e: str) -> None:
        """What the cotangents of an element's state at the end ask of its start and of its
        nodes.
        """
        if self._has_rates:
            self._fill(("element_state_start_bar", e))
        places: Places = {
            bar(name): ("element_state_bar", e, name)
            for name in self.layout.fields("element_state_bar")
        }
        places |= {bar("work"): ("sample", 0, bar("work"))}
        places |= {bar(name): ("energy", 0, bar(name)) for name in ENERGIES}
        self._element_bars("finish element", e, places)

    def _element_bars(self, word: str, e: str, places: Places) -> None:
        """Derivatives of element e, and of the loads between its nodes, see `_spread`."""
        to, spread = ("of_element", 0), partial(self._spread, j=e, source="of_element")
        self._at_element(f"{word} bar", e, to, places, then=spread)
        for k in self._loaded(e):
            self._call(name := f"{word} load bar {k}", partial(self._of_element, e=e), to, places)
            spread(name)

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

    def _ends(self, j: str) -> None:
        """Of a node: what its end's cotangents ask of the start and of the move."""
        places: Places = {bar(f): ("state_bar", j, f) for f in self.layout.fields("state_bar")}
        places |= {bar("work"): ("sample", 0, bar("work"))}
        places |= {bar(name): ("energy", 0, bar(name)) for name in ENERGIES}
        self._at_node("finish bar", j, ("change", 0), places, then=partial(self._spread, j=j))
        for field in self.layout.fields("unknown_bar"):
            self._add(("change", 0, field), ("unknown_bar", j, field))
        places = {bar(name): ("change", 0, bar(name)) for name in self.layout.fields("unknown")}
        places[f"> {bar('move')}"] = ("asked", self._move_of(j))
        self._at_node("update bar", j, None, places)

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
            self._ask(self._node_of(e, side), bar(f"{side}.move"), "change")

    def _ask(self, node: str, field: str, record: str) -> None:
        """Add a field to what is asked of a node's move."""
        self._add(("asked", self._move_of(node)), (record, 0, field))

    def _at_midside(self, node: str) -> Places:
        move = self._move_of(node)
        return {"right": ("asked", move), "push": ("push", move)}

    def _condensed(self, e: str) -> None:
        for side in SIDES[1]:
            self._ask(self._node_of(e, side), f"right_{side}", "at_middle")

    def _node(self, j: str, turn: str | int) -> None:
        """Of node j: what it adds to the matrix, and what is computed there for the elements at
        it.
        """
        self._at_node("block", j, ("at_node", turn), {f"> {END}": ("at_end", turn)})

    def _element_bar(self, e: str) -> None:
        """What the solution asks of an element: of its gap through the balance, then of its start
        and its constants.
        """
        places: Places = {}
        for side in SIDES[self.order]:
            at = "found", self._move_of(self._node_of(e, side))
            places |= {bar(side): at, bar(f"{side}.balance"): at}
        self._call("pushed bar", lambda f: self._of_element(f, e), ("change", 0), places)
        self._add(("law", e, "gap_bar"), ("change", 0, "gap_bar"))
        places[bar("gap")] = ("law", e, "gap_bar")
        self._element_bars("element", e, places)

    def _spread(self, name: str, j: str, source: str = "change") -> None:
        """Add the cotangents that a function gives to those of the start, of the constants and of
        the step's reaction; a node's u and m stay.
        """
        for out in self.functions[name].outputs:
            field, at = out.removesuffix("_bar"), j
            if field in ("u", "m"):
                continue
            if field != without_side(field):
                at, field = self._node_of(j, field[0]), without_side(field)
            to = self._bar_place(field, at)
            if to is not None:
                self._sum(to, (source, 0, out), self.at("sample", 0, "good"))
