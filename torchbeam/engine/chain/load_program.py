"""Program of load stepping: the functions of Newton's method, and the rules of the
load's steps.
"""

from __future__ import annotations

from functools import partial

from ..compiler.function import Function
from .layout import INTERFACE, NODES, ONE, SIGNS, Layout
from .load_driver import LoadDriver
from .program import NewtonProgram
from .steady_functions import POSE, SteadyFunctions
from .tracing import Tracing

SAMPLE = (
    "over",
    "done",
    "before",
    "iterations",
    "status",
    "cosine",
    "turn",
    "climbing",
    "reached",
    "step",
    "good",
    "last_status",
    "whole",
    "indefinite",
)
RULES = {
    "first_step": ("turn",),
    "shares": ("reached", "step", "last_status"),
    "advanced": (
        "climbing",
        "load_factor",
        "reached",
        "step",
        "last_status",
        "done",
        "status",
        "cosine",
        "iterations",
    ),
}


class LoadProgram(NewtonProgram):
    """judged: whether it says of each equilibrium if the tangent is positive definite."""

    driver = LoadDriver
    unknown = "position", "rotation"
    varying = ("load_factor",)
    numbers = (*NewtonProgram.numbers, "least_force", "least_moment")
    judging = (*NewtonProgram.judging, "whole", "least_force", "least_moment")
    judged = False

    def _of_nodes(self, traced: Tracing, local: SteadyFunctions) -> dict[str, Function]:
        w, q = self.w, self.shapes["rotation"]
        node = {**traced.node, "load_factor": ()}
        functions = {
            "cosine": traced(local.cosine, {"before": q, "rotation": q}),
            "turn": traced(local.turn, {"move": (w,)}),
        }
        for k, kind in enumerate(self.kinds.nodes):
            functions[f"node {k}"] = traced(partial(local.node, kind), node)
            functions[f"update {k}"] = traced(partial(local.update, kind), {**node, "move": (w,)})
            if kind.placed is not None:
                pose = {f"pose.{name}": (size,) for name, size in POSE.items()}
                functions[f"place {k}"] = traced(partial(local.place, kind), node | pose)
        return functions | {
            name: traced(getattr(local, name), dict.fromkeys(fields, ()))
            for name, fields in RULES.items()
        }

    def _functions(self, traced: Tracing, local: SteadyFunctions) -> dict[str, Function]:
        functions = super()._functions(traced, local)
        for name, function in functions.items():
            if "indefinite" in function.outputs and not self.judged:
                functions[name] = function.only(
                    field for field in function.outputs if field != "indefinite"
                )
        return functions

    def _layout(self) -> Layout:
        layout = super()._layout()
        layout.record("pose", NODES, self.constants("pose"))
        layout.record("kept", NODES, self.outputs("update 0"))
        layout.record("change", ONE, [("cosine", 1), ("turn", 1)])
        layout.record("sample", ONE, [(name, 1) for name in SAMPLE])
        layout.record("ruled", ONE, [output for name in RULES for output in self.outputs(name)])
        if self.judged:
            layout.record("sums", ONE, [("indefinite", 1)])
        if self.judged and INTERFACE in self.kinds.runs:
            layout.record("signs", SIGNS, [("number", 1)])
        return layout


class JudgedProgram(LoadProgram):
    """Of loads that are conservative."""

    judged = True
