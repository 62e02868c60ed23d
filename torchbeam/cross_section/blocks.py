"""Sections of rectangles, and tubes: nodes and cells of boxes, I-beams, channels and angles."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ..math.shapes import stacked
from .mesh import grid, with_middles

ALONG, REST, ACROSS = 4, 2, 2  # elements near an end of a wall, from there to its middle, and
# from a face of a wall to its middle
REACH = 2.0  # thicknesses: how far from its ends stresses of torsion vary along a wall
MOST = 0.95  # of half a wall: something is left in its middle, however thick it is
AROUND, THROUGH = 24, 3  # elements of a tube
POWER = 2.0  # places grow from a corner as xi^POWER, because stresses do like r^(-1/3)


def blocks(
    rows: list[tuple[str, Tensor]],
    columns: list[tuple[str, Tensor]],
    present: tuple[str, ...],
    fineness: int,
) -> tuple[Tensor, Tensor]:
    """Nodes (..., n, 2) m and cells of blocks in rows along y and columns along z.

    Each has a length (...) m and a kind: "along" walls from corner to corner or free end, or across
    a wall with inner corners at "both" faces, at the "first" or at the "last". present: of each
    row, "1" where a block is. The origin is the outer corner of the first block.
    """
    near = [length for kind, length in (*rows, *columns) if kind != "along"]
    thickness = torch.stack(torch.broadcast_tensors(*near)).amin(0)
    lines, there = [], torch.tensor([[c == "1" for c in row] for row in present])
    for axis, parts in enumerate((rows, columns)):
        steps = [_steps(kind, length, thickness, fineness) for kind, length in parts]
        counts = torch.tensor([step.shape[-1] for step in steps])
        there = there.repeat_interleave(counts, axis)
        step = stacked(*steps, axis=-1)
        lines.append(with_middles(torch.nn.functional.pad(step.cumsum(-1), (1, 0))))
    cells, i, j = grid(there)
    y, z = (x[..., k.to(x.device)] for x, k in zip(lines, (i, j), strict=True))
    return torch.stack(torch.broadcast_tensors(y, z), -1), cells


def _steps(kind: str, length: Tensor, thickness: Tensor, fineness: int) -> Tensor:
    """(..., n) m, sizes of elements along a length (...) m."""
    if kind in ("first", "last"):
        steps = _graded(length, (ACROSS + 1) * fineness)
        return steps.flip(-1) if kind == "last" else steps
    if kind == "both":
        steps = _graded(length / 2, ACROSS * fineness)
        return torch.cat((steps, steps.flip(-1)), -1)
    return along(length, thickness, fineness)


def along(length: Tensor, thickness: Tensor, fineness: int) -> Tensor:
    """(..., n) m, sizes of elements along a wall of a `length` (...) m, finer at its ends."""
    half, count = length / 2, REST * fineness
    reach = half * (-torch.expm1(-REACH * thickness / half)).clamp(max=MOST)
    rest = ((half - reach) / count)[..., None]
    near = _graded(reach, ALONG * fineness)
    steps = stacked(near, rest.expand(*rest.shape[:-1], count), axis=-1)
    return torch.cat((steps, steps.flip(-1)), -1)


def _graded(length: Tensor, count: int) -> Tensor:
    xi = torch.linspace(0, 1, count + 1, dtype=length.dtype, device=length.device)
    return (length[..., None] * xi**POWER).diff()


def tube(outer: Tensor, inner: Tensor, fineness: int) -> tuple[Tensor, Tensor]:
    """Nodes (..., n, 2) m and cells between two radii (...) m, about the centre."""
    rings = THROUGH * fineness
    cells, i, j = grid(torch.ones(AROUND * fineness, rings, dtype=torch.bool), closed=True)
    i, j = i.to(outer), j.to(outer)
    share = j / (2 * rings)
    radius = outer[..., None] * share + inner[..., None] * (1 - share)
    turn = -math.pi * i / (AROUND * fineness)  # against the rings: elements are right-handed
    return radius[..., None] * torch.stack((torch.cos(turn), torch.sin(turn)), -1), cells


def box(width: Tensor, height: Tensor, t: Tensor, fineness: int) -> tuple[Tensor, Tensor]:
    """Nodes and cells about the centroid, as of those that follow."""
    rows, columns = (_between_walls(x, t) for x in (width, height))
    nodes, cells = blocks(rows, columns, ("111", "101", "111"), fineness)
    return _about(nodes, width / 2, height / 2), cells


def i_beam(
    width: Tensor, height: Tensor, flange: Tensor, web: Tensor, fineness: int
) -> tuple[Tensor, Tensor]:
    wing = (width - web) / 2
    rows = [("along", wing), ("both", web), ("along", wing)]
    nodes, cells = blocks(rows, _between_walls(height, flange), ("101", "111", "101"), fineness)
    return _about(nodes, width / 2, height / 2), cells


def channel(
    width: Tensor, height: Tensor, flange: Tensor, web: Tensor, fineness: int
) -> tuple[Tensor, Tensor]:
    rows = [("last", web), ("along", width - web)]
    nodes, cells = blocks(rows, _between_walls(height, flange), ("111", "101"), fineness)
    inner = height - 2 * flange
    centre = (2 * flange * width**2 + inner * web**2) / (2 * (2 * flange * width + inner * web))
    return _about(nodes, centre, height / 2), cells


def angle(width: Tensor, height: Tensor, t: Tensor, fineness: int) -> tuple[Tensor, Tensor]:
    rows, columns = ([("last", t), ("along", x - t)] for x in (width, height))
    nodes, cells = blocks(rows, columns, ("11", "10"), fineness)
    area = 2 * t * (width + height - t)
    y = (t * width**2 + (height - t) * t**2) / area
    z = (t * height**2 + (width - t) * t**2) / area
    return _about(nodes, y, z), cells


def _between_walls(length: Tensor, thickness: Tensor) -> list[tuple[str, Tensor]]:
    """Bands of a length (...) m that begins and ends with a wall."""
    return [("last", thickness), ("along", length - 2 * thickness), ("first", thickness)]


def _about(nodes: Tensor, y: Tensor, z: Tensor) -> Tensor:
    return nodes - torch.stack(torch.broadcast_tensors(y, z), -1)[..., None, :]
