"""The joints of a scene: their ends as rows of its structure, and whether all of them fit."""

from __future__ import annotations

from typing import Any

import torch

from ..core.arguments import instance
from ..core.leaves import with_values
from ..core.validation import concrete
from .joint import MET, Joint, JointEnd
from .parts import end_of_element, large_rotations
from .structure import Structure
from .supports import Support


def joints_of(scene: Any) -> tuple[Joint, ...]:
    """The joints of a scene, their ends as rows of its structure. Raises ValueError for joints in a
    scene of one beam, of nodes that do not exist or lie within an element, of a node with itself,
    two at one place of the same two nodes, parts that do not meet as drawn, joints with small
    motions, and bodies without inertia which nothing keeps from turning.
    """
    structure, joints = scene.beam, []
    for drawn in scene.joints:
        instance("a joint", drawn, Joint)
        if not structure.parts:
            raise ValueError(
                f"a {drawn.called} was given in a scene of one beam; parts by their names are "
                "wanted: Scene({name: beam, ...})"
            )
        joint = with_values(drawn, a=_resolved(drawn.a, structure), b=_resolved(drawn.b, structure))
        joint.check(structure)
        for other in joints:
            if {joint.ends, joint.ends[::-1]} & {other.ends} and _together(joint, other, structure):
                raise ValueError(
                    f"two joints of {joint.a!r} and {joint.b!r} at one place were given; one is "
                    "wanted"
                )
        joints.append(joint)
    if joints:
        large_rotations(scene, "joints")
    for body in structure.masses:
        if body.inertia is None and not _cannot_turn(body.node, scene, joints):
            raise ValueError(
                f"the body {body.node!r} without inertia was given, which nothing keeps from "
                "turning; an inertia is wanted, or a Weld or a Slider"
            )
    return tuple(joints)


def _resolved(end: JointEnd, structure: Structure) -> JointEnd:
    if end.node is None:
        return end
    row = end_of_element(structure, end.node, "a joint's part", "a joint of")
    return with_values(end, node=row)


def _together(one: Joint, other: Joint, structure: Structure) -> bool:
    """Whether two joints of the same nodes sit at one place."""
    a, b = (
        (joint.drawn(structure)[:2] if joint.ends == one.ends else joint.drawn(structure)[1::-1])
        for joint in (one, other)
    )
    off = sum(torch.linalg.vector_norm(x - y, dim=-1).detach() for x, y in zip(a, b, strict=True))
    return bool(concrete(off <= MET[off.dtype] * structure.size.detach()).all())


def _cannot_turn(node: int, scene: Any, joints: list[Joint]) -> bool:
    """Whether a support or a joint keeps a node from turning."""
    supports = getattr(scene.supports, "given", scene.supports)
    supports = [x for x in supports or () if isinstance(x, Support)]  # others are refused later
    held = [scene.beam.row(x.node) for x in supports if len(x.rotation) == 3]
    return node in held or any(len(x.rotation) == 3 for x in joints if node in x.ends)
