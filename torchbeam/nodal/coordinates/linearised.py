"""Linearised coordinates: small displacements and rotations about the undeformed beam.

A rotation is a rotation vector in the section's undeformed axes; two of them add. Strains are B_0
times the nodes' moves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from ...core.leaves import Tree, leaf
from ...core.validation import concrete
from ...core.warning import warn
from ...math import quaternions as quat
from ...math.shapes import broadcast_shapes, stacked
from ...scene.beam import Beam
from ...state.state import State
from ...topology.protocols import Topology
from ..assembly import Assembly
from .elements import ELEMENTS
from .planar import Planar
from .spatial import Spatial


class Moves(NamedTuple):
    """Of an element, (..., 9): dr_j - dr_i m, frame a, and the rotation vectors of the nodes i and
    j rad, section axes; of a station of three nodes, (..., 12): dr' and three vectors.
    """

    numbers: Tensor


@dataclass(frozen=True)
class LinearElement(Tree):
    """Elements as they are undeformed: chord r_j - r_i (..., N, 3) m; B (..., N, 6, 9) the strain
    operator by spins in frame a; B_section by rotations in section axes.

    Of three nodes chord is dr/dx of the undeformed beam at the stations, and numbers are those of a
    station, see `QuadraticInterpolation`. order: of the elements
    """

    chord: Tensor = leaf(2)
    B: Tensor = leaf(3)
    B_section: Tensor = leaf(3)
    order: int

    interpolation = property(lambda self: ELEMENTS[self.order].interpolation)

    @classmethod
    def of(
        cls, topology: Topology, space: Spatial, nodes: Tensor, frames: Tensor, length: Tensor
    ) -> LinearElement:
        """space: of large rotations, that nodes and frames are those of."""
        interpolation, finite, p = space.interpolation, space.functions, space.dims.position
        assembly = Assembly(topology, interpolation, p)
        positions, rotations = assembly.ends(nodes), assembly.ends(frames)
        B = finite.strain_operator(finite.kinematics(*positions, *rotations, length), length)
        by_r, *by_spin = interpolation.by_spins(B, p)
        turned = (by @ space.spin_matrix(q) for by, q in zip(by_spin, rotations, strict=True))
        B_section = stacked(by_r, *turned, axis=-1)
        return cls(interpolation.slopes(*positions), B, B_section, space.order)

    def kinematics(self, *given: Tensor) -> Moves:
        """Positions m and rotation vectors rad (section axes) of the nodes of each element,
        (..., 3); lengths, not needed.
        """
        *ends, _ = given
        positions, rotations = ends[: len(ends) // 2], ends[len(ends) // 2 :]
        slopes = self.interpolation.slopes(*positions) - self.chord
        return Moves(stacked(slopes, *rotations, axis=-1))

    def strains(self, kin: Moves, length: Tensor, reference: Tensor | float = 0.0) -> Tensor:
        return (self.B_section @ kin.numbers[..., None])[..., 0] - reference

    def forces(self, kin: Moves, stress: Tensor, length: Tensor) -> Tensor:
        return length * (self.B.mT @ stress[..., None])[..., 0]

    def strain_operator(self, kin: Moves, length: Tensor) -> Tensor:
        return self.B.expand(
            *broadcast_shapes(self.B.shape[:-2], kin.numbers.shape[:-1]), *self.B.shape[-2:]
        )

    def geometric_stiffness(self, kin: Moves, stress: Tensor, length: Tensor) -> Tensor:
        return torch.zeros_like(kin.numbers[..., None] + kin.numbers[..., None, :])


@dataclass(frozen=True)
class Linearised(Spatial):
    """frames (..., N+1, 4), R (..., N+1, 3, 3): undeformed section axes -> frame a of each node;
    linear_element: each one's own.
    """

    frames: Tensor = leaf(2)
    R: Tensor = leaf(3)
    linear_element: LinearElement

    turns: ClassVar[bool] = False

    @classmethod
    def of(cls, beam: Beam, topology: Topology) -> Linearised:
        element = LinearElement.of(
            topology, Spatial(order=beam.order), beam.nodes, beam.frames, beam.length[..., None]
        )
        return cls(beam.frames, quat.matrix(beam.frames), element, order=beam.order)

    def of_nodes(self, nodes: slice | int) -> Linearised:
        return replace(self, frames=self.frames[..., nodes, :], R=self.R[..., nodes, :, :])

    def to_reduced(self, state: State) -> State:
        _refuse_turning(state)
        return replace(state, rotation=self.to_reduced_rotation(state.rotation))

    def to_public(self, state: State) -> State:
        _warn_of_turns(state)
        return replace(state, rotation=quat.multiply(self.frames, quat.exponential(state.rotation)))

    def pose(self, position: Tensor, rotation: Tensor) -> tuple[Tensor, Tensor]:
        return position, self.to_reduced_rotation(rotation)

    def hinged(self, q: Tensor, rest: Tensor, axis: Tensor) -> Tensor:
        return rest + (self.R.mT @ (axis[:, None] * (self.R @ (q - rest)[..., None])))[..., 0]

    def hinged_turn(self, m: Tensor, q: Tensor, axis: Tensor) -> Tensor:
        return self.about(q, m, axis)

    functions = property(lambda self: self.linear_element)

    # Rotations

    def matrix(self, q: Tensor) -> Tensor:
        return self.R

    axes = spin_matrix = matrix

    def to_frame(self, q: Tensor, spin: Tensor) -> Tensor:
        return (self.R @ spin[..., None])[..., 0]

    def to_reduced_rotation(self, q: Tensor) -> Tensor:
        return quat.logarithm(quat.multiply(quat.conjugate(self.frames), q))

    def rotation_rate(self: Spatial, q: Tensor, spin: Tensor) -> Tensor:
        return spin

    def to_section(self, q: Tensor, spin: Tensor) -> Tensor:
        return (self.R.mT @ spin[..., None])[..., 0]

    def multiply(self: Spatial, p: Tensor, q: Tensor) -> Tensor:
        return p + q

    def inverse(self: Spatial, q: Tensor) -> Tensor:
        return -q

    def identity(self: Spatial, like: Tensor) -> Tensor:
        return torch.zeros_like(like[..., : self.dims.spin])

    def sqrt(self: Spatial, q: Tensor) -> Tensor:
        return q / 2

    def normalize(self: Spatial, q: Tensor) -> Tensor:
        return q

    cayley = theta = exponential = logarithm = normalize

    def cosine(self: Spatial, q: Tensor) -> Tensor:
        return torch.ones_like(q[..., 0])

    def theta_by_turn(self: Spatial, theta: Tensor) -> Tensor:
        s = self.dims.spin
        return torch.eye(s, dtype=theta.dtype, device=theta.device).expand(*theta.shape, s)

    logarithm_by_turn = theta_by_turn

    def mean_rotation(self, R: Tensor, before: Tensor) -> Tensor:
        return torch.eye(R.shape[-1], dtype=R.dtype, device=R.device).expand_as(R)

    def spin_skew(self, spin: Tensor) -> Tensor:
        return torch.zeros_like(spin)[..., None] * spin[..., None, :]


@dataclass(frozen=True)
class LinearisedPlanar(Planar):
    """In a plane: frames (..., N+1, 2), R (..., N+1, 2, 2); a rotation is an angle rad."""

    frames: Tensor = leaf(2)
    R: Tensor = leaf(3)
    linear_element: LinearElement

    turns: ClassVar[bool] = False
    reversible = False
    functions = property(lambda self: self.linear_element)

    rotation_rate = Linearised.rotation_rate
    multiply = Linearised.multiply
    inverse = Linearised.inverse
    identity = Linearised.identity
    sqrt = Linearised.sqrt
    cosine = Linearised.cosine
    theta_by_turn = Linearised.theta_by_turn
    normalize = cayley = theta = exponential = logarithm = Linearised.normalize

    @classmethod
    def of(cls, beam: Beam, topology: Topology, name: str) -> LinearisedPlanar:
        """Raises ValueError as `Planar.of`."""
        plane = Planar.of(beam, name)
        nodes, frames = plane.pose(beam.nodes, beam.frames)
        element = LinearElement.of(topology, plane, nodes, frames, beam.length[..., None])
        of_plane = plane.name, plane.basis, plane.section, plane.place
        return cls(*of_plane, frames, plane.matrix(frames), element, order=beam.order)

    def of_nodes(self, nodes: slice | int) -> LinearisedPlanar:
        return replace(self, frames=self.frames[..., nodes, :], R=self.R[..., nodes, :, :])

    def to_reduced(self, state: State) -> State:
        _refuse_turning(state)
        return super().to_reduced(state)

    def to_public(self, state: State) -> State:
        _warn_of_turns(state)
        rotation = Planar.multiply(self.frames, super().exponential(state.rotation))
        return super().to_public(replace(state, rotation=rotation))

    def pose(self, position: Tensor, rotation: Tensor) -> tuple[Tensor, Tensor]:
        return self.project_vector(position), self.to_reduced_rotation(rotation)

    def to_reduced_rotation(self, q: Tensor) -> Tensor:
        turned = Planar.multiply(Planar.inverse(self.frames), super().to_reduced_rotation(q))
        return super().logarithm(turned)

    def matrix(self, q: Tensor) -> Tensor:
        return self.R

    def axes(self, q: Tensor) -> Tensor:
        return super().axes(self.frames)


def _refuse_turning(state: State) -> None:
    """ValueError for a state in a frame that turns."""
    if state.frame is not None:
        raise ValueError(
            "a state in a frame that turns was given; small rotations want one that does not"
        )


def _warn_of_turns(state: State) -> None:
    """A public state's quaternion holds less than half a turn: a vector beyond it, which small
    rotations never are, loses whole turns, of which a RuntimeWarning tells.
    """
    angle = state.rotation.detach().norm(dim=-1)
    if concrete(angle > math.pi).any():
        warn(
            f"rotations of {concrete(angle.amax()).item():.3g} rad came of small=True, which "
            "are not small, and of which a state holds what is less than half a turn: what "
            "goes on from it or is read of its rotations is wrong; a scene without small, or "
            "smaller loads, are wanted"
        )
