"""Symbols of supports, joints, springs and loads, as engineers draw them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import instance
from ..core.functions_of_time import shared
from ..core.validation import refusal
from ..math import quaternions as quat
from ..nodal.conditions import conditions
from ..nodal.discretise import discretise
from ..nodal.loads import external
from ..scene.effects import RootSpring, Spring
from ..scene.joint import Joint
from ..scene.scene import Scene
from ..sensors.section_forces import bare_beams
from ..sensors.sensor import nodes_of as moving_nodes
from ..state.state_check import of_mesh
from .arrows import Arrows, normal_to
from .axis import nodes_of
from .canvas import Axes, first, ink, numbers
from .limits import extent, prepared, widened
from .line_loads import line_loads

LOAD = "C3"
ARROW = 0.16  # of the size of all: the longest arrow of a force; half of it of a load along a beam
SIZE = 26  # points, of the symbol of a support, both sides of its node
GROUND = 8  # strokes below it
AXES = "xyz"


def symbols(
    state: Any,
    ax: Axes | None = None,
    *,
    scene: Scene,
    plane: str | None = None,
    inputs: dict[str, Any] | None = None,
) -> Axes:
    """Draw symbols on a picture of the beam. Supports have the symbol of the motions that they
    prevent in the plane (clamp, pin, roller, slide). Hinges are rings. Springs and all loads that
    act in the state follow, with numbers in N, N m and N/m. In space a clamp is a plate, and a
    support of one or two coordinates has a rod along each. A batch shows its first sample.

    Args:
        ax: None = a new one
        scene: whose state it is
        plane: "xy", "xz" or "yz", as in `shape`
        inputs: values of its inputs, by their names

    Raises:
        ValueError: for a state of another scene, a missing value of an input, and as `shape`.

    Examples:
        >>> state = tb.equilibrium(scene)
        >>> ax = tb.plot.symbols(state, tb.plot.shape(state), scene=scene)
    """
    position, turn = nodes_of(state)
    instance("scene", scene, Scene)
    of_mesh(state, scene, "a state")
    ax, seen = prepared(ax, plane, position)
    Symbols.of(ax, seen, scene, position, turn).draw(state, inputs)
    return widened(ax, seen)


@dataclass(frozen=True)
class Symbols:
    """On axes that show the coordinates `seen`, of a scene whose nodes are drawn at position
    (N+1, 3) m with axes (N+1, 3, 3).
    """

    ax: Axes
    seen: list[int]
    scene: Scene
    position: Tensor
    axes: Tensor

    @classmethod
    def of(cls, ax: Axes, seen: list[int], scene: Scene, position: Tensor, axes: Tensor) -> Symbols:
        """Of the first of positions (samples, N+1, 3) and axes (samples, N+1, 3, 3)."""
        return cls(ax, seen, scene, first(position, 2), first(axes, 3))

    def draw(self, state: Any, inputs: dict[str, Any] | None = None) -> None:
        """All of them, and the loads that act in a state. Raises ValueError for no sample."""
        if 0 in self.scene.batch_shape:
            raise refusal("a scene without a sample", "one or more", are=True)
        self.loads(state, inputs)
        self.supports()
        self.joints()

    @property
    def size(self) -> float:
        return extent(self.position)

    def into(self, node: int) -> Tensor:
        """The way (3) from a node into the beam, and into those that it is joined with."""
        position, ways = self.position, [self.position.new_zeros(3)]
        together = {node}
        for pair in self.scene.beam.joined if self.scene.beam.parts else ():
            together |= set(pair) - {None} if node in pair else set()
        for row in self._rows():
            for k in together & set(row):
                ways += [position[j] - position[k] for j in (k - 1, k + 1) if j in row]
        way = torch.stack([torch.nn.functional.normalize(x, dim=0) for x in ways]).sum(0)
        return torch.nn.functional.normalize(way, dim=0) if way.norm() > 0.3 else 0 * way

    def _rows(self) -> list[range]:
        parts = self.scene.beam.parts
        slices = [part.nodes for part in parts if not part.body] if parts else [slice(None)]
        return [range(len(self.position))[row] for row in slices]

    def supports(self) -> None:
        for support in self.scene.supports:
            self.support(support.node, support.held)
        if any(isinstance(load, RootSpring) for load in self.scene.effects):
            self._mark(self.position[0], "spring", -self.into(0))

    def support(self, node: int, held: tuple[bool, ...]) -> None:
        """Of a node, by which of position x y z and rotation x y z are held."""
        x, into = self.position[node], self.into(node)
        if len(self.seen) == 3:
            if all(held):
                self._plate(x, into)
            elif all(held[:3]) or not any(held[:3]):
                self._mark(x, "pin" if held[0] else "turn", x)
            else:
                self._rods(x, held[:3])
            return
        moves, turns = [i for i in self.seen if held[i]], held[3 + 3 - sum(self.seen)]
        if moves or turns:
            kind = ("turn", "slide", "clamp") if turns else ("", "roller", "pin")
            self._mark(x, kind[len(moves)], self._ground(moves, turns, into))

    def _rods(self, x: Tensor, held: tuple[bool, ...]) -> None:
        """In space: one along each coordinate that is held, to a point that stands."""
        for unit in torch.eye(3, dtype=x.dtype)[list(held)]:
            ends = torch.stack((x, x - 0.1 * self.size * unit))
            self.ax.plot(*numbers(ends).T, color=ink(self.ax), lw=1.4, marker="o", ms=3, zorder=3)

    def _ground(self, moves: list[int], turns: bool, into: Tensor) -> Tensor:
        """The side (3) on which the ground lies of what holds these coordinates."""
        side = torch.zeros_like(into)
        if len(moves) == 2 and turns and into.norm() > 0:
            return -into
        side[moves[0] if len(moves) == 1 else self.seen[1]] = -1.0
        return -side if (into @ side).item() > 0.7 else side

    def joints(self) -> None:
        """Rings at hinges (a cross in one with two axes, a dot in a ball), rails along sliders,
        lines between points that are apart; what a joint with the ground holds as a support.
        """
        for joint in self.scene.joints:
            points = torch.stack([*self._ends(joint)])
            middle = points.mean(0)
            if None in joint.ends and joint.position == AXES:
                kind = "clamp" if joint.rotation == AXES else "pin"
                into = self.into(next(node for node in joint.ends if node is not None))
                self._mark(middle, kind, self._ground(self.seen[:2], kind == "clamp", into))
            self.ax.plot(*numbers(points[:, self.seen]).T, color=ink(self.ax), lw=0.8, zorder=3)
            if joint.distance:
                self._rings(points, "")
            elif len(joint.position) < 3:
                self._rails(middle, joint)
            elif len(joint.rotation) < 3:
                self._rings(middle[None], {2: "", 1: "x", 0: "."}[len(joint.rotation)])

    def _ends(self, joint: Joint) -> Iterator[Tensor]:
        """Where its points (3) m on both parts are."""
        beam = self.scene.beam
        for node, drawn in zip(joint.ends, joint.drawn(beam)[:2], strict=True):
            point = first(drawn, 1)
            if node is not None:
                arm = point - first(beam.nodes[..., node, :], 1)
                point = self.position[node] + self._turned(node) @ arm
            yield point

    def _turned(self, node: int | None) -> Tensor:
        """How far (3, 3) a node, None = the ground, has turned since it was drawn."""
        if node is None:
            return torch.eye(3, dtype=self.position.dtype)
        at_rest = first(quat.matrix(self.scene.beam.frames[..., node, :]), 2)
        return self.axes[node] @ at_rest.mT

    def _rings(self, points: Tensor, inside: str) -> None:
        ring = dict(ls="", mfc=self.ax.get_facecolor(), mec=ink(self.ax), zorder=6)
        self.ax.plot(*numbers(points[:, self.seen]).T, marker="o", ms=6.5, **ring)
        if inside:
            self.ax.plot(*numbers(points[:, self.seen]).T, marker=inside, ms=3.5, **ring)

    def _rails(self, x: Tensor, joint: Joint) -> None:
        """Two short lines along the axis of a slider."""
        along = self._turned(joint.ends[0]) @ first(joint.axes(self.scene.beam), 2)[:, 0]
        reach, side = 0.05 * self.size, normal_to(along, self.seen)
        for way in (1, -1):
            middle = x + way * 0.3 * reach * side
            ends = torch.stack((middle - reach * along, middle + reach * along))
            self.ax.plot(*numbers(ends[:, self.seen]).T, color=ink(self.ax), lw=1.6, zorder=6)

    def _mark(self, x: Tensor, kind: str, side: Tensor) -> None:
        """A sign at x (3) m, whose ground lies on a side (3) of it."""
        from matplotlib.markers import MarkerStyle
        from matplotlib.path import Path
        from matplotlib.transforms import Affine2D

        angle = 0.0
        if len(self.seen) == 2 and side[self.seen].norm() > 0:
            right, up = side[self.seen].tolist()
            angle = math.atan2(up, right) + math.pi / 2
        path = Path.make_compound_path(*map(Path, SIGNS[kind]))
        sign = MarkerStyle(path, transform=Affine2D().rotate(angle))
        size = SIZE * abs(path.vertices).max()  # a marker is scaled by its largest coordinate
        look = dict(ms=size, mfc=self.ax.get_facecolor(), mec=ink(self.ax), mew=1.0, zorder=3)
        look["clip_on"] = len(self.seen) == 3  # in space a layout takes it for far larger
        self.ax.plot(*numbers(x[None, self.seen]).T, marker=sign, ls="", **look)

    def _plate(self, x: Tensor, into: Tensor) -> None:
        """Of a clamp in space: a square across the beam."""
        from mpl_toolkits.mplot3d.art3d import Poly3DCollection

        normal = into if into.norm() > 0 else self.axes.new_tensor((0.0, 0.0, 1.0)).to(x)
        e = normal_to(normal, self.seen)
        f = torch.linalg.cross(normal, e)
        corners = [x + 0.06 * self.size * (a * e + b * f) for a, b in CORNERS]
        plate = Poly3DCollection([numbers(torch.stack(corners))], fc="0.8", ec=ink(self.ax))
        plate.set_alpha(0.9)
        self.ax.add_collection3d(plate)

    def loads(self, state: Any, inputs: dict[str, Any] | None) -> None:
        """Of a state: springs, forces and moments on nodes, and loads along beams."""
        model = discretise(replace(self.scene, plane=None))
        state = of_mesh(state, self.scene, "a state").detach()
        nodes = moving_nodes(model.space, model.space.to_reduced(state))
        now = conditions(model, shared(state.t), self.scene.tensors(inputs))
        acts = []
        for act in (act for act in now.loads if not act.along):
            x, arm = self.position[act.node], getattr(act.load, "offset", None)
            arm = torch.zeros_like(x) if arm is None else self.axes[act.node] @ first(arm, 1)
            if isinstance(act.load, Spring):
                self._spring(first(act.load.to, 1), x + arm)
            elif not isinstance(act.load, RootSpring):
                F, M = first(external(model, nodes, now, (act,))[..., act.node, :], 1).split(3)
                acts.append((x + arm, F, M - torch.linalg.cross(arm, F), self.into(act.node)))
        acting_along = tuple(act for act in now.loads if act.along)
        bare = bare_beams(self.scene)
        along = external(bare, nodes, now, acting_along)
        if not isinstance(along, float):
            fixed = first(external(model, nodes, now, acting_along) - along, 2)
            for k in (fixed != 0).any(-1).nonzero()[:, 0].tolist():  # what is fixed to nodes
                acts.append((self.position[k], *fixed[k].split(3), self.into(k)))
        arrows = Arrows(self.ax, self.seen, ARROW * self.size, LOAD)
        strongest = max((F.norm().item() for _, F, *_ in acts), default=0.0)
        most = max((M.norm().item() for _, _, M, _ in acts), default=0.0)
        for x, F, M, into in acts:
            arrows.force(x, F, strongest, into)
            arrows.moment(x, M, max(most, 1e-9 * strongest * self.size))
        if not isinstance(along, float):
            each = line_loads(model, bare, nodes, now)
            arrows = replace(arrows, length=arrows.length / 2)
            rows = [[(k, f) for k in row for f in each[k]] for row in self._rows()]
            most = max((f.norm().item() for row in rows for _, f in row), default=0.0)
            for row in rows:
                at, f = zip(*row, strict=True)
                arrows.row(self.position[[*at]], torch.stack(f), most)

    def _spring(self, start: Tensor, end: Tensor) -> None:
        """A zigzag from what stands to a node."""
        s = torch.linspace(0, 1, 13, dtype=start.dtype)
        out = torch.zeros_like(s)
        out[3:10:2], out[4:10:2] = 1.0, -1.0
        along = end - start
        side = normal_to(torch.nn.functional.normalize(along, dim=0), self.seen)
        points = start + s[:, None] * along + 0.02 * self.size * out[:, None] * side
        self.ax.plot(*numbers(points[:, self.seen]).T, color=ink(self.ax), lw=1.0, zorder=3)
        self._mark(start, "clamp", -along)


def _ground_below(y: float) -> list[tuple[tuple[float, float], ...]]:
    """A line at a height, hatched below."""
    strokes = [((-0.9, y), (0.9, y))]
    for k in range(GROUND):
        right = -0.7 + 1.6 * k / (GROUND - 1)
        strokes.append(((right, y), (right - 0.2, y - 0.22)))
    return strokes


TRIANGLE = ((0, 0), (-0.45, -0.65), (0.45, -0.65), (0, 0))
CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))
# strokes of a sign at (0, 0), its ground below; SIZE is as much as from -1 to 1
SIGNS: dict[str, Any] = {
    "clamp": _ground_below(0.0),
    "pin": [TRIANGLE, *_ground_below(-0.65)],
    "roller": [TRIANGLE, ((-0.6, -0.65), (0.6, -0.65)), *_ground_below(-0.78)],
    "slide": [((-0.7, 0), (0.7, 0)), *_ground_below(-0.2)],
    "turn": [tuple((0.15 * x, 0.15 * y) for x, y in (*CORNERS, CORNERS[0]))],
    "spring": [
        ((0, 0), (0, -0.1), (0.25, -0.2), (-0.25, -0.35), (0.25, -0.5), (0, -0.6), (0, -0.7)),
        *_ground_below(-0.7),
    ],
}
