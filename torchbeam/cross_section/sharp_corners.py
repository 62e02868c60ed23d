"""Sharp corners, as a trailing edge: where the faces of two walls meet before their lines do.

A mitre would reach far back, past stations of the lines. So each place of the corner's row lies
where the surfaces of the two walls at its depth cross. The rows of the stations before lean
towards it: they divide each surface, up to the first row that has room, in the line's shares.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from .wall import Wall, first_number, first_sample, left

ROOM = 0.4  # of the line's length from the corner, within: from where on rows stand upright


class Side:
    """A wall from its station at a corner on, `step` (1 or -1) by step, to its next corner.

    Plies are in the order of a line that comes by one side and goes by the other. surfaces:
    (..., stations + 1, plies + 1, 2) m, the places between plies; lengths: (..., stations + 1) m
    along the line.
    """

    def __init__(self, wall: Wall, station: int, step: int, coming: bool) -> None:
        self.wall, self.station, self.backward = wall, station, coming == (step == 1)
        self.stations = wall.away(station, step)
        place = wall.points[..., station, :]
        direction = wall.direction[..., station - (step < 0 and station >= 0), :]
        upright = place[..., None, :] + wall.offsets[..., None] * left(direction)[..., None, :]
        rows = torch.broadcast_tensors(upright, *(wall.rows[k] for k in self.stations))
        rows = torch.stack(rows, -3)
        self.surfaces = rows.flip(-2) if self.backward else rows
        line = torch.stack([place, *(wall.points[..., k, :] for k in self.stations)], -2)
        self.lengths = _lengths(line)

    def put(self, station: int, row: Tensor) -> None:
        self.wall.rows[station] = row.flip(-2) if self.backward else row

    def lean(self, corner: Tensor, cuts: tuple[int, ...]) -> None:
        """Rows up to the first with room, from the `corner`'s row, whose places cut off so many
        segments of each surface.
        """
        deepest = int(np.argmax(cuts))
        for last in range(max(cuts) + 1, len(self.stations) + 1):
            rest = self._rest(corner, deepest, cuts[deepest], last)
            room = first_number(_lengths(rest)[..., -1]) / first_number(self.lengths[..., last])
            if room > ROOM:
                break
        else:
            return
        surfaces = [self._rest(corner, k, cut, last) for k, cut in enumerate(cuts)]
        for m in range(1, last):
            share = self.lengths[..., m] / self.lengths[..., last]
            self.put(self.stations[m - 1], torch.stack([_at(x, share) for x in surfaces], -2))

    def _rest(self, corner: Tensor, k: int, cut: int, last: int) -> Tensor:
        """(..., n, 2) m, a surface from the corner's row to a station."""
        rest = self.surfaces[..., cut + 1 : last + 1, k, :]
        first = corner[..., k, :].expand(*rest.shape[:-2], 2)
        return torch.cat((first[..., None, :], rest), -2)


def sharpen(one: tuple[Wall, int, int], other: tuple[Wall, int, int]) -> None:
    """Rows about a corner of two sides, each a wall, its station there, and the step away."""
    sides = Side(*one, coming=True), Side(*other, coming=False)
    a, b = (first_sample(side.surfaces, 3) for side in sides)
    cuts = [_crossing(a[:, k], b[:, k]) for k in range(a.shape[1])]
    if not any(map(any, cuts)):
        return
    row = torch.stack(
        [
            _meeting(*(x.surfaces[..., i : i + 2, k, :] for x, i in zip(sides, cut, strict=True)))
            for k, cut in enumerate(cuts)
        ],
        -2,
    )
    for side, cut in zip(sides, zip(*cuts, strict=True), strict=True):
        side.lean(row, cut)
        side.put(side.station, row)


def _crossing(a: np.ndarray, b: np.ndarray) -> tuple[int, int]:
    """The segments of two lines (n, 2) that cross, nearest to their beginning; the first two where
    none do.
    """
    for total in range(len(a) + len(b) - 3):
        for i in range(max(0, total - len(b) + 2), min(total, len(a) - 2) + 1):
            u, v, w = a[i + 1] - a[i], b[total - i + 1] - b[total - i], b[total - i] - a[i]
            cross = u[0] * v[1] - u[1] * v[0]
            s, t = (w[0] * v[1] - w[1] * v[0]), (w[0] * u[1] - w[1] * u[0])
            if cross and 0 <= s / cross <= 1 and 0 <= t / cross <= 1:
                return i, total - i
    return 0, 0


def _meeting(a: Tensor, b: Tensor) -> Tensor:
    """(..., 2) m, where the lines through two points each (..., 2, 2) cross."""
    (u, v), w = (x[..., 1, :] - x[..., 0, :] for x in (a, b)), b[..., 0, :] - a[..., 0, :]
    share = _cross(w, v) / _cross(u, v)
    return a[..., 0, :] + share[..., None] * u


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _lengths(line: Tensor) -> Tensor:
    """(..., n) m, from the first of the points (..., n, 2) of a line to each."""
    return torch.nn.functional.pad(line.diff(dim=-2).norm(dim=-1).cumsum(-1), (1, 0))


def _at(line: Tensor, share: Tensor) -> Tensor:
    """(..., 2) m, at a share (...) of the length of a line (..., n, 2)."""
    lengths = _lengths(line)
    along = share * lengths[..., -1]
    k = int((first_sample(lengths, 1)[1:-1] <= first_number(along)).sum())
    part = (along - lengths[..., k]) / (lengths[..., k + 1] - lengths[..., k])
    return torch.lerp(line[..., k, :], line[..., k + 1, :], part[..., None])
