"""Stretches of tendons in a program: their functions, and the records that they need."""

from __future__ import annotations

from functools import partial

from ..compiler.function import Function
from .interactions import Derivative
from .layout import ONE, STRETCHES, TENDONS, Layout, cotangents
from .node_kinds import StretchKind, distinct
from .sorts import TIE
from .tendon_functions import SUMMED
from .tracing import Tracing

READINGS = 3  # numbers of a tendon in a state
PULL = {"tension": 1, "slope": 1, "ratio": 1, "by_q": 3, "turned": 3}
AT_STRETCH = {**dict.fromkeys(SUMMED, 1), "direction": 3}


def of_tensions(
    traced: Tracing,
    kinds: tuple[StretchKind, ...],
    varying: dict[str, tuple[int, ...]] | None = None,
) -> dict[str, Function]:
    """Functions by which tensions are known, by kind; varying: shapes of what changes with the
    iterations beside the unknowns.
    """
    shapes, functions = traced.stretch | (varying or {}), {}
    for name in ("stretch", "tension_first", "tension_next"):
        for k, kind in distinct(kinds, name.partition("_")[0]):
            function = partial(getattr(traced.local.of(TIE), name), kind)
            functions[f"{name.replace('_', ' ')} {k}"] = traced(function, shapes)
    return functions


def adjoint_of_stretches(
    traced: Tracing, kinds: tuple[StretchKind, ...], derivative: Derivative
) -> dict[str, Function]:
    """Functions of the adjoint, by kind."""
    functions = of_tensions(traced, kinds)
    ends = ("own.direction", "last.direction", "last.tension")
    sums = [f"beyond.{name}" for name in SUMMED]
    bars = {"stretch": ["u", "m"], "tension first": sums, "tension next": [*sums, *ends]}
    for name, place in bars.items():
        word = name.partition(" ")[0]
        for k, _ in distinct(kinds, word):
            whole = functions[f"{name} {k}"]
            of = () if word == "stretch" else ["tension"]
            functions[f"{name} {k} bar"] = derivative(whole, of, place)
    return functions


def record(layout: Layout) -> None:
    """Records of an iteration, and of the adjoint."""
    layout.record("at_stretch", STRETCHES, AT_STRETCH.items())
    layout.record("beyond", STRETCHES, dict.fromkeys(SUMMED, 1).items())
    layout.record("pull", STRETCHES, PULL.items())
    layout.record("tendon_state", TENDONS, [("tendons", READINGS)])


def record_adjoint(layout: Layout) -> None:
    """Records of the adjoint, but for those of constants."""
    record(layout)
    cotangents(layout, "tendon_state", TENDONS, [("tendons", READINGS)])
    layout.record("at_stretch_bar", STRETCHES, AT_STRETCH.items())
    layout.record("beyond_bar", STRETCHES, dict.fromkeys(SUMMED, 1).items())
    layout.record("pull_bar", STRETCHES, [("tension", 1)])
    layout.record("sums_bar", ONE, dict.fromkeys(SUMMED, 1).items())
