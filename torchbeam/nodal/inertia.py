"""The nodes as rigid bodies: each has the mass of the beam around it and what is fixed to it.

With x = r + R e the centre of mass of a node, v_c its velocity and M the mass matrix (mass, and coupling to the neighbours):

    momentum = M v_c        angular momentum = R J Omega        T = v_c^T M v_c/2 + Omega^T J Omega/2

A step takes r_n, R_n to r_{n+1}, R_{n+1} = Cay(Theta) R_n. With e- = (R_n + R_{n+1}) e/2 the centre moves by
x_{n+1} - x_n = r_{n+1} - r_n + Theta x e-. The force M d(v_c)/dt with the moment e- x force keeps energy, momentum and angular
momentum exactly where v_c rises by 2 (x_{n+1} - x_n)/dt - 2 v_c. In a frame that turns with omega, d/dt is d/dt + omega x.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from .. import quaternions as quat
from ..checks import concrete
from ..quaternions import hat
from ..scene import Scene
from .space import Space

COUPLING = 1 / 12  # half consistent, half lumped: the translational error of the implicit form is then fourth order


@dataclass(frozen=True)
class Inertia:
    """Leading axes are batch axes; p and s are the space's numbers of positions and spins.

    mass      (..., N+1, 1) kg
    coupling  (..., N, 1) kg between neighbours; None = lumped
    inertia   (..., N+1, s, s) kg m^2 about the centre of mass, section axes; None without rotary inertia
    offset    (..., N+1, p) m of the centre of mass from the node, section axes; None = it lies there
    """

    space: Space
    mass: Tensor
    coupling: Tensor | None
    inertia: Tensor | None
    offset: Tensor | None

    def momentum(self, velocity: Tensor) -> Tensor:
        """M v_c, (..., N+1, p)."""
        p = self.mass * velocity
        if self.coupling is None:
            return p
        exchange = self.coupling * velocity.diff(dim=-2)
        return p + pad(exchange, (0, 0, 0, 1)) - pad(exchange, (0, 0, 1, 0))

    def angular_momentum(self, spin: Tensor) -> Tensor:
        """J Omega, section axes (..., N+1, s)."""
        return (self.inertia @ spin[..., None])[..., 0]

    def arm(self, rotation: Tensor) -> Tensor:
        """R e, frame a (..., N+1, p)."""
        return (self.space.matrix(rotation) @ self.offset[..., None])[..., 0]

    def centre_velocity(self, rotation: Tensor, velocity: Tensor, spin: Tensor) -> Tensor:
        """v_c of nodes with velocity and spin (section axes)."""
        if self.offset is None:
            return velocity
        turning = self.space.arm(self.arm(rotation)) @ self.space.to_frame(rotation, spin)[..., None]
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
            at = at - pad(between, (0, 0, 0, 0, 0, 1)) - pad(between, (0, 0, 0, 0, 1, 0))
        s = self.space.spin
        if right is None:
            return pad(at, (0, s, 0, s)), None if between is None else pad(between, (0, s, 0, s))[..., None, :, :]

        def whole(block: Tensor, arm: Tensor, turn: Tensor) -> Tensor:
            turned = block @ turn
            row = torch.cat((block.expand(*turned.shape[:-2], *block.shape[-2:]), turned), -1)
            pushed = arm.mT @ row
            return torch.cat((row.expand(*pushed.shape[:-2], *row.shape[-2:]), pushed), -2)

        arm = self.space.arm(left)
        if between is None:
            return whole(at, arm, right), None
        up = whole(between, arm[..., :-1, :, :], right[..., 1:, :, :])
        down = whole(between, arm[..., 1:, :, :], right[..., :-1, :, :])
        return whole(at, arm, right), torch.stack(torch.broadcast_tensors(up, down), -3)


def inertia_of(scene: Scene, space: Space, lumped: bool) -> tuple[Inertia, Tensor, Tensor]:
    """(inertia, section mass about each node per length (..., N+1, 6, 6), length that belongs to each node (..., N+1, 1)).

    Raises ValueError for a mass that is not that of rigid sections: M11 = m I and M12 = -m ~e.
    """
    beam = scene.beam
    h = beam.length[..., None]
    m = _mass(beam.mass, beam.offset)
    half = (h / 2)[..., None] * beam.mass
    ends = half, half
    if beam.curved:  # the section's mass, seen from the axes of the nodes at either end
        ends = tuple(_turned(half, quat.multiply(quat.conjugate(node), beam.elements))
                     for node in (beam.frames[..., :-1, :], beam.frames[..., 1:, :]))
    mass = pad(ends[0], (0, 0, 0, 0, 0, 1)) + pad(ends[1], (0, 0, 0, 0, 1, 0))
    share = pad(h / 2, (0, 0, 0, 1)) + pad(h / 2, (0, 0, 1, 0))
    for body in scene.bodies:
        at, nodes = body.node % (beam.count + 1), beam.count + 1
        mass = mass + pad(body.about_node(h)[..., None, :, :], (0, 0, 0, 0, at, nodes - 1 - at))
    offset = beam.offset or any(b.offset is not None for b in scene.bodies)
    rotary = beam.rotary or offset or any(b.inertia is not None for b in scene.bodies)
    e = None
    whole, J = mass[..., 0, :1], mass[..., 3:, 3:]
    if offset:
        e = _vector(mass[..., 3:, :3]) / whole
        J = J - whole[..., None] * hat(e).mT @ hat(e)
    inertia = Inertia(space, whole, None if lumped else COUPLING * m * h, space.part_of_inertia(J) if rotary else None,
                      None if e is None else space.part_of_offset(e))
    return inertia, mass / share[..., None], share


def _mass(mass: Tensor, offset: bool) -> Tensor:
    """m (..., 1) of a section's mass matrix, which must be that of a rigid body."""
    m = mass[..., :1, 0]
    eye = torch.eye(3, dtype=m.dtype, device=m.device)
    if concrete((mass[..., :3, :3] - m[..., None] * eye).abs() > 1e-6 * m[..., None]).any():
        raise ValueError("a mass per length that depends on the direction was given; M11 = m I is wanted")
    M21 = mass[..., 3:, :3]
    if offset and concrete((M21 + M21.mT).abs() > 1e-6 * M21.abs().amax((-1, -2), keepdim=True)).any():
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
