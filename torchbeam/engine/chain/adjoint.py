"""Adjoint program: the derivatives of a step's local functions, for the constants that want
them.
"""

from __future__ import annotations

from functools import partial
from math import prod

from ..compiler.derivative import bar, vjp
from ..compiler.function import Function
from ..compiler.packing import Packing
from ..compiler.shared_ends import END
from . import interactions, midsides, rows, stretches
from .adjoint_driver import AdjointDriver
from .conserving_functions import ENERGIES
from .interaction import INTERACTIONS, TIE
from .layout import ELEMENTS, MOVES, NODE_PLACES, NODES, ONE, OWN, SUPPORTS, Layout
from .local_functions import LocalFunctions
from .native import NativeProgram
from .node_kinds import Kinds, without_side
from .tracing import Traced, Tracing

SAMPLE = ("good", "work_bar", "work_grad")
# functions of which what they give is kept together
OF_NODES = "node bar", "finish bar", "stress bar", "ended", "scaled bar", "project bar"
ENDED = ("velocity", "spin")  # of a node at the end, that are scaled


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

    def _functions(self, traced: Tracing, local: LocalFunctions) -> dict[str, Function]:
        w, shapes, kinds, own = self.w, self.shapes, self.kinds, partial(self._of_kinds, traced)
        start = (*self.state, *sorted(self.wanted))
        states = {name: shapes[name] for name in self.state}
        after = {f"after_{name}": shape for name, shape in states.items()}
        free = {"move": (w,), "push": (w,), "free": (w,)}
        functions = {
            "solution": traced(local.solution, states | after | traced.constants["common"]),
            "balance_bar": traced(local.balance_bar, free),
        }
        if self.held:
            functions["push"] = traced(local.push, {"reaction_bar": (w,), "free": (w,)})
        nodes, finishes = (
            own(function, kinds.nodes, traced.node) for function in (local.node, local.finish)
        )
        functions |= _bars(nodes, start, ["balance"])
        functions |= _bars(finishes, (*start, "u", "m", "found", "last"), keep=("u", "m"))
        for name, update in own(local.update, kinds.nodes, traced.node | {"move": (w,)}).items():
            if "move" in update.inputs:  # a clamp that moves goes its own way
                bars = vjp(update, ["move"]).with_constants({"move": [0.0] * w})
                functions[_bar_of(name)] = bars
        elements, loads = self._of_elements(functions, traced, local, start, finishes)
        functions |= self._eliminating(traced, local, [*nodes.values()], elements, loads)
        for one in INTERACTIONS:
            by = [f"{side}.{name}" for side in one.sides for name in start]
            by += [*self.wanted, "last_force", "tension", *[one.kept] * bool(one.kept)]
            functions |= interactions.adjoint_of_interaction(
                local, traced, one, self.kinds, self.held, by, _derivative
            )
            if one is TIE:
                ties = kinds.stretches
                functions |= stretches.adjoint_of_stretches(local, traced, ties, by, _derivative)
        return {name: function.only(function.outputs) for name, function in functions.items()}

    def _of_elements(
        self,
        functions: dict[str, Function],
        traced: Tracing,
        local: LocalFunctions,
        start: tuple[str, ...],
        finishes: dict[str, Function],
    ) -> tuple[list[Function], list[Function]]:
        """Adds what the cotangents of elements, and of the energies at the end, are found by. What
        elements give their nodes, and the loads between these.
        """
        kinds, own = self.kinds.elements, partial(self._of_kinds, traced)
        elements = own(local.element, kinds, traced.element)
        loads = own(local.element_load, self.loaded, traced.element)
        ended = own(local.finish_element, kinds, traced.element) if local.element_ends else {}
        ended |= own(local.finish_element_load, self.loaded, traced.element)
        for name, far in own(local.far, self.loaded, traced.element).items():
            functions[name] = far.only(["far"])
        whole = [name for name in start if name.startswith(("element", "common"))]
        ends = [f"{side}.{name}" for side in self.sides for name in start if name not in whole]
        ends += [*local.element_state, *whole]
        moves = [f"{side}.{name}" for side in self.sides for name in ("u", "m")]
        balances = [f"{side}.balance" for side in self.sides]
        functions |= _bars(elements, ends, [*balances, "gap"]) | _bars(loads, ends, balances)
        functions |= _bars(ended, [*ends, *moves])
        for name, finish in (finishes | ended).items():
            if "rise" in finish.outputs:
                there = [field for field in (*ENDED, *ENERGIES) if field in finish.outputs]
                functions[name.replace("finish", "ended")] = finish.only(there)
        if "kinetic" in local.element_ends:
            project = self._of_numbers(traced, local.project)
            shapes = {name: self.shapes[name] for name in ENDED}
            scaled = traced(local.scaled, shapes | {"scale": ()})
            functions["project"] = project.only(["scale"])
            functions["project bar"] = vjp(project, ["defect", "kinetic", "rise"])
            functions["scaled bar"] = vjp(scaled, [*ENDED, "scale"])
        return [*elements.values()], [*loads.values()]

    def _eliminating(
        self,
        traced: Tracing,
        local: LocalFunctions,
        nodes: list[Function],
        elements: list[Function],
        loads: list[Function],
    ) -> dict[str, Function]:
        """Functions of the transposed matrix, and of stresses."""
        w, outputs, functions = self.w, elements[-1].outputs, {}
        own = Packing(OWN, nodes, ["D"])
        blocks = [
            *(f"{side}.D" for side in self.sides),
            *(name for name in midsides.BLOCKS if name in outputs),
        ]
        shapes = {name: outputs[name].shape for name in blocks}
        loads = [load.with_zeros(shapes) for load in loads]
        between = Packing(self.given_by_elements, [*elements, *loads], blocks)
        nodes, made = [one.only([OWN]) for one in own.made()], between.made()
        for k, one in zip(self.touching, made[len(elements) :], strict=True):
            functions[f"load blocks {k}"] = one.only([between.name])
        elements = [one.only([between.name, "E", "hB"]) for one in made[: len(elements)]]
        nodes, elements = self.with_ends(
            nodes, elements, (*self.state, "u", "m"), traced.constants["common"]
        )
        functions |= {f"block {k}": one for k, one in enumerate(nodes)}
        functions |= {f"blocks {k}": element for k, element in enumerate(elements)}
        law = {name: outputs[name].shape for name in ("gap", "E", "hB")}
        moves = {f"{side}.move": (w,) for side in self.sides}
        functions["stress bar"] = vjp(
            traced(local.stress, {**traced.element, **law, **moves}), ["gap", *moves]
        )
        functions["pushed bar"] = vjp(traced(local.pushed, {**traced.element, **law}), ["gap"])
        shapes |= {"own.D": (w, w)}
        return functions | rows.of_rows(
            local, traced, own, between, shapes, self.held, self.kinds.runs, transposed=True
        )

    def _layout(self) -> Layout:
        w, k, layout = self.w, self.k, Layout()
        state = [(name, prod(self.shapes[name])) for name in self.state]
        for kind, sort in (
            ("node", NODES),
            ("element", ELEMENTS),
            ("common", ONE),
            *((("support", SUPPORTS),) * self.held),
            *((one.constants, one.rows) for one in interactions.present(self.kinds)),
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
        for name in ("state", "state_bar", "state_grad", "start_bar"):
            layout.record(name, NODES, state)
        read = self.functions["solution"].inputs
        ends = [(f"after_{name}", size) for name, size in state]
        layout.record("after", NODES, [end for end in ends if end[0] in read])
        layout.record("unknown", NODES, [("u", state[0][1]), ("m", state[1][1])])
        for name in ("stress", "stress_bar", "stress_grad"):
            layout.record(name, ELEMENTS, [("stress", k)])
        if self.element_state:
            own = [(name, prod(self.shapes[name])) for name in self.element_state]
            for name in ("", "_bar", "_grad", "_start_bar"):
                layout.record(f"element_state{name}", ELEMENTS, own)
        ends = self.touching, interactions.present(self.kinds)
        if "finish element bar 0" in self.functions or any(ends):
            layout.record("unknown_bar", NODES, [("u_bar", state[0][1]), ("m_bar", state[1][1])])
        if "project" in self.functions:
            layout.record("ended", NODES, [(name, prod(self.shapes[name])) for name in ENDED])
            bars = [*ENERGIES, "scale", *(f"{name}_bar" for name in (*ENERGIES, "scale"))]
            layout.record("energy", ONE, [(name, 1) for name in bars])
            layout.record(
                "sample", ONE, [(name, 1) for name in ("defect", "defect_bar", "defect_grad")]
            )
        for name in ("asked", "push", "move", "found"):
            layout.record(name, MOVES, [(name, w)])
        layout.record("law", ELEMENTS, [*self.outputs("blocks 0", "E", "hB"), ("gap_bar", k)])
        layout.record("at_node", NODE_PLACES, self.outputs("block 0", OWN))
        layout.record("at_end", NODE_PLACES, self.largest("block", END))
        midsides.record(layout, self.functions, "blocks 0")
        for kind in self.touching:
            layout.record("at_load", ONE, [("far", 1), *self.outputs(f"load blocks {kind}")])
        rows.record(layout, self.functions, w)
        layout.record("nothing", ONE, [("zeros", max(layout.records["between"].size, w * w + k))])
        layout.record("change", ONE, [("gap_bar", k)])
        for name in self.functions:
            if name.startswith(OF_NODES):
                layout.record("change", ONE, self.outputs(name))
        for word in ("element", "finish element", "element load", "finish element load"):
            layout.record("of_element", ONE, self.largest(f"{word} bar"))
        layout.record("sample", ONE, [(name, 1) for name in SAMPLE])
        layout.record("free", NODES, [("free", w)])
        if self.held:
            for name in ("found", "last"):
                read = any(name in function.inputs for function in self.functions.values())
                layout.record("support", SUPPORTS, [(name, w)] * read)
            for name in ("reaction_bar", "reaction_grad", "last_bar"):
                layout.record(name, SUPPORTS, [("reaction", w)])
        for one in interactions.present(self.kinds):
            interactions.record_adjoint(layout, self.functions, one, self.kinds)
        if self.kinds.multiplied:
            interactions.record_adjoint_of_multipliers(layout, self.functions, w)
        if self.kinds.stretches:
            stretches.record_adjoint(layout, self.functions)
        return layout


def _bar_of(name: str) -> str:
    """What the derivative of a function of a kind is called: "node bar 0" of "node 0"."""
    return " bar ".join(name.rsplit(" ", 1))


def _bars(
    functions: dict[str, Function],
    by: tuple[str, ...] | list[str],
    of: list[str] | None = None,
    keep: tuple[str, ...] = (),
) -> dict[str, Function]:
    """See `_derivative`; of: of these outputs alone."""
    return {
        _bar_of(name): _derivative(function.only(of or function.outputs), by, keep)
        for name, function in functions.items()
    }


def _derivative(
    function: Function, by: tuple[str, ...] | list[str], keep: tuple[str, ...] = ()
) -> Function:
    """Cotangents of the inputs `by` that the function has; without those that are zero, but for
    `keep`.
    """
    derivative = vjp(function, [name for name in by if name in function.inputs])
    zero = derivative.graph.zero
    return derivative.only(
        name
        for name, out in derivative.outputs.items()
        if name in map(bar, keep) or any(node != zero for node in out.nodes)
    )
