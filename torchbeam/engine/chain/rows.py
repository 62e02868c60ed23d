"""Rows in a program: functions by which nodes are eliminated, and the records that they need."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from ..compiler.function import Function
from .layout import ENTRIES, INTERFACE, NODES, ONE, Layout, sizes
from .local_functions import LocalFunctions
from .tracing import Shapes, Tracing

ROW, RUN = ("D", "L", "U", "right"), ("ahead", "y", "side")  # of the interface, of a run


def of_rows(
    local: LocalFunctions,
    traced: Tracing,
    packed: Callable[[Function], Function],
    row: Shapes,
    around: Shapes | None,
    manners: tuple[str, ...],
    transposed: bool = False,
) -> dict[str, Function]:
    """Rows of the interface and of runs, as far as these `manners` ask for them, see
    `order.manners_of`: of runs that are eliminated onwards, `backward`, from the last node on, or
    are `bordered`, between two nodes of the interface that are eliminated later. packed: takes what
    nodes and elements give as they give it; row: fields of a row; around: those of what supports
    hold, None = there are none.
    """
    w, functions = local.model.space.unknowns, {}
    of_run = local.transposed_row if transposed else local.row
    of_interface = local.transposed_interface if transposed else local.interface
    own = row if transposed else row | {"push": (w,)}
    of_run_row = row | {"ahead": (w, w), "y": (w,)}
    back = {"ahead": (w, w), "y": (w,), "next": (w,)}
    bordered = {"side": (w, w)}
    for held in (False, True) if around else (False,):
        more = around if held else {}
        rows = {
            INTERFACE: (partial(of_interface, held), own),
            "row forward": (partial(of_run, held), of_run_row),
            "row backward": (partial(of_run, held, backward=True), of_run_row),
            "row bordered": (partial(of_run, held), of_run_row | bordered),
        }
        functions |= {
            f"held {name}" if held else name: packed(traced(function, shapes | more))
            for name, (function, shapes) in rows.items()
            if any(manner.endswith(name.removeprefix("row ")) for manner in manners)
        }
    functions["back"] = traced(local.back, back)
    if "bordered" in manners:
        functions["back bordered"] = traced(local.back, back | bordered | {"first": (w,)})
    return functions


def given_by_rows(functions: dict[str, Function]) -> dict[str, int]:
    """Fields that functions of rows give, and how many components they have."""
    return {
        field: size
        for name in functions
        if name.removeprefix("held ").partition(" ")[0] in (INTERFACE, "row")
        for field, size in sizes(functions, name).items()
    }


def record(layout: Layout, functions: dict[str, Function], w: int) -> None:
    """Records of what is eliminated."""
    given = given_by_rows(functions)
    layout.record("row", NODES, [("ahead", w * w), ("y", w)])
    if "side" in given:
        layout.record("row", NODES, [("side", w * w)])
        layout.record("edge", ONE, [(name, w * w) for name in ("E", "pushed", "start")])
    if INTERFACE in functions:
        layout.record("interface", INTERFACE, [(name, given[name]) for name in ROW])
        layout.record("matrix", ENTRIES, [("entry", 1)])
    layout.record("at_row", ONE, [x for x in given.items() if x[0] not in (*ROW, *RUN)])
