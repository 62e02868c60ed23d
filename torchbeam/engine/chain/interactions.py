"""Interactions in a program: their functions, and the records that they need."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from ..compiler.function import Function
from .interaction import FINISHED, INTERACTIONS, Interaction
from .interaction_functions import GAPS, end_reaction, free_blocks, is_block
from .layout import FLAGS, MULTIPLIERS, ONE, Layout, cotangents, largest
from .local_functions import LocalFunctions
from .node_kinds import Kinds, distinct
from .tracing import Tracing

SUMS = (*GAPS, *FLAGS)  # what of an interaction a sample is judged by
Derivative = Callable[[Function, Sequence[str], Sequence[str]], Function]


def all_kinds(kinds: Kinds, one: Interaction) -> tuple[Any, ...]:
    """Of an interaction."""
    return dict(zip(INTERACTIONS, kinds.between, strict=True))[one]


def present(kinds: Kinds) -> list[Interaction]:
    """Those that there are."""
    return [one for one in INTERACTIONS if all_kinds(kinds, one)]


def kept(kinds: Kinds, one: Interaction) -> int:
    """How many numbers a state has of each."""
    return max((kind.kept for kind in all_kinds(kinds, one)), default=0)


def kinds_of(kinds: Kinds, one: Interaction) -> list[tuple[int, Any]]:
    """Those whose functions are not those of an earlier one, with their numbers."""
    return distinct(all_kinds(kinds, one), one.name)


def of_interaction(
    local: LocalFunctions,
    traced: Tracing,
    one: Interaction,
    kinds: Kinds,
    held: bool,
    function: Callable[[Any], Function],
) -> dict[str, Function]:
    """Functions of an iteration, by kind; function: what gives pushes and blocks, of a kind."""
    functions = {}
    for k, kind in kinds_of(kinds, one):
        functions[f"{one.name} {k}"] = own = function(kind)
        if one.far:
            functions[f"far {one.name} {k}"] = _far(local, traced, one, kind)
        if held:
            functions |= _free(local, traced, f"free {one.name} {k}", own, kind.sides)
            functions |= _reactions(local, traced, f"{one.name} reaction {k}", own, kind.sides)
    return functions


def _far(local: LocalFunctions, traced: Tracing, one: Interaction, kind: Any) -> Function:
    """Whether one of a kind is too far to act."""
    return traced(
        partial(getattr(local.of(one), f"far_{one.name}"), kind), getattr(traced, one.constants)
    )


def _free(
    local: LocalFunctions, traced: Tracing, called: str, function: Function, sides: tuple[str, ...]
) -> dict[str, Function]:
    """See `free_blocks`; of the blocks that a function gives."""
    blocks = {name: shape for name, shape in _blocks(function) if {*name} & {*sides}}
    free = {f"{side}.free": (local.model.space.unknowns,) for side in sides}
    return {called: traced(free_blocks, blocks | free)} if blocks else {}


def _reactions(
    local: LocalFunctions, traced: Tracing, called: str, function: Function, sides: tuple[str, ...]
) -> dict[str, Function]:
    """See `end_reaction`; called: their names, but for the side."""
    w, functions = local.model.space.unknowns, {}
    for side in sides:
        row = {name: shape for name, shape in _blocks(function) if name[0] == side}
        moves = {f"{name[1]}.move": (w,) for name in row}
        given = {"end_free": (w,)} | row | moves
        functions[f"{called} {side}"] = traced(partial(end_reaction, side), given)
    return functions


def _blocks(function: Function) -> list[tuple[str, tuple[int, ...]]]:
    return [(name, out.shape) for name, out in function.outputs.items() if is_block(name)]


def adjoint_of_interaction(
    local: LocalFunctions,
    traced: Tracing,
    one: Interaction,
    kinds: Kinds,
    held: bool,
    derivative: Derivative,
) -> dict[str, Function]:
    """Functions of the adjoint, by kind; derivative: see `AdjointProgram`."""
    functions, fields = {}, getattr(traced, one.constants)
    for k, kind in kinds_of(kinds, one):
        blocks = traced(partial(local.transposed_interaction, one, held, kind), fields)
        functions[f"{one.name} blocks {k}"] = blocks
        if held:
            functions |= _free(local, traced, f"free {one.name} {k}", blocks, kind.sides)
        if kind.multiplied:
            solution = partial(getattr(local.of(one), f"{one.name}_solution"), kind)
            functions[f"{one.name} solution {k}"] = traced(solution, fields)
        whole = traced(partial(getattr(local.of(one), one.name), kind), fields)
        asked = [f"{side}.push" for side in kind.sides] + ["right"] * kind.multiplied
        functions[f"{one.name} bar {k}"] = derivative(whole, asked, ())
        if one.far:
            functions[f"far {one.name} {k}"] = _far(local, traced, one, kind).only(["far"])
        if one not in FINISHED:
            continue
        finish = traced(partial(local.finished, one, kind), fields)
        functions[f"finish {one.name} bar {k}"] = derivative(finish, (), ("u", "m", "force"))
        if "rise" in finish.outputs:
            functions[f"ended {one.name} {k}"] = finish.only(["rise"])
    return functions


def record(
    layout: Layout,
    functions: dict[str, Function],
    one: Interaction,
    kinds: Kinds,
    constants: list[tuple[str, int]],
    w: int,
) -> None:
    """Records of an iteration, and of a step where there are functions that finish one."""
    layout.record(one.constants, one.rows, constants)
    _record(layout, functions, one, one.name)
    blocks = layout.fields(f"{one.name} blocks")
    layout.record("sums", ONE, [(name, 1) for name in SUMS if name in blocks])
    layout.record("end_reaction", ONE, [("total", w)])
    before = largest(functions, f"before {one.name}")
    if before:
        layout.record(f"before {one.name}", one.rows, before.items())
    if kept(kinds, one):
        layout.record(f"{one.name}_state", one.rows, [(one.kept, kept(kinds, one))])


def record_multipliers(layout: Layout, w: int) -> None:
    """Records of an iteration and of a step, where there are forces of constraints."""
    layout.record("sample", ONE, [("counted", 1)])
    layout.record("common", ONE, [("constraint_size", 1)])
    layout.record("multiplier_state", MULTIPLIERS, [("last_force", w)])
    layout.record("multiplier", MULTIPLIERS, [("force", w)])


def record_adjoint_of_multipliers(layout: Layout, functions: dict[str, Function], w: int) -> None:
    """Those of the adjoint."""
    read = any("last_force" in function.inputs for function in functions.values())
    layout.record("multiplier_state", MULTIPLIERS, [("last_force", w)] * read)
    cotangents(layout, "multiplier_state", MULTIPLIERS, [("last_force", w)])
    for name in ("multiplier", "multiplier_after", "multiplier_bar"):
        layout.record(name, MULTIPLIERS, [("force", w)])


def record_adjoint(
    layout: Layout, functions: dict[str, Function], one: Interaction, kinds: Kinds
) -> None:
    """Records of the adjoint, but for those of constants."""
    _record(layout, functions, one, f"{one.name} blocks")
    if kept(kinds, one):
        own = [(one.kept, kept(kinds, one))]
        layout.record(f"{one.name}_state", one.rows, own)
        cotangents(layout, f"{one.name}_state", one.rows, own)


def _record(layout: Layout, functions: dict[str, Function], one: Interaction, called: str) -> None:
    """called: the functions that give blocks."""
    for name in (called, f"far {one.name}"):
        layout.record(f"{one.name} blocks", one.rows, largest(functions, name).items())
    if one.far:
        layout.record("near", one.rows, [("number", 1)])  # numbers of those that are not far
        layout.record("near_count", ONE, [("count", 1)])
