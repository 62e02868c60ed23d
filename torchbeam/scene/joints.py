"""Joints, by what they leave free."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from ..core.leaves import leaf
from ..core.validation import Value, concrete
from .axes import axes_along
from .joint import MET, Joint
from .structure import Structure

SQUARE = {torch.float64: 1e-9, torch.float32: 1e-5}  # cosine between axes that are at right angles


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
    distance = True

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
