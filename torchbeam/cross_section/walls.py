"""Walls of plies along lines: strips of quadrilaterals, and how they meet.

A wall's line has a station at each of its points. There lies a row of places across the wall, one
between all plies: on the mitre where the line turns, on the face of another wall where a wall
stands on it, straight across at a free end. Elements divide what lies between rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..core.arguments import choice, instance
from ..core.validation import as_tensor, common_dtype, finite, positive, refusal, shown
from ..math.shapes import stacked
from .blocks import along
from .elements import plain
from .material import Material, turned
from .mesh import MEETING, Mesh, grid, merged, ply_axes, points_of, with_middles

LINES = "middle", "first"
LEAST_ACROSS = 4  # elements across a wall
CURVED = 5  # segments from which on a line counts as a curve, with as few elements each as will do
ELEMENTS = 24  # along such a line, or one a segment
SMOOTH = 0.87  # cosine: below 30 degrees, what differs in thickness is taken up in an element
THINNEST = 5e-4  # of its width, a laminate: bending across it is lost in rounding beside stretching


@dataclass
class Wall:
    """A wall. points: (..., n, 2) m. thickness: of each ply (...) m. vertices: numbers of places,
    equal where lines share one. rows: of each station, its places across (..., plies + 1, 2).
    feet: of a station on which a wall stands, such rows between its plies (..., k, plies + 1, 2).
    """

    points: Tensor
    thickness: list[Tensor]
    angle: list[Tensor]
    material: list[Material]
    first: float  # of the thickness, to the right of the line
    vertices: list[int] = field(default_factory=list)
    rows: dict[int, Tensor] = field(default_factory=dict)
    feet: dict[int, Tensor] = field(default_factory=dict)

    @property
    def closed(self) -> bool:
        return self.vertices[0] == self.vertices[-1]

    @property
    def direction(self) -> Tensor:
        """(..., n - 1, 2) of its segments."""
        return torch.nn.functional.normalize(self.points.diff(dim=-2), dim=-1)

    @property
    def offsets(self) -> Tensor:
        """(..., plies + 1) m to the left of the line."""
        t = torch.stack(torch.broadcast_tensors(*self.thickness), -1)
        return torch.nn.functional.pad(t.cumsum(-1), (1, 0)) - self.first * t.sum(-1, keepdim=True)

    def end(self, station: int) -> tuple[Tensor, Tensor]:
        """Direction away from an end, station 0 or -1, and offsets to the left of it."""
        if station == 0:
            return self.direction[..., 0, :], self.offsets
        return -self.direction[..., -1, :], -self.offsets.flip(-1)


def thin_walled(walls: Sequence[Any], line: str, fineness: int) -> Mesh:
    """The mesh of walls (points, plies)."""
    first = 0.5 if choice("line", line, LINES) == "middle" else 0.0
    if not (isinstance(walls, (list, tuple)) and walls):
        raise refusal(f"walls = {shown(walls)}", "a list of one or more")
    parts = [_wall(wall, first) for wall in walls]
    _meet(parts)
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
    return thin_walled([(points, plies)], "middle", fineness)


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


def _meet(walls: list[Wall]) -> None:
    """Rows of places of all walls' stations."""
    known = [plain(wall.points).reshape(-1, *wall.points.shape[-2:])[0] for wall in walls]
    near = MEETING * np.ptp(np.concatenate(known), axis=0).max()
    places: list[np.ndarray] = []
    passing: dict[int, tuple[Wall, int]] = {}
    ends: dict[int, list[tuple[Wall, int]]] = {}
    for wall, points in zip(walls, known, strict=True):
        for p in points:
            same = [k for k, q in enumerate(places) if np.linalg.norm(p - q) <= near]
            wall.vertices.append(same[0] if same else len(places))
            places += [] if same else [p]
        if any(a == b for a, b in zip(wall.vertices, wall.vertices[1:], strict=False)):
            raise refusal("a wall with two equal points in a row", "different ones", are=True)
        inner = range(0 if wall.closed else 1, len(wall.vertices) - 1)
        for k in inner:
            if wall.vertices[k] in passing:
                raise refusal("two lines that cross at a point", "walls that end there", are=True)
            passing[wall.vertices[k]] = wall, k
            wall.rows[k] = _mitre(wall, k, wall, k)
        if not wall.closed:
            for station in (0, -1):
                ends.setdefault(wall.vertices[station], []).append((wall, station))
    for vertex, meeting in ends.items():
        if vertex in passing and len(meeting) == 1:
            _stand(*meeting[0], *passing[vertex])
        elif vertex in passing or len(meeting) > 2:
            raise refusal(
                f"{len(meeting) + (vertex in passing)} walls that meet at a point",
                "two ends, or one end within the line of another wall", were=True, are=True,
            )  # fmt: skip
        elif len(meeting) == 2:
            (a, i), (b, j) = meeting
            if len(a.thickness) != len(b.thickness):
                raise refusal("a corner of walls with different numbers of plies", "as many plies")
            row = _mitre(a, i, b, j)
            a.rows[i], b.rows[j] = row, (row.flip(-2) if i == j else row)
        else:
            wall, station = meeting[0]
            direction, offsets = wall.end(station)
            row = (
                wall.points[..., station, None, :]
                + offsets[..., None] * _left(direction)[..., None, :]
            )
            wall.rows[station] = row if station == 0 else row.flip(-2)


def _mitre(a: Wall, i: int, b: Wall, j: int) -> Tensor:
    """(..., plies + 1, 2) m, places between plies where wall a, coming, turns into wall b, by the
    order of a; within one line at station i, or of two ends.
    """
    if a is b and i == j:
        count = len(a.vertices) - 1
        come, go = a.direction[..., (i - 1) % count, :], a.direction[..., i, :]
        d_come = d_go = a.offsets
        place = a.points[..., i, :]
    else:
        (away, d_come), (go, d_go) = a.end(i), b.end(j)
        come, d_come, place = -away, -d_come.flip(-1), a.points[..., i, :]
    n, m = _left(come), _left(go)
    cosine = (n * m).sum(-1)[..., None, None]
    middle, half = (d_come + d_go)[..., None] / 2, (d_come - d_go)[..., None] / 2
    n, m = n[..., None, :], m[..., None, :]
    row = middle * (n + m) / (1 + cosine)
    if (plain(cosine) < SMOOTH).any():  # lines that differ in thickness meet at their crossing
        row = row + half * (n - m) / (1 - cosine)
    row = place[..., None, :] + row
    return row.flip(-2) if a is not b and i == 0 else row


def _stand(wall: Wall, station: int, base: Wall, k: int) -> None:
    """A wall whose end stands on the face of another, within its line at station k."""
    away, offsets = wall.end(station)
    count = len(base.vertices) - 1
    come, go = base.direction[..., (k - 1) % count, :], base.direction[..., k, :]
    along_base = torch.nn.functional.normalize(come + go, dim=-1)
    left = bool((plain((away * _left(along_base)).sum(-1)) > 0).all())
    row, place = base.rows[k], base.points[..., k, :]
    face = (row[..., -1 if left else 0, :] - place)[..., None, :]
    # place + offset n + lambda away = place + face + s along
    n = _left(away)[..., None, :]
    s = (offsets - (face * n).sum(-1)) / (along_base[..., None, :] * n).sum(-1)
    feet = s[..., None] * along_base[..., None, :]  # by the wall's order away from its end
    ends = place[..., None, :] + face + feet
    wall.rows[station] = ends if station == 0 else ends.flip(-2)
    backward = bool((plain(s[..., 0]) > plain(s[..., -1])).all())
    base.feet[k] = row[..., None, :, :] + (feet.flip(-2) if backward else feet)[..., None, :]


def _left(direction: Tensor) -> Tensor:
    y, z = direction.unbind(-1)
    return torch.stack((-z, y), -1)


def _across(plies: int) -> int:
    """Elements across each of so many plies."""
    return -(-LEAST_ACROSS // plies)


def _strip(wall: Wall, fineness: int) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Nodes, cells, stiffness, density and axes of a wall's elements."""
    direction, count = wall.direction, len(wall.vertices) - 1
    rows, tangents, steps = [], [], []
    for k in range(count if wall.closed else count + 1):
        station = -1 if k == count else k
        if k in wall.feet:
            feet = wall.feet[k]
            number = feet.shape[-3] - 1
            rows += list(feet.unbind(-3))
            mean = torch.nn.functional.normalize(
                direction[..., k, :] + direction[..., (k - 1) % count, :], dim=-1
            )
            tangents += [mean] * number
            share = 1 / (_across(number) * fineness)
            steps += [torch.full((_across(number) * fineness,), share, dtype=feet.dtype)] * number
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
    across = _across(len(wall.thickness)) * fineness
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
