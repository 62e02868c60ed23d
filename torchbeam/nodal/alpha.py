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
from functools import cached_property
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..state import State
from . import external
from .balance import Linearisation, Residual, blocked, largest, size_of_strain
from .external import Chain, Nodes
from .model import times
from .step import SPINS, Step


@dataclass(frozen=True)
class AlphaState(State):
    """What the method remembers beside the state; stress and reaction are those at the state's instant.

    acceleration  (..., N+1, 2 w) q" and a: of position m/s^2, frame a, and of spin rad/s^2, section axes, in the coordinates
                  of the scene's space (w = 6; 3 in a plane)
    straining     (..., N, 2 k) strain rate 1/s and 1/(m s), and its algorithmic counterpart, likewise (k = 6; 3 in a plane)
    """

    acceleration: Tensor
    straining: Tensor

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


class End(NamedTuple):
    """The unknowns: u (..., N+1, p) m and m (..., N+1, ...) from the start to the end, stress (..., N, k) N and N m."""

    u: Tensor
    m: Tensor
    stress: Tensor


@dataclass(frozen=True)
class Alpha(Step):
    """A step of length dt (0-dim or (...)) from `start`, with loads as at time t, its end (0-dim), and inputs held over it."""

    start: AlphaState
    rho_inf: float = 0.8

    INSTANT = 1.0
    PART = 1.0

    @cached_property
    def coefficients(self) -> tuple[float, float, float, float]:
        """alpha_m, alpha_f, gamma, beta."""
        m, f = (2 * self.rho_inf - 1) / (self.rho_inf + 1), self.rho_inf / (self.rho_inf + 1)
        return m, f, 0.5 - m + f, (1 - m + f) ** 2 / 4

    @cached_property
    def share(self) -> float:
        """d q"/d a."""
        m, f, *_ = self.coefficients
        return (1 - m) / (1 - f)

    def guess(self) -> End:
        """Constant velocity, and the stress of the step before."""
        turn = self.model.space.exponential(self.start.spin * self.h)
        return self.held(End(self.start.velocity * self.h, turn, self.start.stress))

    def still(self) -> End:
        return End(*super().still())

    def moved(self, x: End, move: Tensor, dstress: Tensor) -> End:
        """x after a move of the end."""
        return End(*super().moved(x, move, dstress))

    def true(self, algorithmic: Tensor, before: Tensor) -> Tensor:
        """q" of a at the end and (q", a) at the start."""
        m, f, *_ = self.coefficients
        q, a = before.chunk(2, -1)
        return ((1 - m) * algorithmic + m * a - f * q) / (1 - f)

    def motion(self, x: End) -> tuple[Tensor, Tensor, Tensor]:
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

    def turned(self, x: End) -> Tensor:
        space = self.model.space
        return space.normalize(space.multiply(self.start.rotation, x.m))

    def at_end(self, x: End, q: Tensor, motion: Tensor, true: Tensor) -> Nodes:
        """What loads see."""
        p, space = self.model.space.position, self.model.space
        return Nodes(self.start.position + x.u, q, motion[..., :p], space.to_frame(q, motion[..., p:]),
                     acceleration=true[..., :p])

    def load(self, nodes: Nodes) -> Tensor | float:
        moving = self.model.loads[0]
        return self._dead + self.model.external(nodes, self.t, self.inputs, moving) if moving else self._dead

    def residual(self, x: End) -> tuple[Residual, Any, Tensor, Tensor, Tensor]:
        """The balance at x; with it the elements, the nodes' rotation and their motion."""
        model, space, h = self.model, self.model.space, self.model.length
        x = self.held(x)
        q = self.turned(x)
        end = space.kinematics(self.start.position + x.u, q, h)
        v, true, _ = self.motion(x)
        p = space.position
        change = model.inertia.momentum(true[..., :p])
        torque = torch.zeros_like(true[..., p:])
        if model.inertia.inertia is not None:
            torque = space.to_frame(q, self._torque(v, true)[0])
        inertia = torch.cat((change, torque), -1)
        element = space.forces(end, x.stress, h)
        load = self.load(self.at_end(x, q, v, true))
        strain_end = space.strains(end, h, model.reference)
        followed = strain_end - self.own_strain
        if model.rate is not None:
            followed = followed + times(model.rate, self.rates(strain_end)[0][..., None])[..., 0]
        gap = followed - times(model.S, x.stress[..., None])[..., 0]
        nodes = inertia + space.to_nodes(element) - load
        sizes = largest(p, h, element, load, inertia, blocked(model, end, self.own_strain, h))
        return Residual(model.held, nodes, gap, *sizes, size_of_strain(followed, self.own_strain)), end, q, v, true

    def _torque(self, v: Tensor, true: Tensor) -> tuple[Tensor, Tensor]:
        """J q" + Omega x J Omega and J Omega, section axes."""
        p, space, inertia = self.model.space.position, self.model.space, self.model.inertia
        H = inertia.angular_momentum(v[..., p:])
        return inertia.angular_momentum(true[..., p:]) + (space.hat(v[..., p:]) @ H[..., None])[..., 0], H

    def linearise(self, x: End, end: Any, q: Tensor, v: Tensor, true: Tensor) -> Linearisation:
        """The tangent by (dr, spin of R) at the end: d(psi) = (I + ~psi/2 + k ~psi ~psi) R^T spin."""
        model, space, h = self.model, self.model.space, self.model.length[..., None]
        p, inertia = space.position, self.model.inertia
        *_, gamma, beta = self.coefficients
        by_a = self.share / beta / self.h[..., None] ** 2
        E = B = space.strain_operator(end, model.length)
        if model.rate is not None:
            E = E + self.share / gamma / self.h[..., None] * times(model.rate, E)
        eye = torch.eye(p, dtype=q.dtype, device=q.device)
        diagonal, coupling = inertia.blocks(by_a * eye)
        R = by_psi = None
        if inertia.inertia is not None or SPINS & self._read:
            R, by_psi = space.spin_matrix(q), space.logarithm_by_turn(x.m)
        if inertia.inertia is not None:
            torque, H = self._torque(v, true)
            by_spin = gamma / beta / self.h[..., None] * (space.hat(v[..., p:]) @ inertia.inertia - space.hat(H)) + (
                by_a * inertia.inertia)
            turned = (R @ torque[..., None])[..., 0]
            diagonal = diagonal + pad(R @ by_spin @ by_psi @ R.mT - space.hat(turned), (p, 0, p, 0))
        if model.loads[0]:
            by, nodes = None, self.at_end(x, q, v, true)
            if self._read:
                rate = gamma / beta / self.h[..., None]
                spin = rate * R @ by_psi @ R.mT - space.hat(nodes.spin) if SPINS & self._read else rate * torch.eye(
                    space.spin, dtype=q.dtype, device=q.device)
                by = Chain(rate * eye, spin, by_a * eye)
            diagonal = diagonal - external.tangent(model, nodes, self.t, self.inputs, model.loads[0], by)
        rest = space.geometric_stiffness(end, x.stress, model.length)
        return Linearisation.condense(model, rest, diagonal, h * B, self.C, E, coupling)

    def finish(self, x: End, reaction: Tensor) -> AlphaState:
        """The state at the end of the step; the work by the mean of the loads at its two ends."""
        model, space = self.model, self.model.space
        x = self.held(x)
        q = self.turned(x)
        v, true, a = self.motion(x)
        p = space.position
        work, turn = self.start.work, space.to_frame(q, space.logarithm(x.m))
        load = self.load(self.at_end(x, q, v, true))
        if not isinstance(load, float):
            before = Nodes(self.start.position, self.start.rotation, self.start.velocity,
                           space.to_frame(self.start.rotation, self.start.spin), acceleration=self.start.acceleration[..., :p])
            first = model.external(before, self.t - self.dt, self.inputs)
            work = work + ((first + load) / 2 * torch.cat((x.u, turn), -1)).sum((-1, -2))
        for k, given in enumerate(self.given):
            at = given.node
            made = torch.cat((x.u[..., at, :], turn[..., at, :]), -1)
            work = work + ((self.start.reaction[..., k, :] + reaction[..., k, :]) / 2 * made).sum(-1)
        straining = self.start.straining
        if model.rate is not None:
            end = space.kinematics(self.start.position + x.u, q, model.length)
            straining = torch.cat(self.rates(space.strains(end, model.length, model.reference)), -1)
        free = 1.0 if self.given else torch.cat((model.held.slide, model.held.turn.expand(-1, space.spin)), -1)
        v, acceleration = free * v, torch.cat((free * true, free * a), -1)
        return replace(self.start, position=self.start.position + x.u, rotation=q, velocity=v[..., :p], spin=v[..., p:],
                       stress=x.stress, reaction=reaction, work=work, t=self.start.t + self.dt, acceleration=acceleration,
                       straining=straining)


torch.serialization.add_safe_globals([AlphaState])
