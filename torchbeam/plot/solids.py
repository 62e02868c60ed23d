"""Surfaces of what is solid as meshes of quadrilaterals: of obstacles, of bodies, of beams."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ..scene.effects.obstacle import Obstacle
from ..scene.effects.obstacles import Capsule, Cylinder, Plane, RoundedBox, Sphere

QUARTER = 7  # points along a quarter of a circle
SIDES = 12  # of a round beam
TRIES = 100  # to a surface, by its distance


class Mesh(NamedTuple):
    """Quadrilaterals (m, 4) of points (n, 3) m; dark (m) bool: those that show how it turns."""

    points: Tensor
    quads: Tensor
    dark: Tensor

    def moved(self, centre: Tensor, R: Tensor) -> Mesh:
        """At a centre (3) m with axes R (3, 3)."""
        return self._replace(points=self.points @ R.mT + centre)


def tube_mesh(axis: Tensor, across: Tensor, corners: Tensor) -> Mesh:
    """A beam along points (p, 3) m, whose sections have corners (p, k, 2) m, k even, in axes
    (p, 3, 2): of the first of its k sides, if these are more than four, every quadrilateral is
    dark.
    """
    count, sides = corners.shape[:2]
    points = axis[:, None] + corners @ across.mT
    ring = torch.arange(sides)
    first = sides * torch.arange(count - 1)[:, None] + ring
    right = sides * torch.arange(count - 1)[:, None] + (ring + 1) % sides
    quads = torch.stack((first, right, right + sides, first + sides), -1)
    dark = (ring == 0).expand(count - 1, sides) & (sides > 4)
    inner = torch.arange(1, sides - 1, 2)
    cap = torch.stack((torch.zeros_like(inner), inner + 2, inner + 1, inner), -1) % sides
    caps = torch.cat((cap, cap.flip(-1) + sides * (count - 1)))
    no = torch.zeros(len(caps), dtype=torch.bool)
    quads, dark = torch.cat((quads.flatten(0, 1), caps)), torch.cat((dark.flatten(), no))
    return Mesh(points.flatten(0, 1), quads, dark)


def rounds(radius: Tensor) -> Tensor:
    """Corners (p, SIDES, 2) m of round sections of radii (p) m."""
    turn = torch.arange(SIDES, dtype=radius.dtype) * (2 * math.pi / SIDES)
    return radius[:, None, None] * torch.stack((turn.cos(), turn.sin()), -1)


def surface_mesh(obstacle: Obstacle, size: float) -> Mesh:
    """Of an obstacle of one sample at one instant, as far as `size` (m) where it has no end; of
    what a user derived from `Obstacle`, none, unless it may be that of a body.
    """
    obstacle = obstacle.in_body
    if isinstance(obstacle, Plane):
        R = _axes(obstacle.normal)
        corners = obstacle.point.new_tensor([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        return _plain(obstacle.point + size * corners @ R.mT, torch.arange(4)[None])
    if isinstance(obstacle, Sphere):
        R = torch.eye(3, dtype=obstacle.centre.dtype)
        return _rounded(obstacle.centre, R, torch.zeros_like(obstacle.centre), obstacle.radius)
    if isinstance(obstacle, Cylinder):
        half = obstacle.point.new_tensor([0, 0, size])
        return _rounded(obstacle.point, _axes(obstacle.axis), half, obstacle.radius, ends=False)
    if isinstance(obstacle, Capsule):
        a, b = obstacle.a, obstacle.b
        half = torch.stack((a.new_zeros(()), a.new_zeros(()), (b - a).norm() / 2))
        return _rounded((a + b) / 2, _axes(b - a), half, obstacle.radius)
    if isinstance(obstacle, RoundedBox):
        return _rounded(obstacle.centre, obstacle.axes, obstacle.half, obstacle.radius)
    if obstacle.of_bodies:  # from its reach inward
        centre = getattr(obstacle, obstacle.PLACE)
        R, none = torch.eye(3, dtype=centre.dtype), torch.zeros_like(centre)
        mesh = _rounded(centre, R, none, 2 * obstacle.reach)
        inward, points = torch.nn.functional.normalize(centre - mesh.points), mesh.points
        for _ in range(TRIES):
            points = points + obstacle.distance(points) * inward
        return mesh._replace(points=points)
    return _plain(torch.empty(0, 3).double(), torch.empty(0, 4, dtype=torch.long))


def _plain(points: Tensor, quads: Tensor) -> Mesh:
    return Mesh(points, quads, torch.zeros(len(quads), dtype=torch.bool))


def _rounded(centre: Tensor, R: Tensor, half: Tensor, radius: Tensor, ends: bool = True) -> Mesh:
    """What is at most `radius` from a box of the sides 2 `half` (3) about a centre, with axes R:
    of the unit sphere's normals, octant by octant, each from its corner of the box. Without its
    `ends` along the third axis, the tube between these. Two opposite quarters are dark.
    """
    quarter = torch.linspace(0, math.pi / 2, QUARTER, dtype=half.dtype)
    around = torch.cat([quarter + k * math.pi / 2 for k in range(4)])
    signs = half.new_tensor([[1, 1], [-1, 1], [-1, -1], [1, -1]]).repeat_interleave(QUARTER, 0)
    up = torch.cat((quarter - math.pi / 2, quarter)) if ends else half.new_zeros(2)
    side = half.new_tensor([-1.0, 1.0]).repeat_interleave(len(up) // 2)
    flat = torch.stack((around.cos(), around.sin()), -1)
    rows, columns = len(up), len(around)
    shape = rows, columns, 1
    high = up.sin()[:, None, None].expand(shape)
    normal = torch.cat((up.cos()[:, None, None] * flat, high), -1)
    sign = torch.cat((signs.expand(rows, columns, 2), side[:, None, None].expand(shape)), -1)
    points = centre + (sign * half + radius * normal).flatten(0, 1) @ R.mT
    first = columns * torch.arange(rows - 1)[:, None] + torch.arange(columns)
    right = columns * torch.arange(rows - 1)[:, None] + (torch.arange(columns) + 1) % columns
    quads = torch.stack((first, right, right + columns, first + columns), -1).flatten(0, 1)
    dark = (torch.arange(columns) // QUARTER % 2 == 0).expand(rows - 1, columns).flatten()
    if ends and half[:2].any():  # faces across the third axis
        face = QUARTER * torch.arange(4)
        quads = torch.cat((quads, torch.stack((face.flip(0), face + columns * (rows - 1)))))
        dark = torch.cat((dark, dark.new_zeros(2)))
    return Mesh(points, quads, dark)


def _axes(direction: Tensor) -> Tensor:
    """Axes (3, 3), columns, of which the third has a direction (3)."""
    z = direction / direction.norm()
    x = torch.eye(3, dtype=z.dtype)[z.abs().argmin()]
    x = torch.linalg.cross(x, z)
    x = x / x.norm()
    return torch.stack((x, torch.linalg.cross(z, x), z), -1)
