"""One implicit step of the nodal form: mean strain, mid-step forces, Cayley rotations.

Unknown at mid step: u = r_mid - r_n and the rotation from R_n to R_mid (m, so that R_{n+1} = R_n R(m)^2), and the stress,
which is a mean over the step. With dt the step and Theta = 2 tan(angle/2) n of the whole step's rotation (Simo and Wong 1991:
the increment that keeps the energy of a free body), see `inertia` for x, v_c, e-:

    v_{n+1} = 4 u/dt - v_n                          Omega_{n+1} = 2 Theta/dt - Omega_n
    M (v_c,{n+1} - v_c,n)/dt + to_nodes(h B_mid^T [F; M])_force - f = 0
    (R_{n+1} J Omega_{n+1} - R_n J Omega_n)/dt + e- x (the force of inertia) + to_nodes(h B_mid^T [F; M])_moment - m = 0
    S [F; M] = (strain_n + strain_{n+1})/2 + rate (strain_{n+1} - strain_n)/dt

Momentum is exact; the energy is kept to third order in the step, far better than by the strain at mid step (Simo, Tarnow
and Doblare 1995; Romero and Armero 2002). What is left over can be taken out of the velocities: see `conserve`.

In a frame a that moves with v, omega at mid step, velocities are absolute: their mean is 2 u/dt + v + omega x r_mid, d/dt of a
momentum is its difference over dt and omega x its mean, and Theta is that of R_n^T Cay(omega dt) R_{n+1}. A steady motion
with the frame is then steady in the step as well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..effects import Inputs
from ..state import State, put
from . import external
from .balance import Linearisation, Residual, blocked, largest, size_of_strain
from .conserve import conserved
from .external import Chain, Nodes
from .given import Given, given
from .model import Model, times
from .passage import Passage, Way

SPINS = frozenset({"spin"})
MOTIONS = frozenset({"velocity", "acceleration", *SPINS})


class Middle(NamedTuple):
    """The unknowns: u (..., N+1, p) m, m (..., N+1, ...) from R_n to R_mid, stress (..., N, k) N and N m."""

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
        space, length = self.model.space, self.model.length
        k = space.kinematics(self.start.position, self.start.rotation, length)
        return space.strains(k, length, self.model.reference)

    @cached_property
    def own_strain(self) -> Tensor | float:
        """What the beam bends by itself."""
        return self.model.eigenstrain(self.t, self.inputs)

    @cached_property
    def R(self) -> Tensor:
        return self.model.space.spin_matrix(self.start.rotation)

    @cached_property
    def frame(self) -> tuple[Tensor | None, Tensor | None]:
        """v, omega of frame a at mid step."""
        return self.model.frame(self.t)

    @cached_property
    def frame_end(self) -> Tensor | None:
        """The frame's orientation at the end."""
        if self.start.frame is None:
            return None
        space = self.model.space
        return space.multiply(self.start.frame, space.exponential(self.frame[1][..., 0, :] * self.dt[..., None]))

    @cached_property
    def given(self) -> tuple[Given, ...]:
        """The supports that move, in frame a or with it."""
        return given(self.model, self.start, self.t + (1 - self.INSTANT) * self.dt, self.dt, self.PART)

    @cached_property
    def passage(self) -> Passage:
        return Passage(self.model, self.start, self.h, self.frame, self.given)

    def held(self, x: Middle) -> Middle:
        """x with the supports where they have to be."""
        u, m = x.u, x.m
        for one in self.given:
            if one.u is not None:
                u = put(u, one.node, torch.where(one.position, one.u, u[..., one.node, :]))
                m = put(m, one.node, one.m) if one.rotation else m
        return x._replace(u=u, m=m)

    @cached_property
    def _dead(self) -> Tensor | float:
        nodes = Nodes(self.start.position, self.start.rotation, None, None, self._frame_middle, self.start.internal, self.dt)
        return self.model.external(nodes, self.t, self.inputs, self.model.loads[1])

    @cached_property
    def _frame_middle(self) -> Tensor | None:
        if self.start.frame is None:
            return None
        space = self.model.space
        return space.multiply(self.start.frame, space.exponential(self.frame[1][..., 0, :] * self.dt[..., None] / 2))

    @cached_property
    def _Z(self) -> Tensor:
        """Derivative of an inertia force per mass by the centre's move: (2/dt + ~omega)^2."""
        dt, omega = self.h[..., None], self.frame[1]
        eye = torch.eye(self.model.space.position, dtype=dt.dtype, device=dt.device)
        if omega is None:
            return 4 / dt**2 * eye
        rate = 2 / dt * eye + self.model.space.tilde(omega)
        return rate @ rate

    @cached_property
    def _masses(self) -> tuple[Tensor, Tensor | None]:
        return self.model.inertia.blocks(self._Z)

    def guess(self) -> Middle:
        """Constant velocity, and the stress of the step before."""
        space, start = self.model.space, self.start
        v, omega = self.frame
        velocity, spin = start.velocity, start.spin
        if v is not None:
            velocity = velocity - v
        if omega is not None:
            velocity = velocity - (space.tilde(omega) @ start.position[..., None])[..., 0]
            spin = spin - space.to_section(start.rotation, omega)
        if self.given:  # what is held does not move in frame a, whatever the mean of its velocities
            velocity, spin = self.model.held.slide * velocity, self.model.held.turn * spin
        return self.held(Middle(velocity * self.h / 2, space.cayley(spin * self.h / 2), start.stress))

    def still(self) -> Middle:
        """Standing still: what a failed sample is differentiated at."""
        u = torch.zeros_like(self.start.position)
        return Middle(u, self.model.space.none(u), torch.zeros_like(self.start.stress))

    def moved(self, x: Middle, move: Tensor, dstress: Tensor) -> Middle:
        """x after a move of the mid-step configuration; a spin s in frame a turns R_n R(m) from the left."""
        space = self.model.space
        turn = space.to_section(self.start.rotation, move[..., space.position:])
        return Middle(x.u + move[..., :space.position], space.multiply(space.cayley(turn), x.m), x.stress + dstress)

    def nodes(self, x: Middle, way: Way) -> Nodes:
        """What loads see: the middle of the step, velocities its mean."""
        spin = self.model.space.to_frame(way.q, way.theta) / self.h
        return Nodes(self.start.position + x.u, way.q, way.velocity, spin, self._frame_middle, self.start.internal, self.dt,
                     self.acceleration(way) if self.model.adds_mass else None)

    def acceleration(self, way: Way) -> Tensor:
        """Mean over the step, absolute, frame a."""
        after, omega = self.passage.velocity_end(way, self.passage.spin_end(way))[0], self.frame[1]
        mean = (after - self.start.velocity) / self.h
        if omega is None:
            return mean
        return mean + (self.model.space.tilde(omega) @ (after + self.start.velocity)[..., None])[..., 0] / 2

    def external(self, x: Middle, way: Way) -> Tensor | float:
        """Loads at the nodes (..., N+1, w)."""
        moving = self.model.loads[0]
        return self._dead + self.model.external(self.nodes(x, way), self.t, self.inputs, moving) if moving else self._dead

    def residual(self, x: Middle) -> tuple[Residual, Way, Any, Any, Tensor]:
        """The balance at x; with it what follows from x, the elements at mid step and at the end, and R_{n+1} J Omega_{n+1}."""
        model, space, h = self.model, self.model.space, self.model.length
        x = self.held(x)
        way = self.passage.way(x.u, x.m)
        inertia, turning = self.passage.inertia(way)
        middle = space.kinematics(self.start.position + x.u, way.q, h)
        element = space.forces(middle, x.stress, h)
        load = self.external(x, way)
        end = space.kinematics(self.start.position + 2 * x.u, way.q_end, h)
        strain_end = space.strains(end, h, model.reference)
        rise = strain_end - self.strain
        followed = (self.strain + strain_end) / 2 - self.own_strain
        if model.rate is not None:
            followed = followed + times(model.rate, rise[..., None])[..., 0] / self.dt[..., None, None]
        gap = followed - times(model.S, x.stress[..., None])[..., 0]
        nodes = inertia + space.to_nodes(element) - load
        sizes = largest(space.position, h, element, load, inertia, blocked(model, middle, self.own_strain, h))
        return Residual(model.held, nodes, gap, *sizes, size_of_strain(followed, self.own_strain)), way, middle, end, turning

    def linearise(self, x: Middle, way: Way, middle: Any, end: Any, turning: Tensor) -> Linearisation:
        """The tangent by (dr_mid, spin of R_mid): R_{n+1} follows with spin (I + R_mid R_n^T) spin_mid."""
        model, space, h, dt = self.model, self.model.space, self.model.length[..., None], self.h[..., None]
        p, inertia, omega = space.position, self.model.inertia, self.frame[1]
        R = space.spin_matrix(way.q)
        half = space.carried(R, self.R)
        B = space.strain_operator(end, model.length)
        by_r, by_i, by_j = B.split((p, space.spin, space.spin), -1)
        E = torch.cat((by_r, by_i @ half[..., :-1, :, :], by_j @ half[..., 1:, :, :]), -1)
        if model.rate is not None:
            E = E + 2 / dt * times(model.rate, E)
        rest = space.geometric_stiffness(middle, x.stress, model.length)
        if way.arm is None:
            diagonal, coupling = self._masses
        else:
            A = space.arm(inertia.arm(way.q_end)) @ half  # the centre's move by the node's spin
            diagonal, coupling = inertia.blocks(self._Z, way.arm, A)
            if space.turns:
                force = self.passage.inertia(way)[0][..., :p]
                diagonal = diagonal - pad(space.arm(force).mT @ A, (p, 0, p, 0))
        if inertia.inertia is not None or SPINS & self._read:
            R_end = space.spin_matrix(way.q_end)
            by_theta = space.theta_by_turn(way.theta) @ (R_end + R).mT
        if inertia.inertia is not None:
            by_spin = 2 / dt * R_end @ (inertia.inertia @ by_theta) - 2 * space.hat(turning) @ half
            by_spin = by_spin / dt if omega is None else by_spin / dt + space.hat(omega) @ by_spin / 2
            diagonal = diagonal + pad(by_spin, (p, 0, p, 0))
        if model.loads[0]:
            by = None
            if self._read:
                eye = torch.eye(p, dtype=R.dtype, device=R.device)
                velocity = 2 / dt * eye if omega is None else 2 / dt * eye + space.tilde(omega)
                spin = R @ by_theta - space.hat(space.to_frame(way.q, way.theta)) if SPINS & self._read else half
                by = Chain(velocity, spin / dt, self._Z)
            diagonal = diagonal - external.tangent(model, self.nodes(x, way), self.t, self.inputs, model.loads[0], by)
        hB = h * space.strain_operator(middle, model.length)
        return Linearisation.condense(model, rest, diagonal, hB, self.C, E, coupling)

    @cached_property
    def _read(self) -> frozenset[str]:
        """Motions that loads read."""
        return frozenset().union(*(self.model.reads(load) for load in self.model.loads[0])) & MOTIONS

    def finish(self, x: Middle, reaction: Tensor) -> State:
        """The state at the end of the step."""
        model, start, space = self.model, self.start, self.model.space
        x = self.held(x)
        way = self.passage.way(x.u, x.m)
        spin = self.passage.spin_end(way)
        velocity, _ = self.passage.velocity_end(way, spin)
        load = self.external(x, way)
        work, turn = start.work, space.to_frame(way.q, way.theta)
        if not isinstance(load, float):
            work = work + (load * torch.cat((self.h * way.velocity, turn), -1)).sum((-1, -2))
        for k, one in enumerate(self.given):
            made = torch.cat((self.dt[..., None] * way.velocity[..., one.node, :], turn[..., one.node, :]), -1)
            work = work + (reaction[..., k, :] * made).sum(-1)
        if not self.given:  # what stands still has no velocity, whatever rounding has left
            velocity, spin = model.held.slide * velocity, model.held.turn * spin
        after = replace(
            start, position=start.position + 2 * x.u, rotation=way.q_end, velocity=velocity, spin=spin, stress=x.stress,
            reaction=reaction, work=work, t=start.t + self.dt, frame=self.frame_end,
            internal=self._internal(self.nodes(x, way)))
        return conserved(self.model, start, after, self.dt, self.own_strain) if self.conserve else after

    def _internal(self, nodes: Nodes) -> Tensor | None:
        """The user loads' own states at the end."""
        return None if self.start.internal is None else external.advanced(self.model, nodes, self.t, self.inputs)
