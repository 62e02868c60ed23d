"""Joints in a program: their functions, and the records that they need."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from ..compiler.function import Function
from .layout import JOINTS, ONE, Layout, largest
from .local_functions import LocalFunctions
from .node_kinds import SIDES, JointKind
from .tracing import JOINT_READINGS, Tracing

GAPS = "gap_position", "gap_rotation"
JUDGED = (*GAPS, "joint_size")


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
) -> None:
    """Records of an iteration, and of a step where there is `finish joint`; constants: of a joint;
    kinds: how many there are.
    """
    if not kinds:
        return
    layout.record("sample", ONE, [("counted", 1)])
    layout.record("common", ONE, [("joint_size", 1)])
    layout.record("joint", JOINTS, constants)
    layout.record("joint_state", JOINTS, [("joints", JOINT_READINGS), ("last_force", w)])
    layout.record("joint_unknown", JOINTS, [("force", w)])
    layout.record("joint_move", JOINTS, [("move", w)])
    layout.record("joint_reaction", ONE, [("reaction", w), ("total", w)])
    layout.record("joint_change", ONE, [("force", w), *largest(functions, "finish joint").items()])
    for field, size in largest(functions, "joint").items():
        where = ("at_joint", ONE) if field in GAPS else ("joint_blocks", JOINTS)
        layout.record(*where, [(field, size)])
    layout.record("before joint", JOINTS, largest(functions, "before joint").items())
    layout.record("sums", ONE, [(name, 1) for name in GAPS])


def record_adjoint(layout: Layout, functions: dict[str, Function], w: int, kinds: int) -> None:
    """Records of the adjoint, but for those of constants."""
    if not kinds:
        return
    read = any("last_force" in function.inputs for function in functions.values())
    layout.record("joint_state", JOINTS, [("joints", JOINT_READINGS), *[("last_force", w)] * read])
    for name in ("joint_after", "joint_unknown", "joint_asked"):
        layout.record(name, JOINTS, [("force", w)])
    layout.record("joint_move", JOINTS, [("move", w)])
    state = [("joint_force", w), ("joints", JOINT_READINGS)]
    for name in ("joint_state_bar", "joint_state_grad", "joint_start_bar"):
        layout.record(name, JOINTS, state)
    layout.record("joint_blocks", JOINTS, largest(functions, "joint blocks").items())
    for word in ("finish joint bar", "joint bar"):
        layout.record("of_joint", ONE, largest(functions, word).items())
