"""Program of a step: the functions of Newton's method; one for all scenes of a structure."""

from __future__ import annotations

from functools import partial
from typing import Any

from ..compiler.function import Function, Functions
from ..compiler.packing import Packing
from ..compiler.shared_ends import END
from ..compiler.split import split
from . import interactions, rows, tendon_driver
from .adjoint import AdjointProgram
from .driver import SUMS, Driver, Slots
from .interaction_sorts import INTERACTIONS
from .layout import (
    ELEMENTS,
    FLAGS,
    INTERFACE,
    LAW,
    MOVES,
    MULTIPLIERS,
    NODE_PLACES,
    NODES,
    ONE,
    OWN,
    SUPPORTS,
    TOLD,
    Layout,
    most,
)
from .local_functions import LocalFunctions
from .native import NativeProgram
from .row_functions import RowFunctions
from .search_driver import SQUARES
from .sorts import ELEMENT, LOAD, NODE, Sort
from .step_driver import StepSlots
from .tracing import Shapes, Tracing

SAMPLE = "moving", "cosine", "good", "found_status", "last_status", "work"
# of a step's search for its length: what it takes and gives of a sample
LENGTH = "merit", "share", "waited", "best_near"


class NewtonProgram(NativeProgram):
    """Newton's method. Subclasses say what is of a sample (`_of_samples`), what rows do beside
    their balance (`_beside`), and add records of their own (`_layout`).

    unknown  fields that an iteration changes, of a node; varying: others that are not the same
             throughout a call; numbers: those that stay, of a sample; judging: those of a sample by
             which it is judged
    """

    driver = Driver
    slots: type[Slots]
    unknown: tuple[str, ...]
    varying: tuple[str, ...] = ()
    numbers = "total", "longest", "exact", "tolerance"
    judging = (*SUMS, *numbers, "before", "over", "done", "status", "iterations")

    def coded(self, *of: Any) -> Driver:
        return Driver(self.slots, *of)

    def _of_samples(self, traced: Tracing) -> Functions:
        """Functions that are not of a kind, beside those of Newton's method."""
        return {}

    def _of_rows(self, traced: Tracing, sort: Sort) -> Functions:
        """Balances by kind of rows."""
        kinds = interactions.kinds_of(self.kinds, sort)
        return {f"{sort.name} {k}": self._of_row(traced, sort, x) for k, x in kinds}

    def _of_row(self, traced: Tracing, sort: Sort, kind: Any) -> Function:
        """The balance of a kind of rows."""
        shapes = traced.of(sort) | dict.fromkeys(self.varying, ())
        shapes |= self._told(traced.local.points_told(sort, kind))
        return traced(partial(traced.local.balance(sort), kind), shapes)

    def _told(self, points: int) -> Shapes:
        """What the last iteration tells so many points where surfaces rub."""
        return {}

    def _beside(self, traced: Tracing) -> Functions:
        """What there is beside balances, by kind of rows: how unknowns follow from moves."""
        fields = traced.node | {"move": (self.w,)}
        return self._of_kinds(traced, traced.local.update, self.kinds.nodes, fields)

    def _functions(self, traced: Tracing) -> Functions:
        w, functions = self.w, self._of_samples(traced)
        nodes = [*self._of_rows(traced, NODE).values()]
        functions |= self._beside(traced)
        packing = Packing(OWN, nodes, [name for name in nodes[0].outputs if name != "told"])
        elements = [*self._of_rows(traced, ELEMENT).values()]
        shapes = {name: out.shape for name, out in elements[0].outputs.items()}
        names = rows.to_nodes(shapes)
        loads = self._of_loads_between(functions, traced, {n: shapes[n] for n in names})
        between = Packing(self.given_by_elements, [*elements, *loads.values()], names)
        made = between.made()
        for name, load in zip(loads, made[len(elements) :], strict=True):
            functions[name] = load.only(load.outputs)
        law = Packing(LAW, made[: len(elements)], ("gap", "E"))
        elements = [one.only(name for name in one.outputs if name != "hB") for one in law.made()]
        self._iterated(functions, packing.made(), elements, traced)

        moves = {f"{side}.move": (w,) for side in self.sides}
        stress = traced(
            traced.local.stress,
            {**traced.element, **{name: shapes[name] for name in law.fields}, **moves},
        )
        functions["stress"] = law.taken(stress, {name: name for name in law.fields})
        shapes |= {f"own.{name}": nodes[0].outputs[name].shape for name in packing.fields}
        functions |= rows.of_rows(traced, packing, between, shapes, self.held, self.kinds.runs)
        functions |= self._interactions(traced)
        if self.held:
            functions["reaction"] = traced(
                RowFunctions(traced.local).reaction,
                {
                    "rows": (w, 3 * w),
                    **{name: (w,) for name in ("asked", "free", "before", "here", "after")},
                },
            )
        judging = (
            *self.judging,
            *((*interactions.GAPS, "constraint_size") * self.kinds.multiplied),
        )
        functions["judge"] = traced(traced.local.samples.judge, dict.fromkeys(judging, ()))
        if traced.local.searches:
            functions |= self._searching(traced, judging)
        return functions

    def _searching(self, traced: Tracing, judging: tuple[str, ...]) -> Functions:
        """Functions of what shortens steps."""
        other = ("done", "status", "back", "ratio")
        given = [name for name in (*judging, "near", *SQUARES, *LENGTH) if name not in other]
        functions = {"search": traced(traced.local.samples.search, dict.fromkeys(given, ()))}
        unknowns = {
            "unknown": {name: self.shapes[name] for name in self.unknown},
            "stress": {"stress": (self.k,)},
        }
        if self.kinds.multiplied:
            unknowns["multiplier"] = {"force": (self.w,)}
        for name, shapes in unknowns.items():
            ends = shapes | {f"to_{field}": shape for field, shape in shapes.items()}
            part = traced(traced.local.samples.part, ends | {"ratio": ()})
            functions[f"part {name}"] = part
        return functions

    def _interactions(self, traced: Tracing) -> Functions:
        """Functions of what acts between nodes."""
        functions, w, kinds = {}, self.w, self.kinds
        for sort in INTERACTIONS:
            traced_row = partial(self._of_row, traced, sort)
            functions |= interactions.of_interaction(traced, sort, kinds, self.held, traced_row)
            changing = [f"{side}.{name}" for side in sort.sides for name in self.unknown]
            for k, _ in interactions.kinds_of(kinds, sort) if sort.early else ():
                name = f"{sort.name} {k}"
                _split(functions, name, functions[name], (*changing, "force", *self.varying))
        if kinds.multiplied:
            numbers = {"force": (w,), "move": (w,)}
            functions["multiplier update"] = traced(traced.local.multiplier_update, numbers)
        shapes = dict.fromkeys(self.varying, ()) | {"told": (2,)}
        functions |= tendon_driver.of_tensions(traced, kinds, shapes)
        return functions

    def _of_loads_between(self, functions: Functions, traced: Tracing, shapes: Shapes) -> Functions:
        """What loads between nodes add to what elements give their nodes, of these fields; adds
        what says of each kind where they do nothing.
        """
        varying = dict.fromkeys(self.varying, ())
        for k, kind in interactions.kinds_of(self.kinds, LOAD):
            far = interactions.far(traced, LOAD, kind, varying)
            functions[f"far {LOAD.name} {k}"] = far if traced.local.searches else far.only(["far"])
        loads = self._of_rows(traced, LOAD)
        return {name: load.with_zeros(shapes) for name, load in loads.items()}

    def _iterated(
        self, functions: Functions, nodes: list[Function], elements: list[Function], traced: Tracing
    ) -> None:
        """What each iteration computes of nodes and elements: what is of one of an element's nodes
        alone is computed there, and before the iterations what does not depend on the unknowns.
        """
        nodes, elements = self.with_ends(
            nodes, elements, self.unknown, (*traced.constants["common"], *self.varying)
        )
        for k, x in enumerate(nodes):
            _split(functions, f"node {k}", x, (*self.unknown, "told", *self.varying))
        changing = [f"{side}.{name}" for side in self.sides for name in (*self.unknown, END)]
        for k, x in enumerate(elements):
            _split(functions, f"element {k}", x, (*changing, "stress", *self.varying))

    def _layout(self) -> Layout:
        inputs, outputs, w, k = self.constants, self.outputs, self.w, self.k
        layout, row = Layout(), rows.given_by_rows(self.functions)
        layout.record("node", NODES, inputs("node"))
        layout.record("element", ELEMENTS, inputs("element"))
        layout.record(
            "common",
            ONE,
            [*inputs("common"), *((name, 1) for name in (*self.numbers, *self.varying))],
        )
        layout.record("unknown", NODES, outputs("update 0"))
        for name in ("stress", "start_stress"):
            layout.record(name, ELEMENTS, [("stress", k)])
        for name, sort in (("before node", NODES), ("before element", ELEMENTS)):
            layout.record(name, sort, self.largest(name))
        layout.record("at_node", NODE_PLACES, outputs("node 0", OWN))
        layout.record("at_end", NODE_PLACES, self.largest("node", END))
        rows.record_midsides(layout, self.functions, "element 0")
        for k, _ in interactions.kinds_of(self.kinds, LOAD):
            for word in (f"far {LOAD.name}", LOAD.name):
                layout.record("sums", ONE, outputs(f"{word} {k}", *FLAGS))
        layout.record("sums", ONE, [(flag, row[flag]) for flag in FLAGS if flag in row])
        rows.record(layout, self.functions, w)
        layout.record("strain_law", ELEMENTS, outputs("element 0", LAW))
        layout.record("move", MOVES, [("move", w)])
        layout.record("nothing", ONE, [("zeros", max(layout.records["between"].size, w * w))])
        layout.record("change", ONE, most(self.functions).items())
        layout.record("sample", ONE, outputs("judge"))
        layout.record("sums", ONE, [(name, 1) for name in SUMS])
        if "search" in self.functions:
            layout.record("sums", ONE, [(name, 1) for name in SQUARES])
            layout.record("sample", ONE, outputs("search"))
            for name, sort in (("unknown", NODES), ("stress", ELEMENTS)):
                _beside(layout, name, sort)
        if self.held:
            layout.record("free", NODES, [("free", w)])
            layout.record(
                "support",
                SUPPORTS,
                [
                    *inputs("support"),
                    *((name, row[name]) for name in ("rows", "asked")),
                    *((name, w) for name in ("reaction", "found", "last")),
                ],
            )
        if INTERFACE in self.kinds.runs:
            layout.record("push", NODES, [("push", w)])
        for sort in interactions.present(self.kinds):
            settings = self.kinds, inputs(sort.constants), w
            interactions.record(layout, self.functions, sort, *settings)
        if self.kinds.multiplied:
            interactions.record_multipliers(layout, w)
        tendon_driver.record(layout, self.kinds)
        if "part multiplier" in self.functions:
            _beside(layout, "multiplier", MULTIPLIERS)
        for name, sort in TOLD.items():
            if told := self.largest(name, "told"):
                for word in ("told", "next", "best told"):
                    layout.record(f"{word} {sort}", sort, told)
        return layout


class StepProgram(NewtonProgram):
    """Steps forwards; `adjoints` by the constants that want a gradient."""

    slots = StepSlots
    unknown = "u", "m"

    def __init__(self, local: LocalFunctions, *args: Any, **named: Any) -> None:
        if local.searches:
            self.judging = (*self.judging, "back", "ratio")
        super().__init__(local, *args, **named)
        self.adjoints: dict[frozenset[str], AdjointProgram] = {}

    def _told(self, points: int) -> Shapes:
        return {"told": (int(points), 6)} if points else {}

    def _of_samples(self, traced: Tracing) -> Functions:
        functions = {"cosine": traced(traced.local.cosine, {"m": self.shapes["m"]})}
        if "kinetic" in traced.local.element_ends:
            functions["project"] = self._of_numbers(traced, traced.local.project)
            shapes = {name: self.shapes[name] for name in ("velocity", "spin")}
            functions["scaled"] = traced(traced.local.scaled, shapes | {"scale": ()})
        passes = (
            interactions.kinds_of(self.kinds, LOAD)
            or any(sort.far for sort in interactions.present(self.kinds))
            or traced.local.model.bodies_touch
        )
        without = () if passes else ("passed_through",)
        functions["outcome"] = self._of_numbers(traced, traced.local.samples.outcome, without)
        return functions

    def _beside(self, traced: Tracing) -> Functions:
        """With these what unknowns start from, and what becomes of rows at the end of a step."""
        still = {name: shape for name, shape in traced.node.items() if name not in self.unknown}
        functions = super()._beside(traced)
        functions |= self._of_kinds(traced, traced.local.predictor, self.kinds.nodes, still)
        return functions | self.finishing(traced)

    def _layout(self) -> Layout:
        layout = super()._layout()
        layout.record("common", ONE, [("least", 1)])
        layout.record(NODE.state, NODES, self.outputs("finish node 0", *self.state))
        if self.element_state:
            layout.record(
                ELEMENT.state, ELEMENTS, self.outputs("finish element 0", *self.element_state)
            )
        layout.record("sample", ONE, [(name, 1) for name in SAMPLE])
        if "project" in self.functions:
            layout.record("energy", ONE, [(name, 1) for name in ("kinetic", "rise", "scale")])
            layout.record("sample", ONE, [("defect", 1)])
        return layout


def _beside(layout: Layout, name: str, rows: str) -> None:
    """Records like that of an unknown: the best so far, and what is part of the way back to it."""
    fields = [(field, size) for field, (_, size) in layout.fields(name).items()]
    layout.record(f"best_{name}", rows, fields)
    layout.record(f"{name}_back", ONE, fields)


def _split(functions: Functions, name: str, function: Function, unknown: tuple[str, ...]) -> None:
    """The function in two, of which the first does not depend on the unknowns."""
    before, rest = split(function, [field for field in function.inputs if field not in unknown])
    functions[f"before {name}"], functions[name] = before.only(before.outputs), rest
