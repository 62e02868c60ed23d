"""Elements in a balance: forces on their nodes, and the strain that stress answers to. Local:
nothing here knows a topology.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.leaves import Tree, leaf
from ..nodal.constitutive_law import ElasticLaw
from ..nodal.coordinates.spatial import Spatial
from ..nodal.linear_interpolation import Ends

# eps: strains below are differences of positions that floating point does not hold
ROUNDING = 1000.0


class ElementBalance(NamedTuple):
    """acting, end: kinematics where the forces are taken, and at the end; forces (..., N, p + 2 s);
    effective_strain and constitutive_residual (..., N, k).
    """

    acting: Any
    end: Any
    forces: Tensor
    effective_strain: Tensor
    constitutive_residual: Tensor


class ElementTangent(NamedTuple):
    """stiffness (..., N, p + 2 s, p + 2 s) at fixed stress; force_operator and strain_by_move
    (..., N, k, p + 2 s): h B, the strain operator by the length, where the forces are taken, and E,
    the derivative of the constitutive residual by the moves.
    """

    stiffness: Tensor
    force_operator: Tensor
    strain_by_move: Tensor


@dataclass(frozen=True)
class BalancedElement(Tree):
    """Any number of elements, one too: length (..., N, 1) m, reference (..., N, k) strain of the
    undeformed beam, eigenstrain (..., N or 1, k) or 0.0.
    """

    space: Spatial
    law: ElasticLaw
    length: Tensor = leaf(2)
    reference: Tensor = leaf(2)
    eigenstrain: Tensor | float = leaf(2)

    @property
    def rounding(self) -> Tensor | float:
        """(..., N), or of all: what floating point may leave of the constitutive residual."""
        return ROUNDING * torch.finfo(self.length.dtype).eps

    def balance(self, stress: Tensor, *poses: Ends) -> ElementBalance:
        """stress (..., N, k); nodes where forces and strain are taken."""
        raise NotImplementedError

    def tangent(
        self, balance: ElementBalance, stress: Tensor, half: Callable[[], tuple[Tensor, ...]]
    ) -> ElementTangent:
        """half() (..., N, s, s) of an element's nodes: half the spin of a rotation at the end by
        its spin at mid step.
        """
        raise NotImplementedError

    def _kinematics(self, nodes: Ends) -> tuple[Any, Tensor]:
        """With the strain."""
        kinematics = self.space.kinematics(*nodes, self.length)
        return kinematics, self.space.strains(kinematics, self.length, self.reference)

    def _balance(
        self, acting: Any, end: Any, effective_strain: Tensor, stress: Tensor
    ) -> ElementBalance:
        return ElementBalance(
            acting,
            end,
            self.space.forces(acting, stress, self.length),
            effective_strain,
            self.law.constitutive_residual(effective_strain, stress),
        )

    def _tangent(self, acting: Any, stress: Tensor, B: Tensor, E: Tensor) -> ElementTangent:
        return ElementTangent(
            self.space.geometric_stiffness(acting, stress, self.length),
            self.length[..., None] * B,
            E,
        )


@dataclass(frozen=True)
class ElementAtRest(BalancedElement):
    """In an equilibrium: n, m_i, m_j = h B^T [F; M], gap = strain - S [F; M]."""

    def balance(self, stress: Tensor, nodes: Ends) -> ElementBalance:
        kinematics, strain = self._kinematics(nodes)
        return self._balance(kinematics, kinematics, strain - self.eigenstrain, stress)

    def tangent(
        self, balance: ElementBalance, stress: Tensor, half: Callable[[], tuple[Tensor, ...]]
    ) -> ElementTangent:
        B = self.space.strain_operator(balance.end, self.length)
        return self._tangent(balance.acting, stress, B, B)
