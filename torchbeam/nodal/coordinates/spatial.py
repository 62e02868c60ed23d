"""Coordinates of nodes in space: their rotations, and the functions of the element between two of
them. See `planar` for fewer unknowns, and `linearised` for small rotations, of the same
mathematics.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ...core.leaves import Tree
from ...math import quaternions as quat
from ...state.state import State
from .elements import ELEMENTS


def same(x: Any) -> Any:
    """x, as it is."""
    return x


class Dimensions(NamedTuple):
    """How many numbers a node's position and its spin have, and an element's strain."""

    position: int
    spin: int
    strain: int


@dataclass(frozen=True)
class Spatial(Tree):
    """Rotations are unit quaternions, spins are 3-vectors. A spin is expressed in the section's
    axes or in those of frame a.

    order   of the elements between the nodes
    """

    order: int = field(default=1, kw_only=True)

    plane: ClassVar[str | None] = None  # that it lies in, "xy" or "xz"; None = in space
    turns: ClassVar[bool] = True  # whether what is fixed to a section turns with it
    dims: ClassVar[Dimensions] = Dimensions(position=3, spin=3, strain=6)

    element = property(lambda self: ELEMENTS[self.order])
    interpolation = property(lambda self: self.element.interpolation)
    functions = property(lambda self: self.element.spatial)  # of the element, those named below

    kinematics = property(lambda self: self.functions.kinematics)
    strains = property(lambda self: self.functions.strains)
    forces = property(lambda self: self.functions.forces)
    strain_operator = property(lambda self: self.functions.strain_operator)
    geometric_stiffness = property(lambda self: self.functions.geometric_stiffness)

    multiply = staticmethod(quat.multiply)
    inverse = staticmethod(quat.conjugate)
    normalize = staticmethod(quat.normalize)
    exponential = staticmethod(quat.exponential)
    logarithm = staticmethod(quat.logarithm)
    to_frame = staticmethod(quat.rotate)  # a spin, section axes -> frame a
    matrix = staticmethod(quat.matrix)  # of a position, section axes -> frame a
    spin_matrix = staticmethod(quat.matrix)  # of a spin
    spin_skew = staticmethod(quat.skew)  # of a spin, that another one is crossed with

    @property
    def unknowns(self) -> int:
        """Of a node."""
        return self.dims.position + self.dims.spin

    def of_nodes(self, nodes: slice | int) -> Spatial:
        """Of some nodes, or of one, where nodes differ."""
        return self

    # Of the public kind, in 3D, and in these coordinates, which are those
    to_reduced = staticmethod(same)  # a state in these coordinates
    to_public = staticmethod(same)  # the public state
    embed = staticmethod(same)  # [force; moment] (..., w) -> (..., 6)
    project = staticmethod(same)  # [force; moment] (..., 6), frame a -> (..., w)
    project_map = staticmethod(same)  # d[force; moment] by [displacement; spin], (..., 6, 6)
    project_strain = staticmethod(same)  # (..., 6), frame B -> (..., k)
    project_section = staticmethod(same)  # 6x6 of a section -> (..., k, k)
    project_diagonal = staticmethod(same)  # of one that has no more, (..., 6) -> (..., k)
    project_inertia = staticmethod(same)  # (..., 3, 3), section axes -> (..., s, s)
    project_offset = staticmethod(same)  # (..., 3), section axes -> (..., p)
    project_vector = staticmethod(same)  # displacement or velocity (..., 3), frame a -> (..., p)
    project_spin = staticmethod(same)  # (..., 3), frame a -> (..., s)
    public_position = staticmethod(same)  # (..., p), frame a -> (..., 3)
    public_vector = staticmethod(same)  # a velocity or acceleration likewise
    public_spin = staticmethod(same)  # a spin or its rate (..., s), frame a, likewise
    public_frame = staticmethod(same)  # quaternion (..., 4) of frame a's rotation
    reduced_frame = staticmethod(same)  # the inverse
    to_reduced_rotation = staticmethod(same)  # quaternions (..., N+1, 4) of all nodes
    # which of a node's unknowns a support holds, from position x y z and rotation x y z
    constrained = staticmethod(same)
    axes = staticmethod(quat.matrix)  # section axes -> frame a, (..., 3, 3)

    def start(self, state: State) -> State:
        """`to_reduced` of a user's state; ValueError where these coordinates do not hold it."""
        return self.to_reduced(state)

    def pose(self, position: Tensor, rotation: Tensor) -> tuple[Tensor, Tensor]:
        """Position (..., 3), frame a, and quaternion (..., 4) of one node in these coordinates."""
        return position, rotation

    def motion(self, velocity: Tensor, spin: Tensor) -> tuple[Tensor, Tensor]:
        """Velocity (..., 3), frame a, and spin (..., 3), section axes, likewise."""
        return velocity, spin

    # Rotations

    def rotation_rate(self, q: Tensor, spin: Tensor) -> Tensor:
        """R' of R, spin in section axes."""
        return self.multiply(q, pad(spin / 2, (1, 0)))

    def hinged(self, q: Tensor, rest: Tensor, axis: Tensor) -> Tensor:
        """The rotation q of a node that may turn from `rest` about one axis of frame a alone, a
        mask (3,): its turn about the others is taken out.
        """
        turn = self.multiply(q, self.inverse(rest)) * pad(axis, (1, 0), value=1.0)
        return self.multiply(self.normalize(turn), rest)

    def hinged_turn(self, m: Tensor, q: Tensor, axis: Tensor) -> Tensor:
        """The turn m of a node at the rotation q, section axes, of which a hinge leaves what is
        about its axis of frame a, a mask (3,); one that is none stays none, to the last bit.
        """
        return self.normalize(torch.cat((m[..., :1], self.about(q, m[..., 1:], axis)), -1))

    def about(self, rotation: Tensor, spin: Tensor, axis: Tensor) -> Tensor:
        """Of a spin (..., 3), section axes: what is about an axis of frame a, a mask (3,)."""
        return self.to_section(rotation, axis * self.to_frame(rotation, spin))

    def to_section(self, q: Tensor, spin: Tensor) -> Tensor:
        """A spin, frame a -> section axes."""
        return quat.rotate(quat.conjugate(q), spin)

    def identity(self, like: Tensor) -> Tensor:
        """The rotation that changes nothing, for positions `like` these."""
        return pad(torch.zeros_like(like), (1, 0), value=1.0)

    def cayley(self, theta: Tensor) -> Tensor:
        """The rotation with Theta = 2 tan(angle/2) n."""
        return quat.normalize(pad(theta / 2, (1, 0), value=1.0))

    def theta(self, q: Tensor) -> Tensor:
        """Theta = 2 tan(angle/2) n of a rotation."""
        return 2 * q[..., 1:] / q[..., :1]

    def theta_by_turn(self, theta: Tensor) -> Tensor:
        """d(Theta) of R exp(~x) by x at 0: I + ~Theta/2 + Theta Theta^T/4."""
        eye = torch.eye(3, dtype=theta.dtype, device=theta.device)
        return eye + quat.skew(theta / 2) + theta[..., :, None] * theta[..., None, :] / 4

    def logarithm_by_turn(self, q: Tensor) -> Tensor:
        """d(log) of R exp(~x) by x at 0: I + ~psi/2 + k ~psi ~psi, psi = log R."""
        eye, psi = torch.eye(3, dtype=q.dtype, device=q.device), quat.skew(quat.logarithm(q))
        s2 = q[..., 1:].square().sum(-1, keepdim=True)
        small = s2 < 1e-6
        g = quat.arc_ratio(q[..., :1], s2)
        k = torch.where(
            small, 1 / 12 + s2 / 180, (1 - g * q[..., :1]) / torch.where(small, 1.0, 4 * g**2 * s2)
        )
        return eye + psi / 2 + k[..., None] * psi @ psi

    def cosine(self, q: Tensor) -> Tensor:
        """cos(angle/2), (...)."""
        return q[..., 0]

    def sqrt(self, q: Tensor) -> Tensor:
        """The rotation that gives q when made twice."""
        return quat.half_way(self.identity(q[..., 1:]), q)

    def mean_rotation(self, R: Tensor, before: Tensor) -> Tensor:
        """(I + R R_before^T)/2 of spin matrices."""
        return (torch.eye(3, dtype=R.dtype, device=R.device) + R @ before.mT) / 2

    # Arms: a force at x has the moment arm(x)^T f; a spin moves x with arm(x) spin

    def lever_matrix(self, x: Tensor) -> Tensor:
        """(..., p, s) of a vector (..., p), frame a."""
        return -quat.skew(x)

    def skew(self, omega: Tensor) -> Tensor:
        """(..., p, p) of omega x, for a spin (..., s), frame a."""
        return quat.skew(omega)
