"""The nodal form as an explicit ordinary differential equation: lumped mass, one block a node, no global solve."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from .. import quaternions as quat
from ..effects import Inputs
from ..scene import Scene
from ..state import State
from .element import forces, kinematics, strain, strain_operator, to_nodes
from .model import Model, times

SIZES = (3, 4, 3, 3)  # position, rotation, velocity, spin of a free node


@dataclass(frozen=True)
class Rates:
    """The right-hand side dy/dt = f(t, y), y (..., 13 N + 1): position, quaternion, velocity and spin of the N free nodes,
    and the work of the loads.

        r' = v      q' = q Omega / 2      m v' = f      J Omega' = R^T m - Omega x J Omega
    """

    model: Model
    inputs: Inputs

    @classmethod
    def of(cls, scene: Scene, inputs: Inputs) -> Rates:
        """Raises ValueError where a block of the mass is singular or a stiffness infinite: both need the implicit form."""
        model = Model.of(scene, lumped=True)
        if model.inertia is None or (torch.linalg.det(model.inertia[..., 1:, :, :]) <= 0).any():
            raise ValueError("a section without rotary inertia was given; an explicit method wants some (the implicit "
                             "method 'midpoint' needs none)")
        if any(scene.beam.rigid):
            raise ValueError("an infinite stiffness was given; an explicit method wants finite ones (the implicit method "
                             "'midpoint' takes it)")
        return cls(model, inputs)

    def pack(self, state: State) -> Tensor:
        """The state's free nodes and its work as one vector."""
        fields = (state.position, state.rotation, state.velocity, state.spin)
        shape = torch.broadcast_shapes(state.batch_shape, self.model.scene.batch_shape)
        flat = [x[..., 1:, :].expand(*shape, *x[..., 1:, :].shape[-2:]).flatten(-2) for x in fields]
        return torch.cat((*flat, state.work.expand(shape)[..., None]), -1)

    def unpack(self, y: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Position, unit quaternion, velocity and spin of all nodes, root included."""
        N = self.model.scene.beam.count
        r, q, v, omega = (part.unflatten(-1, (N, -1)) for part in y[..., :-1].split([N * s for s in SIZES], -1))
        beam = self.model.scene.beam
        r, q = (torch.cat((root[..., :1, :].expand(*x.shape[:-2], 1, x.shape[-1]), x), -2)
                for root, x in ((beam.nodes, r), (beam.frames, quat.normalize(q))))
        return r, q, pad(v, (0, 0, 1, 0)), pad(omega, (0, 0, 1, 0))

    def stress(self, r: Tensor, q: Tensor, v: Tensor, omega: Tensor) -> Tensor:
        """[F; M] (..., N, 6) of the strain and, where there is damping, of its rate."""
        model = self.model
        kin = kinematics(r, q, model.length)
        felt = strain(kin, model.length, model.reference)[..., None]
        if model.rate is not None:
            spin = quat.rotate(q, omega)
            nine = torch.cat((v.diff(dim=-2), spin[..., :-1, :], spin[..., 1:, :]), -1)
            felt = felt + times(model.rate, strain_operator(kin, model.length) @ nine[..., None])
        return times(model.C, felt)[..., 0]

    def balance(self, t: Tensor, r: Tensor, q: Tensor, v: Tensor, omega: Tensor) -> tuple[Tensor, Tensor]:
        """(loads less internal forces (..., N+1, 6) in frame a, loads)"""
        model = self.model
        internal = to_nodes(forces(kinematics(r, q, model.length), self.stress(r, q, v, omega), model.length))
        external = model.external(q, t, self.inputs, model.scene.loads) + torch.zeros_like(internal)
        return external - internal, external

    def __call__(self, t: Tensor, y: Tensor) -> Tensor:
        model = self.model
        r, q, v, omega = self.unpack(y)
        net, external = self.balance(t, r, q, v, omega)
        acceleration = net[..., 1:, :3] / model.mass[..., 1:, :]
        free, J = omega[..., 1:, :], model.inertia[..., 1:, :, :]
        torque = quat.rotate(quat.conjugate(q[..., 1:, :]), net[..., 1:, 3:])
        torque = torque - torch.linalg.cross(free, (J @ free[..., None])[..., 0])
        spin_rate = torch.linalg.solve(J, torque[..., None])[..., 0]
        q_raw = y[..., 3 * J.shape[-3]:7 * J.shape[-3]].unflatten(-1, (-1, 4))  # its length is left as it is
        q_rate = quat.multiply(q_raw, pad(free / 2, (1, 0)))
        power = (external[..., :3] * v).sum((-1, -2)) + (external[..., 3:] * quat.rotate(q, omega)).sum((-1, -2))
        parts = (v[..., 1:, :], q_rate, acceleration, spin_rate)
        return torch.cat((*(x.flatten(-2) for x in parts), power[..., None]), -1)

    def state(self, t: Tensor, y: Tensor, status: Tensor) -> State:
        """The state at time t; stress and reaction are those of the instant."""
        r, q, v, omega = self.unpack(y)
        net, _ = self.balance(t, r, q, v, omega)
        return State(r, q, v, omega, self.stress(r, q, v, omega), -net[..., 0, :], y[..., -1], torch.zeros_like(y[..., -1]),
                     t.expand(y.shape[:-1]), status)
