"""Adjoint program: the derivatives of a step's local functions, for the constants that want
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from math import prod

from ..compiler.derivative import vjp
from ..compiler.function import Function, Functions
from ..compiler.packing import Packing
from ..compiler.shared_ends import END
from . import interactions, rows, tendon_driver
from .adjoint_driver import AdjointDriver
from .interaction_sorts import BALANCES, INTERACTIONS
from .interactions import kinds_of
from .kinds import Kinds, without_side
from .layout import (
    ELEMENTS,
    MOVES,
    NODE_PLACES,
    NODES,
    ONE,
    OWN,
    SUPPORTS,
    Layout,
    cotangents,
    most,
)
from .local_functions import LocalFunctions
from .method_functions import ENERGIES
from .native import NativeProgram
from .row_functions import RowFunctions
from .sorts import ELEMENT, LOAD, NODE, Sort
from .tracing import Traced, Tracing

SAMPLE = ("good", "work_bar", "work_grad")
# of their states, and of tendons
OF_INTERACTIONS = "last_force", "tension", *(sort.kept for sort in INTERACTIONS if sort.kept)
ENDED = ("velocity", "spin")  # of a node at the end, that are scaled
# what ends follow from beside the start and the constants
ENDED_BY = "u", "m", "found", "last", "force", "change", "start"


class AdjointProgram(NativeProgram):
    """wanted: names of the constants' fields whose cotangents are asked for."""

    driver = AdjointDriver

    def __init__(
        self,
        local: LocalFunctions,
        kinds: Kinds,
        held: bool,
        wanted: frozenset[str],
        key: str | None = None,
        known: Traced | None = None,
    ) -> None:
        self.wanted = wanted
        super().__init__(local, kinds, held, key, known)

    def _functions(self, traced: Tracing) -> Functions:
        w, shapes, kinds = self.w, self.shapes, self.kinds
        states = {name: shapes[name] for name in self.state}
        after = {f"after_{name}": shape for name, shape in states.items()}
        free = {"move": (w,), "push": (w,), "free": (w,)}
        of_rows = RowFunctions(traced.local)
        functions = {
            "solution": traced(traced.local.solution, states | after | traced.constants["common"]),
            "balance_bar": traced(of_rows.balance_bar, free),
        }
        if self.held:
            functions["push"] = traced(of_rows.push, {"reaction_bar": (w,), "free": (w,)})
        moved = self._of_kinds(
            traced, traced.local.update, kinds.nodes, traced.node | {"move": (w,)}
        )
        for name, update in moved.items():
            if "move" in update.inputs:  # a clamp that moves goes its own way
                bars = vjp(update, ["move"]).with_constants({"move": [0.0] * w})
                functions[_bar_of(name)] = bars
        balances: dict[Sort, list[Function]] = {}
        for sort in (*BALANCES, LOAD):
            balances[sort] = []
            for k, kind in kinds_of(kinds, sort):
                balance = partial(traced.local.balance(sort), kind)
                whole = traced(balance, traced.of(sort))
                balances[sort].append(whole)
                asked = self.asked(sort, kind)
                functions[f"{sort.name} bar {k}"] = self._derivative(whole, asked)
        functions |= self._ends(traced)
        functions |= self._eliminating(traced, *(balances[x] for x in (NODE, ELEMENT, LOAD)))
        for k, kind in kinds_of(kinds, LOAD):
            far = interactions.far(traced, LOAD, kind)
            functions[f"far {LOAD.name} {k}"] = far.only(["far"])
        for sort in INTERACTIONS:
            functions |= interactions.transposed(traced, sort, kinds, self.held)
        functions |= tendon_driver.adjoint_of_stretches(traced, kinds, self._derivative)
        return {name: function.only(function.outputs) for name, function in functions.items()}

    def _ends(self, traced: Tracing) -> Functions:
        """What the cotangents of rows, and of the energies, at the end are found by."""
        functions = {}
        for name, finish in self.finishing(traced).items():
            functions[_bar_of(name)] = self._derivative(finish, (), ENDED_BY)
            if "rise" in finish.outputs:
                there = [field for field in (*ENDED, *ENERGIES) if field in finish.outputs]
                functions[name.replace("finish", "ended")] = finish.only(there)
        if "kinetic" in traced.local.element_ends:
            project = self._of_numbers(traced, traced.local.project)
            shapes = {name: self.shapes[name] for name in ENDED}
            scaled = traced(traced.local.scaled, shapes | {"scale": ()})
            functions["project"] = project.only(["scale"])
            functions["project bar"] = vjp(project, ["defect", "kinetic", "rise"])
            functions["scaled bar"] = vjp(scaled, [*ENDED, "scale"])
        return functions

    def _derivative(
        self, function: Function, of: Sequence[str] = (), more: Sequence[str] = ()
    ) -> Function:
        """Cotangents of what a function reads of the state at the start and of the wanted
        constants, and of `more`, without those that are zero; of: of these outputs alone.
        """
        by = {*self.state, *self.element_state, *self.wanted, *OF_INTERACTIONS, *more}
        whole = function.only(of or function.outputs)
        derivative = vjp(whole, [name for name in whole.inputs if {name, without_side(name)} & by])
        zero = derivative.graph.zero
        return derivative.only(
            name
            for name, out in derivative.outputs.items()
            if any(node != zero for node in out.nodes)
        )

    def _eliminating(
        self,
        traced: Tracing,
        nodes: list[Function],
        elements: list[Function],
        loads: list[Function],
    ) -> Functions:
        """Functions of the transposed matrix, and of stresses."""
        w, outputs, functions = self.w, elements[-1].outputs, {}
        packing = Packing(OWN, nodes, ["D"])
        blocks = [
            *(f"{side}.D" for side in self.sides),
            *(name for name in rows.BLOCKS if name in outputs),
        ]
        shapes = {name: outputs[name].shape for name in blocks}
        loads = [load.with_zeros(shapes) for load in loads]
        between = Packing(self.given_by_elements, [*elements, *loads], blocks)
        nodes, made = [function.only([OWN]) for function in packing.made()], between.made()
        kinds = kinds_of(self.kinds, LOAD)
        for (k, _), load in zip(kinds, made[len(elements) :], strict=True):
            functions[f"{LOAD.name} blocks {k}"] = load.only([between.name])
        elements = [function.only([between.name, "E", "hB"]) for function in made[: len(elements)]]
        nodes, elements = self.with_ends(
            nodes, elements, (*self.state, "u", "m"), traced.constants["common"]
        )
        functions |= {f"node blocks {k}": node for k, node in enumerate(nodes)}
        functions |= {f"element blocks {k}": element for k, element in enumerate(elements)}
        law = {name: outputs[name].shape for name in ("gap", "E", "hB")}
        moves = {f"{side}.move": (w,) for side in self.sides}
        functions["stress bar"] = vjp(
            traced(traced.local.stress, {**traced.element, **law, **moves}), ["gap", *moves]
        )
        functions["pushed bar"] = vjp(
            traced(traced.local.pushed, {**traced.element, **law}), ["gap"]
        )
        shapes |= {"own.D": (w, w)}
        return functions | rows.of_rows(
            traced, packing, between, shapes, self.held, self.kinds.runs, transposed=True
        )

    def _layout(self) -> Layout:
        w, k, layout = self.w, self.k, Layout()
        state = [(name, prod(self.shapes[name])) for name in self.state]
        for kind, sort in (
            ("node", NODES),
            ("element", ELEMENTS),
            ("common", ONE),
            *((("support", SUPPORTS),) * self.held),
            *((sort.constants, sort.rows) for sort in interactions.present(self.kinds)),
        ):
            # a derivative need not read what it is by
            outputs = (output for name in self.functions for output in self.outputs(name))
            fields = {
                name: size
                for out, size in outputs
                if (name := without_side(out).removesuffix("_bar")).startswith(f"{kind}.")
            }
            layout.record(kind, sort, self.constants(kind))
            layout.record(f"{kind}_bar", sort, sorted(fields.items()))
        layout.record(NODE.state, NODES, state)
        cotangents(layout, NODE.state, NODES, state)
        read = self.functions["solution"].inputs
        ends = [(f"after_{name}", size) for name, size in state]
        layout.record("after", NODES, [end for end in ends if end[0] in read])
        for name in ("unknown", "unknown_bar"):
            layout.record(name, NODES, [("u", state[0][1]), ("m", state[1][1])])
        layout.record("stress", ELEMENTS, [("stress", k)])
        cotangents(layout, "stress", ELEMENTS, [("stress", k)])
        if self.element_state:
            sizes = [(name, prod(self.shapes[name])) for name in self.element_state]
            layout.record(ELEMENT.state, ELEMENTS, sizes)
            cotangents(layout, ELEMENT.state, ELEMENTS, sizes)
        if "project" in self.functions:
            layout.record("ended", NODES, [(name, prod(self.shapes[name])) for name in ENDED])
            bars = [*ENERGIES, "scale", *(f"{name}_bar" for name in (*ENERGIES, "scale"))]
            layout.record("energy", ONE, [(name, 1) for name in bars])
            layout.record(
                "sample", ONE, [(name, 1) for name in ("defect", "defect_bar", "defect_grad")]
            )
        for name in ("asked", "push", "move", "found"):
            layout.record(name, MOVES, [(name, w)])
        layout.record(
            "law", ELEMENTS, [*self.outputs("element blocks 0", "E", "hB"), ("gap_bar", k)]
        )
        layout.record("at_node", NODE_PLACES, self.outputs("node blocks 0", OWN))
        layout.record("at_end", NODE_PLACES, self.largest("node blocks", END))
        rows.record_midsides(layout, self.functions, "element blocks 0")
        rows.record(layout, self.functions, w)
        layout.record("nothing", ONE, [("zeros", max(layout.records["between"].size, w * w + k))])
        layout.record("change", ONE, most(self.functions).items())
        layout.record("sample", ONE, [(name, 1) for name in SAMPLE])
        layout.record("free", NODES, [("free", w)])
        if self.held:
            for name in ("found", "last"):
                read = any(name in function.inputs for function in self.functions.values())
                layout.record("support", SUPPORTS, [(name, w)] * read)
            cotangents(layout, "reaction", SUPPORTS, [("reaction", w)])
        for one in interactions.present(self.kinds):
            interactions.record_adjoint(layout, self.functions, one, self.kinds)
        if self.kinds.multiplied:
            interactions.record_adjoint_of_multipliers(layout, self.functions, w)
        tendon_driver.record_adjoint(layout, self.kinds)
        return layout


def _bar_of(name: str) -> str:
    """What the derivative of a function of a kind is called: "node bar 0" of "node 0"."""
    return " bar ".join(name.rsplit(" ", 1))
