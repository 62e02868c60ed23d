"""Elements over one implicit step: forces, the strain that stress answers to, and their tangent.
Local: nothing here knows the chain. The midpoint step has forces at mid step and a mean strain,
generalized alpha both at the end:

    n, m_i, m_j = h B_mid^T [F; M]
    gap = (strain_n + strain_{n+1})/2 + rate (strain_{n+1} - strain_n)/dt - S [F; M]
    n, m_i, m_j = h B_{n+1}^T [F; M]    gap = strain_{n+1} + rate (strain rate)_{n+1} - S [F; M]
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from ..core.derivatives import cached
from ..core.leaves import leaf
from ..nodal.linear_interpolation import Ends
from .alpha_kinematics import GeneralizedAlpha
from .balanced_element import ROUNDING, BalancedElement, ElementBalance, ElementTangent

DIGITS = 10.0  # eps of a position, or of a rotation, that a step may leave in it


@dataclass(frozen=True)
class StepElement(BalancedElement):
    """h (..., 1, 1) s the step, start the nodes then."""

    h: Tensor = leaf(2)
    start: Ends = leaf(2)

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

    def _effective_strain(self, strain: Tensor, rate: Callable[[], Tensor]) -> Tensor:
        return self.law.effective_strain(strain - self.eigenstrain, rate)


@dataclass(frozen=True)
class MidpointElement(StepElement):
    """Over a midpoint step."""

    @cached
    def rate(self) -> Tensor:
        """2/dt: rate of the strain by its mean."""
        return 2 / self.h[..., None]

    def balance(self, stress: Tensor, middle: Ends, end: Ends) -> ElementBalance:
        """stress (..., N, k); nodes at mid step and at the end."""
        acting = self.space.kinematics(*middle, self.length)
        end, after = self._kinematics(end)
        effective_strain = self._effective_strain(
            (self.strain + after) / 2, lambda: (after - self.strain) / self.h
        )
        return self._balance(acting, end, effective_strain, stress)

    def tangent(
        self, balance: ElementBalance, stress: Tensor, half: Callable[[], tuple[Tensor, ...]]
    ) -> ElementTangent:
        space = self.space
        by_r, *by_spin = space.interpolation.by_spins(
            space.strain_operator(balance.end, self.length), space.dims.position
        )
        turned = (by @ half_turn for by, half_turn in zip(by_spin, half(), strict=True))
        E = self.law.effective_strain_by(space.interpolation.by_numbers(by_r, *turned), self.rate)
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
            self._effective_strain(strain, lambda: self.rates(strain)[0]),
            stress,
        )

    def tangent(
        self, balance: ElementBalance, stress: Tensor, half: Callable[[], tuple[Tensor, ...]]
    ) -> ElementTangent:
        """By the move of the end: `half` is not asked for."""
        B = self.space.strain_operator(balance.end, self.length)
        E = self.law.effective_strain_by(B, self.rate)
        return self._tangent(balance.acting, stress, B, E)
