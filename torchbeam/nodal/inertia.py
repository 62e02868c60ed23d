"""Inertia of the nodes, rigid bodies with the mass of the beam around them and what is fixed to
them.

With x = r + R e the centre of mass of a node, v_c its velocity and M the mass matrix (mass, and
coupling to the neighbours):

    momentum = M v_c        angular momentum H = R J Omega
    T = v_c^T M v_c/2 + Omega^T J Omega/2

A motion asks the nodes for the rates of both, absolute (see `frame`), the moment of the force among
them (see `mass_offset`):

    force = M dv_c/dt        moment = dH/dt + R e x force

A step takes r_n, R_n to r_{n+1}, R_{n+1} = Cay(Theta) R_n. With e- = (R_n + R_{n+1}) e/2 the centre
moves by x_{n+1} - x_n = r_{n+1} - r_n + Theta x e-. The force M d(v_c)/dt with the moment e- x
force keeps energy, momentum and angular momentum exactly where v_c rises by 2
(x_{n+1} - x_n)/dt - 2 v_c.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.leaves import Tree
from ..core.remembered import remembered
from ..core.validation import concrete, refusal
from ..core.warning import warn
from ..math import quaternions as quat
from ..math.block_matrices import of_blocks
from ..math.quaternions import skew
from ..scene.beam import Beam
from ..scene.effects import PointMass
from ..topology.protocols import Matrix
from .assembly import Assembly
from .coordinates.spatial import Spatial
from .mass import (
    LumpedMass,
    NoRotaryInertia,
    RotaryInertia,
    SharedMass,
    gregory,
    too_uneven,
    trapezoidal,
)
from .mass_offset import MassOffset, NoMassOffset

TWIST = 3  # of strains, in space


def impossible_strains(beam: Beam) -> Tensor | None:
    """(..., stations or 1, 6), 1 where a section's strain is impossible, else 0; None = no section
    has stretch, and the shear and the bending across one axis, impossible.
    """
    if not (beam.rigid[0] and any(map(all, (beam.rigid[1:6:4], beam.rigid[2:5:2])))):
        return None
    return (beam.compliance.diagonal(dim1=-2, dim2=-1) == 0).to(beam.length)


def rigid_elements(impossible: Tensor | None, beam: Beam, space: Spatial) -> Tensor | None:
    """(..., elements or 1, 1) bool: which neither stretch, shear nor bend; None = all do."""
    if impossible is None:
        return None
    strains = space.project_diagonal(impossible)
    others = [k for k in range(space.dims.strain) if k != TWIST]
    rigid = (strains[..., others] > 0).all(-1)
    if not concrete(rigid).any():
        return None
    if rigid.shape[-1] > 1:
        rigid = rigid.unflatten(-1, (-1, beam.order)).all(-1)
    return rigid[..., None]


# of a beam's largest nodal mass, or inertia about an axis: what rounding may leave of none
NEGATIVE = 1e-5
UNEVEN = (
    "linked interpolation was given elements whose lengths or masses jump by so much that mass "
    "and loads along the beam are lumped half and half: frequencies are then less accurate than "
    "without it; lengths of neighbours within a factor of 1.5 are wanted"
)


class Momenta(NamedTuple):
    """At the nodes, frame a: M v_c (..., N+1, p) kg m/s, and about their centres R J Omega
    (..., N+1, s) kg m^2/s, zero without rotary inertia.
    """

    linear: Tensor
    angular: Tensor


class InertiaForces(NamedTuple):
    """wrench (..., N+1, w): force N and moment N m, frame a, that the motion asks the nodes for;
    angular (..., N+1, s): their R J Omega at the end of the step.
    """

    wrench: Tensor
    angular: Tensor


@dataclass(frozen=True)
class Inertia(Tree):
    """Mass, rotary inertia and the offset of the centres of mass, section axes; each knows whether
    it is there.
    """

    space: Spatial
    translational: LumpedMass
    rotary: NoRotaryInertia
    offset: NoMassOffset

    @property
    def mass(self) -> Tensor:
        """(..., N+1, 1) kg"""
        return self.translational.mass

    def of_nodes(self, nodes: slice) -> Inertia:
        """Of some nodes, by themselves: without what they share with their neighbours."""
        space = self.space.of_nodes(nodes)
        mass = LumpedMass(self.translational.topology, self.mass[..., nodes, :])
        return Inertia(
            space, mass, self.rotary.of_nodes(space, nodes), self.offset.of_nodes(space, nodes)
        )

    def momenta(self, rotation: Tensor, centre_velocity: Tensor, spin: Tensor) -> Momenta:
        """Of nodes whose centres move with v_c (frame a) and turn with Omega (section axes)."""
        return Momenta(
            self.translational.momentum(centre_velocity), self.rotary.momentum(rotation, spin)
        )

    def centre_velocity(self, rotation: Tensor, velocity: Tensor, spin: Tensor) -> Tensor:
        """v_c of nodes with velocity and spin (section axes)."""
        return self.offset.turned(rotation).velocity(
            velocity, lambda: self.space.to_frame(rotation, spin)
        )

    def kinetic_energy(self, rotation: Tensor, velocity: Tensor, spin: Tensor) -> Tensor:
        """(...) J"""
        v = self.centre_velocity(rotation, velocity, spin)
        T = (v * self.translational.momentum(v)).sum((-1, -2)) / 2
        return self.rotary.present_or(
            T, lambda: T + (spin * self.rotary.section_momentum(spin)).sum((-1, -2)) / 2
        )

    def masses(self, Z: Tensor) -> Matrix:
        """M Z, see `LumpedMass.matrix` and `NoMassOffset.prepared`."""
        return self.offset.prepared(self.translational.matrix(Z), self.space.dims.spin)

    def matrix(self, rotation: Tensor, lever: NoMassOffset) -> Matrix:
        """The mass matrix by [acceleration; angular acceleration] of nodes, frame a."""
        eye = torch.eye(self.space.dims.position, dtype=self.mass.dtype, device=self.mass.device)
        return self.rotary.matrix(
            lever.matrix(self.masses(eye), lambda: lever.A), lambda: self.rotary.in_frame(rotation)
        )


def warn_of_uneven(beam: Beam) -> None:
    """A warning about a beam with linked interpolation that gains nothing by it."""
    if not beam.linked_interpolation:
        return
    density = beam.mass[..., 0, 0]
    if any(
        concrete(uneven).any() for x in (density, 1.0) for uneven in _along(beam, too_uneven, x)
    ):
        warn(UNEVEN)


class NodeMass(NamedTuple):
    """inertia, section_mass about each node per length (..., N+1, 6, 6), tributary_length that
    belongs to each node (..., N+1, 1): of a body's node 1, so that its mass per length is its mass.
    """

    inertia: Inertia
    section_mass: Tensor
    tributary_length: Tensor


def inertia_of(
    bodies: tuple[PointMass, ...],
    beam: Beam,
    impossible: Tensor | None,
    space: Spatial,
    assembly: Assembly,
    lumped: bool,
) -> NodeMass:
    """Of a beam's mass and of what is fixed to it; impossible: see `impossible_strains`, a rigid
    element's mass is consistent.

    Raises ValueError for a mass that is not that of rigid sections: M11 = m I and M12 = -m ~e, or
    that changes too much within an element of order 2 to be shared among its nodes.
    """
    h, interpolation = beam.length[..., None], assembly.interpolation
    m = beam.mass[..., :1, 0]
    rigid = None if lumped else rigid_elements(impossible, beam, space)
    beam_mass, tributary_length = remembered(_of_beam, beam, rigid, assembly)
    mass = beam_mass
    for body in bodies:
        at, nodes = body.node % assembly.topology.node_count, assembly.topology.node_count
        mass = mass + pad(body.about_node[..., None, :, :], (0, 0, 0, 0, at, nodes - 1 - at))
    offset = beam.offset or any(b.offset is not None for b in bodies)
    rotary = beam.rotary or offset or any(b.inertia is not None for b in bodies)
    whole, J, lever = mass[..., 0, :1], mass[..., 3:, 3:], NoMassOffset()
    if offset:
        e = _centre(mass)
        J = J - whole[..., None] * skew(e).mT @ skew(e)
        lever = MassOffset(space, space.project_offset(e))
    if lumped or (beam.linked_interpolation and rigid is None):
        translational = LumpedMass(assembly.topology, whole)
    else:
        of_elements = (m * h).unflatten(-2, (-1, interpolation.order)).sum(-2)
        part = 0.0 if beam.linked_interpolation else interpolation.coupling
        if rigid is not None:
            part = torch.where(rigid, interpolation.consistent, part)
        translational = SharedMass(
            assembly.topology, whole, part * of_elements, interpolation.difference
        )
    bending = translational
    if offset and rigid is not None:
        bending = replace(translational, coupling=translational.coupling * ~rigid)
        bars = replace(translational, coupling=translational.coupling * rigid)
        J = J + _aside(bars, beam, e)
    if offset and bodies:
        J = J + _swung(bending, e - _centre(beam_mass))
    inertia = Inertia(
        space,
        translational,
        RotaryInertia(space, space.project_inertia(J)) if rotary else NoRotaryInertia(space),
        lever,
    )
    return NodeMass(inertia, mass / tributary_length[..., None], tributary_length)


def _of_beam(beam: Beam, rigid: Tensor | None, assembly: Assembly) -> tuple[Tensor, Tensor]:
    """Mass (..., N+1, 6, 6) about each node of a beam alone, and the length (..., N+1, 1) that
    belongs to each; rigid: see `rigid_elements`.
    """
    _check_mass(beam.mass.detach(), beam.offset)
    mass, tributary_length = _shared_by_nodes(beam, assembly)
    if beam.linked_interpolation:
        density = beam.mass[..., 0, 0]
        smooth = density if rigid is None else torch.where(rigid[..., 0], 0.0, density)
        weights, halves, shares = (
            _of_nodes(beam, _along(beam, *rule))
            for rule in ((gregory, density, smooth), (trapezoidal, density), (gregory,))
        )
        mass, tributary_length = mass * (weights / halves)[..., None, None], shares[..., None]
    elif beam.masses:
        share, own = tributary_length.split(
            (beam.node_count - len(beam.masses), len(beam.masses)), -2
        )
        tributary_length = torch.cat((share, torch.ones_like(own)), -2)
    if beam.mass_taper is not None:
        more = 2 * beam.length[..., None, None] * beam.mass_taper
        mass = mass + _at_nodes(beam, assembly, (-more, more))
    return mass, tributary_length


def _shared_by_nodes(beam: Beam, assembly: Assembly) -> tuple[Tensor, Tensor]:
    """Mass (..., N+1, 6, 6) about each node, and length (..., N+1, 1) of what elements share out to
    their nodes, which all see the same of them.
    """
    h, interpolation = beam.length[..., None], assembly.interpolation
    mass = _at_nodes(beam, assembly, (h[..., None] * beam.mass,) * (interpolation.order + 1))
    if not interpolation.positive:
        diagonal = concrete(mass.diagonal(dim1=-2, dim2=-1))
        if (diagonal < -NEGATIVE * diagonal.abs().amax(-2, keepdim=True)).any():
            raise ValueError(
                "a mass or inertia that changes more than threefold within an element of order "
                f"{beam.order} was given; more elements are wanted"
            )
    return mass, assembly.shared((h,) * (interpolation.order + 1))


def _at_nodes(beam: Beam, assembly: Assembly, parts: tuple[Tensor, ...]) -> Tensor:
    """Masses (..., N, 6, 6) of stations, as each of their nodes counts them, about the nodes."""
    if beam.curved:  # the section's mass, seen from the axes of the element's nodes
        axes = assembly.interpolation.axes_at_nodes(beam.elements)
        seen = zip(parts, assembly.ends(beam.frames), axes, strict=True)
        parts = tuple(
            _turned(part, quat.multiply(quat.conjugate(q), axes)) for part, q, axes in seen
        )
    return assembly.shared(parts, 2)


def _along(beam: Beam, rule: Callable[..., Tensor], *densities: Tensor | float) -> list[Tensor]:
    """What a rule of quadrature says of each beam by itself; densities (..., N or 1) per metre."""
    if not beam.parts:
        return [rule(beam.length, *densities)]
    return [
        rule(
            beam.length[..., part.stations],
            *(x if isinstance(x, float) else x[..., part.stations] for x in densities),
        )
        for part in beam.beams
    ]


def _of_nodes(beam: Beam, weights: list[Tensor]) -> Tensor:
    """(..., nodes) of each beam's nodes, 1 of a body."""
    if not beam.masses:
        return weights[0] if len(weights) == 1 else torch.cat(weights, -1)
    shape = weights[0].shape[:-1] if weights else ()
    return torch.cat((*weights, beam.nodes.new_ones(*shape, len(beam.masses))), -1)


def _aside(mass: SharedMass, beam: Beam, e: Tensor) -> Tensor:
    """Inertia (..., N+1, 3, 3) that nodes gain where the centres of mass of a rigid element's nodes
    lie at e (..., N+1, 3) other than along it: what the element's mass shares is by how its nodes
    go apart, b^T r, and not their centres, b^T x.
    """
    R = quat.matrix(beam.frames)
    x = beam.nodes + (R @ e[..., None])[..., 0]
    apart = (skew(mass.differences(mass.topology.gather(places))) for places in (x, beam.nodes))
    of_centres, of_nodes = (v.mT @ v for v in apart)
    share = mass.coupling[..., None] / len(mass.difference) * (of_centres - of_nodes)
    return R.mT @ mass.topology.scatter((share,) * len(mass.difference), 2) @ R


def _swung(mass: LumpedMass, x: Tensor) -> Tensor:
    """Inertia (..., N+1, 3, 3) that nodes lose by the mass that neighbours share, where bodies have
    moved the centres of mass by x (..., N+1, 3) from the beam's: the shared mass is the beam's
    alone, and does not swing with them.
    """
    shared = mass.mass - mass.matrix(torch.ones_like(x[..., :1, :1, None])).diagonal[..., 0]
    return shared[..., None] * skew(x).mT @ skew(x)


def _check_mass(mass: Tensor, offset: bool) -> None:
    """Refuse a section's mass matrix that is not that of a rigid body."""
    m = mass[..., :1, 0]
    eye = torch.eye(3, dtype=m.dtype, device=m.device)
    if concrete((mass[..., :3, :3] - m[..., None] * eye).abs() > 1e-6 * m[..., None]).any():
        raise refusal("a mass per length that depends on the direction", "M11 = m I")
    M21 = mass[..., 3:, :3]
    size = (m * mass[..., 3:, 3:].diagonal(dim1=-2, dim2=-1)).abs().amax(-1)[..., None, None].sqrt()
    if offset and concrete((M21 + M21.mT).abs() > 1e-6 * size).any():
        raise ValueError(
            "a section mass that couples V and Omega otherwise than an offset centre of mass was "
            "given; M21 = m ~e is wanted"
        )


def _centre(mass: Tensor) -> Tensor:
    """(..., N+1, 3) m: of the mass of each node (..., N+1, 6, 6), at the node where it has none."""
    whole = mass[..., 0, :1]
    return _vector(mass[..., 3:, :3]) / torch.where(whole > 0, whole, 1.0)


def _vector(skew: Tensor) -> Tensor:
    """x of ~x."""
    twice = skew - skew.mT
    return torch.stack((twice[..., 2, 1], twice[..., 0, 2], twice[..., 1, 0]), -1) / 2


def _turned(mass: Tensor, q: Tensor) -> Tensor:
    """6x6 mass in the axes that q maps into: diag(R, R) mass diag(R, R)^T."""
    R = quat.matrix(q)
    zero = torch.zeros_like(R)
    both = of_blocks(R, zero, zero, R)
    return both @ mass @ both.mT
