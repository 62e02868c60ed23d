"""One implicit step of the nodal form: mean strain, mid-step forces, Cayley rotations.

Unknown at mid step: u = r_mid - r_n and the rotation from R_n to R_mid (quaternion m, so that R_{n+1} = R_n R(m)^2), and
the stress, which is a mean over the step. With dt the step, tau = m_v/m_0 = tan(angle/4) n of the whole step's angle and
Theta = 4 tau/(1 - |tau|^2) = 2 tan(angle/2) n (Simo and Wong 1991: the increment that keeps the energy of a free body):

    v_{n+1} = 4 u/dt - v_n                          Omega_{n+1} = 2 Theta/dt - Omega_n
    (p_{n+1} - p_n)/dt + to_nodes(h B_mid^T [F; M])_force - f = 0
    (R_{n+1} J Omega_{n+1} - R_n J Omega_n)/dt + to_nodes(h B_mid^T [F; M])_moment - m = 0
    S [F; M] = (strain_n + strain_{n+1})/2 + rate (strain_{n+1} - strain_n)/dt

Momentum is exact; the energy is kept to third order in the step, far better than by the strain at mid step (Simo, Tarnow
and Doblare 1995; Romero and Armero 2002). What is left over can be taken out of the velocities: see `conserve`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from .. import quaternions as quat
from ..effects import Inputs
from ..quaternions import hat
from ..state import State
from .balance import Linearisation, Residual, largest
from .element import Kinematics, forces, geometric_stiffness, kinematics, strain, strain_operator, to_nodes
from .model import Model, times

MOST = 0.01  # of the kinetic energy, that `conserve` may take or give in one step


class Middle(NamedTuple):
    """The unknowns: u (..., N+1, 3) m, m (..., N+1, 4) from R_n to R_mid, stress (..., N, 6) N and N m."""

    u: Tensor
    m: Tensor
    stress: Tensor


@dataclass(frozen=True)
class Step:
    """A step of length dt (0-dim or (...)) from `start`, with loads as at time t (0-dim) and inputs held over it.

    conserve  scale the velocities at the end so that kinetic + strain energy changes by the work of the loads less what
              damping takes, exactly; by at most 1/2 %, the rest waits for a step with more kinetic energy
    """

    model: Model
    start: State
    dt: Tensor
    t: Tensor
    inputs: Inputs
    conserve: bool = False

    INSTANT = 0.5  # of the step: when loads are taken
    PART = 0.5  # of the step's rotation: what the unknown m holds

    @cached_property
    def h(self) -> Tensor:
        """dt as (..., 1, 1)."""
        return self.dt[..., None, None]

    @cached_property
    def C(self) -> Tensor:
        """S^-1 of the tangent."""
        return self.model.stiffness(self.dt.detach())

    @cached_property
    def strain(self) -> Tensor:
        k = kinematics(self.start.position, self.start.rotation, self.model.length)
        return strain(k, self.model.length, self.model.reference)

    @cached_property
    def R(self) -> Tensor:
        return quat.matrix(self.start.rotation)

    @cached_property
    def angular_momentum(self) -> Tensor:
        """J Omega_n, section axes."""
        return (self.model.inertia @ self.start.spin[..., None])[..., 0]

    @cached_property
    def _loads(self):
        beam = self.model.scene.beam
        moving = tuple(x for x in self.model.scene.loads if x.moves(beam))
        dead = tuple(x for x in self.model.scene.loads if not x.moves(beam))
        return moving, self.model.external(self.start.rotation, self.t, self.inputs, dead)

    @cached_property
    def _masses(self) -> tuple[Tensor, Tensor | None]:
        """Derivative of the inertia force by u: (at a node (..., N+1, 6, 6), between neighbours (..., N, 6, 6))."""
        model, dt = self.model, self.h[..., None]
        eye = torch.eye(3, dtype=dt.dtype, device=dt.device)
        by_r = 4 / dt**2 * model.mass[..., None] * eye
        if model.coupling is None:
            return pad(by_r, (0, 3, 0, 3)), None
        k = 4 / dt**2 * model.coupling[..., None] * eye
        by_r = by_r - pad(k, (0, 0, 0, 0, 0, 1)) - pad(k, (0, 0, 0, 0, 1, 0))
        return pad(by_r, (0, 3, 0, 3)), pad(k, (0, 3, 0, 3))

    def guess(self) -> Middle:
        """Constant velocity, and the stress of the step before."""
        m = quat.normalize(pad(self.start.spin * self.h / 4, (1, 0), value=1.0))
        return Middle(self.start.velocity * self.h / 2, m, self.start.stress)

    def still(self) -> Middle:
        """Standing still: what a failed sample is differentiated at."""
        u = torch.zeros_like(self.start.position)
        return Middle(u, pad(u, (1, 0), value=1.0), torch.zeros_like(self.start.stress))

    def moved(self, x: Middle, move: Tensor, dstress: Tensor) -> Middle:
        """x after a move of the mid-step configuration; a spin s in frame a turns R_n R(m) from the left."""
        turn = quat.rotate(quat.conjugate(self.start.rotation), move[..., 3:]) / 2
        m = quat.normalize(quat.multiply(pad(turn, (1, 0), value=1.0), x.m))
        return Middle(x.u + move[..., :3], m, x.stress + dstress)

    def theta(self, x: Middle) -> Tensor:
        """Theta = 2 tan(angle/2) n of the whole step, section axes."""
        tau = x.m[..., 1:] / x.m[..., :1]
        return 4 * tau / (1 - tau.square().sum(-1, keepdim=True))

    def at_middle(self, x: Middle) -> tuple[Kinematics, Tensor]:
        q = quat.multiply(self.start.rotation, x.m)
        return kinematics(self.start.position + x.u, q, self.model.length), q

    def at_end(self, x: Middle, q: Tensor) -> tuple[Kinematics, Tensor, Tensor]:
        q = quat.normalize(quat.multiply(q, x.m))
        position = self.start.position + 2 * x.u
        return kinematics(position, q, self.model.length), position, q

    def external(self, q: Tensor) -> Tensor | float:
        """Loads at the nodes (..., N+1, 6), with the sections turned as at mid step."""
        moving, dead = self._loads
        return dead + self.model.external(q, self.t, self.inputs, moving)

    def residual(self, x: Middle) -> tuple[Residual, Kinematics, Kinematics, Tensor]:
        """The balance at x; with it the elements at mid step and at the end, and the nodes' rotation at mid step."""
        model, h, dt = self.model, self.model.length, self.h
        middle, q = self.at_middle(x)
        end, _, q_end = self.at_end(x, q)
        change = model.momentum(4 / dt**2 * (x.u - dt / 2 * self.start.velocity))
        if model.inertia is None:
            torque = torch.zeros_like(change)
        else:
            spin = 2 / dt * self.theta(x) - self.start.spin
            H = (model.inertia @ spin[..., None])[..., 0]
            torque = (quat.rotate(q_end, H) - quat.rotate(self.start.rotation, self.angular_momentum)) / dt
        inertia = torch.cat((change, torque), -1)
        element = forces(middle, x.stress, h)
        external = self.external(q)
        strain_end = strain(end, h, model.reference)
        rise = strain_end - self.strain
        followed = (self.strain + strain_end) / 2
        if model.rate is not None:
            followed = followed + times(model.rate, rise[..., None])[..., 0] / dt
        gap = followed - times(model.S, x.stress[..., None])[..., 0]
        nodes = inertia + to_nodes(element) - external
        sizes = largest(h, element, external, inertia)
        return Residual(nodes, gap, *sizes, followed.detach().abs().amax((-1, -2))), middle, end, q

    def linearise(self, x: Middle, middle: Kinematics, end: Kinematics, q: Tensor) -> Linearisation:
        """The tangent by (dr_mid, spin of R_mid): R_{n+1} follows with spin (I + R_mid R_n^T) spin_mid."""
        model, h, dt = self.model, self.model.length[..., None], self.h[..., None]
        R = quat.matrix(q)
        eye = torch.eye(3, dtype=R.dtype, device=R.device)
        D = R @ self.R.mT
        half = (eye + D) / 2
        B_end = strain_operator(end, model.length)
        E = torch.cat((B_end[..., :3], B_end[..., 3:6] @ half[..., :-1, :, :], B_end[..., 6:] @ half[..., 1:, :, :]), -1)
        if model.rate is not None:
            E = E + 2 / dt * times(model.rate, E)
        rest = geometric_stiffness(middle, x.stress, model.length)
        diagonal, coupling = self._masses
        if model.inertia is not None:
            tau = x.m[..., 1:] / x.m[..., :1]
            t2 = tau.square().sum(-1)[..., None, None]
            H = (model.inertia @ (2 / self.h * self.theta(x) - self.start.spin)[..., None])[..., 0]
            R_end = D @ R
            turned = (R_end @ H[..., None])[..., 0]
            by_chi = eye + hat(tau) + (3 + t2) / (1 - t2) * tau[..., :, None] * tau[..., None, :]  # dTheta (1 - t2)/2
            by_spin = (4 / dt / (1 - t2) * R_end @ model.inertia @ by_chi @ R.mT - 2 * hat(turned) @ half) / dt
            diagonal = diagonal + pad(by_spin, (3, 0, 3, 0))
        load = model.external_tangent(q, self.t, self.inputs, self._loads[0])
        if not isinstance(load, float):
            diagonal = diagonal - pad(load, (3, 0))
        hB = h * strain_operator(middle, model.length)
        return Linearisation.condense(rest, diagonal, hB, self.C, E, coupling)

    def finish(self, x: Middle, reaction: Tensor) -> State:
        """The state at the end of the step."""
        q = quat.multiply(self.start.rotation, x.m)
        end = quat.normalize(quat.multiply(q, x.m))
        theta = self.theta(x)
        free = torch.ones_like(x.u[..., :1])
        free = torch.cat((torch.zeros_like(free[..., :1, :]), free[..., 1:, :]), -2)
        external = self.external(q)
        work = self.start.work
        if not isinstance(external, float):
            spin = quat.rotate(q, theta)
            work = work + (external[..., :3] * 2 * x.u + external[..., 3:] * spin).sum((-1, -2))
        after = State(
            position=self.start.position + 2 * x.u,
            rotation=end,
            velocity=free * (4 * x.u / self.h - self.start.velocity),
            spin=free * (2 * theta / self.h - self.start.spin),
            stress=x.stress,
            reaction=reaction,
            work=work,
            defect=self.start.defect,
            t=self.start.t + self.dt,
            status=self.start.status,
        )
        return self._conserved(after) if self.conserve else after

    def _conserved(self, after: State) -> State:
        """`after` with its velocities scaled by s, s^2 = 1 - defect/kinetic."""
        model, start = self.model, self.start
        kinetic = model.kinetic_energy(after.velocity, after.spin)
        gain = (kinetic + model.strain_energy(after.position, after.rotation)
                - model.kinetic_energy(start.velocity, start.spin) - model.strain_energy(start.position, start.rotation))
        defect = start.defect + gain - (after.work - start.work)
        if model.rate is not None:
            end = kinematics(after.position, after.rotation, model.length)
            rise = (strain(end, model.length, model.reference) - self.strain)[..., None]
            lost = (rise * times(model.C, times(model.rate, rise)))[..., 0]
            defect = defect + (model.length * lost).sum((-1, -2)) / self.dt
        change = (-defect / kinetic.clamp(min=torch.finfo(kinetic.dtype).tiny)).clamp(-MOST, MOST)
        scale = (1 + change).sqrt()[..., None, None]
        return replace(after, velocity=scale * after.velocity, spin=scale * after.spin, defect=defect + change * kinetic)
