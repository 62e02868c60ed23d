"""One step of the generalized-alpha method: force balance at the end of the step, high frequencies damped at will.

Chung and Hulbert 1993, on the nodes' rotations as Arnold and Bruels 2007. With a the algorithmic acceleration, q" the true one,
psi = log(R_n^T R_{n+1}) the rotation vector of the step and rho the spectral radius at infinite frequency,

    alpha_m = (2 rho - 1)/(rho + 1)    alpha_f = rho/(rho + 1)    gamma = 1/2 - alpha_m + alpha_f    beta = (gamma + 1/2)^2/4
    r_{n+1} - r_n, psi  = dt v_n + dt^2 ((1/2 - beta) a_n + beta a_{n+1})
    v_{n+1}             = v_n + dt ((1 - gamma) a_n + gamma a_{n+1})
    (1 - alpha_f) q"_{n+1} + alpha_f q"_n = (1 - alpha_m) a_{n+1} + alpha_m a_n

where v holds velocity (frame a) and spin (section axes), and at the end of the step

    momentum(q")                + to_nodes(h B^T [F; M])_force  - f = 0
    R (J q" + Omega x J Omega)  + to_nodes(h B^T [F; M])_moment - m = 0          S [F; M] = strain + rate (strain rate)

The strain rate follows from the strains as q" does from v (Jansen, Whiting and Hulbert 2000): damping is second order too.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from .. import quaternions as quat
from ..quaternions import hat
from ..state import State
from .balance import Linearisation, Residual, largest
from .element import Kinematics, forces, geometric_stiffness, kinematics, strain, strain_operator, to_nodes
from .model import times
from .step import Step


@dataclass(frozen=True)
class AlphaState(State):
    """What the method remembers beside the state; stress and reaction are those at the state's instant.

    acceleration  (..., N+1, 12) q" and a: of position m/s^2, frame a, and of spin rad/s^2, section axes
    straining     (..., N, 12) strain rate 1/s and 1/(m s), and its algorithmic counterpart
    """

    acceleration: Tensor
    straining: Tensor

    @classmethod
    def between(cls, state: State, after: State, rise: Tensor, dt: Tensor) -> AlphaState:
        """`state` with the mean rates up to a state a step later, in which the strains rose by `rise` (..., N, 6)."""
        h = dt[..., None, None]
        mean = torch.cat((after.velocity - state.velocity, after.spin - state.spin), -1) / h
        return cls(**vars(state), acceleration=torch.cat((mean, mean), -1), straining=torch.cat((rise, rise), -1) / h)

    def plain(self) -> State:
        """What every method knows of the state."""
        return State(*(getattr(self, f.name) for f in fields(State)))


class End(NamedTuple):
    """The unknowns: u (..., N+1, 3) m and m (..., N+1, 4) from the start to the end, stress (..., N, 6) N and N m."""

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
        return End(self.start.velocity * self.h, quat.exponential(self.start.spin * self.h), self.start.stress)

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
        """(..., N+1, 6) at the end: velocity and spin, q", a."""
        *_, gamma, beta = self.coefficients
        a_n = self.start.acceleration[..., 6:]
        v_n = torch.cat((self.start.velocity, self.start.spin), -1)
        way = torch.cat((x.u, quat.logarithm(x.m)), -1)
        a = ((way / self.h - v_n) / self.h - (0.5 - beta) * a_n) / beta
        return v_n + self.h * ((1 - gamma) * a_n + gamma * a), self.true(a, self.start.acceleration), a

    def rates(self, strain_end: Tensor) -> tuple[Tensor, Tensor]:
        """(..., N, 6) at the end: strain rate, and its algorithmic counterpart."""
        gamma = self.coefficients[2]
        d = ((strain_end - self.strain) / self.h - (1 - gamma) * self.start.straining[..., 6:]) / gamma
        return self.true(d, self.start.straining), d

    def at_end(self, x: End) -> tuple[Kinematics, Tensor, Tensor]:
        q = quat.normalize(quat.multiply(self.start.rotation, x.m))
        position = self.start.position + x.u
        return kinematics(position, q, self.model.length), position, q

    def residual(self, x: End) -> tuple[Residual, Kinematics, Tensor]:
        """The balance at x; with it the elements and the nodes' rotation."""
        model, h = self.model, self.model.length
        end, _, q = self.at_end(x)
        v, true, _ = self.motion(x)
        change = model.momentum(true[..., :3])
        torque = torch.zeros_like(change) if model.inertia is None else quat.rotate(q, self._torque(v, true)[0])
        inertia = torch.cat((change, torque), -1)
        element = forces(end, x.stress, h)
        external = self.external(q)
        strain_end = strain(end, h, model.reference)
        followed = strain_end
        if model.rate is not None:
            followed = followed + times(model.rate, self.rates(strain_end)[0][..., None])[..., 0]
        gap = followed - times(model.S, x.stress[..., None])[..., 0]
        nodes = inertia + to_nodes(element) - external
        sizes = largest(h, element, external, inertia)
        return Residual(nodes, gap, *sizes, followed.detach().abs().amax((-1, -2))), end, q

    def _torque(self, v: Tensor, true: Tensor) -> tuple[Tensor, Tensor]:
        """J q" + Omega x J Omega and J Omega, section axes."""
        H = (self.model.inertia @ v[..., 3:, None])[..., 0]
        return (self.model.inertia @ true[..., 3:, None])[..., 0] + torch.linalg.cross(v[..., 3:], H), H

    def linearise(self, x: End, end: Kinematics, q: Tensor) -> Linearisation:
        """The tangent by (dr, spin of R) at the end: d(psi) = (I + ~psi/2 + k ~psi ~psi) R^T spin."""
        model, h = self.model, self.model.length[..., None]
        *_, gamma, beta = self.coefficients
        by_a = self.share / beta / self.h[..., None] ** 2
        E = B = strain_operator(end, model.length)
        if model.rate is not None:
            E = E + self.share / gamma / self.h[..., None] * times(model.rate, E)
        eye = torch.eye(3, dtype=q.dtype, device=q.device)
        coupling = None
        by_r = by_a * model.mass[..., None] * eye
        if model.coupling is not None:
            k = by_a * model.coupling[..., None] * eye
            by_r = by_r - pad(k, (0, 0, 0, 0, 0, 1)) - pad(k, (0, 0, 0, 0, 1, 0))
            coupling = pad(k, (0, 3, 0, 3))
        diagonal = pad(by_r, (0, 3, 0, 3))
        if model.inertia is not None:
            v, true, _ = self.motion(x)
            torque, H = self._torque(v, true)
            R, psi = quat.matrix(q), hat(quat.logarithm(x.m))
            s2 = x.m[..., 1:].square().sum(-1, keepdim=True)
            g = quat.arc_ratio(x.m[..., :1], s2)
            small = s2 < 1e-6
            k = torch.where(small, 1 / 12 + s2 / 180, (1 - g * x.m[..., :1]) / torch.where(small, 1.0, 4 * g**2 * s2))
            by_psi = eye + psi / 2 + k[..., None] * psi @ psi
            by_spin = gamma / beta / self.h[..., None] * (hat(v[..., 3:]) @ model.inertia - hat(H)) + by_a * model.inertia
            turned = (R @ torque[..., None])[..., 0]
            diagonal = diagonal + pad(R @ by_spin @ by_psi @ R.mT - hat(turned), (3, 0, 3, 0))
        load = self.model.external_tangent(q, self.t, self.inputs, self._loads[0])
        if not isinstance(load, float):
            diagonal = diagonal - pad(load, (3, 0))
        rest = geometric_stiffness(end, x.stress, model.length)
        return Linearisation.condense(rest, diagonal, h * B, self.C, E, coupling)

    def finish(self, x: End, reaction: Tensor) -> AlphaState:
        """The state at the end of the step; the work by the mean of the loads at its two ends."""
        end, position, q = self.at_end(x)
        v, true, a = self.motion(x)
        free = pad(torch.ones_like(x.u[..., 1:, :1]), (0, 0, 1, 0))
        work = self.start.work
        external = self.external(q)
        if not isinstance(external, float):
            before = self.model.external(self.start.rotation, self.t - self.dt, self.inputs, self.model.scene.loads)
            way = torch.cat((x.u, quat.rotate(q, quat.logarithm(x.m))), -1)
            work = work + ((before + external) / 2 * way).sum((-1, -2))
        straining = self.start.straining
        if self.model.rate is not None:
            straining = torch.cat(self.rates(strain(end, self.model.length, self.model.reference)), -1)
        return replace(self.start, position=position, rotation=q, velocity=free * v[..., :3], spin=free * v[..., 3:],
                       stress=x.stress, reaction=reaction, work=work, t=self.start.t + self.dt,
                       acceleration=free * torch.cat((true, a), -1), straining=straining)


torch.serialization.add_safe_globals([AlphaState])
