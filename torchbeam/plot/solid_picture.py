"""Solid picture: beams, bodies, tendons and obstacles of a scene in their sizes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import instance
from ..core.leaves import sent, with_values
from ..math import quaternions as quat
from ..scene.effects.contact import Contact
from ..scene.effects.obstacle import Obstacle
from ..scene.effects.obstacles import Cylinder, Plane
from ..scene.scene import Scene
from ..state.state import State
from ..state.state_check import of_mesh
from .axis import PLANES, axis_curve, nodes_of, rows_of
from .canvas import Axes, numbers
from .obstacles import ball_of, cut, in_axes, standing, surface_of
from .sections import Sections, across
from .solids import Mesh, rounds, surface_mesh, tube_mesh

SOLID, ROPE = "0.85", "0.25"  # colours of obstacles, of tendons
LIGHT = (0.3, -0.55, 0.78)  # from where it comes
RINGS = 400  # along a beam, at most
THIN = 0.003  # radius of a tendon, of the extent of all


@dataclass(frozen=True)
class SolidPicture:
    """On axes `ax`, of a `plane`, None = in space; color: None = by samples, or by parts."""

    scene: Scene
    ax: Axes
    plane: str | None
    sections: Sections
    color: Any = None

    @classmethod
    def of(cls, scene: Scene, state: Any, ax: Axes, seen: list[int], color: Any) -> SolidPicture:
        """On axes that show the coordinates `seen`. Raises ValueError for another scene."""
        instance("scene", scene, Scene)
        of_mesh(state, scene, "a state")
        plane = next((name for name, pair in PLANES.items() if list(pair) == seen), None)
        return cls(scene, ax, plane, Sections.of(scene, state), color)

    def reach(self, states: Any) -> Tensor:
        """Points (n, 3) m between which all beams, bodies and tendons of states are."""
        position, R = (_plain(x) for x in nodes_of(states))
        points = [position.flatten(0, 1), *self._ropes(states)]
        for k, (part, row) in enumerate(zip(self._parts(body=False), rows_of(states), strict=True)):
            wide = self.sections.corners(k, part, position.shape[1]).abs().max()
            sides = wide * torch.tensor([-1.0, 1.0]).double().expand(3, 2).mT
            points.append((position[:, row, None] + sides).reshape(-1, 3))
        for part in self._parts(body=True):
            surface = surface_of(self.scene, part)
            if surface is not None and not isinstance(surface, Cylinder):
                node = part.first_node
                mesh = surface_mesh(_plain_tree(surface), 0.0).points
                points.append((mesh @ R[:, node].mT + position[:, node, None]).flatten(0, 1))
        return torch.cat(points)

    def draw(self, state: State) -> list[Any]:
        """All that is solid in a state of one instant, with any batch; of obstacles the first
        sample's. Returns what it has drawn.
        """
        before = {*self.ax.get_children()}
        (self._in_space if self.plane is None else self._in_plane)(state)
        return [artist for artist in self.ax.get_children() if artist not in before]

    def _in_plane(self, state: State) -> None:
        plane = self.plane or ""
        seen = list(PLANES[plane])
        middle = _plain(self.scene.beam.nodes).flatten(0, -2).mean(0)
        for obstacle, turned in self._obstacles(state):
            cut(self.ax, plane, middle, obstacle.distance, SOLID)
            if turned is not None:
                self._spoke(turned, obstacle.radius, "0.4")
        for shade, axis, sides, corners in self._beams(state):
            outline = numbers(_outline(axis[:, seen], sides[:, seen], corners))
            self.ax.fill(*outline.T, fc=_mixed(shade, 0.3), ec=_mixed(shade, 0.3, "k"), lw=0.8)
        for shade, pose, ball in self._round_nodes(state):
            cut(self.ax, plane, pose[0], in_axes(ball, *pose), _mixed(shade, 0.3))
        for shade, pose, surface in self._bodies(state):
            if surface is None:
                self.ax.plot(*pose[0][seen], "s", ms=9, color=shade)
                continue
            cut(self.ax, plane, pose[0], in_axes(surface, *pose), _mixed(shade, 0.5))
            self._spoke(
                pose, -surface.distance(torch.zeros(1, 3).double())[0, 0], _mixed(shade, 0.3, "k")
            )
        for rope in self._ropes(state):
            self.ax.plot(*numbers(rope[:, seen]).T, color=ROPE, lw=1.0)

    def _spoke(self, pose: tuple[Tensor, Tensor], length: Tensor, color: Any) -> None:
        """A line from a centre that turns with its axes."""
        seen = list(PLANES[self.plane or ""])
        ends = torch.stack((pose[0], pose[0] + length * pose[1][:, seen[0]]))
        self.ax.plot(*numbers(ends[:, seen]).T, color=color, lw=1.2)

    def _in_space(self, state: State) -> None:
        from mpl_toolkits.mplot3d.art3d import Poly3DCollection

        ax = self.ax
        limits = torch.tensor([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()]).double()
        size = limits.diff(dim=-1).max().item() / 2
        behind, solid = [], []
        for obstacle, turned in self._obstacles(state):
            if isinstance(obstacle, Plane):
                behind.append((_plane_mesh(obstacle, limits), SOLID))
                continue
            mesh = surface_mesh(_about(obstacle, limits.mean(-1)), size)
            if turned is not None:
                mesh = mesh.moved(turned[0] - turned[1] @ turned[0], turned[1])
            layer = solid if obstacle.room is None else behind  # into a tube one sees
            layer.append((mesh, SOLID))
        for shade, axis, sides, corners in self._beams(state):
            solid.append((_tube(axis, sides, corners), shade))
        for shade, pose, ball in self._round_nodes(state):
            solid.append((surface_mesh(ball, size).moved(*pose), shade))
        for shade, pose, surface in self._bodies(state):
            if surface is None:
                ax.plot(*pose[0], "s", ms=9, color=shade)
                continue
            solid.append((surface_mesh(surface, size).moved(*pose), shade))
        for rope in self._ropes(state):
            sides = torch.eye(3).double()[:, :2].expand(len(rope), 3, 2)
            thin = rounds(torch.tensor(2 * THIN * size).double().expand(len(rope)))
            solid.append((_tube(rope, sides, thin), ROPE))
        ax.computed_zorder = False  # what lies beneath all is drawn first, the rest by its depth
        for k, meshes in enumerate((behind, solid)):
            if meshes:
                faces = [_faces(*each) for each in meshes]
                corners, shades = (torch.cat(x) for x in zip(*faces, strict=True))
                look = dict(facecolors=numbers(shades), edgecolors=numbers(shades), lw=0.3)
                collection = Poly3DCollection(numbers(corners), zorder=0.1 + k, **look)
                ax.add_collection3d(collection, autolim=False)

    def _parts(self, *, body: bool) -> list[Any]:
        """Bodies, or beams, of which one by itself is no part."""
        parts = [part for part in self.scene.beam.parts if part.body == body]
        return parts if self.scene.beam.parts or body else [None]

    def _each(
        self, state: State, *, body: bool
    ) -> Iterator[tuple[Any, int, int, Any, Tensor, Tensor]]:
        """Of each sample and part: colour, sample, place, part, positions and axes of all nodes."""
        position, R = (_plain(x) for x in nodes_of(state))
        known = self.scene.beam.parts
        for i in range(len(position)):
            for k, part in enumerate(self._parts(body=body)):
                which = known.index(part) if len(position) == 1 and part is not None else i
                shade = f"C{which % 10}" if self.color is None else self.color
                yield shade, i, k, part, position[i], R[i]

    def _beams(self, state: State) -> Iterator[tuple[Any, Tensor, Tensor, Tensor]]:
        """Colour, axis (p, 3) m, axes across it (p, 3, 2), corners (p, k, 2) m."""
        rows = rows_of(state)
        for shade, i, k, part, x, R in self._each(state, body=False):
            beam_rows = rows[k]
            axis = axis_curve(x[None, beam_rows], R[None, beam_rows, :, 0])[0]
            corners = self.sections.corners(k, part, len(axis), state.position.shape[:-2], i)
            yield shade, axis, across(R[beam_rows, :, 1:], len(axis)), corners

    def _round_nodes(self, state: State) -> Iterator[tuple[Any, tuple[Tensor, Tensor], Obstacle]]:
        """Of nodes that touch as balls: colour, centre and axes, the ball."""
        touching = [load.node for load in self.scene.effects if isinstance(load, Contact)]
        for shade, i, k, part, x, R in self._each(state, body=False):
            rows = range(len(x))[rows_of(state)[k]]
            for node in touching:
                if isinstance(node, int) and node % len(x) in rows:
                    ball = ball_of(self.scene, part, state.position.shape[:-2], i)
                    if ball is not None:
                        yield shade, (x[node], R[node]), _plain_tree(ball)

    def _bodies(self, state: State) -> Iterator[tuple[Any, tuple[Tensor, Tensor], Obstacle | None]]:
        """Colour, centre and axes, surface, None = it has none."""
        for shade, i, _, part, x, R in self._each(state, body=True):
            surface = surface_of(self.scene, part, state.position.shape[:-2], i)
            surface = None if surface is None else _plain_tree(surface)
            yield shade, (x[part.first_node], R[part.first_node]), surface

    def _ropes(self, state: State) -> Iterator[Tensor]:
        for tendon in self.scene.tendons if isinstance(state, State) else ():
            points = _plain(tendon.at(state.position.detach(), state.rotation.detach()))
            yield from points.reshape(-1, *points.shape[-2:])

    def _obstacles(self, state: State) -> Iterator[tuple[Obstacle, tuple[Tensor, Tensor] | None]]:
        """With its centre and axes, if its surface turns."""
        t = state.t.detach().flatten()[0].item()
        for obstacle in map(_plain_tree, standing(self.scene, t)):
            if obstacle.spinning is None:
                yield obstacle, None
                continue
            R = quat.matrix(quat.exponential(t * obstacle.spinning))
            yield obstacle, (getattr(obstacle, obstacle.PLACE), R)


def _tube(axis: Tensor, across: Tensor, corners: Tensor) -> Mesh:
    """With rings that are no closer than they have to be."""
    s = torch.nn.functional.pad(axis.diff(dim=0).norm(dim=-1).cumsum(0), (1, 0))
    apart = torch.maximum(0.8 * corners.norm(dim=-1).min(), s[-1] / RINGS)
    ring = (s / apart).long()
    kept = torch.cat((ring.new_tensor([True]).bool(), ring[1:] > ring[:-1]))
    kept[-1] = True
    return tube_mesh(axis[kept], across[kept], corners[kept])


def _outline(axis: Tensor, across: Tensor, corners: Tensor) -> Tensor:
    """(2 p, 2) m about an axis (p, 2) m: as far as corners (p, k, 2) in axes (p, 2, 2) are."""
    along = torch.gradient(axis, dim=0)[0]
    normal = torch.stack((-along[:, 1], along[:, 0]), -1) / along.norm(dim=-1, keepdim=True)
    reach = ((corners @ across.mT) @ normal[..., None]).amax(1)
    return torch.cat((axis + reach * normal, (axis - reach * normal).flip(0)))


def _faces(mesh: Mesh, color: Any) -> tuple[Tensor, Tensor]:
    """Corners (m, 4, 3) m of quadrilaterals, and their colours (m, 3) by the light."""
    corners = mesh.points[mesh.quads]
    normal = torch.linalg.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normal = torch.nn.functional.normalize(normal, dim=-1)
    bright = 0.6 + 0.4 * (normal @ torch.tensor(LIGHT).double())
    bright = torch.where(mesh.dark, 0.75 * bright, bright).clamp(0, 1)
    return corners, bright[:, None] * torch.tensor(_mixed(color, 0.2)).double()


def _mixed(color: Any, share: float, other: Any = "w") -> tuple[float, ...]:
    """A colour with a share of another."""
    from matplotlib.colors import to_rgb

    return tuple(
        (1 - share) * x + share * y for x, y in zip(to_rgb(color), to_rgb(other), strict=True)
    )


def _about(obstacle: Obstacle, middle: Tensor) -> Obstacle:
    """A bar without end by its place next to the middle of the picture."""
    if not isinstance(obstacle, Cylinder):
        return obstacle
    along = ((middle - obstacle.point) @ obstacle.axis) * obstacle.axis
    return with_values(obstacle, point=obstacle.point + along)


def _plane_mesh(plane: Plane, limits: Tensor) -> Mesh:
    """As far as the picture's limits (3, 2) m across the coordinate most along its normal."""
    deep = int(plane.normal.abs().argmax())
    x, y = (k for k in range(3) if k != deep)
    corners = plane.point.expand(4, 3).clone()
    corners[:, x], corners[:, y] = limits[x][[0, 1, 1, 0]], limits[y][[0, 0, 1, 1]]
    corners[:, deep] -= ((corners - plane.point) @ plane.normal) / plane.normal[deep]
    return Mesh(corners, torch.arange(4)[None], torch.tensor([False]))


def _plain(x: Tensor) -> Tensor:
    return x.detach().double().cpu()


def _plain_tree(obstacle: Obstacle) -> Obstacle:
    return sent(obstacle, "cpu", torch.float64)
