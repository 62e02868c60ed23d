"""A sensor of acceleration: no part of a state, it follows from the balance of momentum."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from .. import quaternions as quat
from ..nodal.model import Model
from ..nodal.rates import Rates
from ..scene import Scene
from ..solve import block_tridiagonal
from ..state import State
from .node import _OfNode
from .sensor import XYZ


@dataclass(frozen=True, eq=False, repr=False)
class NodeAcceleration(_OfNode):
    """Acceleration (..., 3) m/s^2 of a node, in the axes of frame a, at the instant of the state: of its positions,
    velocities and loads at that time, by the nodal form's own mass,

        M a = loads - internal forces (strain and strain rate)

    a block tridiagonal solve. (After an implicit step it is that at the end of the step; the step itself ran on the mean.)

    scene   whose loads act;  inputs  by name, (..., size), where the scene has some
    body    in the axes of the node's section
    proper  less gravity g (..., 3) m/s^2, frame a: what an accelerometer reads; None = not
    lumped  as in `Stepper`

    Raises ValueError for a scene that the nodal form does not take, an infinite stiffness (the acceleration then follows from
    constraints that a state does not hold), or a state of another form.
    """

    scene: Scene
    inputs: dict[str, Any] = field(default_factory=dict)
    body: bool = False
    proper: Any = None
    lumped: bool = False
    rates: Rates = field(init=False)
    what = "acceleration"
    unit = "m/s^2"
    labels = XYZ

    def __post_init__(self) -> None:
        super().__post_init__()
        if any(self.scene.beam.rigid):
            raise ValueError("a scene with an infinite stiffness was given to NodeAcceleration; finite ones are wanted")
        if self.proper is not None:
            object.__setattr__(self, "proper", torch.as_tensor(self.proper, dtype=self.scene.dtype, device=self.scene.device))
        object.__setattr__(self, "rates", Rates(Model.of(self.scene, self.lumped), self.scene.tensors(self.inputs)))

    def read(self, state: Any) -> Tensor:
        if not isinstance(state, State):
            raise ValueError(f"a {type(state).__name__} was given to NodeAcceleration; a State of the nodal form is wanted")
        if state.t.numel() > 1 and (state.t != state.t.flatten()[0]).any():  # a trajectory: loads are asked for one instant
            return torch.stack([self.read(one) for one in (state[k] for k in range(len(state.t)))])
        motion = (state.position, state.rotation, state.velocity, state.spin)
        net, _ = self.rates.balance(state.t.flatten()[0], *motion)
        a = self.solve(net[..., :3])[..., self.node, :]
        a = a if self.proper is None else a - self.proper
        return quat.rotate(quat.conjugate(state.rotation[..., self.node, :]), a) if self.body else a

    def solve(self, force: Tensor) -> Tensor:
        """M^-1 force of the free nodes, (..., N+1, 3); node 0 is held."""
        model = self.rates.model
        eye = torch.eye(3, dtype=force.dtype, device=force.device)
        diagonal, force = model.mass[..., 1:, :, None] * eye, force[..., 1:, :]
        if model.coupling is None:
            free = force / model.mass[..., 1:, :]
        else:
            k = model.coupling[..., None] * eye
            diagonal = diagonal - k - torch.nn.functional.pad(k[..., 1:, :, :], (0, 0, 0, 0, 0, 1))
            free = block_tridiagonal(diagonal, k[..., 1:, :, :], k[..., 1:, :, :], force)
        return torch.nn.functional.pad(free, (0, 0, 1, 0))
