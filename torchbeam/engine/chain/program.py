"""Program of a step: the functions of Newton's method; one for all scenes of a structure."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

from ...core.remembered import keep
from ...core.surroundings import Surroundings
from ..compiler.function import Function
from ..compiler.object_cache import key_of
from ..compiler.packing import Packing
from ..compiler.shared_ends import END
from ..compiler.split import split
from . import interactions, midsides, rows, stretches
from .adjoint import AdjointProgram
from .disk_key import key_on_disk, structure
from .driver import SQUARES, SUMS
from .interaction import FINISHED, INTERACTIONS, PAIR, Interaction
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
from .node_kinds import ElementKind, Kinds, NodeKind
from .row_functions import RowFunctions
from .step_driver import StepDriver
from .tracing import Shapes, Traced, Tracing

T = TypeVar("T")
SAMPLE = "moving", "cosine", "good", "found_status", "last_status", "work"
# of a step's search for its length: what it takes and gives of a sample
LENGTH = "merit", "share", "waited", "best_near"


class NewtonProgram(NativeProgram):
    """Newton's method. Subclasses say what is of a sample (`_of_samples`), what nodes do beside
    `node` and `update` (`_of_nodes`), and add records of their own (`_layout`).

    unknown  fields that an iteration changes, of a node; varying: others that are not the same
             throughout a call; numbers: those that stay, of a sample; judging: those of a sample by
             which it is judged
    """

    unknown: tuple[str, ...]
    varying: tuple[str, ...] = ()
    numbers = "total", "longest", "exact", "tolerance"
    judging = (*SUMS, *numbers, "before", "over", "done", "status", "iterations")

    def _of_samples(self, traced: Tracing, local: LocalFunctions) -> dict[str, Function]:
        """Functions that are not of a kind, beside those of Newton's method."""
        return {}

    def _of_nodes(self, traced: Tracing, local: LocalFunctions) -> dict[str, Function]:
        """Functions by kind of nodes."""
        kinds, move = self.kinds.nodes, {"move": (self.w,)}
        return {
            f"node {k}": self._of_node(traced, local, kind) for k, kind in enumerate(kinds)
        } | self._of_kinds(traced, local.update, kinds, traced.node | move)

    def _of_node(self, traced: Tracing, local: LocalFunctions, kind: NodeKind) -> Function:
        """`node` of a kind."""
        given = traced.node | dict.fromkeys(self.varying, ())
        return traced(partial(local.node, kind), given | self._told(local.rubbing_points(kind)))

    def _of_element(self, traced: Tracing, local: LocalFunctions, kind: ElementKind) -> Function:
        """`element` of a kind."""
        given = traced.element | dict.fromkeys(self.varying, ())
        return traced(partial(local.element, kind), given)

    def _of_interaction(
        self, traced: Tracing, local: LocalFunctions, one: Interaction, kind: Any
    ) -> Function:
        """What gives pushes and blocks, of a kind."""
        given = getattr(traced, one.constants) | dict.fromkeys(self.varying, ())
        given |= self._told(one is PAIR and kind.rubs)
        return traced(partial(getattr(local.of(one), one.name), kind), given)

    def _told(self, points: int) -> Shapes:
        """What the last iteration tells so many points where surfaces rub."""
        return {}

    def _functions(self, traced: Tracing, local: LocalFunctions) -> dict[str, Function]:
        w, functions = self.w, self._of_samples(traced, local) | self._of_nodes(traced, local)
        nodes = [functions[f"node {k}"] for k in range(len(self.kinds.nodes))]
        own = Packing(OWN, nodes, [name for name in nodes[0].outputs if name != "told"])
        elements = [self._of_element(traced, local, kind) for kind in self.kinds.elements]
        shapes = {name: out.shape for name, out in elements[0].outputs.items()}
        names = midsides.to_nodes(shapes)
        loads = self._of_loads_between(functions, traced, local, {n: shapes[n] for n in names})
        between = Packing(self.given_by_elements, [*elements, *loads], names)
        made = between.made()
        for k, one in zip(self.touching, made[len(elements) :], strict=True):
            functions[f"element load {k}"] = one.only(one.outputs)
        law = Packing(LAW, made[: len(elements)], ("gap", "E"))
        elements = [one.only(name for name in one.outputs if name != "hB") for one in law.made()]
        self._iterated(functions, own.made(), elements, traced)

        moves = {f"{side}.move": (w,) for side in self.sides}
        stress = traced(
            local.stress, {**traced.element, **{name: shapes[name] for name in law.fields}, **moves}
        )
        functions["stress"] = law.taken(stress, {name: name for name in law.fields})
        shapes |= {f"own.{name}": nodes[0].outputs[name].shape for name in own.fields}
        functions |= rows.of_rows(local, traced, own, between, shapes, self.held, self.kinds.runs)
        functions |= self._interactions(traced, local)
        if self.held:
            functions["reaction"] = traced(
                RowFunctions(local).reaction,
                {
                    "rows": (w, 3 * w),
                    **{name: (w,) for name in ("asked", "free", "before", "here", "after")},
                },
            )
        judging = (
            *self.judging,
            *((*interactions.GAPS, "constraint_size") * self.kinds.multiplied),
        )
        functions["judge"] = traced(local.samples.judge, dict.fromkeys(judging, ()))
        if local.searches:
            functions |= self._searching(local, traced, judging)
        return functions

    def _searching(
        self, local: LocalFunctions, traced: Tracing, judging: tuple[str, ...]
    ) -> dict[str, Function]:
        """Functions of what shortens steps."""
        other = ("done", "status", "back", "ratio")
        given = [name for name in (*judging, "near", *SQUARES, *LENGTH) if name not in other]
        places = {name: self.shapes[name] for name in self.unknown}
        ends = places | {f"to_{name}": shape for name, shape in places.items()}
        functions = {
            "search": traced(local.samples.search, dict.fromkeys(given, ())),
            "between": traced(local.samples.between, ends | {"ratio": ()}),
        }
        sizes = {"stress": self.k} | ({"multiplier": self.w} if self.kinds.multiplied else {})
        for name, size in sizes.items():
            numbers = {"x": (size,), "to": (size,), "ratio": ()}
            functions[f"part {name}"] = traced(local.samples.part, numbers)
        return functions

    def _interactions(self, traced: Tracing, local: LocalFunctions) -> dict[str, Function]:
        """Functions of what acts between nodes."""
        functions, w, kinds = {}, self.w, self.kinds
        for one in INTERACTIONS:
            own = partial(self._of_interaction, traced, local, one)
            functions |= interactions.of_interaction(local, traced, one, kinds, self.held, own)
            changing = [f"{side}.{name}" for side in one.sides for name in self.unknown]
            for k, _ in interactions.kinds_of(kinds, one) if one.hoisted else ():
                name = f"{one.name} {k}"
                _split(functions, name, functions[name], (*changing, "force", *self.varying))
        if kinds.multiplied:
            numbers = {"force": (w,), "move": (w,)}
            functions["multiplier update"] = traced(local.multiplier_update, numbers)
        shapes = dict.fromkeys(self.varying, ()) | {"told": (2,)}
        functions |= stretches.of_tensions(local, traced, kinds.stretches, shapes)
        return functions

    def _of_loads_between(
        self, functions: dict[str, Function], traced: Tracing, local: LocalFunctions, shapes: Shapes
    ) -> list[Function]:
        """What loads between nodes add to what elements give their nodes, of these fields; `far` of
        each kind says where they do nothing.
        """
        given = traced.element | dict.fromkeys(self.varying, ())
        for name, far in self._of_kinds(traced, local.far, self.loaded, given).items():
            functions[name] = far if local.searches else far.only(["far"])
        each = []
        for kind in filter(None, self.loaded):
            told = self._told(local.rubbing_points_between(kind))
            load = traced(partial(local.element_load, kind), given | told)
            each.append(load.with_zeros(shapes))
        return each

    def _iterated(
        self,
        functions: dict[str, Function],
        nodes: list[Function],
        elements: list[Function],
        traced: Tracing,
    ) -> None:
        """What each iteration computes of nodes and elements: what is of one of an element's nodes
        alone is computed there, and before the iterations what does not depend on the unknowns.
        """
        nodes, elements = self.with_ends(
            nodes, elements, self.unknown, (*traced.constants["common"], *self.varying)
        )
        for k, one in enumerate(nodes):
            _split(functions, f"node {k}", one, (*self.unknown, "told", *self.varying))
        changing = [f"{side}.{name}" for side in self.sides for name in (*self.unknown, END)]
        for k, one in enumerate(elements):
            _split(functions, f"element {k}", one, (*changing, "stress", *self.varying))

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
        midsides.record(layout, self.functions, "element 0")
        for kind in self.touching:
            for word in ("far", "element load"):
                layout.record("sums", ONE, outputs(f"{word} {kind}", *FLAGS))
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
        for one in interactions.present(self.kinds):
            given = self.kinds, inputs(one.constants), w
            interactions.record(layout, self.functions, one, *given)
        if self.kinds.multiplied:
            interactions.record_multipliers(layout, w)
        if self.kinds.stretches:
            stretches.record(layout)
        if "part multiplier" in self.functions:
            _beside(layout, "multiplier", MULTIPLIERS)
        for name, sort in TOLD.items():
            if told := self.largest(name, "told"):
                for word in ("told", "next", "best told"):
                    layout.record(f"{word} {sort}", sort, told)
        return layout


class StepProgram(NewtonProgram):
    """Steps forwards; `adjoints` by the constants that want a gradient."""

    driver = StepDriver
    unknown = "u", "m"

    def __init__(self, local: LocalFunctions, *args: Any, **named: Any) -> None:
        if local.searches:
            self.judging = (*self.judging, "back", "ratio")
        super().__init__(local, *args, **named)
        self.adjoints: dict[frozenset[str], AdjointProgram] = {}

    def _interactions(self, traced: Tracing, local: LocalFunctions) -> dict[str, Function]:
        functions = super()._interactions(traced, local)
        for one in FINISHED:
            for k, kind in interactions.kinds_of(self.kinds, one):
                finish = partial(local.finished, one, kind)
                functions[f"finish {one.name} {k}"] = traced(finish, getattr(traced, one.constants))
        if self.kinds.stretches:
            functions[stretches.WORK] = stretches.of_work(local, traced)
        return functions

    def _told(self, points: int) -> Shapes:
        return {"told": (int(points), 6)} if points else {}

    def _of_samples(self, traced: Tracing, local: LocalFunctions) -> dict[str, Function]:
        functions = {"cosine": traced(local.cosine, {"m": self.shapes["m"]})}
        if "kinetic" in local.element_ends:
            functions["project"] = self._of_numbers(traced, local.project)
            shapes = {name: self.shapes[name] for name in ("velocity", "spin")}
            functions["scaled"] = traced(local.scaled, shapes | {"scale": ()})
        passes = self.touching or self.kinds.pairs or local.model.bodies_touch
        without = () if passes else ("passed",)
        functions["outcome"] = self._of_numbers(traced, local.samples.outcome, without)
        return functions

    def _of_nodes(self, traced: Tracing, local: LocalFunctions) -> dict[str, Function]:
        kinds, own = self.kinds, partial(self._of_kinds, traced)
        still = {name: shape for name, shape in traced.node.items() if name not in self.unknown}
        functions = super()._of_nodes(traced, local)
        functions |= own(local.predictor, kinds.nodes, still)
        functions |= own(local.finish, kinds.nodes, traced.node)
        if local.element_ends:
            functions |= own(local.finish_element, kinds.elements, traced.element)
        return functions | own(local.finish_element_load, self.loaded, traced.element)

    def _layout(self) -> Layout:
        layout = super()._layout()
        layout.record("common", ONE, [("least", 1)])
        layout.record("state", NODES, self.outputs("finish 0", *self.state))
        if self.element_state:
            layout.record(
                "element_state", ELEMENTS, self.outputs("finish element 0", *self.element_state)
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


def _split(
    functions: dict[str, Function], name: str, function: Function, unknown: tuple[str, ...]
) -> None:
    """The function in two, of which the first does not depend on the unknowns."""
    before, rest = split(function, [field for field in function.inputs if field not in unknown])
    functions[f"before {name}"], functions[name] = before.only(before.outputs), rest


# by structure, with the surroundings that its key is made of
PROGRAMS: dict[tuple, tuple[NewtonProgram, Surroundings]] = {}
TRACED: dict[tuple, tuple[Traced, Surroundings]] = {}  # likewise, what their programs share
NOTHING = Surroundings()
KEPT, KEPT_TRACED = 64, 8  # of them; the one that was not asked for for longest goes first


def program_of(
    local: LocalFunctions,
    kinds: Kinds,
    held: bool,
    around: Surroundings | None = NOTHING,
    made: type[NewtonProgram] = StepProgram,
    known: Traced | None = None,
) -> NewtonProgram:
    """The program of a structure, that of an earlier scene if there was one. kinds: of all nodes
    and elements; around: what users' functions read, which is part of it; None = that is not known,
    and the program one of its own. known: functions of `local` that were traced; None = those of
    the same structure.
    """
    kinds = kinds.distinct()
    if around is None:
        return made(local, kinds, held)
    key = made, around.key, *structure(local, kinds, held)

    def new() -> NewtonProgram:
        traced = traced_of(local, kinds, held, around) if known is None else known
        return made(local, kinds, held, key_on_disk(key), traced)

    return _kept(PROGRAMS, key, KEPT, around, new)


def traced_of(
    local: LocalFunctions, kinds: Kinds, held: bool, around: Surroundings | None
) -> Traced:
    """Functions that programs of the same structure have traced of late, see `program_of`."""
    if around is None:
        return {}
    key = around.key, *structure(local, kinds.distinct(), held)
    return _kept(TRACED, key, KEPT_TRACED, around, dict)


def _kept(
    entries: dict[tuple, tuple[T, Surroundings]],
    key: tuple,
    count: int,
    around: Surroundings,
    new: Callable[[], T],
) -> T:
    """The entry of a key, or a new one, among at most so many; with it the surroundings that the
    key is made of.
    """
    entry = entries.pop(key, None)  # other threads may ask too: at worst two of them make it
    if entry is None:
        entry = new(), around
    return keep(entries, key, entry, count)[0]


def adjoint_of(
    program: StepProgram, local: LocalFunctions, wanted: frozenset[str], around: Surroundings | None
) -> AdjointProgram:
    """The adjoint of a program, for these constants: of what users' functions were when it was
    made.
    """
    if wanted not in program.adjoints:
        key = None if program.key is None else key_of(program.key, *sorted(wanted))
        known, own = program.traced, (program.kinds, program.held)
        known = traced_of(local, *own, around) if known is None else known
        program.adjoints[wanted] = AdjointProgram(local, *own, wanted, key, known)
    return program.adjoints[wanted]
