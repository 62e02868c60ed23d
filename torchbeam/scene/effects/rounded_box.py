"""Rounded box: the surface of a body, as what touches it sees it. A ball, a capsule and a round bar
are boxes, too, whose halves are 0 across their axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ...core.leaves import Tree, leaf, own_leaves
from ...core.validation import shown
from ...math import quaternions as quat
from .obstacles import Box, Capsule, Cylinder, Obstacle, Sphere

SIGNS = tuple((x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0))


@dataclass(frozen=True)
class RoundedBox(Tree):
    """All that is nearer than `rounding` (...) m to a box with sharp edges, in a body's axes: its
    centre (..., 3) m, its axes (..., 3, 3) as columns, half of its size (..., 3) m.
    """

    centre: Tensor = leaf(1)
    axes: Tensor = leaf(2)
    half: Tensor = leaf(1)
    rounding: Tensor = leaf(0)

    @classmethod
    def of(cls, shape: Obstacle) -> RoundedBox:
        """Of an obstacle whose numbers are tensors."""
        if isinstance(shape, Box):
            eye = torch.eye(3, dtype=shape.size.dtype, device=shape.size.device)
            turned = shape.rotation is not None
            axes = quat.matrix(quat.exponential(shape.rotation)) if turned else eye
            return cls(
                shape.centre, axes, shape.size / 2 - shape.rounding[..., None], shape.rounding
            )
        if isinstance(shape, Sphere):
            eye = torch.eye(3, dtype=shape.centre.dtype, device=shape.centre.device)
            return cls(shape.centre, eye, torch.zeros_like(shape.centre), shape.radius)
        if isinstance(shape, Capsule):
            along = (shape.b - shape.a) / 2
            length = torch.linalg.vector_norm(along, dim=-1)
            return cls._bar((shape.a + shape.b) / 2, along, length, shape.radius)
        length = shape.radius / torch.finfo(shape.radius.dtype).eps  # no end
        return cls._bar(shape.point, shape.axis, length, shape.radius)

    @classmethod
    def _bar(cls, centre: Tensor, along: Tensor, length: Tensor, radius: Tensor) -> RoundedBox:
        """About an axis (..., 3), whose half is a `length` (...) m."""
        e = along / torch.linalg.vector_norm(along, dim=-1, keepdim=True)
        least = torch.zeros_like(e).scatter(-1, e.detach().abs().argmin(-1, keepdim=True), 1.0)
        n = torch.linalg.cross(e, least)
        n = n / torch.linalg.vector_norm(n, dim=-1, keepdim=True)
        axes = torch.stack((e, n, torch.linalg.cross(e, n)), -1)
        length = length[..., None]
        half = torch.cat((length, torch.zeros_like(length), torch.zeros_like(length)), -1)
        return cls(centre, axes, half, radius)

    @property
    def corners(self) -> Tensor:
        """(..., 8, 3) m, body's axes, of the box without its rounding."""
        signs = self.half.new_tensor(SIGNS)
        local = signs * self.half[..., None, :]
        return self.centre[..., None, :] + local @ self.axes.mT

    @property
    def reach(self) -> Tensor:
        """(...) m from the body's centre: no place of the surface is further."""
        off = torch.linalg.vector_norm(self.centre, dim=-1)
        return off + torch.linalg.vector_norm(self.half, dim=-1) + self.rounding


def surface(name: str, shape: object) -> Obstacle:
    """A body's surface. Raises ValueError for what is none."""
    if not isinstance(shape, (Box, Capsule, Cylinder, Sphere)):
        raise ValueError(
            f"{shown(shape)} was given as {name}; a Sphere, Capsule, Cylinder or Box in the body's "
            "axes is wanted"
        )
    if isinstance(shape, Cylinder) and shape.inside:
        raise ValueError(
            f"a Cylinder with inside=True was given as {name}; what is solid within is wanted"
        )
    if any(callable(part.value) for part in own_leaves(shape)):
        raise ValueError(
            f"a {shape.called} that is a function of t was given as {name}; it moves with the "
            "body, and numbers are wanted"
        )
    if getattr(shape, "spin", None) is not None:
        raise ValueError(
            f"a {shape.called} with a spin was given as {name}; it turns with the body, and none "
            "is wanted"
        )
    return shape
