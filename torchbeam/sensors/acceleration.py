"""A sensor of acceleration: no part of a state, it follows from the balance of momentum."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from .. import quaternions as quat
from ..motion import GAP, INCREMENT
from ..nodal.external import Nodes, added_mass
from ..nodal.model import Model
from ..nodal.rates import Rates
from ..scene import Scene
from ..solve import block_tridiagonal
from ..state import State, put
from .node import _OfNode
from .sensor import XYZ


@dataclass(frozen=True, eq=False, repr=False)
class NodeAcceleration(_OfNode):
    """Acceleration (..., 3) m/s^2 of a node, in the axes of frame a, at the instant of the state: of its positions,
    velocities and loads at that time, by the nodal form's own mass,

        M a = loads - internal forces (strain and strain rate) - what the spin makes of masses off the axis

    a block tridiagonal solve; absolute, where frame a or a support moves. (After an implicit step it is that at the end of
    the step; the step itself ran on the mean.)

    scene   whose loads act;  inputs  by name, (..., size), where the scene has some
    body    in the axes of the node's section
    proper  less gravity g (..., 3) m/s^2, in the axes of frame a at that instant: what an accelerometer reads; None = not
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
        if self.scene.carried and not all(s.clamp for s in self.scene.supports):
            raise ValueError("a carried beam with a support that is no clamp was given to NodeAcceleration; clamps are wanted")
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
        """Absolute acceleration of all nodes, (..., N+1, 3). With a and alpha those of the nodes, e the arms to their centres
        of mass and A alpha = alpha x e:

            M a_c = f      A^T M a_c + J alpha + Omega x J Omega = m      a_c = a + A alpha + Omega x (Omega x e)
        """
        model = self.rates.model
        t, space, inertia, p = state.t.flatten()[0], model.space, model.inertia, model.space.position
        state = space.enter(state)
        q, spin = state.rotation, state.spin
        nodes = Nodes(state.position, q, state.velocity, space.to_frame(q, spin), state.frame, state.internal)
        right, _ = self.rates.balance(t, nodes)
        eye, moving = torch.eye(p, dtype=right.dtype, device=right.device), model.held.moving
        if inertia.offset is None:
            at, between = inertia.blocks(eye)
            moving = moving & (torch.arange(moving.shape[-1], device=moving.device) < p)  # spins have no say
        else:
            e, turning = inertia.arm(q), space.tilde(nodes.spin)
            A = space.arm(e)
            at, between = inertia.blocks(eye, e, A)
            R = space.spin_matrix(q)
            at = at + pad(R @ inertia.inertia @ R.mT, (p, 0, p, 0))
            pull = inertia.momentum((turning @ (turning @ e[..., None]))[..., 0])
            gyroscopic = space.to_frame(q, (space.hat(spin) @ (inertia.inertia @ spin[..., None]))[..., 0])
            right = right - torch.cat((pull, (A.mT @ pull[..., None])[..., 0] + gyroscopic), -1)
        if model.adds_mass:
            at = at + added_mass(model, nodes, t, self.rates.inputs)
        between = torch.zeros_like(at[..., 1:, None, :, :]) if between is None else between
        U, L = between[..., 0, :, :], between[..., -1, :, :]
        free = moving.to(right)
        given = self.given(t, free) if model.scene.carried else torch.zeros_like(free)
        row, column = free[..., None], free[..., None, :]
        right = right - _times(at, L, U, given)
        D = at * row * column + torch.diag_embed(1 - free)
        found = block_tridiagonal(D, L * row[1:] * column[:-1], U * row[:-1] * column[1:], right * free)
        return space.whole(found + given)[..., :3]

    def given(self, t: Tensor, free: Tensor) -> Tensor:
        """Absolute acceleration (..., N+1, w) of the supports' nodes that are carried: by central differences; 0 elsewhere."""
        model = self.rates.model
        space, carrying, whole = model.space, model.carrying, torch.zeros_like(free)
        _, omega = carrying.frame(t)
        for support in model.scene.supports:
            def motion(t: Tensor, support: Any = support) -> Tensor:
                """Velocity and spin (..., 2, 3), absolute, in the axes of frame a."""
                v, spin = carrying.absolute(support, t, torch.full_like(t, GAP / INCREMENT))
                spin = quat.rotate(carrying.pose(support, t)[1], spin)
                return torch.stack(torch.broadcast_tensors(v, spin), -2)

            rate = (motion(t + GAP) - motion(t - GAP)) / (2 * GAP)
            if omega is not None:
                rate = rate + torch.linalg.cross(*torch.broadcast_tensors(omega[..., None, :], motion(t)))
            a, alpha = rate.unbind(-2)
            both = torch.cat((space.part_of_vector(a), space.part_of_spin(alpha)), -1)
            whole = put(whole.expand(*both.shape[:-1], *whole.shape[-2:]), support.node, both)
        return whole * (1 - free)


def _times(D: Tensor, L: Tensor, U: Tensor, x: Tensor) -> Tensor:
    """A block tridiagonal matrix times x (..., N+1, w)."""
    ahead, behind = ((A @ part[..., None])[..., 0] for A, part in ((U, x[..., 1:, :]), (L, x[..., :-1, :])))
    return (D @ x[..., None])[..., 0] + pad(ahead, (0, 0, 0, 1)) + pad(behind, (0, 0, 1, 0))
