"""Walls of plies along lines: strips of quadrilaterals, and how they meet.

A wall's line has a station at each of its points. There lies a row of places across the wall, one
between all plies: on the mitre where the line turns, on the face of another wall where a wall
stands on it, straight across at a free end. Elements divide what lies between rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import choice, instance
from ..core.validation import as_tensor, common_dtype, finite, positive, refusal, shown
from ..math.shapes import stacked
from .blocks import along
from .elements import plain
from .material import Material, turned
from .meetings import meet
from .mesh import Mesh, grid, merged, ply_axes, points_of, with_middles
from .wall import Wall

LINES = "middle", "first"
JOINS = "plies", "depth"
CURVED = 5  # segments from which on a line counts as a curve, with as few elements each as will do
ELEMENTS = 24  # along such a line, or one a segment
THINNEST = 5e-4  # of its width, a laminate: bending across it is lost in rounding beside stretching


def thin_walled(walls: Sequence[Any], line: str, join: str, fineness: int) -> Mesh:
    """The mesh of walls (points, plies)."""
    first = 0.5 if choice("line", line, LINES) == "middle" else 0.0
    if not (isinstance(walls, (list, tuple)) and walls):
        raise refusal(f"walls = {shown(walls)}", "a list of one or more")
    parts = [_wall(wall, first) for wall in walls]
    meet(parts, choice("join", join, JOINS) == "depth")
    strips = [_strip(wall, fineness) for wall in parts]
    counts = [0]
    for nodes, *_ in strips:
        counts.append(counts[-1] + nodes.shape[-2])
    nodes, stiffness, density, axes = (
        stacked(*(strip[k] for strip in strips), axis=axis)
        for k, axis in ((0, -2), (2, -3), (3, -1), (4, -3))
    )
    cells = torch.cat([strip[1] + n for strip, n in zip(strips, counts, strict=False)])
    nodes, cells = merged(nodes, cells)
    return Mesh(nodes, cells.to(nodes.device), stiffness, density, axes)


def laminate(plies: Sequence[Any], width: Tensor, fineness: int) -> Mesh:
    """The mesh of a flat strip of plies, width (...) m along y."""
    zero = torch.zeros_like(width)
    points = torch.stack((torch.stack((-width, zero), -1), torch.stack((width, zero), -1)), -2) / 2
    wall = _wall((points, plies), 0.0)
    thickness = sum(plain(x) for x in wall.thickness)
    if (thickness < THINNEST * plain(width)).any():
        given = f"a laminate of {float((thickness / plain(width)).min()):.1e} of its width"
        raise refusal(given, f"a thickness of {THINNEST:g} of it")
    return thin_walled([(points, plies)], "middle", "plies", fineness)


def _wall(wall: Any, first: float) -> Wall:
    if not (isinstance(wall, (tuple, list)) and len(wall) == 2):
        raise refusal(f"a wall {shown(wall)}", "(points, plies)")
    points, plies = wall
    if not (isinstance(plies, (list, tuple)) and plies):
        raise refusal(f"plies = {shown(plies)}", "a list of one or more")
    points = points_of("points", points, least=2)
    if not all(isinstance(ply, (tuple, list)) and len(ply) == 3 for ply in plies):
        raise refusal(f"plies = {shown(plies)}", "(thickness, angle, material) of each")
    values = [[as_tensor(x, *common_dtype(x)) for x in ply[:2]] for ply in plies]
    return Wall(
        points,
        [positive("a ply's thickness", thickness) for thickness, _ in values],
        [finite("a ply's angle", angle) for _, angle in values],
        [instance("a ply's material", ply[2], Material) for ply in plies],
        first,
    )


def _strip(wall: Wall, fineness: int) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Nodes, cells, stiffness, density and axes of a wall's elements."""
    direction, count = wall.direction, len(wall.vertices) - 1
    rows, tangents, steps = [], [], []
    for k in range(count if wall.closed else count + 1):
        station = -1 if k == count else k
        if k in wall.feet:
            feet, across = wall.feet[k]
            number, across = feet.shape[-3] - 1, across * fineness
            rows += list(feet.unbind(-3))
            mean = torch.nn.functional.normalize(sum(wall.around(k)), dim=-1)
            tangents += [mean] * number
            steps += [torch.full((across,), 1 / across, dtype=feet.dtype)] * number
        else:
            rows.append(wall.rows[station])
        if k < count:
            tangents.append(direction[..., k, :])
            steps.append(None)
    rows += rows[:1] if wall.closed else []
    thickness = wall.offsets[..., -1] - wall.offsets[..., 0]
    lines, numbers = [], []
    for a, b, step in zip(rows[:-1], rows[1:], steps, strict=True):
        if step is None:
            step = _steps((b - a).mean(-2).norm(dim=-1), thickness, count, fineness)
        step = step.to(a)
        start = (step.cumsum(-1) - step)[..., None, None]
        lines.append(a[..., None, :, :] + start * (b - a)[..., None, :, :])
        numbers.append(step.shape[-1])
    lattice = stacked(*lines, rows[-1][..., None, :, :], axis=-3)
    across = wall.across * fineness
    share = torch.linspace(0, 1, across + 1, dtype=lattice.dtype, device=lattice.device)[:-1, None]
    low, high = lattice[..., :-1, None, :], lattice[..., 1:, None, :]
    lattice = torch.cat(((low + share * (high - low)).flatten(-3, -2), lattice[..., -1:, :]), -2)
    lattice = with_middles(lattice.transpose(-1, -2)).transpose(-1, -2)
    lattice = with_middles(lattice.movedim(-3, -1)).movedim(-1, -3)
    lattice = lattice[..., :-1, :, :] if wall.closed else lattice
    plies = len(wall.thickness)
    cells, *_ = grid(torch.ones(sum(numbers), plies * across, dtype=torch.bool), wall.closed)
    tangent = stacked(*(t[..., None, :] for t in tangents))
    i = torch.arange(len(numbers)).repeat_interleave(torch.tensor(numbers))
    i, j = torch.meshgrid(i, torch.arange(plies).repeat_interleave(across), indexing="ij")
    i, j = i.reshape(-1).to(lattice.device), j.reshape(-1).to(lattice.device)
    axes = [ply_axes(angle[..., None], tangent) for angle in wall.angle]
    stiffness = [
        turned(m.stiffness[..., None, :, :], R) for m, R in zip(wall.material, axes, strict=True)
    ]
    axes = torch.stack(torch.broadcast_tensors(*axes), -3)  # (..., intervals, plies, 3, 3)
    stiffness = torch.stack(torch.broadcast_tensors(*stiffness), -3)
    density = torch.stack(torch.broadcast_tensors(*(m.rho for m in wall.material)), -1)
    return (
        lattice.flatten(-3, -2),
        cells,
        stiffness[..., i, j, :, :],
        density[..., j],
        axes[..., i, j, :, :],
    )


def _steps(length: Tensor, thickness: Tensor, segments: int, fineness: int) -> Tensor:
    """(..., n) shares of elements between two stations of a line of so many segments."""
    if segments < CURVED:
        return along(length, thickness, fineness) / length[..., None]
    n = max(1, -(-ELEMENTS // segments)) * fineness
    return torch.full((n,), 1 / n, dtype=length.dtype, device=length.device)
