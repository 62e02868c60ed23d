"""The nodal form as an explicit ordinary differential equation: lumped mass, one block a node, no
global solve.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from ..core.derivatives import cached
from ..math.block_tridiagonal import broadcast_matrices
from ..math.shapes import broadcast_shapes, stacked
from ..scene.effects import INERTIAL, Inputs
from ..scene.scene import Scene
from ..scene.supports import Support
from ..state.rest_shape import RestShape
from ..state.state import State
from .conditions import Conditions, conditions
from .discretise import discretise
from .element_loads import all_loads
from .inertia import Inertia
from .loads import Nodes, added_mass, advanced_rates
from .model import Model
from .moves import remembered


def forces_between_nodes(scene: Scene) -> str | None:
    """What pushes between nodes that no element joins, which rates do not know; None = nothing."""
    if scene.joints:
        return f"a {scene.joints[0].called}"
    if scene.tendons:
        return "a Tendon"
    bound = [
        interaction.called
        for interaction in scene.interactions
        if interaction.unknowns or interaction.memory
    ]
    if bound:
        return f"a {bound[0]} with unknowns or a memory"
    return f"a {scene.pairs[0].called} of two parts" if scene.pairs else None


def refuse_forces_between_nodes(scene: Scene) -> None:
    """ValueError for a scene with such."""
    if what := forces_between_nodes(scene):
        raise ValueError(
            f"{what} was given to an explicit method, which has no forces of it; the implicit "
            "method 'midpoint' takes it"
        )


@dataclass(frozen=True)
class Rates:
    """The right-hand side dy/dt = f(t, y) of the nodes with unknowns: position, rotation, velocity
    and spin, then, where there are such, the frame's orientation and internal states of loads, and
    the work of the loads.

        r' = v      R' = R ~Omega      m v' = f      J Omega' = R^T m - Omega x J Omega

    in a frame that turns with omega, where v and Omega are absolute: r' = v - v_a - omega x r,
    R' = R ~(Omega - R^T omega), m (v' + omega x v) = f. A mass off its node or a node held in part
    couples v' and Omega': one block a node.
    """

    model: Model
    inputs: Inputs

    @classmethod
    def of(cls, scene: Scene, inputs: Inputs) -> Rates:
        """Raises ValueError where a block of the mass is singular or a stiffness infinite (both
        need the implicit form), and for supports that move, by themselves or with frame a, other
        than clamps.
        """
        refuse_forces_between_nodes(scene)
        model = discretise(scene, lumped=True)
        rotary = cls(model, inputs).free.rotary
        if not rotary.present or (torch.linalg.det(rotary.J) <= 0).any():
            raise ValueError(
                "a section without rotary inertia was given; an explicit method wants some (the "
                "implicit method 'midpoint' needs none)"
            )
        if any(scene.beam.rigid):
            raise ValueError(
                "an infinite stiffness was given; an explicit method wants finite ones (the "
                "implicit method 'midpoint' takes it)"
            )
        if any((s.moves or scene.frame is not None) and not s.clamp for s in scene.supports):
            raise ValueError(
                "a support that moves, or whose frame does, other than a clamp, was given; the "
                "implicit method 'midpoint' takes it"
            )
        return cls(model, inputs)

    @cached
    def clamps(self) -> tuple[Support, ...]:
        """Supports that leave their nodes no unknowns, by node."""
        pairs = zip(self.model.scene.supports, self.model.constraints.fixed, strict=True)
        return tuple(
            sorted(
                (support for support, fixed in pairs if bool(fixed.all())),
                key=lambda support: support.node,
            )
        )

    @cached
    def carried(self) -> bool:
        """Whether there are clamps that move, with frame a or in it."""
        return bool(self.clamps) and self.model.scene.has_prescribed_motion

    @cached
    def places(self) -> tuple[Tensor, Tensor]:
        """Of the nodes with unknowns, and of those that are clamped."""
        moving = self.model.constraints.moving.any(-1)
        return moving.nonzero()[:, 0], (~moving).nonzero()[:, 0]

    @cached
    def partly_held(self) -> Tensor | None:
        """(n, w) 1 where the nodes with unknowns are free, 0 where they are held; None = free."""
        moving = self.model.constraints.moving[self.places[0]]
        return None if bool(moving.all()) else moving.to(self.model.length)

    @cached
    def free(self) -> Inertia:
        """Of the nodes with unknowns."""
        return self.model.inertia.of_nodes(self.places[0])

    @cached
    def clamped(self) -> Inertia:
        """Of those that are clamped."""
        return self.model.inertia.of_nodes(self.places[1])

    def unknown(self, x: Tensor, axes: int = 1) -> Tensor:
        """Nodes (..., N+1, *) -> those with unknowns."""
        return x.index_select(-1 - axes, self.places[0]) if self.clamps else x

    def joined(self, x: Tensor, clamped: Tensor) -> Tensor:
        """Nodes with unknowns (..., n, *), and clamps -> all."""
        if not self.clamps:
            return x
        return stacked(x, clamped).index_select(-2, torch.cat(self.places).argsort())

    @property
    def sizes(self) -> list[int]:
        """Of position, rotation, velocity, spin of the nodes with unknowns."""
        space, n = self.model.space, len(self.places[0])
        rotation = space.to_reduced_rotation(self.model.scene.beam.frames).shape[-1]
        return [n * space.dims.position, n * rotation, n * space.dims.position, n * space.dims.spin]

    def pack(self, state: State) -> Tensor:
        """The state's nodes with unknowns, and what else changes, as one vector."""
        model = self.model
        shape = broadcast_shapes(state.batch_shape, model.scene.batch_shape)
        state = model.space.to_reduced(state)
        motion = state.position, state.rotation, state.velocity, state.spin
        parts = [self.unknown(x).flatten(-2) for x in motion]
        parts += [x for x in (state.frame, remembered(state)) if x is not None]
        return torch.cat(
            [x.expand(*shape, x.shape[-1]) for x in (*parts, state.work[..., None])], -1
        )

    def unpack(self, t: Tensor, y: Tensor) -> tuple[Nodes, Tensor, Tensor]:
        """(nodes, supports included; spins in section axes; the rotations of nodes with unknowns as
        they are in y).
        """
        model, space = self.model, self.model.space
        *parts, rest = y.split([*self.sizes, y.shape[-1] - sum(self.sizes)], -1)
        r, raw, v, spin = (x.unflatten(-1, (len(self.places[0]), -1)) for x in parts)
        q = space.normalize(raw)
        z, frame = model.lag_count, None
        if model.turning:
            width = rest.shape[-1] - 1 - z
            frame = space.normalize(rest[..., :width])
        internal = rest[..., rest.shape[-1] - 1 - z : -1] if z else None
        if self.clamps:
            r, q, v, spin = map(self.joined, (r, q, v, spin), self._of_clamps(self._held, t))
        accelerations = ()
        if model.adds_mass:  # of a clamp that moves; of what is free they are to be found
            accelerations = torch.zeros_like(v), torch.zeros_like(spin)
            if self.carried:
                known = self._of_clamps(self._accelerations, t)
                accelerations = tuple(
                    self.joined(self.unknown(x), of_clamps)
                    for x, of_clamps in zip(accelerations, known, strict=True)
                )
        return (
            Nodes(r, q, v, space.to_frame(q, spin), frame, internal, None, *accelerations),
            spin,
            raw,
        )

    def conditions(self, t: Tensor) -> Conditions:
        return conditions(self.model, t, self.inputs)

    def stress(self, nodes: Nodes, now: Conditions) -> Tensor:
        """[F; M] (..., N, k) of the strain, of its rate where there is damping, and of what has
        crept where stress relaxes.
        """
        model, space = self.model, self.model.space
        kinematics = model.kinematics(nodes.position, nodes.rotation)

        def rate() -> Tensor:
            moving = model.assembly.to_elements(torch.cat((nodes.velocity, nodes.spin), -1))
            return (space.strain_operator(kinematics, model.length) @ moving[..., None])[..., 0]

        strain = model.strain(kinematics) - now.eigenstrain
        if model.law.arms is not None:
            strain = model.law.arms.now(strain, self._crept(nodes))
        return model.law.stress(model.law.effective_strain(strain, rate))

    def _crept(self, nodes: Nodes) -> Tensor:
        """(..., N, m k), behind internal states of loads."""
        crept = nodes.internal[..., self.model.internal_states :]
        return crept.unflatten(-1, (self.model.station_count, -1))

    def balance(self, now: Conditions, nodes: Nodes) -> tuple[Tensor, Tensor]:
        """(loads less internal forces (..., N+1, w) in frame a, loads)"""
        model, space = self.model, self.model.space
        kinematics = model.kinematics(nodes.position, nodes.rotation)
        internal = model.assembly.to_nodes(
            space.forces(kinematics, self.stress(nodes, now), model.length)
        )
        loads = all_loads(model, nodes, now) + torch.zeros_like(internal)
        return loads - internal, loads

    def accelerations(
        self, now: Conditions, nodes: Nodes, spin: Tensor, net: Tensor
    ) -> tuple[Tensor, Tensor]:
        """v' (frame a) and Omega' (section axes) of the nodes with unknowns."""
        model, inertia, space = self.model, self.free, self.free.space
        p, q = space.dims.position, self.unknown(nodes.rotation)
        if inertia.offset.present or self.partly_held is not None or model.adds_mass:
            accelerations, _ = self._solved(now, nodes, spin, net)
            return accelerations[..., :p], space.to_section(q, accelerations[..., p:])
        v, spin, net = map(self.unknown, (nodes.velocity, spin, net))
        torque = space.to_section(q, net[..., p:]) - inertia.rotary.gyroscopic(spin)
        return (
            now.frame.rate(net[..., :p] / inertia.mass, lambda: -v),
            torch.linalg.solve(inertia.rotary.J, torque[..., None])[..., 0],
        )

    def _solved(
        self, now: Conditions, nodes: Nodes, spin: Tensor, net: Tensor
    ) -> tuple[Tensor, Tensor]:
        """[v'; R Omega'] (..., n, w) of the nodes with unknowns, frame a, and what their balance
        lacks: zero, but where supports hold them.
        """
        model, free = self.model, self.partly_held
        q, v, spin, net = map(self.unknown, (nodes.rotation, nodes.velocity, spin, net))
        block, known = self._asked(self.free, now, q, v, spin)
        if model.adds_mass:
            p, transport = model.space.dims.position, now.frame.rate(torch.zeros_like(v), lambda: v)
            fluid = self.unknown(added_mass(model, nodes, now), 2)
            block, known = block + fluid, known + (fluid[..., :p] @ transport[..., None])[..., 0]
        right, whole = net - known, block
        if free is not None:
            block = block * free[..., None] * free[..., None, :] + torch.diag_embed(1 - free)
        accelerations = torch.linalg.solve(
            block, (right if free is None else right * free)[..., None]
        )[..., 0]
        return accelerations, (whole @ accelerations[..., None])[..., 0] - right

    def _asked(
        self, inertia: Inertia, now: Conditions, q: Tensor, v: Tensor, spin: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Mass (..., n, w, w) by [v'; R Omega'] of nodes with this inertia, and what else their
        motion asks for (..., n, w).
        """
        frame, space, lever = now.frame, inertia.space, inertia.offset.turned(q)
        bias = lever.acceleration(
            frame.rate(torch.zeros_like(v), lambda: v), lambda: space.to_frame(q, spin)
        )
        known = lever.wrench(
            inertia.mass * bias, space.to_frame(q, inertia.rotary.gyroscopic(spin))
        )
        return inertia.matrix(q, lever).diagonal, known

    def __call__(self, t: Tensor, y: Tensor) -> Tensor:
        model, space = self.model, self.free.space
        now, (nodes, spin, raw) = self.conditions(t), self.unpack(t, y)
        net, loads = self.balance(now, nodes)
        acceleration, spin_rate = self.accelerations(now, nodes, spin, net)
        frame = now.frame
        position, rotation, moving, turning = map(
            self.unknown, (nodes.position, nodes.rotation, nodes.velocity, spin)
        )
        velocity = frame.relative_velocity(moving, position)
        turn = frame.relative_spin(turning, rotation)
        parts = [
            x.flatten(-2)
            for x in (velocity, space.rotation_rate(raw, turn), acceleration, spin_rate)
        ]
        if frame.turns:
            parts.append(space.rotation_rate(nodes.frame, frame.omega[..., 0, :]))
        power = (loads * torch.cat((nodes.velocity, nodes.spin), -1)).sum((-1, -2))
        if model.adds_mass:
            rates = frame.rate(acceleration, lambda: moving), space.to_frame(rotation, spin_rate)
            fluid = self.unknown(added_mass(model, nodes, now), 2) @ torch.cat(rates, -1)[..., None]
            power = power - (fluid[..., 0] * torch.cat((moving, self.unknown(nodes.spin)), -1)).sum(
                (-1, -2)
            )
            known = (
                x.index_select(-2, self.places[1])
                for x in (nodes.acceleration, nodes.angular_acceleration)
            )
            nodes = nodes._replace(
                **dict(zip(INERTIAL, map(self.joined, rates, known), strict=True))
            )
        if model.internal_states:
            parts.append(advanced_rates(model, nodes, now))
        if model.law.arms is not None:
            strain = model.strain(model.kinematics(nodes.position, nodes.rotation))
            rate = model.law.arms.rate(strain - now.eigenstrain, self._crept(nodes))
            parts.append(rate.flatten(-2))
        if self.carried:
            motion = torch.cat((nodes.velocity, nodes.spin), -1).index_select(-2, self.places[1])
            power = power + (self._clamp_reaction(now, nodes, spin, net) * motion).sum((-1, -2))
        return torch.cat(
            [x.expand(*y.shape[:-1], x.shape[-1]) for x in (*parts, power[..., None])], -1
        )

    def reaction(self, now: Conditions, nodes: Nodes, spin: Tensor, net: Tensor) -> Tensor:
        """(..., K, w): what the balance lacks at the supports, inertia included: of clamps that
        move, and of a mass that moves though its node is held in part.
        """
        constraints, clamped = self.model.constraints, -net.index_select(-2, self.places[1])
        if not constraints.nodes:
            return net[..., :0, :]
        free = (
            self._solved(now, nodes, spin, net)[1]
            if self.partly_held is not None
            else -self.unknown(net)
        )
        lacks = self.joined(
            free, self._clamp_reaction(now, nodes, spin, net) if self.carried else clamped
        )
        return constraints.fixed * lacks[..., list(constraints.nodes), :]

    # Clamps: each by its support, (..., n), then side by side, (..., K, n)

    def _of_clamps(
        self, motion: Callable[[Support, Tensor], tuple[Tensor, ...]], t: Tensor
    ) -> tuple[Tensor, ...]:
        of_each = (motion(support, t) for support in self.clamps)
        return tuple(
            torch.stack(torch.broadcast_tensors(*parts), -2) for parts in zip(*of_each, strict=True)
        )

    def _held(self, support: Support, t: Tensor) -> tuple[Tensor, ...]:
        """Position, rotation, velocity and spin (section axes)."""
        model, space = self.model, self.model.space.of_nodes(support.node)
        r, q = space.pose(*model.prescribed_motion.pose(support, t))
        if self.carried:
            return r, q, *space.motion(*model.prescribed_motion.absolute(support, t))
        return r, q, torch.zeros_like(r), torch.zeros_like(r[..., : space.dims.spin])

    def _accelerations(self, support: Support, t: Tensor) -> tuple[Tensor, Tensor]:
        """Acceleration and angular acceleration, absolute, frame a."""
        space = self.model.space
        a, alpha = self.model.prescribed_motion.acceleration(support, t).unbind(-2)
        return space.project_vector(a), space.project_spin(alpha)

    def _clamp_reaction(self, now: Conditions, nodes: Nodes, spin: Tensor, net: Tensor) -> Tensor:
        """(..., K, w): what the clamps' motion asks for, less what else acts there."""
        q, v, spin, net = (
            x.index_select(-2, self.places[1]) for x in (nodes.rotation, nodes.velocity, spin, net)
        )
        a, alpha = self._of_clamps(self._accelerations, now.t)
        block, known = self._asked(self.clamped, now, q, v, spin)
        rates = torch.cat(broadcast_matrices(now.frame.rate(a, lambda: -v), alpha), -1)
        return (block @ rates[..., None])[..., 0] + known - net

    def state(self, t: Tensor, y: Tensor, status: Tensor) -> State:
        """The state at time t; stress and reaction are those of the instant."""
        now, (nodes, spin, _) = self.conditions(t), self.unpack(t, y)
        net, _ = self.balance(now, nodes)
        work, z, internal, inelastic = y[..., -1], self.model.internal_states, nodes.internal, None
        if self.model.law.arms is not None:
            internal, inelastic = internal[..., :z] if z else None, self._crept(nodes)
        return self.model.space.to_public(
            State(
                *nodes[:3],
                spin,
                self.stress(nodes, now),
                self.reaction(now, nodes, spin, net),
                work,
                torch.zeros_like(work),
                t.expand(work.shape),
                status,
                frame=nodes.frame,
                internal=internal,
                inelastic=inelastic,
                supports=self.model.constraints.nodes,
                parts=self.model.scene.beam.parts,
                rest_shape=RestShape.of(self.model.scene.beam),
            )
        )
