"""Section forces: stress resultants along each element, in balance with the loads along it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.functions_of_time import shared
from ..math import quaternions as quat
from ..nodal.conditions import Conditions, conditions
from ..nodal.discretise import discretise
from ..nodal.element_loads import element_loads
from ..nodal.line_loads import valued
from ..nodal.loads import Nodes, external
from ..nodal.model import Model
from ..scene.scene import Scene
from ..state.state_check import of_mesh
from .sensor import OfScene, nodes_of

# of forces and moments, frame a: what acts in a plane
INSIDE = {"xy": (1.0, 1.0, 0.0, 0.0, 0.0, 1.0), "xz": (1.0, 0.0, 1.0, 0.0, 1.0, 0.0)}


@dataclass(frozen=True, eq=False, repr=False)
class SectionForces(OfScene):
    """Section forces of each element at its start, middle and end, as diagrams show them.

    Shape (..., N, 3, 6): [F1 F2 F3 M1 M2 M3] N and N m, section axes. An element is in balance with
    the loads along it: forces are linear and moments quadratic between its nodes. (F' + f = 0, M' +
    x' x F + m = 0; Reissner, "On one-dimensional large-displacement finite-strain beam theory",
    1973.) `Stress` gives the element's mean. Inertia counts at nodes alone. Of a beam with linked
    interpolation, moments are off by up to f h^2/8 and forces by f h/24, h the element's length.

    Args:
        scene: whose loads along beams count
        inputs: values of its inputs, by their names

    Raises:
        ValueError: for a state of another form or mesh, and without the value of an input.

    Examples:
        >>> snow = tb.Scene(beam, [tb.LineLoad(force=(0, 0, -0.1))])  # N/m
        >>> forces = tb.sensors.SectionForces(snow)(tb.equilibrium(snow))
        >>> forces[0, 0, 4]  # N m, at the clamp: f L^2/2
        tensor(0.0500)
    """

    inputs: dict[str, Any] | None = None

    name, unit = "section forces", "N, N m"
    labels = ("F1", "F2", "F3", "M1", "M2", "M3")

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "model", discretise(replace(self.scene, plane=None)))
        object.__setattr__(self, "bare", bare_beams(self.scene))

    @property
    def shape(self) -> tuple[int, ...]:
        return self.scene.beam.element_count, 3, 6

    def read(self, state: Any) -> Tensor:
        state = of_mesh(state, self.scene, "SectionForces: a state")
        model, beam = self.model, self.scene.beam
        nodes = nodes_of(model.space, model.space.to_reduced(state))
        stress = state.stress[..., : beam.station_count, :]
        kinematics = model.kinematics(nodes.position, nodes.rotation)
        given = model.space.forces(kinematics, stress, model.length)
        inner = model.space.interpolation.loads(given, 3)  # (..., N, 6) of each node, frame a
        along = self._loads(nodes, state.t)
        start, *step, end = (x - f for x, f in zip(inner, along, strict=True))
        start = -start
        x, q = (beam.nodes, beam.frames) if self.scene.small else (state.position, state.rotation)
        x, q = beam.topology.gather(x), beam.topology.gather(q)
        if beam.order == 1:
            x = (x[0], (x[0] + x[1]) / 2, x[1])
            q = (q[0], quat.half_way(*q), q[1])
        values = (start, _between(start, end, x, *step), end)
        turned = [_turned(quat.conjugate(p), f) for p, f in zip(q, values, strict=True)]
        return torch.stack(torch.broadcast_tensors(*turned), -2)

    def _loads(self, nodes: Nodes, t: Tensor) -> tuple[Tensor | float, ...]:
        """Loads along beams, as shares (..., N, 6) of elements at each of their nodes."""
        model, order = self.model, self.scene.beam.order
        now = conditions(model, shared(t), self.scene.tensors(self.inputs))
        total = external(self.bare, nodes, now, tuple(act for act in now.loads if act.along))
        between = element_loads(model, nodes, now) if now.between else (0.0,) * (order + 1)
        if not isinstance(total, float):
            rest, known = total, (0.0,) * (order + 1)
            if any(act.rule is not None for act in model.acts):
                known = known_shares(model, self.bare, nodes, now)
                rest = total - model.topology.scatter(known)
            length = model.length.unflatten(-2, (-1, order)).sum(-2)
            beside = model.topology.scatter((length,) * (order + 1))  # m, of elements at a node
            beside = torch.where(beside > 0, beside, 1.0)  # bodies
            each = zip(model.topology.gather(rest / beside), known, between, strict=True)
            between = tuple(length * f + g + h for f, g, h in each)
        inside = model.length.new_tensor(INSIDE.get(self.scene.plane, (1.0,)))
        return tuple(inside * f for f in between)


def bare_beams(scene: Scene) -> Model:
    """The model, in space, of a scene without masses fixed to nodes, which weigh there and not
    along the elements beside them.
    """
    bare = tuple(effect for effect in scene.effects if effect.kind != "inertia")
    return discretise(replace(scene, plane=None, effects=bare))


def known_shares(model: Model, bare: Model, nodes: Nodes, now: Conditions) -> tuple[Tensor, ...]:
    """Force N and moment N m (..., N, 6), frame a, that elements give each of their nodes, of loads
    that are known along the beam; bare: see `bare_beams`.
    """
    shares, zero = [], torch.zeros_like(nodes.position[..., :1]).repeat_interleave(6, -1)
    for k in range(model.space.interpolation.order + 1):
        known = tuple(
            act._replace(load=valued(model, act, now.t, now.inputs, k))
            for act in model.acts
            if act.rule is not None
        )
        at_nodes = external(bare, nodes, now, known, zero)
        shares.append(model.topology.gather(at_nodes)[k])
    return tuple(shares)


def _between(
    start: Tensor, end: Tensor, x: tuple[Tensor, ...], step: Tensor | float = 0.0
) -> Tensor:
    """In the middle of elements (..., N, 6), frame a: forces lie on a line, but for a step where a
    node is, moments are in balance with them from either end. x: the places (..., N, 3) m of the
    start, the middle and the end.
    """
    middle = (start + end) / 2
    before, after = ((middle + share * step)[..., :3] for share in (0.5, -0.5))
    back = quat.cross(x[1] - x[0], (start[..., :3] + before) / 2)
    on = quat.cross(x[2] - x[1], (after + end[..., :3]) / 2)
    return middle + pad((on - back) / 2, (3, 0))


def _turned(q: Tensor, resultants: Tensor) -> Tensor:
    """R(q) of forces and of moments (..., 6)."""
    return torch.cat([quat.rotate(q, x) for x in resultants.split(3, -1)], -1)
