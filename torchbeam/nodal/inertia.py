"""The nodes as rigid bodies: each has the mass of the beam around it and what is fixed to it.

With x = r + R e the centre of mass of a node, v_c its velocity and M the mass matrix (mass, and coupling to the neighbours):

    momentum = M v_c        angular momentum H = R J Omega        T = v_c^T M v_c/2 + Omega^T J Omega/2

What a motion asks of the nodes, in a frame a that turns with omega, is the rate of both, the moment of the force among it:

    force = M v_c' + omega x M v_c        moment = H' + omega x H + R e x force

A step takes r_n, R_n to r_{n+1}, R_{n+1} = Cay(Theta) R_n. With e- = (R_n + R_{n+1}) e/2 the centre moves by
x_{n+1} - x_n = r_{n+1} - r_n + Theta x e-. The force M d(v_c)/dt with the moment e- x force keeps energy, momentum and angular
momentum exactly where v_c rises by 2 (x_{n+1} - x_n)/dt - 2 v_c.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.leaves import Tree, leaf
from ..core.validation import concrete
from ..math import quaternions as quat
from ..math.quaternions import skew
from ..scene.scene import Scene
from .assembly import at_i, at_j, ends
from .coordinates.spatial import Space

COUPLING = 1 / 12  # half consistent, half lumped: the translational error of the implicit form is then fourth order


class Momenta(NamedTuple):
    """At the nodes, frame a: M v_c (..., N+1, p) kg m/s, and about their centres R J Omega (..., N+1, s) kg m^2/s, zero without
    rotary inertia; or the rates of both.
    """

    linear: Tensor
    angular: Tensor


@dataclass(frozen=True)
class Inertia(Tree):
    """Leading axes are batch axes; p and s are the space's numbers of positions and spins.

    mass      (..., N+1, 1) kg
    coupling  (..., N, 1) kg between neighbours; None = lumped
    inertia   (..., N+1, s, s) kg m^2 about the centre of mass, section axes; None without rotary inertia
    offset    (..., N+1, p) m of the centre of mass from the node, section axes; None = it lies there
    """

    space: Space
    mass: Tensor = leaf(2)
    coupling: Tensor | None = leaf(2)
    inertia: Tensor | None = leaf(3)
    offset: Tensor | None = leaf(2)

    def momentum(self, velocity: Tensor) -> Tensor:
        """M v_c, (..., N+1, p)."""
        p = self.mass * velocity
        if self.coupling is None:
            return p
        shared = exchange(self.coupling, *ends(velocity))
        return p + at_i(shared) - at_j(shared)

    def angular_momentum(self, spin: Tensor) -> Tensor:
        """J Omega, section axes (..., N+1, s)."""
        return torch.zeros_like(spin) if self.inertia is None else (self.inertia @ spin[..., None])[..., 0]

    def momenta(self, rotation: Tensor, centre_velocity: Tensor, spin: Tensor) -> Momenta:
        """Of nodes whose centres move with v_c (frame a), and which turn with Omega (section axes)."""
        H = self.angular_momentum(spin)
        return Momenta(self.momentum(centre_velocity), H if self.inertia is None else self.space.to_frame(rotation, H))

    def balance(self, rates: Momenta, held: Callable[[], Momenta], lever: Tensor | None, omega: Tensor | None) -> Tensor:
        """[force; moment] (..., N+1, w) that changing momenta ask for: their rates in frame a, the momenta themselves (asked
        for where the frame turns), the lever R e of the centres (None: at the nodes) and the frame's omega (None: at rest).
        """
        force, moment = rates
        if omega is not None:
            linear, angular = held()
            force = force + (self.space.skew(omega) @ linear[..., None])[..., 0]
            if self.inertia is not None:
                moment = moment + (self.space.spin_skew(omega) @ angular[..., None])[..., 0]
        if lever is not None:
            moment = moment + (self.space.lever_matrix(lever).mT @ force[..., None])[..., 0]
        return torch.cat((force, moment), -1)

    def angular_tangent(self, R: Tensor, spin_by: Tensor, H: Tensor, turn_by: Tensor) -> Tensor:
        """d(R J Omega) = R J d(Omega) - H x d(turn), (..., N+1, s, s), of d(Omega) in section axes and d(turn) in frame a."""
        return R @ (self.inertia @ spin_by) - self.space.spin_skew(H) @ turn_by

    def tangent(self, blocks: tuple[Tensor, Tensor | None], angular: Tensor | None, force: Tensor | None, moved: Tensor | None
                ) -> tuple[Tensor, Tensor | None]:
        """Derivative of `balance` by the nodes' moves: (at a node (..., N+1, w, w), between neighbours (..., N, 1 or 2, w, w)).

        blocks   that of the forces and their moments at fixed levers, see `blocks`
        angular  (..., N+1, s, s) that of the rate of the angular momentum by the node's spin; None without rotary inertia
        force    (..., N+1, p), and moved (..., N+1, p, s): how a spin moves the centre; None where it lies in the node
        """
        at, between = blocks
        p = self.space.position
        if angular is not None:
            at = at + pad(angular, (p, 0, p, 0))
        if moved is not None and self.space.turns:  # the lever turns under the force
            at = at - pad(self.space.lever_matrix(force).mT @ moved, (p, 0, p, 0))
        return at, between

    def matrix(self, rotation: Tensor) -> tuple[Tensor, Tensor | None]:
        """The mass matrix by [acceleration of the node; angular acceleration], frame a, shapes as in `tangent`."""
        eye = torch.eye(self.space.position, dtype=self.mass.dtype, device=self.mass.device)
        lever = None if self.offset is None else self.lever(rotation)
        J = None if self.inertia is None else self.about_centre(rotation)
        return self.tangent(self.blocks(eye, lever, None if lever is None else self.space.lever_matrix(lever)), J, None, None)

    def about_centre(self, rotation: Tensor) -> Tensor:
        """R J R^T (..., N+1, s, s), frame a."""
        R = self.space.spin_matrix(rotation)
        return R @ self.inertia @ R.mT

    def lever(self, rotation: Tensor) -> Tensor:
        """R e, frame a (..., N+1, p)."""
        return (self.space.matrix(rotation) @ self.offset[..., None])[..., 0]

    def centre_velocity(self, rotation: Tensor, velocity: Tensor, spin: Tensor) -> Tensor:
        """v_c of nodes with velocity and spin (section axes)."""
        if self.offset is None:
            return velocity
        turning = self.space.lever_matrix(self.lever(rotation)) @ self.space.to_frame(rotation, spin)[..., None]
        return velocity + turning[..., 0]

    def kinetic_energy(self, rotation: Tensor, velocity: Tensor, spin: Tensor) -> Tensor:
        """(...) J"""
        v = self.centre_velocity(rotation, velocity, spin)
        T = (v * self.momentum(v)).sum((-1, -2)) / 2
        return T if self.inertia is None else T + (spin * self.angular_momentum(spin)).sum((-1, -2)) / 2

    def blocks(self, Z: Tensor, left: Tensor | None = None, right: Tensor | None = None) -> tuple[Tensor, Tensor | None]:
        """left_i^T-wise [I; arm(left)^T] M Z [I, right]: (at a node (..., N+1, w, w), from a node to its neighbours
        (..., N, 2, w, w), up and down; None without coupling). Z (..., p, p) is the derivative of a force per mass by a
        displacement; left the arm of the force and right (..., N+1, p, s) the centre's displacement by the node's spin.
        """
        at = self.mass[..., None] * Z
        between = None if self.coupling is None else self.coupling[..., None] * Z
        if between is not None:
            at = at - at_i(between, 2) - at_j(between, 2)
        s = self.space.spin
        if right is None:
            return pad(at, (0, s, 0, s)), None if between is None else pad(between, (0, s, 0, s))[..., None, :, :]
        arm = self.space.lever_matrix(left)
        if between is None:
            return with_levers(at, arm, right), None
        (arm_i, arm_j), (right_i, right_j) = ends(arm, 2), ends(right, 2)
        up, down = with_levers(between, arm_i, right_j), with_levers(between, arm_j, right_i)
        return with_levers(at, arm, right), torch.stack(torch.broadcast_tensors(up, down), -3)


def exchange(coupling: Tensor, v_i: Tensor, v_j: Tensor) -> Tensor:
    """Momentum c (v_j - v_i) (..., p) that an element's half-consistent mass gives its node i, and takes from its node j."""
    return coupling * (v_j - v_i)


def with_levers(block: Tensor, arm: Tensor, turn: Tensor) -> Tensor:
    """[I; arm^T] block [I, turn] (..., w, w): a force by a displacement (..., p, p), both of centres off their nodes; arm and
    turn (..., p, s) are what a spin of the nodes moves them by.
    """
    turned = block @ turn
    row = torch.cat((block.expand(*turned.shape[:-2], *block.shape[-2:]), turned), -1)
    pushed = arm.mT @ row
    return torch.cat((row.expand(*pushed.shape[:-2], *row.shape[-2:]), pushed), -2)


def inertia_of(scene: Scene, space: Space, lumped: bool) -> tuple[Inertia, Tensor, Tensor]:
    """(inertia, section mass about each node per length (..., N+1, 6, 6), length that belongs to each node (..., N+1, 1)).

    Raises ValueError for a mass that is not that of rigid sections: M11 = m I and M12 = -m ~e.
    """
    beam = scene.beam
    h = beam.length[..., None]
    m = _mass(beam.mass, beam.offset)
    half = (h / 2)[..., None] * beam.mass
    parts = half, half
    if beam.curved:  # the section's mass, seen from the axes of the nodes at either end
        parts = tuple(_turned(half, quat.multiply(quat.conjugate(node), beam.elements)) for node in ends(beam.frames))
    mass = at_i(parts[0], 2) + at_j(parts[1], 2)
    tributary_length = at_i(h / 2) + at_j(h / 2)
    for body in scene.bodies:
        at, nodes = body.node % (beam.count + 1), beam.count + 1
        mass = mass + pad(body.about_node[..., None, :, :], (0, 0, 0, 0, at, nodes - 1 - at))
    offset = beam.offset or any(b.offset is not None for b in scene.bodies)
    rotary = beam.rotary or offset or any(b.inertia is not None for b in scene.bodies)
    e = None
    whole, J = mass[..., 0, :1], mass[..., 3:, 3:]
    if offset:
        e = _vector(mass[..., 3:, :3]) / whole
        J = J - whole[..., None] * skew(e).mT @ skew(e)
    inertia = Inertia(space, whole, None if lumped else COUPLING * m * h, space.project_inertia(J) if rotary else None,
                      None if e is None else space.project_offset(e))
    return inertia, mass / tributary_length[..., None], tributary_length


def _mass(mass: Tensor, offset: bool) -> Tensor:
    """m (..., 1) of a section's mass matrix, which must be that of a rigid body."""
    m = mass[..., :1, 0]
    eye = torch.eye(3, dtype=m.dtype, device=m.device)
    if concrete((mass[..., :3, :3] - m[..., None] * eye).abs() > 1e-6 * m[..., None]).any():
        raise ValueError("a mass per length that depends on the direction was given; M11 = m I is wanted")
    M21 = mass[..., 3:, :3]
    size = (m * mass[..., 3:, 3:].diagonal(dim1=-2, dim2=-1)).detach().abs().amax(-1)[..., None, None].sqrt()
    if offset and concrete((M21 + M21.mT).abs() > 1e-6 * size).any():
        raise ValueError("a section mass that couples V and Omega otherwise than an offset centre of mass was given; M21 = m "
                         "~e is wanted")
    return m


def _vector(skew: Tensor) -> Tensor:
    """x of ~x."""
    twice = skew - skew.mT
    return torch.stack((twice[..., 2, 1], twice[..., 0, 2], twice[..., 1, 0]), -1) / 2


def _turned(mass: Tensor, q: Tensor) -> Tensor:
    """6x6 mass in the axes that q maps into: diag(R, R) mass diag(R, R)^T."""
    R = quat.matrix(q)
    zero = torch.zeros_like(R)
    both = torch.cat((torch.cat((R, zero), -1), torch.cat((zero, R), -1)), -2)
    return both @ mass @ both.mT
