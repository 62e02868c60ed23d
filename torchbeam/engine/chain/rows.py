"""Rows in a program: functions by which nodes are eliminated, midside nodes element by element, and
the records that they need.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

from ..compiler.function import Function, Functions
from ..compiler.packing import Packing
from .layout import (
    BETWEEN,
    ELEMENT_PLACES,
    ELEMENTS,
    ENTRIES,
    INNER,
    INTERFACE,
    MIDDLE,
    NODES,
    ONE,
    Layout,
    sizes,
)
from .row_functions import MidsideFunctions, RowFunctions
from .sorts import SIDES
from .tracing import Shapes, Tracing

ROW, RUN = ("D", "L", "U", "rhs"), ("ahead", "y", "side")  # of the interface, of a run
BLOCKS = ("U", "L", "far_U", "far_L")  # of an element, beside those of its nodes
# what a midside node's move is made from, beside the moves of its element's ends
FOLLOWING = ("own", "by_i", "by_j")


def to_nodes(names: Iterable[str]) -> list[str]:
    """Of what an element gives: what is for the rows of its nodes."""
    return [name for name in names if name in BLOCKS or name.partition(".")[0] in SIDES[max(SIDES)]]


def _eliminating(
    condense: Functions, restore: Function, inside: Packing, inner: Packing
) -> tuple[Functions, Packing, dict[str, tuple[int, ...]]]:
    """Functions of midside nodes by name, from those that eliminate them, which take fields of the
    midside node (own.) and of the element (element.), and the one that restores them; what elements
    then give their ends, and the shapes of that.
    """
    names = {f"element.{name}": name for name in inner.fields}
    makers = [
        inner.taken(inside.taken(function, {f"own.{name}": name for name in inside.fields}), names)
        for function in condense.values()
    ]
    between = Packing(BETWEEN, makers, to_nodes(makers[0].outputs))
    middle = Packing(MIDDLE, between.made(), FOLLOWING)
    functions = dict(zip(condense, middle.made(), strict=True))
    functions["restore"] = middle.taken(restore, {name: name for name in FOLLOWING})
    return functions, between, {name: makers[0].outputs[name].shape for name in between.fields}


def record_midsides(layout: Layout, functions: Functions, element: str) -> None:
    """Records of what elements give, by the function of that name, and of their midside nodes."""
    last = "condense" if "condense" in functions else element
    layout.record("between", ELEMENT_PLACES, [(BETWEEN, sizes(functions, last)[BETWEEN])])
    if last == element:
        return
    layout.record("inner", ONE, [(INNER, sizes(functions, element)[INNER])])
    layout.record("middle", ELEMENTS, [(MIDDLE, sizes(functions, last)[MIDDLE])])


def of_rows(
    traced: Tracing,
    own: Packing,
    between: Packing,
    shapes: Shapes,
    held: bool,
    manners: tuple[str, ...],
    transposed: bool = False,
) -> Functions:
    """Functions of midside nodes, and of rows of the interface and of runs, as far as these
    `manners` ask for them, see `order.manners_of`: of runs that are eliminated onwards, `backward`,
    from the last node on, or are `bordered`, between two nodes of the interface that are eliminated
    later. own, between: what nodes and elements give, of these shapes, with "own." before those of
    nodes.
    """
    w, functions = traced.local.model.space.unknowns, {}
    of_rows, way = RowFunctions(traced.local), "transposed_" if transposed else ""
    midside = MidsideFunctions(of_rows)
    of = {name: getattr(of_rows, f"{way}{name}") for name in ("row", INTERFACE)}
    of |= {name: getattr(midside, f"{way}{name}") for name in ("condense", "restore")}
    given = {f"own.{name}": shapes[f"own.{name}"] for name in own.fields}
    given |= {"rhs": (w,)} if transposed else {}
    words = ("free", "push") if transposed else ("free",)
    if between.name == INNER:
        inner = given | {f"element.{name}": shapes[name] for name in between.fields}
        condense = {"condense": traced(partial(of["condense"], False), inner)}
        if held:
            around = inner | dict.fromkeys(words, (w,))
            condense["held condense"] = traced(partial(of["condense"], True), around)
        following = {"own": (w,), "by_i": (w, w), "by_j": (w, w), "before": (w,), "after": (w,)}
        restore = traced(of["restore"], following)
        functions, between, shapes = _eliminating(condense, restore, own, between)
    blocks = ("U", "L") if transposed else ("L", "U")  # of the elements before and behind a node
    sides = {
        f"{side}.{name.removeprefix(f'{end}.')}": name
        for side, end, block in zip(("left", "right"), "ji", blocks, strict=True)
        for name in between.fields
        if name.startswith(f"{end}.") or name == block
    }
    row = given | {called: shapes[name] for called, name in sides.items()}
    near = {f"{name}_{at}": (w,) for name in words for at in ("before", "here", "after")}
    of_run = row | {"ahead": (w, w), "y": (w,)}
    bordered = {"side": (w, w)}
    for is_held in (False, True) if held else (False,):
        whole = {
            INTERFACE: (
                partial(of[INTERFACE], is_held),
                row if transposed else row | {"push": (w,)},
            ),
            "row forward": (partial(of["row"], is_held), of_run),
            "row backward": (partial(of["row"], is_held, backward=True), of_run),
            "row bordered": (partial(of["row"], is_held), of_run | bordered),
        }
        for name, (function, fields) in whole.items():
            if any(manner.endswith(name.removeprefix("row ")) for manner in manners):
                one = traced(function, fields | near if is_held else fields)
                one = own.taken(one, {f"own.{field}": field for field in own.fields})
                functions[f"held {name}" if is_held else name] = between.taken(one, sides)
    back = {"ahead": (w, w), "y": (w,), "next": (w,)}
    functions["back"] = traced(of_rows.back, back)
    if "bordered" in manners:
        functions["back bordered"] = traced(of_rows.back, back | bordered | {"first": (w,)})
    return functions


def given_by_rows(functions: Functions) -> dict[str, int]:
    """Fields that functions of rows give, and how many components they have."""
    return {
        field: size
        for name in functions
        if name.removeprefix("held ").partition(" ")[0] in (INTERFACE, "row")
        for field, size in sizes(functions, name).items()
    }


def record(layout: Layout, functions: Functions, w: int) -> None:
    """Records of what is eliminated."""
    sizes = given_by_rows(functions)
    layout.record("row", NODES, [("ahead", w * w), ("y", w)])
    if "side" in sizes:
        layout.record("row", NODES, [("side", w * w)])
        layout.record("edge", ONE, [(name, w * w) for name in ("E", "pushed", "start")])
    if INTERFACE in functions:
        layout.record("interface", INTERFACE, [(name, sizes[name]) for name in ROW])
        layout.record("matrix", ENTRIES, [("entry", 1)])
