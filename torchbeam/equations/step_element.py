"""Elements in a balance, at rest or over one implicit step: forces on their nodes, the strain that
stress answers to, and their tangent. Local: nothing here knows a topology. The midpoint
step has forces at mid step and a mean strain, generalized alpha both at the end:

    n, m_i, m_j = h B_mid^T [F; M]
    gap = (strain_n + strain_{n+1})/2 + rate (strain_{n+1} - strain_n)/dt - S [F; M]
    n, m_i, m_j = h B_{n+1}^T [F; M]    gap = strain_{n+1} + rate (strain rate)_{n+1} - S [F; M]

Where a law's stress relaxes, its arms make of that strain what stress answers to: see
`nodal.maxwell_arms`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import cached
from ..core.leaves import Tree, leaf
from ..nodal.constitutive_law import ElasticLaw
from ..nodal.coordinates.spatial import Spatial
from ..nodal.linear_interpolation import Ends
from ..nodal.maxwell_arms import Decay
from .alpha_kinematics import GeneralizedAlpha

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


# (..., N, s, s) of an element's nodes: half the spin of a rotation at the end by that at mid step
HalfTurns = Callable[[], tuple[Tensor, ...]]


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

    def tangent(self, balance: ElementBalance, stress: Tensor, half: HalfTurns) -> ElementTangent:
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
        effective_strain = self.law.at_rest(strain - self.eigenstrain)
        return self._balance(kinematics, kinematics, effective_strain, stress)

    def tangent(self, balance: ElementBalance, stress: Tensor, half: HalfTurns) -> ElementTangent:
        B = self.space.strain_operator(balance.end, self.length)
        return self._tangent(balance.acting, stress, B, self.law.at_rest_by(B))


DIGITS = 10.0  # eps of a position, or of a rotation, that a step may leave in it


@dataclass(frozen=True)
class StepElement(BalancedElement):
    """h (..., 1, 1) s the step, start the nodes then; crept (..., N, m k): see `MaxwellArms`, None
    = nothing relaxes.
    """

    h: Tensor = leaf(2)
    start: Ends = leaf(2)
    crept: Tensor | None = leaf(2)

    @cached
    def strain(self) -> Tensor:
        """(..., N, k) at the start."""
        return self._kinematics(self.start)[1]

    @property
    def rate(self) -> Tensor:
        """(..., 1, 1, 1) 1/s: rate of the strain by what the law takes for the strain."""
        raise NotImplementedError

    @cached
    def rounding(self) -> Tensor:
        """A strain is a difference of positions, or of rotations, over the length; where rates of
        strain are felt, so is the rate of that.
        """
        reach = sum(r.detach().abs().sum(-1) for r in self.start[: len(self.start) // 2])
        eps, length = torch.finfo(self.length.dtype).eps, self.length.detach()[..., 0]
        error = eps * (ROUNDING + DIGITS * (reach + 1) / length)[..., None]
        error = error.expand(*error.shape[:-1], self.law.S.shape[-2])
        felt = self.law.effective_strain(error, lambda: self.rate[..., 0].detach().abs() * error)
        return felt.detach().abs().amax(-1)

    @cached
    def decay(self) -> Decay:
        """Of the law's arms over the step."""
        return self.law.arms.decay(self.h)

    @property
    def lag(self) -> tuple[Tensor, Tensor, Tensor]:
        """Of the arms' lag where stress is taken: how much is left of that at the start, how much
        there is of the strain's change, and of that of what the law takes for the strain.
        """
        raise NotImplementedError

    def _effective_strain(
        self, strain: Tensor, after: Tensor, rate: Callable[[], Tensor]
    ) -> Tensor:
        """Of the strain where stress is taken; after: the strain at the end."""
        strain = strain - self.eigenstrain
        if self.law.arms is not None:
            start = self.strain - self.eigenstrain
            change = after - self.strain
            strain = self.law.arms.relaxed(strain, start, change, self.crept, self.lag[:2])
        return self.law.effective_strain(strain, rate)

    def _effective_strain_by(self, strain_by_move: Tensor) -> Tensor:
        E = self.law.effective_strain_by(strain_by_move, self.rate)
        if self.law.arms is None:
            return E
        return E + (self.law.arms.relaxed_by(self.lag[2]) - 1)[..., None] * strain_by_move

    def advanced(self, after: Tensor) -> Tensor:
        """What has crept at the end, where the strain is `after`, (..., N, m k)."""
        start = self.strain - self.eigenstrain
        return self.law.arms.advanced(start, after - self.strain, self.crept, self.decay)


@dataclass(frozen=True)
class MidpointElement(StepElement):
    """Over a midpoint step."""

    @cached
    def rate(self) -> Tensor:
        """2/dt: rate of the strain by its mean."""
        return 2 / self.h[..., None]

    @property
    def lag(self) -> tuple[Tensor, Tensor, Tensor]:
        return self.decay.mean, self.decay.rising, 2 * self.decay.rising

    def balance(self, stress: Tensor, middle: Ends, end: Ends) -> ElementBalance:
        """stress (..., N, k); nodes at mid step and at the end."""
        acting = self.space.kinematics(*middle, self.length)
        end, after = self._kinematics(end)
        effective_strain = self._effective_strain(
            (self.strain + after) / 2, after, lambda: (after - self.strain) / self.h
        )
        return self._balance(acting, end, effective_strain, stress)

    def tangent(self, balance: ElementBalance, stress: Tensor, half: HalfTurns) -> ElementTangent:
        space = self.space
        by_r, *by_spin = space.interpolation.by_spins(
            space.strain_operator(balance.end, self.length), space.dims.position
        )
        turned = (by @ half_turn for by, half_turn in zip(by_spin, half(), strict=True))
        E = self._effective_strain_by(space.interpolation.by_numbers(by_r, *turned))
        return self._tangent(
            balance.acting, stress, space.strain_operator(balance.acting, self.length), E
        )


@dataclass(frozen=True)
class EndElement(StepElement):
    """Over a step of generalized alpha. straining (..., N, 2 k): strain rate at the start, and its
    algorithmic counterpart.
    """

    straining: Tensor = leaf(2)
    method: GeneralizedAlpha

    @cached
    def rate(self) -> Tensor:
        return self.method.ratio / self.method.gamma / self.h[..., None]

    @property
    def lag(self) -> tuple[Tensor, Tensor, Tensor]:
        return self.decay.kept, self.decay.mean, self.decay.mean

    def rates(self, strain: Tensor) -> tuple[Tensor, Tensor]:
        """(..., N, k) at the end, of the strain there: its rate, and the algorithmic one."""
        method = self.method
        _, before = self.straining.chunk(2, -1)
        d = ((strain - self.strain) / self.h - (1 - method.gamma) * before) / method.gamma
        return method.true(d, self.straining), d

    def balance(self, stress: Tensor, end: Ends) -> ElementBalance:
        """stress (..., N, k); nodes at the end."""
        kinematics, strain = self._kinematics(end)
        return self._balance(
            kinematics,
            kinematics,
            self._effective_strain(strain, strain, lambda: self.rates(strain)[0]),
            stress,
        )

    def tangent(self, balance: ElementBalance, stress: Tensor, half: HalfTurns) -> ElementTangent:
        """By the move of the end: `half` is not asked for."""
        B = self.space.strain_operator(balance.end, self.length)
        E = self._effective_strain_by(B)
        return self._tangent(balance.acting, stress, B, E)
