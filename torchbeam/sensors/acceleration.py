"""A sensor of acceleration: no part of a state, it follows from the balance of momentum."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from .. import quaternions as quat
from ..nodal.external import Nodes
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
        if self.scene.carried or Model.of(self.scene).inertia.offset is not None:
            raise ValueError("NodeAcceleration of a beam that is carried, or has a mass off its axis, was asked for; what holds it "
                             "still and masses on the axis are wanted")
        if self.proper is not None:
            object.__setattr__(self, "proper", torch.as_tensor(self.proper, dtype=self.scene.dtype, device=self.scene.device))
        object.__setattr__(self, "rates", Rates(Model.of(self.scene, self.lumped), self.scene.tensors(self.inputs)))

    def read(self, state: Any) -> Tensor:
        if not isinstance(state, State):
            raise ValueError(f"a {type(state).__name__} was given to NodeAcceleration; a State of the nodal form is wanted")
        if state.t.numel() > 1 and (state.t != state.t.flatten()[0]).any():  # a trajectory: loads are asked for one instant
            return torch.stack([self.read(one) for one in (state[k] for k in range(len(state.t)))])
        a = self.solve(state)[..., self.node, :]
        a = a if self.proper is None else a - self.proper
        return quat.rotate(quat.conjugate(state.rotation[..., self.node, :]), a) if self.body else a

    def solve(self, state: State) -> Tensor:
        """Acceleration of all nodes, (..., N+1, 3): zero where they are held."""
        model = self.rates.model
        t, space = state.t.flatten()[0], model.space
        state = space.enter(state)
        nodes = Nodes(state.position, state.rotation, state.velocity, space.to_frame(state.rotation, state.spin),
                      internal=state.internal)
        net, _ = self.rates.balance(t, nodes)
        inertia, p = model.inertia, space.position
        eye = torch.eye(p, dtype=net.dtype, device=net.device)
        at, between = inertia.blocks(eye)
        zero = torch.zeros_like(at[..., :-1, :, :]) if between is None else between[..., 0, :, :]
        free = torch.cat((model.held.slide, torch.zeros_like(net[0, :, p:] if net.ndim > 2 else net[:, p:])), -1)
        row, column = free[..., None], free[..., None, :]
        D, L, U = at * row * column + torch.diag_embed(1 - free), zero * row[1:] * column[:-1], zero * row[:-1] * column[1:]
        return space.whole(block_tridiagonal(D, L, U, net * free))[..., :3]
