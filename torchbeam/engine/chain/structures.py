"""Structures in a program: the functions of joints, of rows next to them, and of what is eliminated
from either end; the records that they need.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from ..compiler.function import Function
from ..compiler.split import HOISTED
from .layout import ELEMENT_PLACES, ENTRIES, INTERFACE, JOINTS, NODE_PLACES, NODES, ONE, Layout
from .local_functions import LocalFunctions
from .node_kinds import SIDES, JointKind
from .tracing import JOINT_READINGS, Shapes, Tracing

GAPS = "gap_position", "gap_rotation"
JUDGED = (*GAPS, "joint_size")
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


def adjoint_of_joints(
    local: LocalFunctions,
    traced: Tracing,
    kinds: tuple[JointKind, ...],
    held: bool,
    by: list[str],
    derivative: Callable[[Function, list[str]], Function],
) -> dict[str, Function]:
    """Functions of joints in the adjoint, by kind; by: what cotangents are asked of."""
    functions, fields = {}, traced.joint
    moves = [f"{side}.{name}" for side in SIDES[1] for name in ("u", "m")]
    for k, kind in enumerate(kinds):
        functions[f"joint solution {k}"] = traced(partial(local.joint_solution, kind), fields)
        blocks = partial(local.transposed_joint, held, kind)
        functions[f"joint blocks {k}"] = traced(blocks, fields)
        finish = traced(partial(local.finish_joint, kind), fields)
        functions[f"finish joint bar {k}"] = derivative(finish, [*by, *moves, "force"])
        if "rise" in finish.outputs:
            functions[f"ended joint {k}"] = finish.only(["rise"])
        joint = traced(partial(local.joint, False, kind), fields)
        pushes = [f"{side}.push" for side in kind.sides]
        functions[f"joint bar {k}"] = derivative(joint.only([*pushes, "right"]), by)
    return functions


def of_joints(
    local: LocalFunctions,
    traced: Tracing,
    kinds: tuple[JointKind, ...],
    held: bool,
    joint: Callable[[JointKind], Function],
) -> dict[str, Function]:
    """Functions of joints, by kind; joint: `joint` of a kind."""
    if not kinds:
        return {}
    w = local.model.space.unknowns
    functions = {"joint update": traced(local.joint_update, {"force": (w,), "move": (w,)})}
    for k, kind in enumerate(kinds):
        functions[f"joint {k}"] = joint(kind)
        if held:
            function, ends = functions[f"joint {k}"], (*kind.sides, "joint")
            functions |= reactions(local, traced, f"joint reaction {k}", function, kind.sides, ends)
    return functions


def reactions(
    local: LocalFunctions,
    traced: Tracing,
    called: str,
    function: Function,
    sides: tuple[str, ...],
    ends: tuple[str, ...],
) -> dict[str, Function]:
    """What a joint or a stretch of a tendon adds to the reactions of supports at its `sides`, by
    the rows that its function made and the moves of its ends; called: their names, but for the
    side.
    """
    w = local.model.space.unknowns
    moves = {f"{end}.move": (w,) for end in ends}
    return {
        f"{called} {side}": traced(
            partial(local.end_reaction, side, ends),
            {"end_free": (w,), f"{side}.row": function.outputs[f"{side}.row"].shape} | moves,
        )
        for side in sides
    }


def record(
    layout: Layout,
    functions: dict[str, Function],
    constants: list[tuple[str, int]],
    w: int,
    kinds: int,
    held: bool,
) -> None:
    """Records of a structure; constants: of a joint; kinds: how many there are of joints."""
    sizes = partial(_sizes, functions)
    _of_system(layout, functions, w, held)
    layout.record("sample", ONE, [("counted", 1)])
    layout.record("push", NODES, [("push", w)])
    own = sizes("held interface" if held else "interface")
    layout.record("at_row", ONE, [x for x in own.items() if x[0] not in ROW])
    layout.record("joint", JOINTS, constants)
    if not kinds:
        return
    layout.record("joint_state", JOINTS, [("joints", JOINT_READINGS), ("last_force", w)])
    layout.record("joint_unknown", JOINTS, [("force", w)])
    layout.record("joint_move", JOINTS, [("move", w)])
    layout.record("joint_reaction", ONE, [("reaction", w), ("total", w)])
    layout.record("joint_change", ONE, [("force", w)])
    for field, size in largest(functions, "joint").items():
        where = ("at_joint", ONE) if field in GAPS else ("joint_blocks", JOINTS)
        layout.record(*where, [(field, size)])
    for k in range(kinds):
        if f"finish joint {k}" in functions:
            layout.record("joint_change", ONE, sizes(f"finish joint {k}").items())
    hoisted = max(sizes(f"before joint {k}")[HOISTED] for k in range(kinds))
    layout.record("before joint", JOINTS, [(HOISTED, hoisted)])
    layout.record("sums", ONE, [(name, 1) for name in GAPS])


def record_adjoint(
    layout: Layout, functions: dict[str, Function], w: int, kinds: int, held: bool
) -> None:
    """Records of a structure in the adjoint, but for those of joints' constants."""
    _of_system(layout, functions, w, held)
    if not kinds:
        return
    read = any("last_force" in function.inputs for function in functions.values())
    layout.record("joint_state", JOINTS, [("joints", JOINT_READINGS), *[("last_force", w)] * read])
    layout.record("joint_after", JOINTS, [("force", w)])
    layout.record("joint_unknown", JOINTS, [("force", w)])
    layout.record("joint_asked", JOINTS, [("force", w)])
    layout.record("joint_move", JOINTS, [("move", w)])
    state = [("joint_force", w), ("joints", JOINT_READINGS)]
    for name in ("joint_state_bar", "joint_state_grad", "joint_start_bar"):
        layout.record(name, JOINTS, state)
    layout.record("joint_blocks", JOINTS, largest(functions, "joint blocks").items())
    for k in range(kinds):
        for name in (f"finish joint bar {k}", f"joint bar {k}"):
            layout.record("of_joint", ONE, _sizes(functions, name).items())


def _of_system(layout: Layout, functions: dict[str, Function], w: int, held: bool) -> None:
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


def largest(functions: dict[str, Function], name: str) -> dict[str, int]:
    """Components of the outputs of the functions of this name of all kinds ("name 0", ...), the
    most that one of them has.
    """
    sizes: dict[str, int] = {}
    for called in functions:
        if called.removeprefix(f"{name} ").isdigit():
            for field, size in _sizes(functions, called).items():
                sizes[field] = max(size, sizes.get(field, 0))
    return sizes


def _sizes(functions: dict[str, Function], name: str) -> dict[str, int]:
    """Components of a function's outputs."""
    return {field: len(out.nodes) for field, out in functions[name].outputs.items()}
