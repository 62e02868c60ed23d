"""Structures in a program: the functions of rows of the interface, and of what is eliminated from
either end; the records that they need.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from ..compiler.function import Function
from .layout import ELEMENT_PLACES, ENTRIES, INTERFACE, NODE_PLACES, NODES, ONE, Layout
from .local_functions import LocalFunctions
from .tracing import Shapes, Tracing

ROW = "D", "L", "U", "right"  # of the interface


def of_rows(
    local: LocalFunctions,
    traced: Tracing,
    packed: Callable[[Function], Function],
    row: Shapes,
    around: Shapes | None,
    runs: tuple[str, ...],
    transposed: bool = False,
) -> dict[str, Function]:
    """Rows beside those of a chain: those of the interface, and of runs that are eliminated
    `backward`, from the last node on, or are `bordered`, between two nodes of the interface that
    are eliminated later. packed: takes what nodes and elements give as they give it; row: fields of
    a row; around: those of what supports hold, None = there are none.
    """
    w, functions = local.model.space.unknowns, {}
    of_run = local.transposed_row if transposed else local.row
    of_interface = local.transposed_interface if transposed else local.interface
    own = {name: shape for name, shape in row.items() if name not in ("ahead", "y")}
    own |= {} if transposed else {"push": (w,)}
    for held in (False, True) if around else (False,):
        more = around if held else {}
        rows = {
            "interface": (partial(of_interface, held), own),
            "row backward": (partial(of_run, held, backward=True), row),
            "row bordered": (partial(of_run, held), row | {"side": (w, w)}),
        }
        functions |= {
            f"held {name}" if held else name: packed(traced(function, shapes | more))
            for name, (function, shapes) in rows.items()
            if name == "interface" or any(run.endswith(name.removeprefix("row ")) for run in runs)
        }
    if "bordered" in runs:
        back = {"ahead": (w, w), "y": (w,), "next": (w,), "side": (w, w), "first": (w,)}
        functions["back bordered"] = traced(local.back, back)
    return functions


def record(layout: Layout, functions: dict[str, Function], w: int, held: bool) -> None:
    """Records of a structure in an iteration."""
    record_system(layout, functions, w, held)
    layout.record("sample", ONE, [("counted", 1)])
    layout.record("push", NODES, [("push", w)])
    own = _sizes(functions, "held interface" if held else "interface")
    layout.record("at_row", ONE, [x for x in own.items() if x[0] not in ROW])


def record_system(layout: Layout, functions: dict[str, Function], w: int, held: bool) -> None:
    """Records of what is eliminated."""
    for name, rows in (
        ("at_node", NODE_PLACES),
        ("at_end", NODE_PLACES),
        ("row", NODES),
        ("between", ELEMENT_PLACES),
    ):
        layout.records[name].rows = rows
    layout.record("row", NODES, [("side", w * w)])
    own = _sizes(functions, "held interface" if held else "interface")
    layout.record("interface", INTERFACE, [(name, own[name]) for name in ROW])
    layout.record("matrix", ENTRIES, [("entry", 1)])
    layout.record("edge", ONE, [(name, w * w) for name in ("E", "pushed", "start")])


def _sizes(functions: dict[str, Function], name: str) -> dict[str, int]:
    """Components of a function's outputs."""
    return {field: len(out.nodes) for field, out in functions[name].outputs.items()}
