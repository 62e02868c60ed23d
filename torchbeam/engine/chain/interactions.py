"""What acts between nodes in a program: its functions, and the records that it needs; and the kinds
of all sorts of rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from ..compiler.function import Function, Functions
from .interaction_functions import GAPS, end_reaction, free_blocks, is_block
from .interaction_sorts import INTERACTIONS
from .kinds import Kinds, distinct
from .layout import FLAGS, MULTIPLIERS, ONE, Layout, cotangents, largest
from .sorts import ELEMENT, LOAD, NODE, Sort
from .tracing import Shapes, Tracing

SUMS = (*GAPS, *FLAGS)  # what of an interaction a sample is judged by
Derivative = Callable[[Function, Sequence[str], Sequence[str]], Function]


def all_kinds(kinds: Kinds, sort: Sort) -> tuple[Any, ...]:
    """Of a sort of rows."""
    of = {NODE: kinds.nodes, ELEMENT: kinds.elements, LOAD: kinds.elements}
    return (of | dict(zip(INTERACTIONS, kinds.between, strict=True)))[sort]


def present(kinds: Kinds) -> list[Sort]:
    """What acts between nodes, as far as there is any."""
    return [sort for sort in INTERACTIONS if all_kinds(kinds, sort)]


def kept(kinds: Kinds, sort: Sort) -> int:
    """How many numbers a state has of each."""
    return max((kind.kept for kind in all_kinds(kinds, sort)), default=0)


def kinds_of(kinds: Kinds, sort: Sort) -> list[tuple[int, Any]]:
    """Those whose functions are not those of an earlier one, with their numbers."""
    every = all_kinds(kinds, sort)
    if sort in INTERACTIONS:
        return distinct(every, sort.name)
    return [(k, kind) for k, kind in enumerate(every) if sort is not LOAD or kind.loads]


def of_interaction(
    traced: Tracing, sort: Sort, kinds: Kinds, held: bool, function: Callable[[Any], Function]
) -> Functions:
    """Functions of an iteration, by kind; function: what gives pushes and blocks, of a kind."""
    functions = {}
    for k, kind in kinds_of(kinds, sort):
        functions[f"{sort.name} {k}"] = push = function(kind)
        if sort.far:
            functions[f"far {sort.name} {k}"] = far(traced, sort, kind)
        if held:
            functions |= _free(traced, f"free {sort.name} {k}", push, kind.sides)
            functions |= _reactions(traced, f"{sort.name} reaction {k}", push, kind.sides)
    return functions


def far(traced: Tracing, sort: Sort, kind: Any, varying: Shapes | None = None) -> Function:
    """Whether one of a kind is too far to act; varying: shapes of what is of an iteration."""
    return traced(partial(traced.local.far(sort), kind), traced.of(sort) | (varying or {}))


def _free(traced: Tracing, called: str, function: Function, sides: tuple[str, ...]) -> Functions:
    """See `free_blocks`; of the blocks that a function gives."""
    blocks = {name: shape for name, shape in _blocks(function) if {*name} & {*sides}}
    free = {f"{side}.free": (traced.local.model.space.unknowns,) for side in sides}
    return {called: traced(free_blocks, blocks | free)} if blocks else {}


def _reactions(
    traced: Tracing, called: str, function: Function, sides: tuple[str, ...]
) -> Functions:
    """See `end_reaction`; called: their names, but for the side."""
    w, functions = traced.local.model.space.unknowns, {}
    for side in sides:
        row = {name: shape for name, shape in _blocks(function) if name[0] == side}
        moves = {f"{name[1]}.move": (w,) for name in row}
        shapes = {"end_free": (w,)} | row | moves
        functions[f"{called} {side}"] = traced(partial(end_reaction, side), shapes)
    return functions


def _blocks(function: Function) -> list[tuple[str, tuple[int, ...]]]:
    return [(name, out.shape) for name, out in function.outputs.items() if is_block(name)]


def transposed(traced: Tracing, sort: Sort, kinds: Kinds, held: bool) -> Functions:
    """Functions of the transposed matrix, by kind, and of the solution between two states."""
    functions, fields = {}, traced.of(sort)
    for k, kind in kinds_of(kinds, sort):
        blocks = traced(partial(traced.local.transposed_interaction, sort, held, kind), fields)
        functions[f"{sort.name} blocks {k}"] = blocks
        if held:
            functions |= _free(traced, f"free {sort.name} {k}", blocks, kind.sides)
        if kind.multiplied:
            solution = partial(traced.local.of(sort).solution, kind)
            functions[f"{sort.name} solution {k}"] = traced(solution, fields)
        if sort.far:
            functions[f"far {sort.name} {k}"] = far(traced, sort, kind).only(["far"])
    return functions


def record(
    layout: Layout,
    functions: Functions,
    sort: Sort,
    kinds: Kinds,
    constants: list[tuple[str, int]],
    w: int,
) -> None:
    """Records of an iteration, and of a step where there are functions that finish one."""
    layout.record(sort.constants, sort.rows, constants)
    _record(layout, functions, sort, sort.name)
    blocks = layout.fields(f"{sort.name} blocks")
    layout.record("sums", ONE, [(name, 1) for name in SUMS if name in blocks])
    layout.record("end_reaction", ONE, [("total", w)])
    before = largest(functions, f"before {sort.name}")
    if before:
        layout.record(f"before {sort.name}", sort.rows, before.items())
    if kept(kinds, sort):
        layout.record(sort.state, sort.rows, [(sort.kept, kept(kinds, sort))])


def record_multipliers(layout: Layout, w: int) -> None:
    """Records of an iteration and of a step, where there are forces of constraints."""
    layout.record("sample", ONE, [("counted", 1)])
    layout.record("common", ONE, [("constraint_size", 1)])
    layout.record("multiplier_state", MULTIPLIERS, [("last_force", w)])
    layout.record("multiplier", MULTIPLIERS, [("force", w)])


def record_adjoint_of_multipliers(layout: Layout, functions: Functions, w: int) -> None:
    """Those of the adjoint."""
    read = any("last_force" in function.inputs for function in functions.values())
    layout.record("multiplier_state", MULTIPLIERS, [("last_force", w)] * read)
    cotangents(layout, "multiplier_state", MULTIPLIERS, [("last_force", w)])
    for name in ("multiplier", "multiplier_after", "multiplier_bar"):
        layout.record(name, MULTIPLIERS, [("force", w)])


def record_adjoint(layout: Layout, functions: Functions, sort: Sort, kinds: Kinds) -> None:
    """Records of the adjoint, but for those of constants."""
    _record(layout, functions, sort, f"{sort.name} blocks")
    if kept(kinds, sort):
        sizes = [(sort.kept, kept(kinds, sort))]
        layout.record(sort.state, sort.rows, sizes)
        cotangents(layout, sort.state, sort.rows, sizes)


def _record(layout: Layout, functions: Functions, sort: Sort, called: str) -> None:
    """called: the functions that give blocks."""
    for name in (called, f"far {sort.name}"):
        layout.record(f"{sort.name} blocks", sort.rows, largest(functions, name).items())
    if sort.far:
        layout.record("near", sort.rows, [("number", 1)])  # numbers of those that are not far
        layout.record("near_count", ONE, [("count", 1)])
