"""Model: what the nodal form needs of a scene, computed once and differentiable in everything the scene holds."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..effects import ACCELERATION, Gravity, Inputs
from ..motion import Carrying
from ..scene import Scene
from ..state import turning
from . import external
from .choice import check_plane, only_numbers, space_of
from .element import kinematics, strain
from .external import Nodes
from .held import Held
from .inertia import Inertia, inertia_of
from .plane import PLANES, Plane
from .space import Space

STIFFENED = 100.0  # by loads, over bending alone: P L^2/EI of that order
REGULARISATION = {torch.float64: 1e-7, torch.float32: 1e-3}  # of the flexibility around it: a strain's least, in a tangent


@dataclass(frozen=True)
class Model:
    """Constants of the nodal form; leading axes are batch axes; w, k: a node's unknowns and an element's strains in `space`.

    length     (..., N, 1) m
    reference  (..., N, k) strain of the undeformed beam
    S          (..., N or 1, k, k) compliance, exact;  C its inverse, regularised where a strain is impossible; both are
               (..., N or 1, k, 1), their diagonals, for an uncoupled section: see `times`
    rate       S [F; M] = strain + rate (strain rate), s: (..., 1, 1, 1), or a matrix like S; None without damping
    """

    scene: Scene
    space: Space
    held: Held
    inertia: Inertia
    length: Tensor
    reference: Tensor
    S: Tensor
    C: Tensor
    rate: Tensor | None
    section_mass: Tensor  # (..., N+1, 6, 6) mean mass per length about each node, with what is fixed to it: for line loads
    share: Tensor  # (..., N+1, 1) m of beam that belong to each node

    @classmethod
    def of(cls, scene: Scene, lumped: bool = False) -> Model:
        """Raises ValueError for what the nodal form does not take: sections whose mass is not that of rigid ones, and loads and
        motions that leave the scene's plane or do not fit small rotations.
        """
        if not isinstance(scene, Scene):
            raise ValueError(f"a scene of type {type(scene).__name__} was given; a torchbeam.Scene is wanted")
        if scene.plane == "auto":
            return cls._in_a_plane(scene, lumped)
        space = space_of(scene)
        beam = scene.beam
        h = beam.length[..., None]
        rest = strain(kinematics(beam.nodes, beam.frames, h), h)
        inertia, section_mass, share = inertia_of(scene, space, lumped)
        model = cls(
            scene=scene, space=space, held=Held.of(scene, space), inertia=inertia, length=h,
            reference=space.part_of_strain(rest) if space.turns else torch.zeros_like(rest),
            S=_slim(beam.compliance, beam, space), C=_slim(_stiffness(beam), beam, space), rate=_rate(scene, space),
            section_mass=section_mass, share=share,
        )
        if inertia.offset is not None and model.adds_mass:
            raise ValueError("added mass on a beam with a mass off its node was given; one of them is wanted")
        if isinstance(space, Plane):
            check_plane(model, cls.of(replace(scene, plane=None), lumped))
        return model

    @classmethod
    def _in_a_plane(cls, scene: Scene, lumped: bool) -> Model:
        """In the first plane that everything fits, if there is one and nothing but numbers acts; else in 3D."""
        for name in PLANES if only_numbers(scene) else ():
            with suppress(ValueError):
                return cls.of(replace(scene, plane=name), lumped)
        return cls.of(replace(scene, plane=None), lumped)

    @property
    def count(self) -> int:
        """N, the number of elements."""
        return self.scene.beam.count

    @property
    def s(self) -> Tensor:
        """(..., N+1) m, arclength of the nodes."""
        return pad(self.length[..., 0].cumsum(-1), (1, 0))

    @property
    def turning(self) -> bool:
        """Whether frame a turns."""
        return turning(self.scene)

    @property
    def internal_states(self) -> int:
        """How many numbers the loads remember."""
        return sum(getattr(load, "internal", 0) for load in self.scene.loads)

    @cached_property
    def carrying(self) -> Carrying:
        return Carrying(self.scene)

    def frame(self, t: Tensor) -> tuple[Tensor | None, Tensor | None]:
        """v (..., 1, p) m/s and omega (..., 1, s) rad/s of frame a; None = at rest."""
        v, omega = self.carrying.frame(t)
        return (None if v is None else self.space.part_of_vector(v)[..., None, :],
                None if omega is None else self.space.part_of_spin(omega)[..., None, :])

    def reads(self, load: Any) -> frozenset[str]:
        """What a load's wrench depends on; an offset point mass makes weight turn, too."""
        own = load.reads(self.scene.beam)
        return own | {"rotation"} if isinstance(load, Gravity) and self.inertia.offset is not None else own

    @cached_property
    def adds_mass(self) -> bool:
        """Whether a load depends on the acceleration."""
        return any(ACCELERATION in self.reads(load) for load in self.scene.loads)

    @cached_property
    def loads(self) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """(loads that depend on how the nodes stand or move, dead ones)."""
        loads = self.scene.loads
        return tuple(x for x in loads if self.reads(x)), tuple(x for x in loads if not self.reads(x))

    def external(self, nodes: Nodes, t: Tensor, inputs: Inputs, loads: tuple[Any, ...] | None = None) -> Tensor | float:
        """Loads summed at nodes, see `external.external`; all of the scene's unless given."""
        return external.external(self, nodes, t, inputs, self.scene.loads if loads is None else loads)

    def eigenstrain(self, t: Tensor, inputs: Inputs) -> Tensor | float:
        """Strain (..., N or 1, k) that the beam takes by itself; 0.0 where there is none."""
        total = 0.0
        for effect in self.scene.eigenstrains:
            total = total + self.space.part_of_strain(effect.eigenstrain(t, inputs, self.length, self.count))
        return total

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
        sizes = self.space.position, self.space.spin
        by_force, by_moment = (part.amax((-3, -2), keepdim=True) for part in diagonal.split(sizes, -2))
        softest = torch.maximum(by_force / L2, by_moment)
        moment = STIFFENED / torch.where(softest > 0, softest, torch.ones_like(softest))  # what bends round about, N m^2
        force = moment / L2
        if dt is not None:
            h2 = h.amax(-2, keepdim=True)[..., None] ** 2
            line_mass = (self.inertia.mass / self.share).detach().amax(-2, keepdim=True)[..., None]
            inertial = line_mass * h2 * (2 / dt[..., None, None, None]) ** 2
            force, moment = force + inertial, moment + inertial * h2
        parts = torch.broadcast_tensors(*[force] * sizes[0], *[moment] * sizes[1])
        least = REGULARISATION[S.dtype] / torch.cat(parts, -2)
        least = torch.where(diagonal == 0 if dt is None else diagonal < least, least, diagonal)
        return 1 / least if slim else torch.linalg.inv(S + torch.diag_embed((least - diagonal)[..., 0]))

    def kinetic_energy(self, rotation: Tensor, velocity: Tensor, spin: Tensor) -> Tensor:
        """(...) J"""
        return self.inertia.kinetic_energy(rotation, velocity, spin)

    def strain_energy(self, position: Tensor, rotation: Tensor, eigenstrain: Tensor | float = 0.0) -> Tensor:
        """(...) J"""
        kin = self.space.kinematics(position, rotation, self.length)
        e = self.space.strains(kin, self.length, self.reference) - eigenstrain
        return (self.length * e * times(self.C, e[..., None])[..., 0]).sum((-1, -2)) / 2


def times(matrix: Tensor, x: Tensor) -> Tensor:
    """matrix @ x for x (..., k, n), where the matrix may be given as (..., k, 1), its diagonal, or (..., 1, 1), a factor."""
    return matrix * x if matrix.shape[-1] == 1 else matrix @ x


def _slim(matrix: Tensor, beam: Any, space: Space) -> Tensor:
    matrix = space.part_of_section(matrix)
    return matrix if beam.coupled else matrix.diagonal(dim1=-2, dim2=-1)[..., None]


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


def _rate(scene: Scene, space: Space) -> Tensor | None:
    if scene.damping is None:
        return None
    tau = torch.as_tensor(scene.damping.tau, dtype=scene.dtype, device=scene.device)
    if not scene.damping.six:
        return tau[..., None, None, None]
    if any(scene.beam.rigid):
        raise ValueError("six-valued tau was given for a section with an impossible strain; one value is wanted there")
    if not scene.beam.coupled:
        return space.part_of_section(torch.diag_embed(tau)).diagonal(dim1=-2, dim2=-1)[..., None, :, None]
    root = torch.diag_embed(tau.sqrt())[..., None, :, :]
    return space.part_of_section(scene.beam.compliance @ root @ torch.linalg.inv(scene.beam.compliance) @ root)
