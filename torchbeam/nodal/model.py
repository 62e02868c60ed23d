"""Model: what the nodal form needs of a scene, computed once and differentiable in everything the scene holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from .. import quaternions as quat
from ..effects import Inputs, Site
from ..scene import Scene
from .element import kinematics, strain

COUPLING = 1 / 12  # half consistent, half lumped: the translational error of the implicit form is then fourth order
STIFFENED = 100.0  # by loads, over bending alone: P L^2/EI of that order
REGULARISATION = {torch.float64: 1e-7, torch.float32: 1e-3}  # of the flexibility around it: a strain's least, in a tangent


@dataclass(frozen=True)
class Model:
    """Constants of the nodal form; leading axes are batch axes.

    length     (..., N, 1) m
    reference  (..., N, 6) strain of the undeformed beam
    S          (..., N or 1, 6, 6) compliance, exact;  C its inverse, regularised where a strain is impossible; both are
               (..., N or 1, 6, 1), their diagonals, for an uncoupled section: see `times`
    rate       S [F; M] = strain + rate (strain rate), s: (..., 1, 1, 1), or a matrix like S; None without damping
    mass       (..., N+1, 1) kg of nodes;  inertia (..., N+1, 3, 3) kg m^2, section axes, None without rotary inertia
    coupling   (..., N, 1) kg between neighbours; None = lumped
    """

    scene: Scene
    length: Tensor
    reference: Tensor
    S: Tensor
    C: Tensor
    rate: Tensor | None
    mass: Tensor
    inertia: Tensor | None
    coupling: Tensor | None
    section_mass: Tensor  # (..., N+1, 6, 6) mean section mass about each node, for loads along the beam
    share: Tensor  # (..., N+1, 1) m of beam that belong to each node

    @classmethod
    def of(cls, scene: Scene, lumped: bool = False) -> Model:
        """Raises ValueError for what the nodal form does not take: a moving frame or root, an offset centre of mass."""
        if not isinstance(scene, Scene):
            raise ValueError(f"a scene of type {type(scene).__name__} was given; a torchbeam.Scene is wanted")
        beam = scene.beam
        if scene.frame is not None or scene.root is not None:
            raise ValueError("a moving frame or root was given; the nodal form wants a fixed clamp (form='minimal' takes both)")
        if beam.offset:
            raise ValueError("a section mass that couples V and Omega was given; the nodal form wants the reference axis "
                             "through the centre of mass (form='minimal' takes an offset)")
        M11 = beam.mass[..., :3, :3]
        m = M11[..., :1, 0]
        if not torch.allclose(M11, m[..., None] * torch.eye(3, dtype=m.dtype, device=m.device), rtol=1e-6):
            raise ValueError("a mass per length that depends on the direction was given; M11 = m I is wanted")
        h = beam.length[..., None]
        reference = strain(kinematics(beam.nodes, beam.frames, h), h)
        half = (h / 2)[..., None] * beam.mass
        ends = half, half
        if beam.curved:  # the section's mass, seen from the axes of the nodes at either end
            ends = tuple(_turned(half, quat.multiply(quat.conjugate(node), beam.elements))
                         for node in (beam.frames[..., :-1, :], beam.frames[..., 1:, :]))
        node_mass = pad(ends[0], (0, 0, 0, 0, 0, 1)) + pad(ends[1], (0, 0, 0, 0, 1, 0))
        share = pad(h / 2, (0, 0, 0, 1)) + pad(h / 2, (0, 0, 1, 0))
        return cls(
            scene=scene, length=h, reference=reference, S=_slim(beam.compliance, beam), C=_slim(_stiffness(beam), beam),
            rate=_rate(scene),
            mass=node_mass[..., 0, :1], inertia=node_mass[..., 3:, 3:] if beam.rotary else None,
            coupling=None if lumped else COUPLING * m * h,
            section_mass=node_mass / share[..., None], share=share,
        )

    def stiffness(self, dt: Tensor | None = None) -> Tensor:
        """S^-1 for the tangent of a balance, or of a step of dt (0-dim or (...)); a constant, in the form of S.

        Impossible strains, and in a step those next to impossible beside the softest bending or twist and the inertia, get a
        small flexibility: the tangent stays well conditioned, and as the residual keeps S exactly, Newton's method loses
        nothing.
        """
        S, h = self.S.detach(), self.length.detach()
        slim = S.shape[-1] == 1
        if not (slim or any(self.scene.beam.rigid)):
            return self.C.detach()
        diagonal = S if slim else S.diagonal(dim1=-2, dim2=-1)[..., None]
        L2 = h.sum(-2, keepdim=True)[..., None] ** 2
        by_force, by_moment = (part.amax((-3, -2), keepdim=True) for part in diagonal.split(3, -2))
        softest = torch.maximum(by_force / L2, by_moment)
        moment = STIFFENED / torch.where(softest > 0, softest, torch.ones_like(softest))  # what bends round about, N m^2
        force = moment / L2
        if dt is not None:
            h2 = h.amax(-2, keepdim=True)[..., None] ** 2
            line_mass = (self.mass / self.share).detach().amax(-2, keepdim=True)[..., None]
            inertial = line_mass * h2 * (2 / dt[..., None, None, None]) ** 2
            force, moment = force + inertial, moment + inertial * h2
        least = REGULARISATION[S.dtype] / torch.cat(torch.broadcast_tensors(*[force] * 3, *[moment] * 3), -2)
        least = torch.where(diagonal == 0 if dt is None else diagonal < least, least, diagonal)
        return 1 / least if slim else torch.linalg.inv(S + torch.diag_embed((least - diagonal)[..., 0]))

    def momentum(self, velocity: Tensor) -> Tensor:
        """Mass matrix times velocity, (..., N+1, 3): mass and, where asked for, coupling to the neighbours."""
        p = self.mass * velocity
        if self.coupling is None:
            return p
        exchange = self.coupling * velocity.diff(dim=-2)
        return p + pad(exchange, (0, 0, 0, 1)) - pad(exchange, (0, 0, 1, 0))

    def external(self, rotation: Tensor, t: Tensor, inputs: Inputs, loads: tuple[Any, ...]) -> Tensor | float:
        """Loads summed at nodes, (..., N+1, 6) force N and moment N m, frame a; 0.0 where there is none."""
        return sum((_spread(self, load, load.wrench(site, t, inputs)) for load, site in self._sites(rotation, loads)), 0.0)

    def external_tangent(self, rotation: Tensor, t: Tensor, inputs: Inputs, loads: tuple[Any, ...]) -> Tensor | float:
        """Derivative of `external` with respect to the nodes' spins, (..., N+1, 6, 3); 0.0 where there is none."""
        def columns(load, site):
            by_spin = load.tangent(site, t, inputs)["rotation"]
            if load.node is None:
                return self.share[..., None] * by_spin
            at = load.node % (self.scene.beam.count + 1)
            return pad(by_spin[..., None, :, :], (0, 0, 0, 0, at, self.scene.beam.count - at))
        return sum((columns(load, site) for load, site in self._sites(rotation, loads)), 0.0)

    def _sites(self, rotation: Tensor, loads: tuple[Any, ...]):
        for load in loads:
            if load.node is None:
                yield load, Site(quat.matrix(rotation), self.section_mass, s=pad(self.length[..., 0].cumsum(-1), (1, 0)))
            else:
                yield load, Site(quat.matrix(rotation[..., load.node, :]))

    def kinetic_energy(self, velocity: Tensor, spin: Tensor) -> Tensor:
        """(...) J"""
        T = (velocity * self.momentum(velocity)).sum((-1, -2)) / 2
        if self.inertia is None:
            return T
        return T + (spin * (self.inertia @ spin[..., None])[..., 0]).sum((-1, -2)) / 2

    def strain_energy(self, position: Tensor, rotation: Tensor) -> Tensor:
        """(...) J"""
        e = strain(kinematics(position, rotation, self.length), self.length, self.reference)
        return (self.length * e * times(self.C, e[..., None])[..., 0]).sum((-1, -2)) / 2


def times(matrix: Tensor, x: Tensor) -> Tensor:
    """matrix @ x for x (..., 6, n), where the matrix may be given as (..., 6, 1), its diagonal, or (..., 1, 1), a factor."""
    return matrix * x if matrix.shape[-1] == 1 else matrix @ x


def _slim(matrix: Tensor, beam: Any) -> Tensor:
    return matrix if beam.coupled else matrix.diagonal(dim1=-2, dim2=-1)[..., None]


def _turned(mass: Tensor, q: Tensor) -> Tensor:
    """6x6 mass in the axes that q maps into: diag(R, R) mass diag(R, R)^T."""
    R = quat.matrix(q)
    zero = torch.zeros_like(R)
    both = torch.cat((torch.cat((R, zero), -1), torch.cat((zero, R), -1)), -2)
    return both @ mass @ both.mT


def _stiffness(beam: Any) -> Tensor:
    """S^-1; a strain that S makes impossible gets a flexibility that is small beside the others, for the tangent only."""
    S = beam.compliance
    if not any(beam.rigid):
        return torch.linalg.inv(S)
    rigid = torch.tensor(beam.rigid, device=S.device)
    L = beam.length.sum(-1)[..., None, None]
    scale = torch.cat((L.expand(*L.shape[:-1], 3), torch.ones_like(L).expand(*L.shape[:-1], 3)), -1)  # (..., 1, 6)
    diagonal = S.diagonal(dim1=-2, dim2=-1)
    largest = (diagonal / scale**2).amax(-1, keepdim=True).detach()  # flexibility of a bending or twist, 1/(N m^2)
    largest = torch.where(largest > 0, largest, torch.ones_like(largest))
    small = REGULARISATION[S.dtype] * largest * scale.detach() ** 2
    return torch.linalg.inv(S + torch.diag_embed(torch.where(rigid & (diagonal == 0), small, torch.zeros_like(small))))


def _rate(scene: Scene) -> Tensor | None:
    if scene.damping is None:
        return None
    tau = torch.as_tensor(scene.damping.tau, dtype=scene.dtype, device=scene.device)
    if not scene.damping.six:
        return tau[..., None, None, None]
    if any(scene.beam.rigid):
        raise ValueError("six-valued tau was given for a section with an impossible strain; one value is wanted there")
    if not scene.beam.coupled:
        return tau[..., None, :, None]
    root = torch.diag_embed(tau.sqrt())[..., None, :, :]
    return scene.beam.compliance @ root @ torch.linalg.inv(scene.beam.compliance) @ root


def _spread(model: Model, load: Any, wrench: tuple[Tensor | None, Tensor | None]) -> Tensor:
    """A load's force and moment at the nodes: (..., N+1, 6)."""
    force, moment = wrench
    there = force if force is not None else moment
    zero = torch.zeros_like(there)
    both = torch.cat(torch.broadcast_tensors(zero if force is None else force, zero if moment is None else moment), -1)
    if load.node is None:
        return model.share * both
    nodes = model.scene.beam.count + 1
    at = load.node % nodes
    return pad(both[..., None, :], (0, 0, at, nodes - 1 - at))
