"""Polygons with holes: a mesh of triangles whose nodes follow the corners."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ..core.validation import broadcast, refusal
from ..math.shapes import stacked
from .elements import plain
from .material import Material
from .mesh import Mesh, of_one_material
from .triangulation import Triangulation, crossing, within

ELEMENTS = 250  # at least, at fineness 1
THINNEST = (
    5e-5  # area over the perimeter's square: thinner ones take more pieces than they are worth
)


def polygon(corners: list[Tensor], material: Material, fineness: int) -> Mesh:
    """Mesh of a polygon and its holes, each (..., n, 2) m; that of the first sample, which the
    others' nodes follow.

    The nodes of an edge keep their shares of it, and those within move as the harmonic map of the
    boundary does: a shape that is stretched or moved takes its mesh along.
    """
    broadcast("polygons", *(x.shape[:-2] for x in corners))
    whole = stacked(*corners)
    joined = plain(whole).reshape(-1, *whole.shape[-2:])[0]
    parts = np.split(joined, np.cumsum([x.shape[-2] for x in corners])[:-1])
    area = abs(_area(parts[0])) - sum(abs(_area(x)) for x in parts[1:])
    edges = np.concatenate(
        [np.stack((np.arange(len(x)), np.roll(np.arange(len(x)), -1)), 1) + n
         for x, n in zip(parts, np.cumsum([0, *map(len, parts)]), strict=False)]
    )  # fmt: skip
    part = np.repeat(np.arange(len(parts)), [len(x) for x in parts])  # of each corner
    of_parts = [within(joined, joined, edges[part == k]) for k in range(len(parts))]
    around = sum(x & (part != k) for k, x in enumerate(of_parts))  # how many parts around a corner
    if area <= 0 or crossing(joined, edges) or (around[part > 0] != 1).any():
        raise refusal(
            "a polygon whose edges cross or touch, or a hole outside of it or in another",
            "edges that meet at corners alone",
            are=True,
        )
    around_it = sum(np.linalg.norm(np.roll(x, -1, 0) - x, axis=1).sum() for x in parts)
    if area < THINNEST * around_it**2:
        raise refusal(
            f"a polygon of an area of {area / around_it**2:.1e} of its perimeter's square",
            f"{THINNEST:g}, or thin_walled,",
        )
    mesh = Triangulation(parts, float(np.sqrt(2.3 * area / ELEMENTS)) / fineness)
    cells, sides = _with_sides(mesh.triangles, len(mesh.points))
    follow, first = _following(mesh), torch.from_numpy(joined).to(whole)
    follow = torch.from_numpy(np.concatenate((follow, follow[sides].mean(1)))).to(whole)
    places = np.concatenate((mesh.points, mesh.points[sides].mean(1)))
    nodes = torch.from_numpy(places).to(whole) + follow @ (whole - first)
    return of_one_material(nodes, torch.from_numpy(cells), material)


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
