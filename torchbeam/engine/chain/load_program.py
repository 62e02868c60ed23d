"""Programs of what is at rest: of load stepping, the functions of Newton's method and the rules of
the load's steps; of a point of a path, the balance there and what its tangent asks for, in one pass
each for the residual and for its slope by the load factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from torch import Tensor

from ...equations.balance_problem import BalanceProblem
from ...nodal.model import Model
from ...topology.framework import Framework
from ..compiler.derivative import dot, jvp
from ..compiler.function import Function, Functions
from .driver import SUMS
from .kinds import without_side
from .layout import ELEMENTS, INTERFACE, NODES, ONE, SIGNS, Layout
from .load_driver import PIVOT, LoadSlots, PathSlots
from .local_problem import BetweenKind, Ends, Fields
from .program import NewtonProgram
from .row_kinds import ElementKind, NodeKind
from .rows import given_by_rows
from .sample_functions import SampleFunctions
from .sorts import ELEMENT, LOAD, Sort
from .steady_functions import POSE, SteadyFunctions
from .tracing import Tracing

RULES = "first_step", "shares", "advanced"


class RestProgram(NewtonProgram):
    """Of what is at rest: the shape, and where supports have to be."""

    unknown = "position", "rotation"
    varying: tuple[str, ...] = ("load_factor",)

    def _beside(self, traced: Tracing) -> Functions:
        pose = {"load_factor": ()} | {f"pose.{name}": (size,) for name, size in POSE.items()}
        placed = [kind if kind.placed else None for kind in self.kinds.nodes]
        return super()._beside(traced) | self._of_kinds(
            traced, traced.local.place, placed, traced.node | pose
        )

    def _layout(self) -> Layout:
        layout = super()._layout()
        layout.record("pose", NODES, self.constants("pose"))
        layout.record("kept", NODES, self.outputs("update 0"))
        return layout


class LoadProgram(RestProgram):
    """judged: whether it says of each equilibrium if the tangent is positive definite, as loads are
    conservative.
    """

    slots = LoadSlots
    numbers = (*NewtonProgram.numbers, "least_force", "least_moment", "smallest")
    judging = (*NewtonProgram.judging, "whole", "least_force", "least_moment")

    def __init__(self, *of: Any, judged: bool = False) -> None:
        self.judged = judged
        super().__init__(*of)

    def _of_samples(self, traced: Tracing) -> Functions:
        w, q = self.w, self.shapes["rotation"]
        turned = {"rotation": q} | {f"pose.{name}": (POSE[name],) for name in ("rotation", "turn")}
        turns = traced.local.model.space.turns and any(
            kind.placed and kind.placed.displaced[1] for kind in self.kinds.nodes
        )
        functions = {
            "cosine": traced(traced.local.cosine, {"before": q, "rotation": q}),
            "turn": traced(traced.local.turn, {"move": (w,)} | (turned if turns else {})),
        }
        return functions | {
            name: self._of_numbers(traced, getattr(traced.local.samples, name)) for name in RULES
        }

    def _functions(self, traced: Tracing) -> Functions:
        functions = super()._functions(traced)
        for name, function in functions.items():
            if "indefinite" in function.outputs and not self.judged:
                functions[name] = function.only(
                    field for field in function.outputs if field != "indefinite"
                )
        return functions

    def _layout(self) -> Layout:
        layout = super()._layout()
        rules = [self.functions[name] for name in RULES]
        names = [x for rule in rules for x in (*rule.outputs, *rule.inputs)]
        names = [x for x in (*names, "indefinite") if x not in (*self.varying, "smallest")]
        layout.record("sample", ONE, [(name, 1) for name in names])
        if self.judged:
            layout.record("sums", ONE, [("indefinite", 1)])
        if self.judged and INTERFACE in self.kinds.runs:
            layout.record("signs", SIGNS, [("number", 1)])
        return layout


RATE = "node.rate"


@dataclass(frozen=True)
class PathFunctions(SteadyFunctions):
    """Local functions of a point of a path. rising: what rises with the load factor, by name: it
    itself, or constants, whose tangents are fields then. led: whether supports go with it, by
    `node.rate` (p) from where they are at the factor `reached`.
    """

    rising: tuple[str, ...] = ("load_factor",)
    led: bool = False

    @property
    def options(self) -> tuple[Any, ...]:
        return self.rising, self.led, self.resisting

    def of_node(self, fields: Fields, kind: NodeKind) -> tuple[BalanceProblem, Any]:
        return super().of_node(_led(fields, ""), kind)

    def of_element(self, fields: Fields, kind: ElementKind) -> tuple[BalanceProblem, Any]:
        for side in self.sides:
            fields = _led(fields, f"{side}.")
        return super().of_element(fields, kind)

    def of_ends(self, fields: Fields, kind: BetweenKind, topology: Framework) -> Ends:
        for side in kind.sides:
            fields = _led(fields, f"{side}.")
        return super().of_ends(fields, kind, topology)

    def pivot(self, block: Tensor) -> Fields:
        """The pivot block itself; nothing in a structure with an interface, where others are asked
        for.
        """
        return {PIVOT: block} if by_rows(self.model) else {}

    @property
    def samples(self) -> PathSamples:
        return PathSamples(self.model)


@dataclass(frozen=True)
class PathSamples(SampleFunctions):
    """Functions of a sample at a point of a path."""

    def judge(
        self,
        force: Tensor,
        moment: Tensor,
        least_force: Tensor,
        least_moment: Tensor,
        **sizes: Tensor,
    ) -> Fields:
        """Size of the residual, see `Residual.measure`."""
        force, moment = force.maximum(least_force), moment.maximum(least_moment)
        return {"size": self._size(force, moment, **sizes)}


def by_rows(model: Model) -> bool:
    """Whether the pivots of the elimination are those of rows and midside nodes, without an
    interface.
    """
    return not model.topology.cut.interface


def _led(fields: Fields, side: str) -> Fields:
    """A node where its support is; there already, but so that derivatives know it."""
    name, rate = f"{side}position", fields.get(f"{side}{RATE}")
    if rate is None:
        return fields
    return {**fields, name: fields[name] + (fields["load_factor"] - fields["reached"]) * rate}


def _or_else(
    function: Function, inputs: dict[str, tuple[int, ...]], others: dict[str, Sequence[int]]
) -> Function:
    """The function of these inputs that gives, where `slope` is not 0, these other nodes of its
    graph in the place of its outputs.
    """
    graph = function.graph
    still = graph.make("eq", graph.input("slope", 0), graph.zero)
    chosen = {
        name: function.outputs[name]._replace(
            nodes=tuple(
                graph.make("select", still, *pair)
                for pair in zip(function.outputs[name].nodes, nodes, strict=True)
            )
        )
        for name, nodes in others.items()
    }
    whole = Function(graph, {**inputs, "slope": ()}, {**function.outputs, **chosen})
    return whole.with_constants({dot("load_factor"): (1.0,)}).only(whole.outputs)


class PathProgram(RestProgram):
    """Of nodes the balance, of elements what they ask of their nodes and their gap: or the slopes
    of these by the load factor.
    """

    slots = PathSlots
    varying = "load_factor", "reached", "slope"
    numbers = "total", "longest", "least_force", "least_moment"
    judging = (*SUMS, *numbers)

    def _slopes(self, function: Function, traced: Tracing, of: list[str]) -> Function:
        """Of such outputs, by all that rises: on the function's graph."""
        return jvp(
            function, (x for x in function.inputs if without_side(x) in traced.local.rising), of
        )

    def _of_row(self, traced: Tracing, sort: Sort, kind: Any) -> Function:
        given = traced.of(sort) | dict.fromkeys(self.varying, ())
        if traced.local.led:
            sides = self.sides if sort in (ELEMENT, LOAD) else getattr(kind, "sides", ())
            names = [f"{side}.{RATE}" for side in sides] or [RATE]
            given |= dict.fromkeys(names, self.shapes["position"])
        whole = traced(partial(traced.local.balance(sort), kind), given)
        if sort is LOAD:
            return whole
        if sort is ELEMENT:
            return self._of_element(traced, whole)
        asked = self.asked(sort, kind)
        slope = self._slopes(whole, traced, asked)
        return _or_else(whole, slope.inputs, {x: slope.outputs[dot(x)].nodes for x in asked})

    def _of_element(self, traced: Tracing, element: Function) -> Function:
        """With what its slope asks of its nodes."""
        graph, outputs = element.graph, element.outputs
        slope = self._slopes(element, traced, ["gap", *(f"{side}.balance" for side in self.sides)])
        slopes = {name: out.nodes for name, out in slope.outputs.items()}
        fields = {name: outputs[name].shape for name in ("gap", "hB")}
        pushed = traced(traced.local.pushed, fields | traced.element).into(
            graph, {"gap": slopes[dot("gap")], "hB": outputs["hB"].nodes}
        )
        others = {
            f"{side}.asked": [
                graph.make("add", *pair)
                for pair in zip(slopes[dot(f"{side}.balance")], pushed[side], strict=True)
            ]
            for side in self.sides
        }
        return _or_else(element, slope.inputs, {"gap": slopes[dot("gap")], **others})

    def _layout(self) -> Layout:
        layout = super()._layout()
        if PIVOT in given_by_rows(self.functions):
            layout.record("row", NODES, [(PIVOT, self.w**2)])
            if "condense" in self.functions:
                layout.record("middle pivot", ELEMENTS, self.outputs("condense", PIVOT))
        layout.record("sample", ONE, [("over", 1)])
        return layout
