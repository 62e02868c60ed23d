"""Programs of what is at rest: of load stepping, the functions of Newton's method, and the rules
of the load's steps.
"""

from __future__ import annotations

from typing import Any

from ..compiler.function import Function
from .layout import INTERFACE, NODES, ONE, SIGNS, Layout
from .load_driver import LoadSlots
from .program import NewtonProgram
from .steady_functions import POSE
from .tracing import Tracing

RULES = "first_step", "shares", "advanced"


class RestProgram(NewtonProgram):
    """Of what is at rest: the shape, and where supports have to be."""

    unknown = "position", "rotation"
    varying: tuple[str, ...] = ("load_factor",)

    def _beside(self, traced: Tracing) -> dict[str, Function]:
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

    def _of_samples(self, traced: Tracing) -> dict[str, Function]:
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

    def _functions(self, traced: Tracing) -> dict[str, Function]:
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
