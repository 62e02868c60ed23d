"""Pairs that may touch in a program: their functions, and the records that they need."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from ..compiler.function import Function
from .layout import FLAGS, ONE, PAIRS, Layout, largest
from .local_functions import LocalFunctions
from .node_kinds import PAIR_SIDES, PairKind
from .pair_functions import PAIR_BLOCKS
from .tracing import Tracing


def of_pairs(
    local: LocalFunctions,
    traced: Tracing,
    kinds: tuple[PairKind, ...],
    held: bool,
    varying: tuple[str, ...] = (),
) -> dict[str, Function]:
    """Functions of an iteration, by kind; varying: see `NewtonProgram`."""
    functions = {}
    for k, kind in enumerate(kinds):
        functions[f"far pair {k}"] = traced(partial(local.far_pair, kind), traced.pair)
        given = traced.pair | {name: () for name in varying}
        functions[f"pair {k}"] = traced(partial(local.pair, kind), given)
        if held:
            functions[f"free pair {k}"] = _free(local, traced, kind)
            functions |= _reactions(local, traced, f"pair reaction {k}", kind)
    return functions


def _free(local: LocalFunctions, traced: Tracing, kind: PairKind) -> Function:
    """See `PairFunctions.free_pair`."""
    free = {f"{side}.free": (local.model.space.unknowns,) for side in PAIR_SIDES}
    q = local.coupled(kind)
    return traced(local.free_pair, dict.fromkeys(PAIR_BLOCKS, (q, q)) | free)


def _reactions(
    local: LocalFunctions, traced: Tracing, called: str, kind: PairKind
) -> dict[str, Function]:
    """See `PairFunctions.pair_reaction`; called: their names, but for the side."""
    w, q, functions = local.model.space.unknowns, local.coupled(kind), {}
    moves = {f"{side}.move": (w,) for side in PAIR_SIDES}
    for side in PAIR_SIDES:
        given = {"end_free": (w,)} | {side + other: (q, q) for other in PAIR_SIDES} | moves
        functions[f"{called} {side}"] = traced(partial(local.pair_reaction, side), given)
    return functions


def adjoint_of_pairs(
    local: LocalFunctions,
    traced: Tracing,
    kinds: tuple[PairKind, ...],
    held: bool,
    by: list[str],
    derivative: Callable[[Function, list[str]], Function],
) -> dict[str, Function]:
    """Functions of the adjoint, by kind; by: what cotangents are asked of."""
    functions = {}
    moves = [f"{side}.{name}" for side in PAIR_SIDES for name in ("u", "m")]
    for k, kind in enumerate(kinds):
        far = traced(partial(local.far_pair, kind), traced.pair)
        functions[f"far pair {k}"] = far.only(["far"])
        blocks = partial(local.transposed_pair, held, kind)
        functions[f"pair blocks {k}"] = traced(blocks, traced.pair)
        if held:
            functions[f"free pair {k}"] = _free(local, traced, kind)
        pair = traced(partial(local.pair, kind), traced.pair)
        pushes = pair.only([f"{side}.push" for side in PAIR_SIDES])
        functions[f"pair bar {k}"] = derivative(pushes, by)
        finish = traced(partial(local.finish_pair, kind), traced.pair)
        functions[f"finish pair bar {k}"] = derivative(finish, [*by, *moves])
        if "rise" in finish.outputs:
            functions[f"ended pair {k}"] = finish.only(["rise"])
    return functions


def record(
    layout: Layout,
    functions: dict[str, Function],
    constants: list[tuple[str, int]],
    w: int,
    kinds: int,
) -> None:
    """Records of an iteration, and of a step where there is `finish pair`; kinds: how many there
    are.
    """
    if not kinds:
        return
    layout.record("pair", PAIRS, constants)
    _record(layout, functions, "pair")
    layout.record("pair_reaction", ONE, [("reaction", w)])
    layout.record("sums", ONE, [(name, 1) for name in FLAGS])
    for name, size in largest(functions, "finish pair").items():
        layout.record("pair_change", ONE, [(name, size)])


def record_adjoint(layout: Layout, functions: dict[str, Function], kinds: int) -> None:
    """Records of the adjoint, but for those of constants."""
    if not kinds:
        return
    _record(layout, functions, "pair blocks")
    layout.record("pair_change", ONE, [("rise", 1)])
    for word in ("pair bar", "finish pair bar"):
        layout.record("of_pair", ONE, largest(functions, word).items())


def _record(layout: Layout, functions: dict[str, Function], blocks: str) -> None:
    for word in ("far pair", blocks):
        layout.record("pairs", PAIRS, largest(functions, word).items())
    layout.record("near", PAIRS, [("pair", 1)])  # numbers of those that are not far
    layout.record("near_count", ONE, [("count", 1)])
    layout.record("free_pair", ONE, largest(functions, "free pair").items())
