"""The nodal form as an explicit ordinary differential equation: lumped mass, one block a node, no global solve."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..effects import Inputs
from ..motion import GAP, INCREMENT
from ..scene import Scene
from ..solve import level
from ..state import State, put
from .external import Nodes, added_mass, advanced_rates
from .model import Model, times


@dataclass(frozen=True)
class Rates:
    """The right-hand side dy/dt = f(t, y) of the nodes with unknowns: position, rotation, velocity and spin, then, where there
    are such, the frame's orientation and internal states of loads, and the work of the loads.

        r' = v      R' = R ~Omega      m v' = f      J Omega' = R^T m - Omega x J Omega

    in a frame that turns with omega, where v and Omega are absolute: r' = v - v_a - omega x r, R' = R ~(Omega - R^T omega),
    m (v' + omega x v) = f. A mass off its node or a node held in part couples v' and Omega': one block a node.
    """

    model: Model
    inputs: Inputs

    @classmethod
    def of(cls, scene: Scene, inputs: Inputs) -> Rates:
        """Raises ValueError where a block of the mass is singular or a stiffness infinite (both need the implicit form), and
        for supports that move other than a clamp at node 0.
        """
        model = Model.of(scene, lumped=True)
        J = model.inertia.inertia
        if J is None or (torch.linalg.det(J[..., model.held.first:, :, :]) <= 0).any():
            raise ValueError("a section without rotary inertia was given; an explicit method wants some (the implicit "
                             "method 'midpoint' needs none)")
        if any(scene.beam.rigid):
            raise ValueError("an infinite stiffness was given; an explicit method wants finite ones (the implicit method "
                             "'midpoint' takes it)")
        if any(s.moves and not (s.clamp and s.node == 0) for s in scene.supports):
            raise ValueError("a support that moves, other than a clamp at node 0, was given; the implicit method 'midpoint' "
                             "takes it")
        return cls(model, inputs)

    @property
    def sizes(self) -> list[int]:
        """Of position, rotation, velocity, spin of the nodes with unknowns."""
        space, beam = self.model.space, self.model.scene.beam
        n = beam.count + 1 - self.model.held.first
        rotation = space.enter_rotation(beam.frames).shape[-1]
        return [n * space.position, n * rotation, n * space.position, n * space.spin]

    def pack(self, state: State) -> Tensor:
        """The state's nodes with unknowns, and what else changes, as one vector."""
        model = self.model
        shape = torch.broadcast_shapes(state.batch_shape, model.scene.batch_shape)
        state = model.space.enter(state)
        parts = [x[..., model.held.first:, :].flatten(-2) for x in (state.position, state.rotation, state.velocity, state.spin)]
        parts += [x for x in (state.frame, state.internal) if x is not None]
        return torch.cat([x.expand(*shape, x.shape[-1]) for x in (*parts, state.work[..., None])], -1)

    def unpack(self, t: Tensor, y: Tensor) -> tuple[Nodes, Tensor, Tensor]:
        """(nodes, supports included; spins in section axes; the rotations of nodes with unknowns as they are in y)."""
        model, space = self.model, self.model.space
        *parts, rest = y.split([*self.sizes, y.shape[-1] - sum(self.sizes)], -1)
        n = model.count + 1 - model.held.first
        r, raw, v, spin = (x.unflatten(-1, (n, -1)) for x in parts)
        q = space.normalize(raw)
        z, frame = model.internal_states, None
        if model.turning:
            width = rest.shape[-1] - 1 - z
            frame = space.normalize(rest[..., :width])
        internal = rest[..., rest.shape[-1] - 1 - z:-1] if z else None
        if model.held.first:
            support = model.scene.supports[0]
            pose = space.pose(*model.carrying.pose(support, t), 0)
            if model.scene.carried:
                motion = space.motion(*model.carrying.absolute(support, t, torch.full_like(t, GAP / INCREMENT)))
            else:
                motion = torch.zeros_like(pose[0]), torch.zeros_like(pose[0][..., :space.spin])
            r, q, v, spin = (torch.cat((first[..., None, :].expand(*x.shape[:-2], 1, x.shape[-1]), x), -2)
                             for first, x in zip((pose[0], pose[1], *motion), (r, q, v, spin), strict=True))
        a = None
        if model.adds_mass:  # of a clamp that moves; of what is free it is to be found
            a = torch.zeros_like(v)
            if model.scene.carried and model.held.first:
                a = put(a, 0, self._clamp_acceleration(t))
        return Nodes(r, q, v, space.to_frame(q, spin), frame, internal, None, a), spin, raw

    def stress(self, nodes: Nodes, t: Tensor) -> Tensor:
        """[F; M] (..., N, k) of the strain and, where there is damping, of its rate."""
        model, space = self.model, self.model.space
        kin = space.kinematics(nodes.position, nodes.rotation, model.length)
        felt = (space.strains(kin, model.length, model.reference) - model.eigenstrain(t, self.inputs))[..., None]
        if model.rate is not None:
            moving = space.to_elements(torch.cat((nodes.velocity, nodes.spin), -1))
            felt = felt + times(model.rate, space.strain_operator(kin, model.length) @ moving[..., None])
        return times(model.C, felt)[..., 0]

    def balance(self, t: Tensor, nodes: Nodes) -> tuple[Tensor, Tensor]:
        """(loads less internal forces (..., N+1, w) in frame a, loads)"""
        model, space = self.model, self.model.space
        kin = space.kinematics(nodes.position, nodes.rotation, model.length)
        internal = space.to_nodes(space.forces(kin, self.stress(nodes, t), model.length))
        loads = model.external(nodes, t, self.inputs) + torch.zeros_like(internal)
        return loads - internal, loads

    def accelerations(self, t: Tensor, nodes: Nodes, spin: Tensor, net: Tensor) -> tuple[Tensor, Tensor]:
        """v' (frame a) and Omega' (section axes) of the nodes with unknowns."""
        model, space, first = self.model, self.model.space, self.model.held.first
        inertia, omega, p = model.inertia, model.frame(t)[1], space.position
        q, v, spin, net = (x[..., first:, :] for x in (nodes.rotation, nodes.velocity, spin, net))
        J, m = inertia.inertia[..., first:, :, :], inertia.mass[..., first:, :]
        bias = torch.zeros_like(v) if omega is None else (space.tilde(omega) @ v[..., None])[..., 0]
        gyroscopic = (space.hat(spin) @ (J @ spin[..., None]))[..., 0]
        if inertia.offset is None and model.held.free is None and not model.adds_mass:
            torque = space.to_section(q, net[..., p:]) - gyroscopic
            return net[..., :p] / m - bias, torch.linalg.solve(J, torque[..., None])[..., 0]
        R = space.spin_matrix(q)
        by_v, by_spin = m[..., None] * torch.eye(p, dtype=m.dtype, device=m.device), R @ J @ R.mT
        torque, force = net[..., p:] - space.to_frame(q, gyroscopic), net[..., :p]
        coupling = torch.zeros_like(by_v[..., :space.spin])
        if inertia.offset is not None:
            e = inertia.arm(nodes.rotation)[..., first:, :]
            tilde, A = space.tilde(space.to_frame(q, spin)), space.arm(e)
            bias = bias + (tilde @ (tilde @ e[..., None]))[..., 0]
            coupling = m[..., None] * A
            by_spin = by_spin + A.mT @ coupling
            torque = torque - (A.mT @ (m * bias)[..., None])[..., 0]
        if model.adds_mass:
            by_v = by_v + added_mass(model, nodes, t, self.inputs)[..., first:, :p, :p]
        force = force - (by_v @ bias[..., None])[..., 0]
        top, bottom = (torch.cat(level(*row), -1)
                       for row in ((by_v, coupling), (coupling.mT, by_spin)))
        block = torch.cat(level(top, bottom), -2)
        right = torch.cat((force, torque), -1)
        free = model.held.free
        if free is not None:
            block = block * free[..., None] * free[..., None, :] + torch.diag_embed(1 - free)
            right = right * free
        found = torch.linalg.solve(block, right[..., None])[..., 0]
        return found[..., :p], space.to_section(q, found[..., p:])

    def __call__(self, t: Tensor, y: Tensor) -> Tensor:
        model, space, first = self.model, self.model.space, self.model.held.first
        nodes, spin, raw = self.unpack(t, y)
        net, loads = self.balance(t, nodes)
        acceleration, spin_rate = self.accelerations(t, nodes, spin, net)
        v, omega = model.frame(t)
        velocity, turn = nodes.velocity[..., first:, :], spin[..., first:, :]
        if v is not None:
            velocity = velocity - v
        if omega is not None:
            velocity = velocity - (space.tilde(omega) @ nodes.position[..., first:, :, None])[..., 0]
            turn = turn - space.to_section(nodes.rotation[..., first:, :], omega)
        parts = [x.flatten(-2) for x in (velocity, space.rotation_rate(raw, turn), acceleration, spin_rate)]
        if nodes.frame is not None:
            parts.append(space.rotation_rate(nodes.frame, omega[..., 0, :]))
        if nodes.internal is not None:
            parts.append(advanced_rates(model, nodes, t, self.inputs))
        power = (loads * torch.cat((nodes.velocity, nodes.spin), -1)).sum((-1, -2))
        if model.adds_mass:
            a = acceleration if omega is None else acceleration + (
                space.tilde(omega) @ nodes.velocity[..., first:, :, None])[..., 0]
            fluid = added_mass(model, nodes, t, self.inputs)[..., first:, :space.position, :space.position] @ a[..., None]
            power = power - (fluid[..., 0] * nodes.velocity[..., first:, :]).sum((-1, -2))
        if model.scene.carried and model.held.first:
            moving = torch.cat((nodes.velocity, nodes.spin), -1)[..., 0, :]
            power = power + (self.reaction(t, nodes, net)[..., 0, :] * moving).sum(-1)
        return torch.cat([x.expand(*y.shape[:-1], x.shape[-1]) for x in (*parts, power[..., None])], -1)

    def reaction(self, t: Tensor, nodes: Nodes, net: Tensor) -> Tensor:
        """(..., K, w): what the balance lacks at the supports, the inertia of a clamp that moves included."""
        model = self.model
        found = [-model.held.fixed[k] * net[..., node, :] for k, node in enumerate(model.held.nodes)]
        if not found:
            return net[..., :0, :]
        if model.scene.carried and model.held.first:
            before, after = (self._momentum(at) for at in (t - GAP, t + GAP))
            omega, space = model.frame(t)[1], model.space
            rate = (after - before) / (2 * GAP)
            if omega is not None:
                p = space.position
                now, omega = self._momentum(t), omega[..., 0, :]
                turned = space.tilde(omega) @ now[..., :p, None], space.hat(omega) @ now[..., p:, None]
                rate = rate + torch.cat(turned, -2)[..., 0]
            if model.inertia.offset is not None:
                p = model.space.position
                lever = self._clamp(t)[-1].mT @ rate[..., :p, None]
                rate = torch.cat((rate[..., :p], rate[..., p:] + lever[..., 0]), -1)
            found[0] = found[0] + rate
        return torch.stack(torch.broadcast_tensors(*found), -2)

    def _momentum(self, t: Tensor) -> Tensor:
        """[m v_c; R J Omega] (..., w) of a clamp at node 0."""
        inertia, space = self.model.inertia, self.model.space
        q, v, spin, arm = self._clamp(t)
        H = (inertia.inertia[..., 0, :, :] @ spin[..., None])[..., 0]
        spin, H = (space.to_frame(q, x[..., None, :])[..., 0, :] for x in (spin, H))
        if arm is not None:
            v = v + (arm @ spin[..., None])[..., 0]
        p = inertia.mass[..., 0, :, None] * v[..., None]
        return torch.cat(level(p, H[..., None]), -2)[..., 0]

    def _clamp_acceleration(self, t: Tensor) -> Tensor:
        """(..., p) of a clamp at node 0, absolute, frame a."""
        rate = (self._clamp(t + GAP)[1] - self._clamp(t - GAP)[1]) / (2 * GAP)
        tilde = None if self.model.frame(t)[1] is None else self.model.space.tilde(self.model.frame(t)[1][..., 0, :])
        return rate if tilde is None else rate + (tilde @ self._clamp(t)[1][..., None])[..., 0]

    def _clamp(self, t: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor | None]:
        """Of a clamp at node 0: rotation (as if that of every node, for spaces whose nodes have axes of their own), velocity,
        spin (section axes), how a spin moves its centre of mass (..., p, s).
        """
        model, space = self.model, self.model.space
        support = model.scene.supports[0]
        _, q = space.pose(*model.carrying.pose(support, t), 0)
        q = q[..., None, :].expand(*q.shape[:-1], model.count + 1, q.shape[-1])
        motion = space.motion(*model.carrying.absolute(support, t, torch.full_like(t, GAP / INCREMENT)))
        arm = None if model.inertia.offset is None else space.arm(model.inertia.arm(q)[..., 0, :])
        return q, *motion, arm

    def state(self, t: Tensor, y: Tensor, status: Tensor) -> State:
        """The state at time t; stress and reaction are those of the instant."""
        nodes, spin, _ = self.unpack(t, y)
        net, _ = self.balance(t, nodes)
        work = y[..., -1]
        return self.model.space.leave(State(
            *nodes[:3], spin, self.stress(nodes, t), self.reaction(t, nodes, net), work, torch.zeros_like(work),
            t.expand(work.shape), status, frame=nodes.frame, internal=nodes.internal))
