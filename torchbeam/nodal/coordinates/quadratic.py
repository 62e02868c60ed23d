"""Coordinates of beams whose elements have three nodes: the same unknowns of a node, with another element between nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from ...math import quaternions as quat
from .. import quadratic_assembly, quadratic_element
from . import planar_quadratic_element
from .linearised import LinearElement, Moves, Small
from .planar import Plane
from .spatial import Space


class QuadraticSpace(Space):
    """See `Space` and `quadratic_element`."""

    chain = quadratic_assembly

    kinematics = staticmethod(quadratic_element.kinematics)
    strains = staticmethod(quadratic_element.strain)
    forces = staticmethod(quadratic_element.forces)
    strain_operator = staticmethod(quadratic_element.strain_operator)
    geometric_stiffness = staticmethod(quadratic_element.geometric_stiffness)


@dataclass(frozen=True)
class QuadraticPlane(Plane):
    """See `Plane` and `planar_quadratic_element`."""

    chain = quadratic_assembly

    kinematics = staticmethod(planar_quadratic_element.kinematics)
    strains = staticmethod(planar_quadratic_element.strains)
    forces = staticmethod(planar_quadratic_element.forces)
    strain_operator = staticmethod(planar_quadratic_element.strain_operator)
    geometric_stiffness = staticmethod(planar_quadratic_element.geometric_stiffness)


@dataclass(frozen=True)
class LinearQuadraticElement(LinearElement):
    """chord: dr/dx of the undeformed beam at the stations; numbers of a station as in `quadratic_assembly`."""

    @classmethod
    def of(cls, nodes: Tensor, frames: Tensor, length: Tensor) -> LinearQuadraticElement:
        rotations = quadratic_assembly.ends(frames)
        kin = quadratic_element.kinematics(*quadratic_assembly.ends(nodes), *rotations, length)
        B = quadratic_element.strain_operator(kin, length)
        by_r, *by_spin = B.split(3, -1)
        turned = torch.broadcast_tensors(by_r, *(by @ quat.matrix(q) for by, q in zip(by_spin, rotations, strict=True)))
        return cls(length * kin.d, B, torch.cat(turned, -1))

    def kinematics(self, r_1: Tensor, r_2: Tensor, r_3: Tensor, q_1: Tensor, q_2: Tensor, q_3: Tensor, length: Tensor) -> Moves:
        """Positions m and rotation vectors rad (section axes) of the three nodes, (..., 3)."""
        along = quadratic_assembly.slopes(r_1, r_2, r_3) - self.chord
        return Moves(torch.cat(torch.broadcast_tensors(along, q_1, q_2, q_3), -1))


@dataclass(frozen=True)
class QuadraticSmall(Small):
    """See `Small`."""

    chain = quadratic_assembly
    linear: ClassVar[type[LinearElement]] = LinearQuadraticElement
