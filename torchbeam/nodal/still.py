"""Equilibrium of the nodal form: the balance of what stands still, or moves with a frame that moves steadily."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..effects import Inputs
from ..state import State, orientation, put
from . import external
from .balance import Linearisation, Residual, blocked, largest, size_of_strain
from .external import STEADY, Chain, Nodes
from .model import Model, times


class Shape(NamedTuple):
    """position (..., N+1, p) m, rotation (..., N+1, ...), stress (..., N, k) N and N m, in the space's coordinates."""

    position: Tensor
    rotation: Tensor
    stress: Tensor


@dataclass(frozen=True)
class Still:
    """inertia + to_nodes(h B^T [F; M]) = share * loads and S [F; M] = strain; `share` (...) in [0, 1] steps the loads, the
    inertia of a moving frame, the strain that a beam takes by itself and the motion of its supports.

    Steady motion with velocity v and angular velocity omega of frame a: with x the centres of mass and e their arms, the
    inertia at a node is the force omega x M (v + omega x x) with the moment omega x R J R^T omega + e x force.
    """

    model: Model
    t: Tensor
    inputs: Inputs
    share: Tensor

    @cached_property
    def frame(self) -> tuple[Tensor | None, Tensor | None]:
        return self.model.frame(self.t)

    @cached_property
    def _own_strain(self) -> Tensor | float:
        own = self.model.eigenstrain(self.t, self.inputs)
        return own if isinstance(own, float) else self.share[..., None, None] * own

    def moved(self, x: Shape, move: Tensor, dstress: Tensor) -> Shape:
        space = self.model.space
        turn = move[..., space.position:]
        turn = space.cayley(turn if space.turns else space.to_section(x.rotation, turn))
        rotation = space.normalize(space.multiply(turn, x.rotation))
        return Shape(x.position + move[..., :space.position], rotation, x.stress + dstress)

    def nodes(self, x: Shape) -> Nodes:
        velocity, spin = self.velocity(x)
        nodes, sizes = Nodes(x.position, x.rotation, velocity, spin), self.model.internal_states
        if self.frame[1] is not None:
            nodes = nodes._replace(acceleration=(self.model.space.tilde(self.frame[1]) @ velocity[..., None])[..., 0])
        if not sizes:
            return nodes
        start = x.position.new_zeros(*x.position.shape[:-2], sizes)
        return nodes._replace(internal=start, dt=torch.full_like(self.t, STEADY))

    def velocity(self, x: Shape) -> tuple[Tensor, Tensor]:
        """Of nodes that move with frame a, absolute, frame a."""
        space, (v, omega) = self.model.space, self.frame
        velocity = torch.zeros_like(x.position) if v is None else v + torch.zeros_like(x.position)
        spin = torch.zeros_like(x.position[..., :space.spin])
        if omega is not None:
            velocity, spin = velocity + (space.tilde(omega) @ x.position[..., None])[..., 0], omega + spin
        return velocity, spin

    def inertia(self, x: Shape) -> tuple[Tensor, Tensor]:
        """Force and moment (..., N+1, w), and their derivative by position and spin (..., N+1, w, w), neighbours apart."""
        model, space, omega = self.model, self.model.space, self.frame[1]
        inertia = model.inertia
        arm = inertia.arm(x.rotation) if inertia.offset is not None else None
        velocity, _ = self.velocity(x if arm is None else x._replace(position=x.position + arm))
        tilde = space.tilde(omega)
        force = (tilde @ inertia.momentum(velocity)[..., None])[..., 0]
        torque = torch.zeros_like(force[..., :space.spin])
        by_spin = torch.zeros_like(torque[..., None] * torque[..., None, :])
        if inertia.inertia is not None:
            R = space.spin_matrix(x.rotation)
            J = R @ inertia.inertia @ R.mT
            H = (J @ omega[..., None])[..., 0]
            torque = torque + (space.hat(omega) @ H[..., None])[..., 0]
            by_spin = by_spin + space.hat(omega) @ (J @ space.hat(omega) - space.hat(H))
        if arm is not None:
            torque = torque + (space.arm(arm).mT @ force[..., None])[..., 0]
            by_spin = by_spin - space.arm(force).mT @ space.arm(arm)
        return torch.cat((force, torque), -1), by_spin

    def residual(self, x: Shape) -> tuple[Residual, Any]:
        model, space, h = self.model, self.model.space, self.model.length
        x = self.held(x)
        kin = space.kinematics(x.position, x.rotation, h)
        element = space.forces(kin, x.stress, h)
        load = model.external(self.nodes(x), self.t, self.inputs)
        if self.frame[1] is not None:
            load = load - self.inertia(x)[0]
        load = load if isinstance(load, float) else self.share[..., None, None] * load
        bent = space.strains(kin, h, model.reference) - self._own_strain
        gap = bent - times(model.S, x.stress[..., None])[..., 0]
        sizes = largest(space.position, h, element, load, blocked(model, kin, self._own_strain, h))
        return Residual(model.held, space.to_nodes(element) - load, gap, *sizes, size_of_strain(bent, self._own_strain)), kin

    def linearise(self, x: Shape, kin: Any) -> Linearisation:
        model, space = self.model, self.model.space
        p, w, share = space.position, space.unknowns, self.share[..., None, None, None]
        B = space.strain_operator(kin, model.length)
        diagonal, coupling = torch.zeros_like(B[..., :1, :1, :1]).expand(*B.shape[:-3], 1, w, w), None
        if model.loads[0]:
            omega, by = self.frame[1], None
            if omega is not None:
                tilde = space.tilde(omega)
                by = Chain(tilde, torch.zeros_like(omega)[..., None] * omega[..., None, :], tilde @ tilde)
            diagonal = diagonal - share * external.tangent(model, self.nodes(x), self.t, self.inputs, model.loads[0], by)
        if self.frame[1] is not None:
            tilde = space.tilde(self.frame[1])
            arm = None if model.inertia.offset is None else space.arm(model.inertia.arm(x.rotation))
            at, coupling = model.inertia.blocks(tilde @ tilde, None if arm is None else model.inertia.arm(x.rotation), arm)
            diagonal = diagonal + share * (at + pad(self.inertia(x)[1], (p, 0, p, 0)))
            coupling = None if coupling is None else share[..., None] * coupling
        return Linearisation.condense(model, space.geometric_stiffness(kin, x.stress, model.length), diagonal,
                                      model.length[..., None] * B, model.stiffness(), B, coupling)

    def state(self, x: Shape, reaction: Tensor, status: Tensor) -> State:
        """The public state of a solution: at rest in frame a."""
        model, space, shape = self.model, self.model.space, status.shape
        velocity, spin = self.velocity(x)
        zero = torch.zeros_like(status, dtype=x.position.dtype)
        return space.leave(State(
            *x[:2], velocity=velocity, spin=space.to_section(x.rotation, spin), stress=x.stress, reaction=reaction, work=zero,
            defect=zero, t=self.t.expand(shape), status=status, frame=orientation(model.scene, shape),
            internal=external.internal(model, self.nodes(x), self.t, self.inputs, shape)))

    def held(self, x: Shape) -> Shape:
        """x with the supports where they have to be."""
        position, rotation, space = x.position, x.rotation, self.model.space
        for support, fixed in zip(self.model.scene.supports, self.model.held.fixed, strict=True):
            at = support.node
            r, q = space.pose(*self.model.carrying.pose(support, self.t, self.share[..., None]), at)
            position = put(position, at, torch.where(fixed[:space.position] > 0, r, position[..., at, :]))
            rotation = put(rotation, at, q) if bool(fixed[space.position:].all()) else rotation
        return Shape(position, rotation, x.stress)
