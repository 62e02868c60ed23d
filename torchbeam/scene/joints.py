"""Joints: what two parts of a structure, or a part and the ground, have in common where they meet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..core.arguments import instance
from ..core.leaves import Tree, leaf, with_values
from ..core.validation import Value, axis_last, concrete, finite
from .axes import axes_along
from .effects.values import plain
from .parts import check_node
from .structure import Structure

MET = {torch.float64: 1e-9, torch.float32: 1e-5}  # of the size of a structure: how far apart points that coincide may be
SQUARE = {torch.float64: 1e-9, torch.float32: 1e-5}  # cosine between axes that are at right angles


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
        """Of what a user writes: a node, (name of a body, point in its axes), or None. Raises ValueError otherwise."""
        if isinstance(given, JointEnd):
            return given
        if isinstance(given, tuple) and len(given) == 2 and isinstance(given[0], str) and not isinstance(given[1], int):
            point = axis_last("a joint's point", plain(given[1]), 3)
            finite("a joint's point", torch.as_tensor(point))
            return cls(given[0], point)
        if given is not None:
            check_node(given, "a joint's part")
        return cls(given)

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


@dataclass(frozen=True)
class Joint(Tree):
    """Base of all joints. What is held is said in the joint's own axes, as in `Support`: of the parts as they are drawn.

    a, b   what is joined: (name, number) of a beam's node, the name of a body, (name, (x, y, z)) with a point in a body's axes,
           or None, the ground
    at     (..., 3) m, frame a: where the joint sits, as drawn. None = where the parts' points are, which coincide

    position, rotation  letters of the axes along and about which b does not move against a
    """

    position: ClassVar[str] = "xyz"
    rotation: ClassVar[str] = "xyz"
    meets: ClassVar[bool] = True  # whether the points of both parts are one, as drawn
    apart: ClassVar[bool] = False  # whether each part has a point of its own

    a: Any
    b: Any
    at: Value | None = leaf(1, default=None, kw_only=True)

    def __post_init__(self) -> None:
        for name in ("a", "b"):
            object.__setattr__(self, name, JointEnd.of(getattr(self, name)))
        self._vector("at")
        if self.a.node is None and self.b.node is None:
            raise ValueError(f"a {self.called} of the ground with itself was given; a part is wanted")
        if self.at is not None and not self.apart and any(end.point is not None for end in (self.a, self.b)):
            raise ValueError(f"a {self.called} at a place and at a point of a body was given; one of them is wanted")

    def _vector(self, name: str) -> None:
        if (value := getattr(self, name)) is not None:
            value = axis_last(f"{self.called}'s {name}", plain(value), 3)
            finite(f"{self.called}'s {name}", torch.as_tensor(value))
            object.__setattr__(self, name, value)

    def __str__(self) -> str:
        return f"{self.called} of {' and '.join('the ground' if end.node is None else repr(end) for end in (self.a, self.b))}"

    @property
    def ends(self) -> tuple[int | None, int | None]:
        """Rows of the two nodes, None = the ground, of a joint in a scene."""
        return tuple(None if end.node is None else int(end.node) for end in (self.a, self.b))

    @property
    def holds(self) -> int:
        """How many components of the motion of b against a are held."""
        return len(self.position) + len(self.rotation)

    @property
    def acts(self) -> dict[str, Any]:
        """What acts in it, by name, where it is there."""
        return {name: value for name in ACTS if (value := getattr(self, name, None)) is not None}

    def drawn(self, structure: Structure) -> tuple[Tensor, Tensor, Tensor]:
        """The joint's point on a and on b (..., 3) m, and its axes (..., 3, 3), columns, of which x is the joint's: frame a, of
        the structure as drawn.
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
        """ValueError for what does not fit a structure: a part joined with itself, parts that do not meet as drawn."""
        if self.a.node == self.b.node:
            raise ValueError(f"a {self.called} of {self.a.node!r} with itself was given; two different nodes are wanted")
        if self.acts:
            raise ValueError(f"a {self.called} with {', '.join(self.acts)} was given; one that is free is wanted: what acts in "
                             "a joint is not there yet")
        if self.at is not None or self.apart or not self.meets or None in (self.a.node, self.b.node):
            return
        off = torch.linalg.vector_norm(self.a.drawn(structure) - self.b.drawn(structure), dim=-1).detach()
        if concrete(off > MET[off.dtype] * structure.size.detach()).any():
            raise ValueError(f"a {self.called} of {self.a!r} and {self.b!r}, which are {concrete(off).max().item():.4g} m apart, was "
                             "given; parts that meet as drawn are wanted, or at=")


@dataclass(frozen=True)
class Weld(Joint):
    """Nothing is left free: b moves with a as drawn, at whatever distance and angle."""

    meets = False


@dataclass(frozen=True)
class Ball(Joint):
    """b turns about a point of a, in any way."""

    rotation = ""


@dataclass(frozen=True)
class AxisJoint(Joint):
    """Base of joints with an axis.

    axis  (..., 3), frame a, as drawn; of any length
    """

    axis: Value = leaf(1, default=(1.0, 0.0, 0.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        self._vector("axis")

    def axes(self, structure: Structure) -> Tensor:
        return axes_along(self.axis, None)


@dataclass(frozen=True)
class DrivenJoint(AxisJoint):
    """Base of joints with one coordinate.

    stiffness, damping, friction, limits  of the coordinate
    """

    stiffness: Value | None = leaf(0, default=None, kw_only=True)
    damping: Value | None = leaf(0, default=None, kw_only=True)
    friction: Value | None = leaf(0, default=None, kw_only=True)
    limits: Value | None = leaf(1, default=None, kw_only=True)


@dataclass(frozen=True)
class Hinge(DrivenJoint):
    """b turns about an axis of a.

    torque  N m about the axis on b, its opposite on a: a number, a function of t, or an `Input`
    angle   rad, prescribed likewise
    """

    rotation = "yz"

    axis: Value = leaf(1, default=(0.0, 1.0, 0.0))
    torque: Value | Callable[[Tensor], Tensor] | None = leaf(0, default=None, kw_only=True)
    angle: Value | Callable[[Tensor], Tensor] | None = leaf(0, default=None, kw_only=True)


@dataclass(frozen=True)
class Slider(DrivenJoint):
    """b slides along an axis of a, and does not turn.

    force   N along the axis on b, its opposite on a: a number, a function of t, or an `Input`
    travel  m, prescribed likewise
    """

    position = "yz"
    meets = False

    force: Value | Callable[[Tensor], Tensor] | None = leaf(0, default=None, kw_only=True)
    travel: Value | Callable[[Tensor], Tensor] | None = leaf(0, default=None, kw_only=True)


@dataclass(frozen=True)
class Cylindrical(AxisJoint):
    """b slides along an axis of a, and turns about it."""

    position = "yz"
    rotation = "yz"
    meets = False


@dataclass(frozen=True)
class Universal(AxisJoint):
    """b turns about two axes that stay at right angles: `axis`, which is fixed in a, and `second`, fixed in b.

    second  (..., 3), frame a, as drawn; of any length
    """

    rotation = "z"

    second: Value = leaf(1, default=(0.0, 1.0, 0.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        self._vector("second")

    def axes(self, structure: Structure) -> Tensor:
        x, y = (v / torch.linalg.vector_norm(v, dim=-1, keepdim=True) for v in (self.axis, self.second))
        x, y = torch.broadcast_tensors(x, y)
        return torch.stack((x, y, torch.linalg.cross(x, y)), -1)

    def check(self, structure: Structure) -> None:
        super().check(structure)
        x, y, _ = self.axes(structure).detach().unbind(-1)
        off = (x * y).sum(-1).abs()
        if concrete(~(off <= SQUARE[off.dtype])).any():
            raise ValueError("a Universal with two axes that are not at right angles was given; such are wanted")


@dataclass(frozen=True)
class Distance(Joint):
    """The distance of a point of a from one of b stays as drawn: a rigid rod with a ball at either end. With the ground `at` is
    the point there.
    """

    position = ""
    rotation = ""
    apart = True

    @property
    def holds(self) -> int:
        return 1

    def __post_init__(self) -> None:
        super().__post_init__()
        ground = None in (self.a.node, self.b.node)
        if ground != (self.at is not None):
            raise ValueError("a Distance " + ("from the ground without at= was given; the point there is wanted" if ground else
                                              "of two parts with at= was given; it is between their own points"))

    def drawn(self, structure: Structure) -> tuple[Tensor, Tensor, Tensor]:
        a, b = (self.at if end.node is None else end.drawn(structure) for end in (self.a, self.b))
        a, b = torch.broadcast_tensors(a, b)
        return a, b, axes_along(b - a, None)

    def check(self, structure: Structure) -> None:
        super().check(structure)
        a, b = (self.at if end.node is None else end.drawn(structure) for end in (self.a, self.b))
        if concrete(torch.linalg.vector_norm(b - a, dim=-1).detach() <= MET[structure.nodes.dtype] * structure.size).any():
            raise ValueError(f"a Distance of {self.a!r} and {self.b!r}, which are at one place, was given; a Ball holds these")


ACTS = ("stiffness", "damping", "friction", "limits", "torque", "angle", "force", "travel")


def _numbers(x: Any) -> Any:
    return tuple(x.tolist()) if x.ndim == 1 else f"points {tuple(x.shape)}"


def joints_of(scene: Any) -> tuple[Joint, ...]:
    """The joints of a scene, their ends as rows of its structure. Raises ValueError for joints in a scene of one beam, of nodes
    that do not exist or lie within an element, of a node with itself, two at one place of the same two nodes, parts that do not
    meet as drawn, joints that are not there yet (springs and drives in them, small motions), and bodies without inertia which
    nothing keeps from turning.
    """
    structure, found = scene.beam, []
    for given in scene.joints:
        instance("a joint", given, Joint)
        if not structure.parts:
            raise ValueError(f"a {given.called} was given in a scene of one beam; parts by their names are wanted: "
                             "Scene({name: beam, ...})")
        joint = with_values(given, a=_resolved(given.a, structure), b=_resolved(given.b, structure))
        joint.check(structure)
        for other in found:
            if {joint.ends, joint.ends[::-1]} & {other.ends} and _together(joint, other, structure):
                raise ValueError(f"two joints of {joint.a!r} and {joint.b!r} at one place were given; one is wanted")
        found.append(joint)
    if found and scene.small:
        raise ValueError("small=True with joints was given; large rotations (small=False) are wanted there")
    for body in structure.masses:
        if body.inertia is None and not _kept(body.node, scene, found):
            raise ValueError(f"the body {body.node!r} without inertia was given, which nothing keeps from turning; an inertia, or a "
                             "Weld or a Slider, is wanted")
    return tuple(found)


def _resolved(end: JointEnd, structure: Structure) -> JointEnd:
    if end.node is None:
        return end
    row = structure.row(end.node, "a joint's part")
    part = structure.part_at(row)
    if end.point is not None and not part.body:
        raise ValueError(f"a joint at a point of {part.name!r} was given; ({part.name!r}, node) of the beam is wanted")
    if (row - part.first_node) % structure.order:
        raise ValueError(f"a joint of the node {row!r} was given, which lies within an element of order 2; an end of an element, "
                         "whose number is even, is wanted")
    return with_values(end, node=row)


def _together(one: Joint, other: Joint, structure: Structure) -> bool:
    """Whether two joints of the same nodes sit at one place."""
    a, b = ((joint.drawn(structure)[:2] if joint.ends == one.ends else joint.drawn(structure)[1::-1]) for joint in (one, other))
    off = sum(torch.linalg.vector_norm(x - y, dim=-1).detach() for x, y in zip(a, b, strict=True))
    return bool(concrete(off <= MET[off.dtype] * structure.size.detach()).all())


def _kept(node: int, scene: Any, joints: list[Joint]) -> bool:
    """Whether a support or a joint keeps a node from turning."""
    supports = scene.supports.given if hasattr(scene.supports, "given") else scene.supports
    return any(len(joint.rotation) == 3 for joint in joints if node in joint.ends) or any(
        scene.beam.row(support.node) == node for support in supports or () if len(support.rotation) == 3)
