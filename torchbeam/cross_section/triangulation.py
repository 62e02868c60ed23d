"""Triangulation of polygons beside and within each other, by Delaunay refinement.

Points go in until no triangle is too large or too flat: at the centre of its circumcircle, or,
where that would come too near to an edge of the boundary, at the middle of the edge (Ruppert 1995,
"A Delaunay refinement algorithm for quality 2-dimensional mesh generation"). Edges whose diametral
circles are empty are edges of every Delaunay triangulation, which scipy (Qhull) gives; so no
constrained one is needed, and no mesher: of those with wheels `triangle` is not free for commercial
use, and `gmsh` is under the GPL.
"""

from __future__ import annotations

import numpy as np

SHAPE = 1.25  # largest circumradius by shortest edge: no angle below 24 degrees
FLAT = 1e-10
SMALLEST = 0.02  # of the wanted size: edges below are split no more
ROUNDS = 200
Array = np.ndarray


class Triangulation:
    """Corners `points` (p, 2), `triangles` (t, 3) of them counter-clockwise, and of each point its
    polygon's edge and its share along that (-1 and 0 within).

    corners: (c, 2), edges: (e, 2) numbers of theirs, each once. polygons: the edges (n,) of each,
    and whether it is filled; what several contain belongs to the last. part: of each triangle.
    """

    def __init__(
        self, corners: Array, edges: Array, polygons: list[tuple[Array, bool]], size: float
    ) -> None:
        self.corners, self.edges, self.polygons = corners, edges, polygons
        self.points, self.size = corners.copy(), size
        self.edge, self.share = np.full(len(corners), -1), np.zeros(len(corners))
        for end in (1, 0):
            self.edge[edges[:, end]], self.share[edges[:, end]] = np.arange(len(edges)), end
        # of the boundary: two points, the polygon's edge, the shares of both along it
        self.pieces, self.piece_edge = edges.copy(), np.arange(len(edges))
        self.piece_share = np.tile([0.0, 1.0], (len(edges), 1))
        self._split_long()
        for _ in range(ROUNDS):
            self._split_encroached()
            self.triangles = self._inside()
            if not self._refine():
                break
        self.part = self.parts(self.points[self.triangles].mean(1))

    def parts(self, points: Array) -> Array:
        """Of points (p, 2) the filled polygon that has them, or -1."""
        part = np.full(len(points), -1)
        for k, (edges, filled) in enumerate(self.polygons):
            part[within(points, self.corners, self.edges[edges])] = k if filled else -1
        return part

    def _split(self, which: Array) -> None:
        """These pieces of the boundary in two."""
        if not len(which):
            return
        edge, shares = self.piece_edge[which], self.piece_share[which]
        middle = self._middles(which)
        a, b = (self.corners[self.edges[edge, k]] for k in (0, 1))
        number = len(self.points) + np.arange(len(which))
        self.points = np.concatenate((self.points, a + middle[:, None] * (b - a)))
        self.edge, self.share = np.append(self.edge, edge), np.append(self.share, middle)
        second = np.stack((number, self.pieces[which, 1]), 1)
        second_share = np.stack((middle, shares[:, 1]), 1)
        self.pieces[which, 1], self.piece_share[which, 1] = number, middle
        self.pieces = np.concatenate((self.pieces, second))
        self.piece_edge = np.append(self.piece_edge, edge)
        self.piece_share = np.concatenate((self.piece_share, second_share))

    def _middles(self, which: Array) -> Array:
        """Shares where pieces are split: their middles; beside a corner, at a distance of `size`
        times a power of two, which two edges of a sharp corner then share.
        """
        shares, ends = self.piece_share[which], self.edges[self.piece_edge[which]]
        length = np.linalg.norm(self.corners[ends[:, 1]] - self.corners[ends[:, 0]], axis=1)
        middle = shares.mean(1)
        for k, at_corner in enumerate((shares[:, 0] == 0, shares[:, 1] == 1)):
            use = at_corner & ~((shares[:, 0] == 0) & (shares[:, 1] == 1))
            piece = (shares[:, 1] - shares[:, 0]) * length
            shell = self.size * 2.0 ** np.round(np.log2(piece / 2 / self.size))
            at = shares[:, 0] + shell / length if k == 0 else shares[:, 1] - shell / length
            middle = np.where(use, at, middle)
        return middle

    def _split_long(self) -> None:
        while len(which := np.flatnonzero(self._lengths() > self.size)):
            self._split(which)

    def _lengths(self) -> Array:
        return np.linalg.norm(
            self.points[self.pieces[:, 1]] - self.points[self.pieces[:, 0]], axis=1
        )

    def _split_encroached(self) -> None:
        from scipy.spatial import cKDTree

        for _ in range(ROUNDS):
            centre, radius = self.points[self.pieces].mean(1), self._lengths() / 2
            near = cKDTree(self.points).query_ball_point(
                centre, radius * (1 - 1e-9), return_length=True
            )
            which = np.flatnonzero((near > 0) & (2 * radius > SMALLEST * self.size))
            if not len(which):
                return
            self._split(which)

    def _inside(self) -> Array:
        from scipy.spatial import Delaunay

        triangles = Delaunay(self.points).simplices
        x = self.points[triangles]
        side = np.roll(x, -1, 1) - x
        twice = side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0]
        flat = np.abs(twice) < FLAT * (side**2).sum((1, 2))  # of points on one edge, by rounding
        triangles[twice < 0] = triangles[twice < 0][:, ::-1]
        return triangles[~flat & (self.parts(x.mean(1)) >= 0)]

    def _refine(self) -> bool:
        """Points for triangles that are too large or too flat; False where none is."""
        from scipy.spatial import cKDTree

        a, b, c = (self.points[self.triangles[:, k]] for k in range(3))
        u, v = b - a, c - a
        twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        uu, vv = (u * u).sum(1), (v * v).sum(1)
        offset = (vv[:, None] * u - uu[:, None] * v)[:, ::-1] * [-1, 1] / (2 * twice[:, None])
        radius = np.linalg.norm(offset, axis=1)
        shortest = np.sqrt(np.minimum(np.minimum(uu, vv), ((c - b) ** 2).sum(1)))
        flat = (radius > SHAPE * shortest) & (shortest > SMALLEST * self.size)
        bad = np.flatnonzero(flat | (radius > self.size))
        if not len(bad):
            return False
        bad = bad[np.argsort(-radius[bad])]
        centres, radius = (a + offset)[bad], radius[bad]
        pieces, length = self.points[self.pieces].mean(1), self._lengths()
        tree = cKDTree(pieces)
        reach = length.max() / 2
        chosen, split = [], set()
        taken = np.zeros(len(bad), dtype=bool)
        near_each = tree.query_ball_point(centres, reach)
        others = cKDTree(centres).query_ball_point(centres, radius)
        for k in range(len(bad)):
            if taken[k]:
                continue
            near = [i for i in near_each[k] if np.hypot(*(centres[k] - pieces[i])) < length[i] / 2]
            taken[others[k]] = True
            if near:
                split.update(i for i in near if length[i] > SMALLEST * self.size)
            else:
                chosen.append(k)
        new = centres[chosen]
        new = new[self.parts(new) >= 0]
        self._split(np.array(sorted(split), dtype=int))
        self.points = np.concatenate((self.points, new))
        self.edge = np.append(self.edge, np.full(len(new), -1))
        self.share = np.append(self.share, np.zeros(len(new)))
        return bool(len(new) or split)


def within(points: Array, corners: Array, edges: Array) -> Array:
    """Whether points (p, 2) lie within polygons of these edges, by the even-odd rule."""
    inside = np.zeros(len(points), dtype=bool)
    y, z = points.T
    for (ya, za), (yb, zb) in corners[edges]:
        if za != zb:
            inside ^= ((za > z) != (zb > z)) & (y < ya + (z - za) * (yb - ya) / (zb - za))
    return inside


def crossing(corners: Array, edges: Array) -> bool:
    """Whether two edges cross or touch, but at a corner of both; or go the same way from there."""
    p, q = corners[edges[:, 0]], corners[edges[:, 1]]

    def side(a: Array, b: Array, c: Array) -> Array:
        u, v = b - a, c - a
        return np.sign(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])

    i, j = np.triu_indices(len(edges), 1)
    apart = (edges[i][:, :, None] != edges[j][:, None, :]).all((1, 2))
    i, j = i[apart], j[apart]
    one = side(p[i], q[i], p[j]) * side(p[i], q[i], q[j])
    other = side(p[j], q[j], p[i]) * side(p[j], q[j], q[i])
    box = (np.minimum(p, q)[i] <= np.maximum(p, q)[j]) & (
        np.minimum(p, q)[j] <= np.maximum(p, q)[i]
    )
    corner, end = np.concatenate((edges, edges[:, ::-1])).T
    y, z = (corners[end] - corners[corner]).T
    turn = np.arctan2(z, y)
    order = np.lexsort((turn, corner))
    alike = (np.diff(corner[order]) == 0) & (np.diff(turn[order]) < FLAT)
    return bool(((one <= 0) & (other <= 0) & box.all(1)).any() or alike.any())
