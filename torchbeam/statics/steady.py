"""Equilibrium of the nodal form: the balance of what stands still, or moves with a frame that moves steadily."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import cached
from ..core.leaves import Tree, leaf
from ..nodal import loads as external
from ..nodal.balance import Linearisation, Residual, largest, restrained_forces, size_of_strain
from ..nodal.inertia import Momenta
from ..nodal.loads import STEADY, MotionJacobian, Nodes
from ..nodal.model import Model
from ..scene.effects import Inputs
from ..scene.prescribed_motion import orientation
from ..state.state import State
from ..state.supported_nodes import set_node


class Configuration(NamedTuple):
    """position (..., N+1, p) m, rotation (..., N+1, ...), stress (..., N, k) N and N m, in the space's coordinates."""

    position: Tensor
    rotation: Tensor
    stress: Tensor


@dataclass(frozen=True)
class SteadyProblem(Tree):
    """inertia + to_nodes(h B^T [F; M]) = load_factor * loads and S [F; M] = strain; `load_factor` (...) in [0, 1] steps the
    loads, the inertia of a moving frame, the strain that a beam takes by itself and the motion of its supports.

    Steady motion with velocity v and angular velocity omega of frame a: with x the centres of mass, momenta are
    M (v + omega x x) and R J R^T omega, and what they ask for is `Inertia.balance`.

    internal  (..., z) of the loads, where they are held; None = where they come to rest
    """

    model: Model
    t: Tensor = leaf(0)
    inputs: Inputs = leaf(1)
    load_factor: Tensor = leaf(0)
    internal: Tensor | None = leaf(1, default=None, kw_only=True)

    @cached
    def frame(self) -> tuple[Tensor | None, Tensor | None]:
        return self.model.frame(self.t)

    @cached
    def _own_strain(self) -> Tensor | float:
        own = self.model.eigenstrain(self.t, self.inputs)
        return own if isinstance(own, float) else self.load_factor[..., None, None] * own

    def update(self, x: Configuration, move: Tensor, dstress: Tensor) -> Configuration:
        space = self.model.space
        turn = move[..., space.position:]
        turn = space.cayley(turn if space.turns else space.to_section(x.rotation, turn))
        rotation = space.normalize(space.multiply(turn, x.rotation))
        return Configuration(x.position + move[..., :space.position], rotation, x.stress + dstress)

    def nodes(self, x: Configuration) -> Nodes:
        velocity, spin = self.velocity(x)
        nodes, sizes = Nodes(x.position, x.rotation, velocity, spin), self.model.internal_states
        if self.frame[1] is not None:
            nodes = nodes._replace(acceleration=(self.model.space.skew(self.frame[1]) @ velocity[..., None])[..., 0])
        if not sizes:
            return nodes
        if self.internal is not None:
            return nodes._replace(internal=self.internal)
        start = x.position.new_zeros(*x.position.shape[:-2], sizes)
        return nodes._replace(internal=start, dt=torch.full_like(self.t, STEADY))

    def holding(self, x: Configuration, internal: Tensor | None) -> SteadyProblem:
        """The same with the internal states of the loads held: at these, or (None) where they come to rest at x."""
        if internal is None:
            internal = external.internal(self.model, self.nodes(x), self.t, self.inputs, x.position.shape[:-2])
        elif internal.shape[-1] != self.model.internal_states:
            raise ValueError(f"a state with {internal.shape[-1]} internal states was given; the scene's loads have "
                             f"{self.model.internal_states}")
        return replace(self, internal=internal)

    def velocity(self, x: Configuration) -> tuple[Tensor, Tensor]:
        """Of nodes that move with frame a, absolute, frame a."""
        space, (v, omega) = self.model.space, self.frame
        velocity = torch.zeros_like(x.position) if v is None else v + torch.zeros_like(x.position)
        spin = torch.zeros_like(x.position[..., :space.spin])
        if omega is not None:
            velocity, spin = velocity + (space.skew(omega) @ x.position[..., None])[..., 0], omega + spin
        return velocity, spin

    def lever(self, x: Configuration) -> Tensor | None:
        """R e (..., N+1, p), frame a; None where the centres lie in the nodes."""
        return None if self.model.inertia.offset is None else self.model.inertia.lever(x.rotation)

    def momenta(self, x: Configuration) -> Momenta:
        """Of steady motion with a frame that turns."""
        lever = self.lever(x)
        velocity, spin = self.velocity(x if lever is None else x._replace(position=x.position + lever))
        return self.model.inertia.momenta(x.rotation, velocity, self.model.space.to_section(x.rotation, spin))

    def inertia(self, x: Configuration) -> Tensor:
        """Force and moment (..., N+1, w) of steady motion with a frame that turns."""
        momenta = self.momenta(x)
        rest = Momenta(*map(torch.zeros_like, momenta))
        return self.model.inertia.balance(rest, lambda: momenta, self.lever(x), self.frame[1])

    def inertia_tangent(self, x: Configuration) -> tuple[Tensor, Tensor | None]:
        """Its derivative by the nodes' moves, see `Inertia.tangent`."""
        space, inertia, omega = self.model.space, self.model.inertia, self.frame[1]
        lever, moved, angular = self.lever(x), None, None
        if lever is not None:
            moved = space.lever_matrix(lever)
        if inertia.inertia is not None:
            R, turning = space.spin_matrix(x.rotation), space.spin_skew(omega)
            eye = torch.eye(space.spin, dtype=R.dtype, device=R.device)
            angular = turning @ inertia.angular_tangent(R, R.mT @ turning, self.momenta(x).angular, eye)
        transport = space.skew(omega)
        force = None if lever is None else self.inertia(x)[..., :space.position]
        return inertia.tangent(inertia.blocks(transport @ transport, lever, moved), angular, force, moved)

    def residual(self, x: Configuration) -> tuple[Residual, Any]:
        model, space, h = self.model, self.model.space, self.model.length
        x = self.apply_supports(x)
        kin = model.kinematics(x.position, x.rotation)
        element = space.forces(kin, x.stress, h)
        load = external.external(model, self.nodes(x), self.t, self.inputs)
        if self.frame[1] is not None:
            load = load - self.inertia(x)
        load = load if isinstance(load, float) else self.load_factor[..., None, None] * load
        bent = model.strain(kin) - self._own_strain
        sizes = largest(space.position, h, element, load, restrained_forces(model, kin, self._own_strain, h))
        return Residual(model.constraints, space.to_nodes(element) - load, model.law.gap(bent, x.stress), *sizes,
                        size_of_strain(bent, self._own_strain)), kin

    def linearise(self, x: Configuration, kin: Any) -> Linearisation:
        model, space = self.model, self.model.space
        w, load_factor = space.unknowns, self.load_factor[..., None, None, None]
        B = space.strain_operator(kin, model.length)
        diagonal, coupling = torch.zeros_like(B[..., :1, :1, :1]).expand(*B.shape[:-3], 1, w, w), None
        if model.loads[0]:
            omega, by = self.frame[1], None
            if omega is not None:
                tilde = space.skew(omega)
                by = MotionJacobian(tilde, torch.zeros_like(omega)[..., None] * omega[..., None, :], tilde @ tilde)
            diagonal = diagonal - load_factor * external.tangent(model, self.nodes(x), self.t, self.inputs, model.loads[0], by)
        if self.frame[1] is not None:
            at, coupling = self.inertia_tangent(x)
            diagonal = diagonal + load_factor * at
            coupling = None if coupling is None else load_factor[..., None] * coupling
        return Linearisation.condense(model, space.geometric_stiffness(kin, x.stress, model.length), diagonal,
                                      model.length[..., None] * B, model.tangent_stiffness(), B, coupling)

    def state(self, x: Configuration, reaction: Tensor, status: Tensor) -> State:
        """The public state of a solution: at rest in frame a."""
        model, space, shape = self.model, self.model.space, status.shape
        velocity, spin = self.velocity(x)
        zero = torch.zeros_like(status, dtype=x.position.dtype)
        return space.to_public(State(
            *x[:2], velocity=velocity, spin=space.to_section(x.rotation, spin), stress=x.stress, reaction=reaction, work=zero,
            defect=zero, t=self.t.expand(shape), status=status, frame=orientation(model.scene, shape),
            internal=external.internal(model, self.nodes(x), self.t, self.inputs, shape)))

    def apply_supports(self, x: Configuration) -> Configuration:
        """x with the supports where they have to be."""
        position, rotation, space = x.position, x.rotation, self.model.space
        for support, fixed in zip(self.model.scene.supports, self.model.constraints.fixed, strict=True):
            at = support.node
            r, q = space.pose(*self.model.prescribed_motion.pose(support, self.t, self.load_factor[..., None]), at)
            position = set_node(position, at, torch.where(fixed[:space.position] > 0, r, position[..., at, :]))
            rotation = set_node(rotation, at, q) if bool(fixed[space.position:].all()) else rotation
        for at, axis in self.model.constraints.hinges:
            _, q = space.pose(self.model.scene.beam.nodes[..., at, :], self.model.scene.beam.frames[..., at, :], at)
            rotation = set_node(rotation, at, space.hinged(rotation[..., at, :], q, axis, at))
        return Configuration(position, rotation, x.stress)
