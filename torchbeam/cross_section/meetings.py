"""Meetings of walls: rows of places across them where lines turn, join, or stand on a face."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ..core.validation import refusal
from .elements import plain
from .mesh import MEETING
from .sharp_corners import sharpen
from .wall import Wall, first_number, first_sample, left, turns

End = tuple[Wall, int]  # a wall and its station 0 or -1


def meet(walls: list[Wall], by_depth: bool) -> None:
    """Rows of places of all walls' stations. by_depth: plies keep their depth from a wall to the
    next, and are divided for it; else each goes over into the one of its number.
    """
    known = [first_sample(wall.points, 2) for wall in walls]
    near = MEETING * np.ptp(np.concatenate(known), axis=0).max()
    passing, ends = _places(walls, known, near)
    pairs = []
    for vertex, meeting in ends.items():
        if len(meeting) > 2 or (vertex in passing and len(meeting) > 1):
            raise refusal(
                f"{len(meeting) + (vertex in passing)} walls that meet at a point",
                "two ends, or one end within the line of another wall", were=True, are=True,
            )  # fmt: skip
        if len(meeting) == 2:
            pairs.append((meeting[0], meeting[1]))
    if by_depth:
        _level(pairs, near)
    for wall, k in passing.values():
        offsets = wall.offsets
        wall.rows[k] = _mitre(wall.points[..., k, :], *wall.around(k), offsets, offsets)
    for pair in pairs:
        _join(*pair, by_depth)
    for vertex, meeting in ends.items():
        if vertex not in passing and len(meeting) == 1:
            _square(*meeting[0])
    for wall, k in passing.values():
        if turns(*wall.around(k)):
            sharpen((wall, k, -1), (wall, k, 1))
    for (a, i), (b, j) in pairs:
        if len(a.thickness) == len(b.thickness):
            sharpen((a, i, -1 if i else 1), (b, j, -1 if j else 1))
    for vertex, meeting in ends.items():
        if vertex in passing:
            _stand(*meeting[0], *passing[vertex])


def _places(
    walls: list[Wall], known: list[np.ndarray], near: float
) -> tuple[dict[int, End], dict[int, list[End]]]:
    """Numbers of the walls' places; of each within a line, that; of each at ends, these."""
    places: list[np.ndarray] = []
    passing: dict[int, End] = {}
    ends: dict[int, list[End]] = {}
    for wall, points in zip(walls, known, strict=True):
        for p in points:
            same = [k for k, q in enumerate(places) if np.linalg.norm(p - q) <= near]
            wall.vertices.append(same[0] if same else len(places))
            places += [] if same else [p]
        if any(a == b for a, b in zip(wall.vertices, wall.vertices[1:], strict=False)):
            raise refusal("a wall with two equal points in a row", "different ones", are=True)
        for k in range(0 if wall.closed else 1, len(wall.vertices) - 1):
            if wall.vertices[k] in passing:
                raise refusal("two lines that cross at a point", "walls that end there", are=True)
            passing[wall.vertices[k]] = wall, k
        if not wall.closed:
            for station in (0, -1):
                ends.setdefault(wall.vertices[station], []).append((wall, station))
    return passing, ends


def _level(pairs: list[tuple[End, End]], near: float) -> None:
    """Walls that run on into each other have divisions at the same depths."""
    groups: list[list[Wall]] = []
    for (a, i), (b, j) in pairs:
        if i == j:
            given = "walls joined by depth, of which two begin or two end at a point"
            raise refusal(given, "lines that run on from one into the next", are=True)
        joined = [group for group in groups if a in group or b in group]
        groups = [group for group in groups if group not in joined] + [sum(joined, [a, b])]
    for group in groups:
        depths: list[Tensor] = []
        for depth in (x for wall in group for x in wall.offsets.unbind(-1)):
            if all(abs(first_number(depth) - first_number(x)) > near for x in depths):
                depths.append(depth)
        for wall in group:
            wall.divide(depths, near)
        across = max(wall.across for wall in group)
        for wall in group:
            wall.across = across


def _join(one: End, other: End, by_depth: bool) -> None:
    """Two ends at a place: by ply, or each with its own plies on the line that halves the angle."""
    (a, i), (b, j) = one, other
    (away, d_come), (go, d_go) = a.end(i), b.end(j)
    place, d_come = a.points[..., i, :], -d_come.flip(-1)
    if not by_depth and len(a.thickness) != len(b.thickness):
        given = "a corner of walls with different numbers of plies"
        raise refusal(given, 'as many plies, or join="depth",', are=True)
    for wall, station, own, backward in ((a, i, d_come, i == 0), (b, j, d_go, j == -1)):
        row = _mitre(place, -away, go, *((own, own) if by_depth else (d_come, d_go)))
        wall.rows[station] = row.flip(-2) if backward else row


def _square(wall: Wall, station: int) -> None:
    """A free end."""
    direction, offsets = wall.end(station)
    row = wall.points[..., station, None, :] + offsets[..., None] * left(direction)[..., None, :]
    wall.rows[station] = row if station == 0 else row.flip(-2)


def _mitre(place: Tensor, come: Tensor, go: Tensor, d_come: Tensor, d_go: Tensor) -> Tensor:
    """(..., plies + 1, 2) m, places between plies where a line turns from `come` to `go` (..., 2),
    at these offsets (..., plies + 1) m before and behind.
    """
    n, m = left(come), left(go)
    cosine = (n * m).sum(-1)[..., None, None]
    middle, half = (d_come + d_go)[..., None] / 2, (d_come - d_go)[..., None] / 2
    n, m = n[..., None, :], m[..., None, :]
    row = middle * (n + m) / (1 + cosine)
    if turns(come, go):  # lines that differ in thickness meet at their crossing
        row = row + half * (n - m) / (1 - cosine)
    return place[..., None, :] + row


def _stand(wall: Wall, station: int, base: Wall, k: int) -> None:
    """A wall whose end stands on the face of another, within its line at station k."""
    away, offsets = wall.end(station)
    come, go = base.around(k)
    along_base = torch.nn.functional.normalize(come + go, dim=-1)
    to_left = bool((plain((away * left(along_base)).sum(-1)) > 0).all())
    row, place = base.rows[k], base.points[..., k, :]
    face = (row[..., -1 if to_left else 0, :] - place)[..., None, :]
    # place + offset n + lambda away = place + face + s along
    n = left(away)[..., None, :]
    s = (offsets - (face * n).sum(-1)) / (along_base[..., None, :] * n).sum(-1)
    feet = s[..., None] * along_base[..., None, :]  # by the wall's order away from its end
    ends = place[..., None, :] + face + feet
    wall.rows[station] = ends if station == 0 else ends.flip(-2)
    backward = bool((plain(s[..., 0]) > plain(s[..., -1])).all())
    feet = row[..., None, :, :] + (feet.flip(-2) if backward else feet)[..., None, :]
    base.feet[k] = feet, wall.across
