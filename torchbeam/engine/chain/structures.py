"""Structures in a program: the functions of joints, of rows next to them, and of what is eliminated
from either end; the records that they need.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from ..compiler.function import Function
from ..compiler.split import HOISTED
from .layout import ELEMENTS, ENTRIES, INTERFACE, JOINTS, NODES, ONE, Layout
from .local_functions import LocalFunctions
from .node_kinds import JointKind
from .tracing import JOINT_READINGS, Shapes, Tracing

GAPS = "gap_position", "gap_rotation"
JUDGED = (*GAPS, "joint_size")
SIZES = "force", "moment", "left_force", "left_moment"
CHANGING = tuple(f"{side}.{name}" for side in "ij" for name in ("u", "m", "position", "rotation"))


def of_rows(
    local: LocalFunctions,
    traced: Tracing,
    packed: Callable[[Function], Function],
    row: Shapes,
    free: Shapes | None,
    runs: tuple[str, ...],
) -> dict[str, Function]:
    """Rows beside those of a chain: those of the interface, and of runs that are eliminated
    `backward`, from the last node on, or are `bordered`, between two nodes of the interface. packed:
    takes what nodes and elements give as they give it; row, free: fields of a row, and what is free
    around it, None = all is.
    """
    w, functions = local.model.space.unknowns, {}
    own = {name: shape for name, shape in row.items() if name not in ("ahead", "y")}
    for held in (False, True) if free else (False,):
        more = free if held else {}
        rows = {
            "interface": (partial(local.interface, held), own | {"push": (w,)}),
            "row backward": (partial(local.row, held, True), row),
            "row bordered": (partial(local.row, held), row | {"side": (w, w)}),
        }
        functions |= {
            f"held {name}" if held else name: packed(traced(function, shapes | more))
            for name, (function, shapes) in rows.items()
            if name == "interface" or name.removeprefix("row ") in runs
        }
    if "bordered" in runs:
        back = {"ahead": (w, w), "y": (w,), "next": (w,), "side": (w, w), "first": (w,)}
        functions["back bordered"] = traced(local.back, back)
    return functions


def of_joints(
    local: LocalFunctions, traced: Tracing, kinds: tuple[JointKind, ...], held: bool
) -> dict[str, Function]:
    """Functions of joints, by kind."""
    if not kinds:
        return {}
    w = local.model.space.unknowns
    functions = {"joint update": traced(local.joint_update, {"force": (w,), "move": (w,)})}
    for k, kind in enumerate(kinds):
        functions[f"joint {k}"] = traced(partial(local.joint, held, kind), traced.joint)
        if held:
            for side in kind.sides:
                rows = {
                    "end_free": (w,),
                    f"{side}.row": functions[f"joint {k}"].outputs[f"{side}.row"].shape,
                }
                moves = {f"{end}.move": (w,) for end in (*kind.sides, "joint")}
                functions[f"joint reaction {k} {side}"] = traced(
                    partial(local.joint_reaction, side), rows | moves
                )
    return functions


def record(
    layout: Layout,
    functions: dict[str, Function],
    constants: list[tuple[str, int]],
    w: int,
    kinds: int,
    held: bool,
) -> None:
    """Records of a structure; constants: of a joint; kinds: how many there are of joints."""

    def sizes(name: str) -> dict[str, int]:
        return {field: len(out.nodes) for field, out in functions[name].outputs.items()}

    for name, rows in (
        ("at_node", NODES),
        ("at_end", NODES),
        ("row", NODES),
        ("between", ELEMENTS),
    ):
        layout.records[name].rows = rows
    layout.record("row", NODES, [("side", w * w)])
    own = sizes("held interface" if held else "interface")
    blocks = [(name, own.pop(name)) for name in ("D", "L", "U", "right")]
    layout.record("interface", INTERFACE, blocks)
    layout.record("at_row", ONE, own.items())
    layout.record("push", NODES, [("push", w)])
    layout.record("matrix", ENTRIES, [("entry", 1)])
    layout.record("edge", ONE, [(name, w * w) for name in ("E", "pushed", "start")])
    layout.record("joint", JOINTS, constants)
    if not kinds:
        return
    layout.record("joint_state", JOINTS, [("joints", JOINT_READINGS), ("last_force", w)])
    layout.record("joint_unknown", JOINTS, [("force", w)])
    layout.record("joint_move", JOINTS, [("move", w)])
    layout.record("joint_reaction", ONE, [("reaction", w)])
    layout.record("joint_change", ONE, [("force", w)])
    for k in range(kinds):
        for field, size in sizes(f"joint {k}").items():
            layout.record(
                *(("at_joint", ONE) if field in GAPS else ("joint_blocks", JOINTS)), [(field, size)]
            )
        if f"finish joint {k}" in functions:
            layout.record("joint_change", ONE, sizes(f"finish joint {k}").items())
    hoisted = max(sizes(f"before joint {k}")[HOISTED] for k in range(kinds))
    layout.record("before joint", JOINTS, [(HOISTED, hoisted)])
    layout.record("sums", ONE, [(name, 1) for name in GAPS])
