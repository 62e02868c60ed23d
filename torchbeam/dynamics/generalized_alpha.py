"""One step of the generalized-alpha method: force balance at the end of the step, high frequencies damped at will.

Chung and Hulbert 1993, on the nodes' rotations as Arnold and Bruels 2007. With a the algorithmic acceleration, q" the true one,
psi = log(R_n^T R_{n+1}) the rotation vector of the step and rho the spectral radius at infinite frequency,

    alpha_m = (2 rho - 1)/(rho + 1)    alpha_f = rho/(rho + 1)    gamma = 1/2 - alpha_m + alpha_f    beta = (gamma + 1/2)^2/4
    r_{n+1} - r_n, psi  = dt v_n + dt^2 ((1/2 - beta) a_n + beta a_{n+1})
    v_{n+1}             = v_n + dt ((1 - gamma) a_n + gamma a_{n+1})
    (1 - alpha_f) q"_{n+1} + alpha_f q"_n = (1 - alpha_m) a_{n+1} + alpha_m a_n

where v holds velocity (frame a) and spin (section axes), and at the end of the step

    M q"                        + to_nodes(h B^T [F; M])_force  - f = 0
    R (J q" + Omega x J Omega)  + to_nodes(h B^T [F; M])_moment - m = 0          S [F; M] = strain + rate (strain rate)

The strain rate follows from the strains as q" does from v (Jansen, Whiting and Hulbert 2000): damping is second order too.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import cached
from ..core.leaves import leaf
from ..nodal import loads as external
from ..nodal.balance import Linearisation, Residual, largest, restrained_forces, size_of_strain
from ..nodal.inertia import Momenta
from ..nodal.loads import MotionJacobian, Nodes
from ..state.state import State
from .midpoint import SPINS, MidpointProblem


@dataclass(frozen=True)
class AlphaState(State):
    """What the method remembers beside the state; stress and reaction are those at the state's instant.

    acceleration  (..., N+1, 2 w) q" and a: of position m/s^2, frame a, and of spin rad/s^2, section axes, in the coordinates
                  of the scene's space (w = 6; 3 in a plane)
    straining     (..., N, 2 k) strain rate 1/s and 1/(m s), and its algorithmic counterpart, likewise (k = 6; 3 in a plane)
    """

    acceleration: Tensor = leaf(2)
    straining: Tensor = leaf(2)

    @classmethod
    def between(cls, state: State, velocity: Tensor, spin: Tensor, strain: Tensor, dt: Tensor) -> AlphaState:
        """`state` with the mean rates up to a state a step later, over which velocity, spin and strain rose by so much (in the
        space's coordinates).
        """
        h = dt[..., None, None]
        mean = torch.cat((velocity, spin), -1) / h
        return cls(**vars(state), acceleration=torch.cat((mean, mean), -1), straining=torch.cat((strain, strain), -1) / h)

    def plain(self) -> State:
        """What every method knows of the state."""
        return State(**{f.name: getattr(self, f.name) for f in fields(State)})


class EndUnknowns(NamedTuple):
    """The unknowns: u (..., N+1, p) m and m (..., N+1, ...) from the start to the end, stress (..., N, k) N and N m."""

    u: Tensor
    m: Tensor
    stress: Tensor


@dataclass(frozen=True)
class GeneralizedAlphaProblem(MidpointProblem):
    """A step of length dt (0-dim or (...)) from `start`, with loads as at time t, its end, and inputs held over it."""

    start: AlphaState
    rho_inf: float = 0.8

    INSTANT = 1.0
    PART = 1.0

    @cached
    def coefficients(self) -> tuple[float, float, float, float]:
        """alpha_m, alpha_f, gamma, beta."""
        m, f = (2 * self.rho_inf - 1) / (self.rho_inf + 1), self.rho_inf / (self.rho_inf + 1)
        return m, f, 0.5 - m + f, (1 - m + f) ** 2 / 4

    @cached
    def acceleration_ratio(self) -> float:
        """d q"/d a."""
        m, f, *_ = self.coefficients
        return (1 - m) / (1 - f)

    def predictor(self) -> EndUnknowns:
        """Constant velocity, and the stress of the step before."""
        turn = self.model.space.exponential(self.start.spin * self.h)
        return self.apply_supports(EndUnknowns(self.start.velocity * self.h, turn, self.start.stress))

    def rest_guess(self) -> EndUnknowns:
        return EndUnknowns(*super().rest_guess())

    def update(self, x: EndUnknowns, move: Tensor, dstress: Tensor) -> EndUnknowns:
        """x after a move of the end."""
        return EndUnknowns(*super().update(x, move, dstress))

    def true(self, algorithmic: Tensor, before: Tensor) -> Tensor:
        """q" of a at the end and (q", a) at the start."""
        m, f, *_ = self.coefficients
        q, a = before.chunk(2, -1)
        return ((1 - m) * algorithmic + m * a - f * q) / (1 - f)

    def motion(self, x: EndUnknowns) -> tuple[Tensor, Tensor, Tensor]:
        """(..., N+1, w) at the end: velocity and spin, q", a."""
        *_, gamma, beta = self.coefficients
        w = self.model.space.unknowns
        a_n = self.start.acceleration[..., w:]
        v_n = torch.cat((self.start.velocity, self.start.spin), -1)
        way = torch.cat((x.u, self.model.space.logarithm(x.m)), -1)
        a = ((way / self.h - v_n) / self.h - (0.5 - beta) * a_n) / beta
        return v_n + self.h * ((1 - gamma) * a_n + gamma * a), self.true(a, self.start.acceleration), a

    def rates(self, strain_end: Tensor) -> tuple[Tensor, Tensor]:
        """(..., N, k) at the end: strain rate, and its algorithmic counterpart."""
        gamma = self.coefficients[2]
        before = self.start.straining[..., self.model.space.strain:]
        d = ((strain_end - self.strain) / self.h - (1 - gamma) * before) / gamma
        return self.true(d, self.start.straining), d

    def turned(self, x: EndUnknowns) -> Tensor:
        space = self.model.space
        return space.normalize(space.multiply(self.start.rotation, x.m))

    def at_end(self, x: EndUnknowns, q: Tensor, motion: Tensor, true: Tensor) -> Nodes:
        """What loads see."""
        p, space = self.model.space.position, self.model.space
        return Nodes(self.start.position + x.u, q, motion[..., :p], space.to_frame(q, motion[..., p:]),
                     **self._accelerations(q, true))

    def _accelerations(self, q: Tensor, true: Tensor) -> dict[str, Tensor]:
        """Of nodes with the accelerations q", as loads see them."""
        p = self.model.space.position
        found = {"acceleration": true[..., :p]}
        if "angular_acceleration" in self._read:
            found["angular_acceleration"] = self.model.space.to_frame(q, true[..., p:])
        return found

    def seen(self, x: EndUnknowns) -> Nodes:
        x = self.apply_supports(x)
        motion, true, _ = self.motion(x)
        return self.at_end(x, self.turned(x), motion, true)

    def load(self, nodes: Nodes) -> Tensor | float:
        moving = self.model.loads[0]
        return self._dead + external.external(self.model, nodes, self.t, self.inputs, moving) if moving else self._dead

    def residual(self, x: EndUnknowns) -> tuple[Residual, Any, Tensor, Tensor, Tensor]:
        """The balance at x; with it the elements, the nodes' rotation and their motion."""
        model, space, h = self.model, self.model.space, self.model.length
        x = self.apply_supports(x)
        q = self.turned(x)
        end = model.kinematics(self.start.position + x.u, q)
        v, true, _ = self.motion(x)
        p = space.position
        rates = Momenta(model.inertia.momentum(true[..., :p]), torch.zeros_like(true[..., p:]))
        if model.inertia.inertia is not None:
            rates = rates._replace(angular=space.to_frame(q, self._torque(v, true)[0]))
        inertia = torch.cat(rates, -1)
        element = space.forces(end, x.stress, h)
        load = self.load(self.at_end(x, q, v, true))
        strain_end = model.strain(end)
        felt = model.law.felt(strain_end - self.eigenstrain, lambda: self.rates(strain_end)[0])
        nodes = inertia + space.to_nodes(element) - load
        sizes = largest(p, h, element, load, inertia, restrained_forces(model, end, self.eigenstrain, h))
        gap = model.law.gap(felt, x.stress)
        return Residual(model.constraints, nodes, gap, *sizes, size_of_strain(felt, self.eigenstrain)), end, q, v, true

    def _torque(self, v: Tensor, true: Tensor) -> tuple[Tensor, Tensor]:
        """J q" + Omega x J Omega and J Omega, section axes."""
        p, space, inertia = self.model.space.position, self.model.space, self.model.inertia
        H = inertia.angular_momentum(v[..., p:])
        return inertia.angular_momentum(true[..., p:]) + (space.spin_skew(v[..., p:]) @ H[..., None])[..., 0], H

    def linearise(self, x: EndUnknowns, end: Any, q: Tensor, v: Tensor, true: Tensor) -> Linearisation:
        """The tangent by (dr, spin of R) at the end: d(psi) = (I + ~psi/2 + k ~psi ~psi) R^T spin."""
        model, space, h = self.model, self.model.space, self.model.length[..., None]
        p, inertia = space.position, self.model.inertia
        *_, gamma, beta = self.coefficients
        by_a = self.acceleration_ratio / beta / self.h[..., None] ** 2
        E = B = space.strain_operator(end, model.length)
        E = model.law.felt_by(E, self.acceleration_ratio / gamma / self.h[..., None])
        eye = torch.eye(p, dtype=q.dtype, device=q.device)
        R = by_psi = angular = None
        if inertia.inertia is not None or SPINS & self._read:
            R, by_psi = space.spin_matrix(q), space.logarithm_by_turn(x.m)
        if inertia.inertia is not None:
            torque, H = self._torque(v, true)
            gyroscopic = space.spin_skew(v[..., p:]) @ inertia.inertia - space.spin_skew(H)
            by_spin = gamma / beta / self.h[..., None] * gyroscopic + by_a * inertia.inertia
            turned = (R @ torque[..., None])[..., 0]
            angular = R @ by_spin @ by_psi @ R.mT - space.spin_skew(turned)
        diagonal, coupling = inertia.tangent(inertia.blocks(by_a * eye), angular, None, None)
        if model.loads[0]:
            by, nodes = None, self.at_end(x, q, v, true)
            if self._read:
                rate = gamma / beta / self.h[..., None]
                spin = rate * R @ by_psi @ R.mT - space.spin_skew(nodes.spin) if SPINS & self._read else rate * torch.eye(
                    space.spin, dtype=q.dtype, device=q.device)
                by = MotionJacobian(rate * eye, spin, by_a * eye)
                if nodes.angular_acceleration is not None:
                    angular = by_a * R @ by_psi @ R.mT - space.spin_skew(nodes.angular_acceleration)
                    by = by._replace(angular_acceleration=angular)
            diagonal = diagonal - external.tangent(model, nodes, self.t, self.inputs, model.loads[0], by)
        rest = space.geometric_stiffness(end, x.stress, model.length)
        return Linearisation.condense(model, rest, diagonal, h * B, self.C, E, coupling)

    def finish(self, x: EndUnknowns, reaction: Tensor) -> AlphaState:
        """The state at the end of the step; the work by the mean of the loads at its two ends."""
        model, space = self.model, self.model.space
        x = self.apply_supports(x)
        q = self.turned(x)
        v, true, a = self.motion(x)
        p = space.position
        work, turn = self.start.work, space.to_frame(q, space.logarithm(x.m))
        load = self.load(self.at_end(x, q, v, true))
        if not isinstance(load, float):
            before = Nodes(self.start.position, self.start.rotation, self.start.velocity,
                           space.to_frame(self.start.rotation, self.start.spin),
                           **self._accelerations(self.start.rotation, self.start.acceleration[..., :model.space.unknowns]))
            first = external.external(model, before, self.t - self.dt, self.inputs)
            work = work + ((first + load) / 2 * torch.cat((x.u, turn), -1)).sum((-1, -2))
        for k, given in enumerate(self.support_motions):
            at = given.node
            made = torch.cat((x.u[..., at, :], turn[..., at, :]), -1)
            work = work + ((self.start.reaction[..., k, :] + reaction[..., k, :]) / 2 * made).sum(-1)
        straining = self.start.straining
        if model.law.damped:
            straining = torch.cat(self.rates(model.strain(model.kinematics(self.start.position + x.u, q))), -1)
        if not self.support_motions:
            free = torch.cat((model.constraints.slide, model.constraints.turn.expand(-1, space.spin)), -1)
            v, true, a = free * v, free * true, free * a
            v = torch.cat((v[..., :p], self.about_hinges(v[..., p:], q)), -1)
        acceleration = torch.cat((true, a), -1)
        return replace(self.start, position=self.start.position + x.u, rotation=q, velocity=v[..., :p], spin=v[..., p:],
                       stress=x.stress, reaction=reaction, work=work, t=self.start.t + self.dt, acceleration=acceleration,
                       straining=straining)


torch.serialization.add_safe_globals([AlphaState])
