"""Joint: what two parts of a structure, or a part and the ground, share where they meet; those of a
scene have their ends as rows of its structure, and all of them fit.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from ..core.arguments import instance
from ..core.declared import own, real_numbers
from ..core.leaves import Tree, leaf, option, with_values
from ..core.validation import Value, concrete, refusal
from .parts import check_node, end_of_element, large_rotations, node_and_point
from .structure import Structure
from .supports import Support

# of the size of a structure: how far apart points that coincide may be
# numbers may have come in single precision
MET = {torch.float64: 1e-6, torch.float32: 1e-5}
VECTOR = "{}'s {}"  # what sentences call a vector of a joint
PLACED = frozenset({"a", "b", "at", "axis", "second"})  # fields that say where it is


class CoordinateLaw(NamedTuple):
    """What acts along a coordinate, (...) each, None = nothing: what it resists by, see
    `DrivenJoint`, and what is given, with values that functions of t and inputs have: the effort,
    the torque about an angle or the force along a travel, or the coordinate itself, prescribed.
    """

    stiffness: Tensor | None = None
    damping: Tensor | None = None
    friction: Tensor | None = None
    slip_speed: Tensor | None = None
    lowest: Tensor | None = None
    highest: Tensor | None = None
    limit_stiffness: Tensor | None = None
    inertia: Tensor | None = None
    effort: Any = None
    prescribed: Any = None


@dataclass(frozen=True)
class JointEnd(Tree):
    """Where a joint sits on a part.

    node   (name, number) of a beam, or the name of a body; None = the ground
    point  (..., 3) m in a body's axes; None = at the node
    """

    node: int | str | tuple[str, int] | None
    point: Value | None = leaf(1, default=None)

    @classmethod
    def of(cls, given: Any) -> JointEnd:
        """Of a node, (name of a body, point in its axes), or None. Raises ValueError otherwise."""
        if isinstance(given, JointEnd):
            return given
        node, point = node_and_point(given)
        if point is not None:
            point = own(real_numbers("a joint's point", point, 3))
        elif node is not None:
            check_node("a joint's part", node)
        return cls(node, point)

    def __repr__(self) -> str:
        return repr(self.node) if self.point is None else f"({self.node!r}, {_numbers(self.point)})"

    def drawn(self, structure: Structure) -> Tensor | None:
        """(..., 3) m, frame a, where a resolved end is drawn; None = the ground."""
        if self.node is None:
            return None
        position = structure.nodes[..., self.node, :]
        if self.point is None:
            return position
        return position + (structure.axes[..., self.node, :, :] @ self.point[..., None])[..., 0]


def _end(name: str, value: Any) -> JointEnd:
    return JointEnd.of(value)


@dataclass(frozen=True)
class Joint(Tree):
    """Base of all joints. What is held is said in the joint's own axes, as in `Support`: of the
    parts as they are drawn.

    a, b   what is joined: (name, number) of a beam's node, the name of a body, (name, (x, y, z))
           with a point in a body's axes, or None, the ground
    at     (..., 3) m, frame a: where the joint sits, as drawn. None = where the parts' points are,
           which coincide

    position, rotation  letters of the axes along and about which b does not move against a
    """

    position: ClassVar[str] = "xyz"
    rotation: ClassVar[str] = "xyz"
    meets: ClassVar[bool] = True  # whether the points of both parts are one, as drawn
    distance: ClassVar[bool] = False  # whether a distance is held, from a point of a to one of b
    hysteresis = None  # law with memory of its coordinate
    drive = None  # `Drive` along its coordinate

    in_words = "a {}'s {}"

    a: Any = option(_end)
    b: Any = option(_end)
    at: Value | None = leaf(1, default=None, kw_only=True, size=3, copied=True, name=VECTOR)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.a.node is None and self.b.node is None:
            raise refusal(f"a {self.called} of the ground with itself", "a part")
        points = any(end.point is not None for end in (self.a, self.b))
        if self.at is not None and not self.distance and points:
            raise refusal(f"a {self.called} at a place and at a point of a body", "one of them")

    def __str__(self) -> str:
        ends = ("the ground" if end.node is None else repr(end) for end in (self.a, self.b))
        return f"{self.called} of {' and '.join(ends)}"

    @property
    def ends(self) -> tuple[int | None, int | None]:
        """Rows of the two nodes, None = the ground, of a joint in a scene."""
        return tuple(None if end.node is None else int(end.node) for end in (self.a, self.b))

    @property
    def holds(self) -> int:
        """How many components of the motion of b against a are held."""
        return len(self.position) + len(self.rotation)

    @property
    def coordinates(self) -> tuple[int, ...]:
        """Which it has: 0 an angle, 1 a travel or second angle; all three of a turn."""
        return tuple(k for k, held in enumerate((self.rotation, self.position)) if held == "yz")

    @property
    def acts(self) -> dict[str, Any]:
        """What acts in it, by name, where it is there."""
        names = [field.name for field in fields(self) if field.name not in PLACED]
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    def law(self, coordinate: int) -> CoordinateLaw:
        """What acts along a coordinate; nothing, where it is none of its `coordinates`."""
        return CoordinateLaw()

    def turning_resistance(self, length: Tensor) -> Tensor | None:
        """(...) N m/rad, the most by which it resists a turn of parts of a length (...) m in all;
        None = not.
        """
        found = None
        for k in self.coordinates:
            stiffness = self.law(k).stiffness
            if stiffness is not None:
                part = stiffness * (length**2 if k == 1 and self.position == "yz" else length**0)
                found = part if found is None else torch.maximum(found, part)
        return found

    def drawn(self, structure: Structure) -> tuple[Tensor, Tensor, Tensor]:
        """The joint's point on a and on b (..., 3) m, and its axes (..., 3, 3), columns, of which x
        is the joint's: frame a, of the structure as drawn.
        """
        a, b = (end.drawn(structure) for end in (self.a, self.b))
        a, b = b if a is None else a, a if b is None else b
        if self.at is not None:
            a = b = self.at
        elif not self.meets:
            a = b
        return (*torch.broadcast_tensors(a, b), self.axes(structure))

    def axes(self, structure: Structure) -> Tensor:
        """(..., 3, 3) columns, frame a, as drawn."""
        return torch.eye(3, dtype=structure.nodes.dtype, device=structure.nodes.device)

    def check(self, structure: Structure) -> None:
        """ValueError for a part joined with itself, and parts that do not meet as drawn."""
        if self.a.node == self.b.node:
            raise ValueError(
                f"a {self.called} of {self.a.node!r} with itself was given; two different nodes "
                "are wanted"
            )
        placed = self.at is not None or self.distance or not self.meets
        if placed or None in (self.a.node, self.b.node):
            return
        apart = self.a.drawn(structure) - self.b.drawn(structure)
        off = torch.linalg.vector_norm(apart, dim=-1).detach()
        if concrete(off > MET[off.dtype] * structure.size.detach()).any():
            gap = concrete(off).max().item()
            raise ValueError(
                f"a {self.called} of {self.a!r} and {self.b!r}, which are {gap:.4g} m apart, was "
                "given; parts that meet as drawn are wanted, or at="
            )


def _numbers(x: Any) -> Any:
    return tuple(x.tolist()) if x.ndim == 1 else f"points {tuple(x.shape)}"


def joints_of(scene: Any) -> tuple[Joint, ...]:
    """The joints of a scene, their ends as rows of its structure. Raises ValueError for joints in a
    scene of one beam, of nodes that do not exist or lie within an element, of a node with itself,
    two at one place of the same two nodes, parts that do not meet as drawn, balls with
    friction or a limit and small motions, an inertia to a ground that moves, and bodies without
    inertia which nothing keeps from turning.
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
        if "inertia" in joint.acts and None in joint.ends and scene.frame is not None:
            raise refusal(
                f"a {joint.called} with an inertia to the ground, which is frame a, beside a Frame",
                "a ground that stands still, or a joint of two parts,",
            )
        for other in joints:
            if {joint.ends, joint.ends[::-1]} & {other.ends} and _together(joint, other, structure):
                raise ValueError(
                    f"two joints of {joint.a!r} and {joint.b!r} at one place were given; one is "
                    "wanted"
                )
        joints.append(joint)
    for joint in joints:
        for name in ("friction", "limit"):
            if getattr(joint, name, None) is not None and len(joint.coordinates) == 3:
                large_rotations(scene, f"the {name} of a {joint.called}")
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
