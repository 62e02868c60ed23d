"""Sensor of acceleration, by the balance of momentum: it is no part of a state."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.arguments import boolean
from ..core.functions_of_time import shared
from ..core.leaves import option
from ..core.validation import as_tensor, axis_last, concrete, finite
from ..math import quaternions as quat
from ..math.shapes import broadcast_shapes
from ..nodal.discretise import discretise
from ..nodal.loads import added_mass
from ..nodal.rates import Rates, forces_between_nodes
from ..scene.scene import Scene
from ..state.state import State
from ..state.state_check import of_mesh
from ..state.supported_nodes import set_node
from .node import _OfNode
from .sensor import XYZ, check_scene, nodes_of


@dataclass(frozen=True, eq=False, repr=False)
class NodeAcceleration(_OfNode):
    """Acceleration (..., 3) m/s^2 of a node against inertial space, in the axes of frame a.

    An accelerometer reads it with `proper`; without, a beam at rest under its weight has zero. It
    follows from positions, velocities and loads at the instant of the state, by the nodal form's
    own mass and a block tridiagonal solve:

        M a = loads - internal forces (strain and strain rate)
              - forces of the spin on masses off the axis

    It is absolute where frame a or a support moves. (After an implicit step it is the acceleration
    at the end of the step; the step itself uses the mean.)

    Args:
        scene: whose loads act
        inputs: by name, (..., size), if the scene has some
        body: in the axes of the node's section
        proper: gravity g (..., 3) m/s^2, subtracted as an accelerometer does; None = no
            subtraction. It is in inertial axes, as in `Gravity`, also in a turning frame
        lumped: as in `Stepper`

    Raises:
        ValueError: for a scene that the nodal form does not take, or with joints, tendons, or parts
            that touch each other. For an infinite stiffness (the acceleration then follows from
            constraints that a state does not hold), or a state of another form.

    Examples:
        >>> accelerometer = tb.sensors.NodeAcceleration(-1, scene, body=True, proper=(0, 0, -9.81))
        >>> accelerometer(solution.state).shape  # m/s^2, in section axes
        torch.Size([6, 3])
    """

    scene: Scene = option(check_scene, name="a scene")
    inputs: dict[str, Any] = field(default_factory=dict)
    body: bool = option(boolean, default=False)
    proper: Any = None
    lumped: bool = False
    rates: Rates = field(init=False)
    row: int = field(init=False)
    what = "acceleration"
    unit = "m/s^2"
    labels = XYZ

    @property
    def transforms_as(self) -> str | None:
        return None if self.body else "vector"

    def __post_init__(self) -> None:
        place = self.node
        super().__post_init__()
        if what := forces_between_nodes(self.scene):
            raise ValueError(
                f"a scene with {what} was given to NodeAcceleration, which has no forces of it; "
                "one without is wanted"
            )
        named = place if self.on is None or isinstance(place, (str, tuple)) else (self.on, place)
        object.__setattr__(self, "row", self.scene.beam.row(named) % self.scene.beam.node_count)
        if any(self.scene.beam.rigid):
            raise ValueError(
                "a scene with an infinite stiffness was given to NodeAcceleration; finite ones "
                "are wanted"
            )
        if self.scene.has_prescribed_motion and not all(s.clamp for s in self.scene.supports):
            raise ValueError(
                "a support that is no clamp, of a beam whose root or frame moves, was given to "
                "NodeAcceleration; clamps are wanted"
            )
        if self.proper is not None:
            g = as_tensor(self.proper, self.scene.dtype, self.scene.device)
            object.__setattr__(self, "proper", finite("proper", axis_last("proper", g, 3)))
        rates = Rates(discretise(self.scene, self.lumped), self.scene.tensors(self.inputs))
        object.__setattr__(self, "rates", rates)

    def __call__(self, state: Any) -> Tensor:
        return self.read(state)

    def read(self, state: Any) -> Tensor:
        state = of_mesh(state, self.scene, "NodeAcceleration: a state")
        # at each instant the loads are asked for once
        if state.t.ndim > 1 and _trajectory(state.t):
            return torch.stack([self.read(state[k]) for k in range(len(state.t))])
        a = self.solve(state)[..., self.row, :]
        if self.proper is not None:
            g, frame = self.proper, state.frame
            a = a - (g if frame is None else quat.rotate(quat.conjugate(frame), g))
        return quat.rotate(quat.conjugate(state.rotation[..., self.row, :]), a) if self.body else a

    def solve(self, state: State) -> Tensor:
        """Absolute acceleration of all nodes, (..., N+1, 3). With a and alpha those of the nodes, e
        the arms to their centres of mass and A alpha = alpha x e:

            M a_c = f      A^T M a_c + J alpha + Omega x J Omega = m
            a_c = a + A alpha + Omega x (Omega x e)
        """
        model = self.rates.model
        t, space, inertia = shared(state.t), model.space, model.inertia
        p, state = space.dims.position, space.to_reduced(state)
        q, spin, nodes = state.rotation, state.spin, nodes_of(space, state)
        now = self.rates.conditions(t)
        right, _ = self.rates.balance(now, nodes)
        eye, moving = torch.eye(p, dtype=right.dtype, device=right.device), model.constraints.moving
        lever, rotary = inertia.offset.turned(q), inertia.rotary
        matrix = lever.matrix(inertia.masses(eye), lambda: lever.A)
        if not lever.present and not (rotary.present and "angular_acceleration" in model.read):
            # spins have no say
            moving = moving & (torch.arange(moving.shape[-1], device=moving.device) < p)
        else:
            matrix = rotary.matrix(matrix, lambda: rotary.in_frame(q))
            right = right - pad(space.to_frame(q, rotary.gyroscopic(spin)), (p, 0))
        if lever.present:
            pull = inertia.translational.momentum(
                lever.acceleration(torch.zeros_like(state.velocity), lambda: nodes.spin)
            )
            right = right - lever.wrench(pull, torch.zeros_like(spin))
        if model.adds_mass:
            matrix = matrix.plus(added_mass(model, nodes, now))
        free = moving.to(right)
        given = self.given(t, free) if model.scene.has_prescribed_motion else torch.zeros_like(free)
        system = matrix.restricted(model.topology.unknowns(moving, right))
        return space.embed(system.solve(right - matrix.times(given), constant=False) + given)[
            ..., :3
        ]

    def given(self, t: Tensor, free: Tensor) -> Tensor:
        """Prescribed absolute acceleration (..., N+1, w) of the nodes at supports; 0 elsewhere."""
        model = self.rates.model
        space, prescribed_motion = model.space, model.prescribed_motion
        whole = torch.zeros_like(free)
        for support in model.scene.supports:
            a, alpha = prescribed_motion.acceleration(support, t).unbind(-2)
            both = torch.cat((space.project_vector(a), space.project_spin(alpha)), -1)
            shape = broadcast_shapes(both.shape[:-1], whole.shape[:-2])
            whole = set_node(whole.expand(*shape, *whole.shape[-2:]), support.node, both)
        return whole * (1 - free)


def _trajectory(t: Tensor) -> bool:
    """Whether t (time, ...) differs along its first axis alone."""
    rows = t.flatten(1)
    return rows.shape[1] > 0 and bool(
        concrete(rows == rows[:, :1]).all() and concrete(rows[:, 0] != rows[0, 0]).any()
    )
