"""What moves in three dimensions: meshes of beams, bodies, tendons and obstacles at an instant."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..core.leaves import sent
from ..math import quaternions as quat
from ..scene.effects.obstacle import Obstacle
from ..scene.effects.obstacles import Sphere
from ..scene.scene import Scene
from ..state.state import State
from .axis import axis_curve, nodes_of, rows_of
from .canvas import numbers
from .obstacles import standing, surface_of
from .sections import SIDE, Sections, across
from .solids import Mesh, surface_mesh, tube_mesh

# matplotlib's
COLOURS = ((31, 119, 180), (255, 127, 14), (44, 160, 44), (148, 103, 189), (140, 86, 75))
FAILED, SOLID, ROPE = (214, 39, 40), (190, 190, 190), (60, 60, 60)


class MovingShapes:
    """What is drawn of a state: name -> kind (a viser mesh or line), what stays, what moves."""

    def __init__(self, state: Any, scene: Scene | None, samples: int) -> None:
        self.scene, self.samples, self.rows = scene, samples, rows_of(state)
        parts = getattr(state, "parts", ())
        self.beams = [part for part in parts if not part.body] if parts else [None]
        self.bodies = [part for part in parts if part.body]
        self.sections = Sections.of(scene, state)
        self.size = self.sections.size

    def at(self, state: Any, t: float) -> dict[str, tuple[str, dict, dict]]:
        batch = state.position.shape[:-2]
        position, axes = (x[: self.samples].double().cpu() for x in nodes_of(state))
        failed = numbers(state.status.expand(state.batch_shape)).reshape(-1) != 0
        shapes: dict[str, tuple[str, dict, dict]] = {}
        for i, (x, R) in enumerate(zip(position, axes, strict=True)):
            colour = FAILED if failed[i] else COLOURS[i % len(COLOURS)]
            for k, (part, row) in enumerate(zip(self.beams, self.rows, strict=True)):
                axis = axis_curve(x[None, row], R[None, row, :, 0])[0]
                corners = self.sections.corners(k, part, len(axis), batch, i)
                mesh = tube_mesh(axis, across(R[row, :, 1:], len(axis)), corners)
                shapes |= _meshes(f"sample {i}/beam {k}", mesh, colour)
            for k, part in enumerate(self.bodies):
                surface = self._surface(part, batch, i)
                pose = x[part.first_node], R[part.first_node]
                mesh = surface_mesh(sent(surface, "cpu", torch.float64), self.size)
                shapes |= _meshes(f"sample {i}/body {k}", mesh, colour, pose)
        if self.scene is not None:
            shapes |= self._ropes(state) | self._obstacles(t)
        return shapes

    def _surface(self, part: Any, batch: Any, i: int) -> Obstacle:
        """Of a body: a small ball where there is nothing that it touches with."""
        known = None if self.scene is None else surface_of(self.scene, part, batch, i)
        return known or Sphere(torch.zeros(3), torch.tensor(2.5 * SIDE * self.size))

    def _ropes(self, state: Any) -> dict[str, tuple[str, dict, dict]]:
        ropes = {}
        for k, tendon in enumerate(self.scene.tendons if isinstance(state, State) else ()):
            points = numbers(tendon.at(state.position.detach(), state.rotation.detach()))
            points = points.reshape(-1, *points.shape[-2:])[: self.samples]
            lines = np.stack((points[:, :-1], points[:, 1:]), -2).reshape(-1, 2, 3)
            look = dict(colors=ROPE, thickness=0.3 * SIDE * self.size)
            ropes[f"tendon {k}"] = "line_segments", look, dict(points=lines.astype(np.float32))
        return ropes

    def _obstacles(self, t: float) -> dict[str, tuple[str, dict, dict]]:
        shapes = {}
        for k, obstacle in enumerate(standing(self.scene, t)):
            mesh = surface_mesh(sent(obstacle, "cpu", torch.float64), self.size)
            # one piece, as it is seen through
            mesh = mesh._replace(dark=torch.zeros_like(mesh.dark))
            through = 0.25 if getattr(obstacle, "inside", False) else 0.6
            shapes |= _meshes(f"obstacle {k}", mesh, SOLID, opacity=through)
        return shapes


def _meshes(
    name: str,
    mesh: Mesh,
    colour: tuple[int, int, int],
    pose: tuple[Tensor, Tensor] | None = None,
    **look: Any,
) -> dict[str, tuple[str, dict, dict]]:
    """Triangles of a mesh in two shades; with a centre and axes its form stays."""
    shapes = {}
    for shade, kept, end in ((1.0, ~mesh.dark, ""), (0.7, mesh.dark, " dark")):
        if not kept.any():
            continue
        used, quads = mesh.quads[kept].unique(return_inverse=True)
        points = numbers(mesh.points[used]).astype(np.float32)
        faces = numbers(quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)).astype(np.uint32)
        static = dict(faces=faces, color=tuple(int(shade * x) for x in colour), side="double")
        static |= dict(flat_shading=True) | look
        moving = dict(vertices=points)
        if pose is not None:
            static |= moving
            moving = dict(position=numbers(pose[0]), wxyz=numbers(quat.from_matrix(pose[1])))
        shapes[f"{name}{end}"] = "mesh_simple", static, moving
    return shapes
