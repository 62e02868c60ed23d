"""Polygons beside and within each other: a mesh of triangles whose nodes follow the corners."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..core.arguments import instance
from ..core.validation import broadcast, refusal, shown
from ..math.shapes import stacked
from .elements import plain
from .material import Material
from .mesh import Mesh, in_one_piece, meeting, of_materials, points_of
from .triangulation import Triangulation, crossing, within

ELEMENTS = 250  # at least, at fineness 1
THINNEST = 5e-5  # area over the perimeter's square: thinner ones take too many pieces

Part = tuple[Tensor, Material | None]


def polygons(parts: Sequence[Any], fineness: int) -> Mesh:
    """Mesh of polygons (..., n, 2) m and their materials, None of a hole; that of the first sample,
    which the others' nodes follow. A place within several belongs to the last of them.

    The nodes of an edge keep their shares of it, and those within move as the harmonic map of the
    edges does: a shape that is stretched or moved takes its mesh along.
    """
    parts = _parts(parts)
    broadcast("polygons", *(x.shape[:-2] for x, _ in parts))
    whole = stacked(*(x for x, _ in parts))
    every = plain(whole).reshape(-1, *whole.shape[-2:])
    number, first = meeting("polygons", every)
    corners, whole = every[0, first], whole[..., torch.from_numpy(first).to(whole.device), :]
    rings = np.split(number, np.cumsum([x.shape[-2] for x, _ in parts])[:-1])
    edges = np.concatenate([np.stack((ring, np.roll(ring, -1)), 1) for ring in rings])
    edges, which = np.unique(np.sort(edges, 1), axis=0, return_inverse=True)
    which = np.split(which.reshape(-1), np.cumsum([len(ring) for ring in rings])[:-1])
    filled = [material is not None for _, material in parts]
    single = (edges[:, 0] != edges[:, 1]).all() and not crossing(corners, edges)
    areas = _areas([corners[ring] for ring in rings], filled) if single else None
    if areas is None:
        raise refusal(
            "polygons whose edges cross or touch, or a hole outside of them or in another",
            "edges that meet at corners alone",
            are=True,
        )
    size = float(np.sqrt(2.3 * sum(areas) / ELEMENTS)) / fineness
    mesh = Triangulation(corners, edges, list(zip(which, filled, strict=True)), size)
    solid = [k for k, x in enumerate(filled) if x]
    if hidden := set(solid) - set(mesh.part.tolist()):
        wanted = "what lies within another behind that"
        raise refusal(f"a polygon, number {min(hidden) + 1}, below later ones", wanted)
    cells, sides = _with_sides(mesh.triangles, len(mesh.points))
    in_one_piece("polygons", cells[:, 3:])
    follow, still = _following(mesh), torch.from_numpy(corners).to(whole)
    follow = torch.from_numpy(np.concatenate((follow, follow[sides].mean(1)))).to(whole)
    places = np.concatenate((mesh.points, mesh.points[sides].mean(1)))
    nodes = torch.from_numpy(places).to(whole) + follow @ (whole - still)
    of_cell = torch.from_numpy(np.searchsorted(solid, mesh.part))
    materials = [material for _, material in parts if material is not None]
    return of_materials(nodes, torch.from_numpy(cells), materials, of_cell)


def _parts(parts: Sequence[Any]) -> list[Part]:
    if not (isinstance(parts, (list, tuple)) and parts):
        raise refusal(f"parts = {shown(parts)}", "a list of one or more")
    if not all(isinstance(part, (tuple, list)) and len(part) == 2 for part in parts):
        raise refusal(f"parts = {shown(parts)}", "(points, material) of each")
    return [
        (
            points_of("points" if material is not None else "a hole", points, least=3),
            material if material is None else instance("a material", material, Material),
        )
        for points, material in parts
    ]


def _areas(rings: list[np.ndarray], filled: list[bool]) -> list[float] | None:
    """Of each filled polygon (n, 2) what no later one within takes; None where a hole is not within
    one of these. Raises ValueError where one is too thin.
    """
    own = [abs(_area(ring)) for ring in rings]
    around = [np.linalg.norm(np.roll(ring, -1, 0) - ring, axis=1).sum() for ring in rings]
    areas, lengths = own.copy(), around.copy()
    for k, ring in enumerate(rings):
        outer = [j for j in range(k) if within(_inner(ring), rings[j], _edges(rings[j]))[0]]
        if not filled[k] and not (outer and filled[outer[-1]]):
            return None
        if outer:
            areas[outer[-1]] -= own[k]
            lengths[outer[-1]] += around[k]
    for area, length, solid in zip(areas, lengths, filled, strict=True):
        if solid and area < THINNEST * length**2:
            raise refusal(
                f"a polygon of an area of {area / length**2:.1e} of its perimeter's square",
                f"{THINNEST:g}, or thin_walled,",
            )
    return [area for area, solid in zip(areas, filled, strict=True) if solid]


def _inner(ring: np.ndarray) -> np.ndarray:
    """(1, 2), a point just within, at the middle of the longest edge."""
    along = np.roll(ring, -1, 0) - ring
    k = int(np.argmax((along**2).sum(1)))
    turned = np.array([-along[k, 1], along[k, 0]]) * np.sign(_area(ring))
    return (ring[k] + along[k] / 2 + 1e-7 * turned)[None]


def _edges(ring: np.ndarray) -> np.ndarray:
    k = np.arange(len(ring))
    return np.stack((k, np.roll(k, -1)), 1)


def _area(x: np.ndarray) -> float:
    y, z = x.T
    return float((y * np.roll(z, -1) - z * np.roll(y, -1)).sum() / 2)


def _with_sides(triangles: np.ndarray, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Cells (t, 6) with the nodes in the middle of sides, and the two ends of each of these."""
    pairs = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), 1)
    sides, number = np.unique(pairs, axis=0, return_inverse=True)
    return np.concatenate((triangles, points + number.reshape(-1, 3)), 1), sides


def _following(mesh: Triangulation) -> np.ndarray:
    """(p, corners): how points move with the corners; harmonic within, by linear elements."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import splu

    n, count = len(mesh.points), len(mesh.corners)
    on = np.flatnonzero(mesh.edge >= 0)
    inner = np.flatnonzero(mesh.edge < 0)
    follow = np.zeros((n, count))
    a, b = mesh.edges[mesh.edge[on]].T
    follow[on, a] = 1 - mesh.share[on]
    follow[on, b] += mesh.share[on]
    if not len(inner):
        return follow
    x = mesh.points[mesh.triangles]
    side = np.roll(x, -2, 1) - np.roll(x, -1, 1)  # opposite of each corner
    twice = np.abs(side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0])
    K = np.einsum("tia,tja->tij", side, side) / (2 * twice[:, None, None])
    rows = np.repeat(mesh.triangles, 3, 1).reshape(-1)
    columns = np.tile(mesh.triangles, (1, 3)).reshape(-1)
    K = coo_matrix((K.reshape(-1), (rows, columns)), shape=(n, n)).tocsr()
    follow[inner] = splu(K[inner][:, inner].tocsc()).solve(-(K[inner][:, on] @ follow[on]))
    return follow
