"""Elements over one midpoint step: forces at mid step, mean strain, and their tangent. Local: nothing here knows the chain.

    n, m_i, m_j = h B_mid^T [F; M]        gap = (strain_n + strain_{n+1})/2 + rate (strain_{n+1} - strain_n)/dt - S [F; M]
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import cached
from ..core.leaves import Tree, leaf
from ..nodal.constitutive_law import ElasticLaw
from ..nodal.coordinates.spatial import Space


class ElementBalance(NamedTuple):
    """middle, end: kinematics at mid step and at the end; forces (..., N, p + 2 s); felt strain and gap (..., N, k)."""

    middle: Any
    end: Any
    forces: Tensor
    felt: Tensor
    gap: Tensor


class ElementTangent(NamedTuple):
    """stiffness (..., N, p + 2 s, p + 2 s) at fixed stress; hB and E (..., N, k, p + 2 s): h times the strain operator at mid
    step, and the derivative of the gap by the moves of mid step.
    """

    stiffness: Tensor
    hB: Tensor
    E: Tensor


@dataclass(frozen=True)
class MidpointElement(Tree):
    """Any number of elements, one too: length (..., N, 1) m, h (..., 1, 1) s the step, reference and strain (..., N, k) of the
    undeformed beam and at the start, eigenstrain (..., N or 1, k) or 0.0.
    """

    space: Space
    law: ElasticLaw
    length: Tensor = leaf(2)
    h: Tensor = leaf(2)
    reference: Tensor = leaf(2)
    strain: Tensor = leaf(2)
    eigenstrain: Tensor | float = leaf(2)

    @cached
    def rate(self) -> Tensor:
        """2/dt: rate of the strain by its mean."""
        return 2 / self.h[..., None]

    def balance(self, middle: tuple[Tensor, ...], end: tuple[Tensor, ...], stress: Tensor) -> ElementBalance:
        """middle, end: positions and rotations (r_i, r_j, q_i, q_j) of the two nodes then; stress (..., N, k)."""
        space, law = self.space, self.law
        middle, end = (space.kinematics(*nodes, self.length) for nodes in (middle, end))
        after = space.strains(end, self.length, self.reference)
        felt = law.felt((self.strain + after) / 2 - self.eigenstrain, lambda: (after - self.strain) / self.h)
        return ElementBalance(middle, end, space.forces(middle, stress, self.length), felt, law.gap(felt, stress))

    def tangent(self, middle: Any, end: Any, stress: Tensor, half_i: Tensor, half_j: Tensor) -> ElementTangent:
        """half_i, half_j (..., N, s, s): half the spin of a node's rotation at the end by its spin at mid step."""
        space, p, s = self.space, self.space.position, self.space.spin
        by_r, by_i, by_j = space.strain_operator(end, self.length).split((p, s, s), -1)
        E = self.law.felt_by(torch.cat((by_r, by_i @ half_i, by_j @ half_j), -1), self.rate)
        hB = self.length[..., None] * space.strain_operator(middle, self.length)
        return ElementTangent(space.geometric_stiffness(middle, stress, self.length), hB, E)
