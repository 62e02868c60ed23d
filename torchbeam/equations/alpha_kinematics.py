"""Nodal kinematics and inertia forces of one generalized-alpha step; the equations are those of
`generalized_alpha`.

Local: a node needs no other, but for the mass that neighbours share.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import cached
from ..nodal.inertia import Inertia, InertiaForces
from ..nodal.loads import Nodes
from ..nodal.mass_offset import NoMassOffset
from ..scene.effects import INERTIAL
from ..state.state import State
from ..topology.protocols import Matrix


class GeneralizedAlpha(NamedTuple):
    """Coefficients of the method."""

    alpha_m: float
    alpha_f: float
    gamma: float
    beta: float

    @classmethod
    def of(cls, rho_inf: float) -> GeneralizedAlpha:
        """By the spectral radius at infinite frequency."""
        m, f = (2 * rho_inf - 1) / (rho_inf + 1), rho_inf / (rho_inf + 1)
        return cls(m, f, 0.5 - m + f, (1 - m + f) ** 2 / 4)

    @property
    def ratio(self) -> float:
        """d q"/d a."""
        return (1 - self.alpha_m) / (1 - self.alpha_f)

    def true(self, algorithmic: Tensor, before: Tensor) -> Tensor:
        """q" of a at the end and (q", a) at the start."""
        q, a = before.chunk(2, -1)
        return ((1 - self.alpha_m) * algorithmic + self.alpha_m * a - self.alpha_f * q) / (
            1 - self.alpha_f
        )


class EndKinematics(NamedTuple):
    """Motion of the nodes at the end of a step, from its unknowns: position and rotation; m, from
    the start to there; velocity (frame a) and spin (section axes) as v, their true rates q" and the
    algorithmic a, (..., N+1, w).
    """

    position_end: Tensor
    q_end: Tensor
    m: Tensor
    v: Tensor
    true: Tensor
    algorithmic: Tensor

    @property
    def poses(self) -> tuple[tuple[Tensor, Tensor], ...]:
        """Position and rotation."""
        return ((self.position_end, self.q_end),)


@dataclass(frozen=True)
class EndMotion:
    """Nodes from `start` (an `AlphaState`) over h (..., 1, 1) s, centres of mass in them."""

    inertia: Inertia
    start: State
    h: Tensor
    method: GeneralizedAlpha

    @cached
    def by_spin(self) -> Tensor:
        """d v/d r = gamma/(beta dt), (..., 1, 1, 1) 1/s."""
        return self.method.gamma / self.method.beta / self.h[..., None]

    @cached
    def by_a(self) -> Tensor:
        """d q"/d r, (..., 1, 1, 1) 1/s^2."""
        return self.method.ratio / self.method.beta / self.h[..., None] ** 2

    @cached
    def Z(self) -> Tensor:
        """The same of positions, (..., 1, p, p)."""
        return self.by_a * torch.eye(
            self.inertia.space.dims.position, dtype=self.h.dtype, device=self.h.device
        )

    @cached
    def masses(self) -> Matrix:
        """M Z, with a turn's rows and columns: no mass lies off its node here."""
        return NoMassOffset().prepared(
            self.inertia.translational.matrix(self.Z), self.inertia.space.dims.spin
        )

    def kinematics(self, u: Tensor, m: Tensor) -> EndKinematics:
        """Over u (..., N+1, p) m and the rotation m, both to the end."""
        space, start, method, h = self.inertia.space, self.start, self.method, self.h
        a_n = start.acceleration[..., space.unknowns :]
        v_n = torch.cat((start.velocity, start.spin), -1)
        move = torch.cat((u, space.logarithm(m)), -1)
        a = ((move / h - v_n) / h - (0.5 - method.beta) * a_n) / method.beta
        v = v_n + h * ((1 - method.gamma) * a_n + method.gamma * a)
        return EndKinematics(
            start.position + u,
            space.normalize(space.multiply(start.rotation, m)),
            m,
            v,
            method.true(a, start.acceleration),
            a,
        )

    def balance(self, kinematics: EndKinematics) -> InertiaForces:
        """At the end; `angular` is J Omega, section axes."""
        inertia, space, p = self.inertia, self.inertia.space, self.inertia.space.dims.position
        rotary, spin = inertia.rotary, kinematics.v[..., p:]
        H = rotary.section_momentum(spin)
        moment = rotary.present_or(
            H,
            lambda: space.to_frame(
                kinematics.q_end,
                rotary.section_momentum(kinematics.true[..., p:])
                + (space.spin_skew(spin) @ H[..., None])[..., 0],
            ),
        )
        return InertiaForces(
            torch.cat((inertia.translational.momentum(kinematics.true[..., :p]), moment), -1), H
        )

    def nodes(self, kinematics: EndKinematics, read: frozenset[str]) -> Nodes:
        """What loads see: the end of the step."""
        p = self.inertia.space.dims.position
        return self._nodes(
            kinematics.position_end,
            kinematics.q_end,
            kinematics.v[..., :p],
            kinematics.v[..., p:],
            kinematics.true,
            read,
        )

    def nodes_before(self, read: frozenset[str]) -> Nodes:
        """The same at the start."""
        start, w = self.start, self.inertia.space.unknowns
        return self._nodes(
            start.position,
            start.rotation,
            start.velocity,
            start.spin,
            start.acceleration[..., :w],
            read,
        )

    def _nodes(
        self,
        r: Tensor,
        q: Tensor,
        velocity: Tensor,
        spin: Tensor,
        true: Tensor,
        read: frozenset[str],
    ) -> Nodes:
        p, to_frame = self.inertia.space.dims.position, self.inertia.space.to_frame
        accelerations = {
            "acceleration": lambda: true[..., :p],
            "angular_acceleration": lambda: to_frame(q, true[..., p:]),
        }
        return Nodes(
            r,
            q,
            velocity,
            to_frame(q, spin),
            **{name: accelerations[name]() for name in INERTIAL if name in read},
        )


@dataclass(frozen=True)
class EndTangent:
    """Derivatives of the motion `way` by the move (dr, spin of R) of the end, each made where it is
    asked for; those of what loads see have its names. d(psi) = (I + ~psi/2 + k ~psi ~psi) R^T spin.
    """

    motion: EndMotion
    kinematics: EndKinematics

    @cached
    def R(self) -> Tensor:
        return self.motion.inertia.space.spin_matrix(self.kinematics.q_end)

    @cached
    def psi(self) -> Tensor:
        """d(psi) by what R turns by, section axes, (..., N+1, s, s)."""
        return self.motion.inertia.space.logarithm_by_turn(self.kinematics.m)

    @cached
    def turn(self) -> Tensor:
        """R d(psi)."""
        return self.R @ self.psi @ self.R.mT

    def inertia(self, forces: InertiaForces) -> Matrix:
        """Of `EndMotion.balance`."""
        motion, space, rotary = self.motion, self.motion.inertia.space, self.motion.inertia.rotary
        p = space.dims.position

        def angular() -> Tensor:
            gyroscopic = space.spin_skew(self.kinematics.v[..., p:]) @ rotary.J - space.spin_skew(
                forces.angular
            )
            by = motion.by_spin * gyroscopic + motion.by_a * rotary.J
            return self.R @ by @ self.psi @ self.R.mT - space.spin_skew(forces.wrench[..., p:])

        return rotary.matrix(motion.masses, angular)

    @property
    def velocity(self) -> Tensor:
        like = self.motion.by_spin
        return like * torch.eye(
            self.motion.inertia.space.dims.position, dtype=like.dtype, device=like.device
        )

    @property
    def spin(self) -> Tensor:
        return self._vector_by(self.motion.by_spin, self.kinematics.v)

    @property
    def acceleration(self) -> Tensor:
        return self.motion.Z

    @property
    def angular_acceleration(self) -> Tensor:
        return self._vector_by(self.motion.by_a, self.kinematics.true)

    def _vector_by(self, rate: Tensor, x: Tensor) -> Tensor:
        """d(R x) of what turns with the section, x (..., N+1, w) rising at a rate with psi."""
        space = self.motion.inertia.space
        return rate * self.turn - space.spin_skew(
            space.to_frame(self.kinematics.q_end, x[..., space.dims.position :])
        )
