"""The nodal form as an explicit ordinary differential equation: lumped mass, one block a node, no global solve."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..core.derivatives import cached
from ..core.functions_of_time import with_rate
from ..math.block_tridiagonal import broadcast_matrices
from ..math.shapes import broadcast_shapes
from ..scene.effects import INERTIAL, Inputs
from ..scene.scene import Scene
from ..scene.supports import Support
from ..state.state import State
from ..state.supported_nodes import set_node
from .discretise import discretise
from .inertia import Inertia
from .loads import Nodes, added_mass, advanced_rates, external
from .model import Model


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
        for supports that move, by themselves or with frame a, other than a clamp at node 0.
        """
        model = discretise(scene, lumped=True)
        rotary = cls(model, inputs).free.rotary
        if not rotary.present or (torch.linalg.det(rotary.J) <= 0).any():
            raise ValueError("a section without rotary inertia was given; an explicit method wants some (the implicit "
                             "method 'midpoint' needs none)")
        if any(scene.beam.rigid):
            raise ValueError("an infinite stiffness was given; an explicit method wants finite ones (the implicit method "
                             "'midpoint' takes it)")
        if any((s.moves or scene.frame is not None) and not (s.clamp and s.node == 0) for s in scene.supports):
            raise ValueError("a support that moves, or whose frame does, other than a clamp at node 0, was given; the implicit "
                             "method 'midpoint' takes it")
        return cls(model, inputs)

    @cached
    def free(self) -> Inertia:
        """Of the nodes with unknowns."""
        return self.model.inertia.of_nodes(slice(self.model.constraints.first, None))

    @cached
    def clamped(self) -> Inertia:
        """Of node 0."""
        return self.model.inertia.of_nodes(slice(0, 1))

    @property
    def sizes(self) -> list[int]:
        """Of position, rotation, velocity, spin of the nodes with unknowns."""
        space, beam = self.model.space, self.model.scene.beam
        n = beam.count + 1 - self.model.constraints.first
        rotation = space.to_reduced_rotation(beam.frames).shape[-1]
        return [n * space.position, n * rotation, n * space.position, n * space.spin]

    def pack(self, state: State) -> Tensor:
        """The state's nodes with unknowns, and what else changes, as one vector."""
        model = self.model
        shape = broadcast_shapes(state.batch_shape, model.scene.batch_shape)
        state = model.space.to_reduced(state)
        motion = state.position, state.rotation, state.velocity, state.spin
        parts = [x[..., model.constraints.first:, :].flatten(-2) for x in motion]
        parts += [x for x in (state.frame, state.internal) if x is not None]
        return torch.cat([x.expand(*shape, x.shape[-1]) for x in (*parts, state.work[..., None])], -1)

    def unpack(self, t: Tensor, y: Tensor) -> tuple[Nodes, Tensor, Tensor]:
        """(nodes, supports included; spins in section axes; the rotations of nodes with unknowns as they are in y)."""
        model, space = self.model, self.model.space
        *parts, rest = y.split([*self.sizes, y.shape[-1] - sum(self.sizes)], -1)
        n = model.count + 1 - model.constraints.first
        r, raw, v, spin = (x.unflatten(-1, (n, -1)) for x in parts)
        q = space.normalize(raw)
        z, frame = model.internal_states, None
        if model.turning:
            width = rest.shape[-1] - 1 - z
            frame = space.normalize(rest[..., :width])
        internal = rest[..., rest.shape[-1] - 1 - z:-1] if z else None
        if model.constraints.first:
            support = self._root
            pose = space.of_nodes(0).pose(*model.prescribed_motion.pose(support, t))
            if model.scene.has_prescribed_motion:
                motion = space.motion(*model.prescribed_motion.absolute(support, t))
            else:
                motion = torch.zeros_like(pose[0]), torch.zeros_like(pose[0][..., :space.spin])
            r, q, v, spin = (torch.cat((first[..., None, :].expand(*x.shape[:-2], 1, x.shape[-1]), x), -2)
                             for first, x in zip((pose[0], pose[1], *motion), (r, q, v, spin), strict=True))
        accelerations = ()
        if model.adds_mass:  # of a clamp that moves; of what is free they are to be found
            accelerations = torch.zeros_like(v), torch.zeros_like(spin)
            if model.scene.has_prescribed_motion and model.constraints.first:
                accelerations = tuple(map(set_node, accelerations, (0, 0), self._clamp_accelerations(t)))
        return Nodes(r, q, v, space.to_frame(q, spin), frame, internal, None, *accelerations), spin, raw

    def stress(self, nodes: Nodes, t: Tensor) -> Tensor:
        """[F; M] (..., N, k) of the strain and, where there is damping, of its rate."""
        model, space = self.model, self.model.space
        kin = model.kinematics(nodes.position, nodes.rotation)

        def rate() -> Tensor:
            moving = space.to_elements(torch.cat((nodes.velocity, nodes.spin), -1))
            return (space.strain_operator(kin, model.length) @ moving[..., None])[..., 0]

        strain = model.strain(kin) - model.eigenstrain(t, self.inputs)
        return model.law.stress(model.law.felt(strain, rate))

    def balance(self, t: Tensor, nodes: Nodes) -> tuple[Tensor, Tensor]:
        """(loads less internal forces (..., N+1, w) in frame a, loads)"""
        model, space = self.model, self.model.space
        kin = model.kinematics(nodes.position, nodes.rotation)
        internal = space.to_nodes(space.forces(kin, self.stress(nodes, t), model.length))
        loads = external(model, nodes, t, self.inputs) + torch.zeros_like(internal)
        return loads - internal, loads

    def accelerations(self, t: Tensor, nodes: Nodes, spin: Tensor, net: Tensor) -> tuple[Tensor, Tensor]:
        """v' (frame a) and Omega' (section axes) of the nodes with unknowns."""
        model, inertia, space, first = self.model, self.free, self.free.space, self.model.constraints.first
        p, q = space.position, nodes.rotation[..., first:, :]
        if inertia.offset.present or model.constraints.free is not None or model.adds_mass:
            found, _ = self._solved(t, nodes, spin, net)
            return found[..., :p], space.to_section(q, found[..., p:])
        v, spin, net = (x[..., first:, :] for x in (nodes.velocity, spin, net))
        torque = space.to_section(q, net[..., p:]) - inertia.rotary.gyroscopic(spin)
        return (model.frame(t).rate(net[..., :p] / inertia.mass, lambda: -v),
                torch.linalg.solve(inertia.rotary.J, torque[..., None])[..., 0])

    def _solved(self, t: Tensor, nodes: Nodes, spin: Tensor, net: Tensor) -> tuple[Tensor, Tensor]:
        """[v'; R Omega'] (..., n, w) of the nodes with unknowns, frame a, and what their balance lacks: zero, but where
        supports hold them.
        """
        model, inertia, space, first = self.model, self.free, self.free.space, self.model.constraints.first
        frame, p, free = model.frame(t), space.position, model.constraints.free
        q, v, spin, net = (x[..., first:, :] for x in (nodes.rotation, nodes.velocity, spin, net))
        lever, transport = inertia.offset.turned(q), frame.rate(torch.zeros_like(v), lambda: v)
        bias = lever.acceleration(transport, lambda: space.to_frame(q, spin))
        known = lever.wrench(inertia.mass * bias, space.to_frame(q, inertia.rotary.gyroscopic(spin)))
        block, = inertia.matrix(q, lever)
        if model.adds_mass:
            fluid = added_mass(model, nodes, t, self.inputs)[..., first:, :, :]
            block, known = block + fluid, known + (fluid[..., :p] @ transport[..., None])[..., 0]
        right, whole = net - known, block
        if free is not None:
            block = block * free[..., None] * free[..., None, :] + torch.diag_embed(1 - free)
        found = torch.linalg.solve(block, (right if free is None else right * free)[..., None])[..., 0]
        return found, (whole @ found[..., None])[..., 0] - right

    def __call__(self, t: Tensor, y: Tensor) -> Tensor:
        model, space, first = self.model, self.free.space, self.model.constraints.first
        nodes, spin, raw = self.unpack(t, y)
        net, loads = self.balance(t, nodes)
        acceleration, spin_rate = self.accelerations(t, nodes, spin, net)
        frame = model.frame(t)
        known = nodes.position, nodes.rotation, nodes.velocity, spin
        position, rotation, moving, turning = (x[..., first:, :] for x in known)
        velocity, turn = frame.relative_velocity(moving, position), frame.relative_spin(turning, rotation)
        parts = [x.flatten(-2) for x in (velocity, space.rotation_rate(raw, turn), acceleration, spin_rate)]
        if frame.turns:
            parts.append(space.rotation_rate(nodes.frame, frame.omega[..., 0, :]))
        power = (loads * torch.cat((nodes.velocity, nodes.spin), -1)).sum((-1, -2))
        if model.adds_mass:
            a, alpha = frame.rate(acceleration, lambda: moving), space.to_frame(rotation, spin_rate)
            fluid = added_mass(model, nodes, t, self.inputs)[..., first:, :, :] @ torch.cat((a, alpha), -1)[..., None]
            power = power - (fluid[..., 0] * torch.cat((moving, nodes.spin[..., first:, :]), -1)).sum((-1, -2))
            found = (torch.cat((known[..., :first, :], free), -2)
                     for known, free in ((nodes.acceleration, a), (nodes.angular_acceleration, alpha)))
            nodes = nodes._replace(**dict(zip(INERTIAL, found, strict=True)))
        if nodes.internal is not None:
            parts.append(advanced_rates(model, nodes, t, self.inputs))
        if model.scene.has_prescribed_motion and model.constraints.first:
            moving = torch.cat((nodes.velocity, nodes.spin), -1)[..., 0, :]
            power = power + (self._clamp_reaction(t, nodes, net) * moving).sum(-1)
        return torch.cat([x.expand(*y.shape[:-1], x.shape[-1]) for x in (*parts, power[..., None])], -1)

    def reaction(self, t: Tensor, nodes: Nodes, spin: Tensor, net: Tensor) -> Tensor:
        """(..., K, w): what the balance lacks at the supports, inertia included: of a clamp that moves, and of a mass that
        moves though its node is held in part.
        """
        model, first, lacks = self.model, self.model.constraints.first, -net
        if model.constraints.free is not None:
            _, own = self._solved(t, nodes, spin, net)
            lacks = torch.cat((lacks[..., :first, :].expand(*own.shape[:-2], first, -1), own), -2)
        found = [model.constraints.fixed[k] * lacks[..., node, :] for k, node in enumerate(model.constraints.nodes)]
        if not found:
            return net[..., :0, :]
        if model.scene.has_prescribed_motion and first:
            found[model.constraints.nodes.index(0)] = self._clamp_reaction(t, nodes, net)
        return torch.stack(torch.broadcast_tensors(*found), -2)

    @property
    def _root(self) -> Support:
        """The clamp at node 0."""
        return self.model.scene.supports[self.model.constraints.nodes.index(0)]

    def _clamp_reaction(self, t: Tensor, nodes: Nodes, net: Tensor) -> Tensor:
        """(..., w) of a clamp at node 0 that moves: the rate of its node's momentum, less what else acts there."""
        frame, sizes = self.model.frame(t), (self.model.space.position, self.model.space.spin)
        (P, H), (P_rate, H_rate) = (x.split(sizes, -1) for x in with_rate(self._momentum, t))
        lever = self.clamped.offset.turned(nodes.rotation[..., :1, :])
        rate = lever.wrench(frame.rate(P_rate, lambda: P), frame.spin_rate(H_rate, lambda: H))
        return rate[..., 0, :] - net[..., 0, :]

    def _momentum(self, t: Tensor) -> Tensor:
        """[m v_c; R J Omega] (..., 1, w) of a clamp at node 0."""
        q, v, spin = self._clamp(t)
        return torch.cat(broadcast_matrices(*self.clamped.momenta(q, self.clamped.centre_velocity(q, v, spin), spin)), -1)

    def _clamp_accelerations(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """Acceleration (..., p) and angular acceleration (..., s) of a clamp at node 0, absolute, frame a."""
        model = self.model
        a, alpha = model.prescribed_motion.acceleration(self._root, t).unbind(-2)
        return model.space.project_vector(a), model.space.project_spin(alpha)

    def _clamp(self, t: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Of a clamp at node 0, (..., 1, ...): rotation, velocity, spin (section axes)."""
        model, space = self.model, self.model.space
        support = self._root
        _, q = space.of_nodes(0).pose(*model.prescribed_motion.pose(support, t))
        return tuple(x[..., None, :] for x in (q, *space.motion(*model.prescribed_motion.absolute(support, t))))

    def state(self, t: Tensor, y: Tensor, status: Tensor) -> State:
        """The state at time t; stress and reaction are those of the instant."""
        nodes, spin, _ = self.unpack(t, y)
        net, _ = self.balance(t, nodes)
        work = y[..., -1]
        return self.model.space.to_public(State(
            *nodes[:3], spin, self.stress(nodes, t), self.reaction(t, nodes, spin, net), work, torch.zeros_like(work),
            t.expand(work.shape), status, frame=nodes.frame, internal=nodes.internal,
            supports=self.model.constraints.nodes))
