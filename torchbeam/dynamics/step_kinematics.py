"""Nodal kinematics and inertia forces of one midpoint step, and their tangent; the equations are those of `midpoint` and
`inertia`.

Local: a node needs no other, but for the half-consistent mass (`inertia.exchange`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import cached
from ..nodal.inertia import Inertia, Momenta
from ..state.state import State
from ..state.supported_nodes import set_node
from .support_motion import SupportMotion


class StepKinematics(NamedTuple):
    """Motion of the nodes over a step, from its unknowns: rotations at mid step and at the end; theta (absolute) and theta
    relative to frame a, section axes; mean velocities of node and centre of mass, absolute, frame a; lever e- (None without
    offset).
    """

    q: Tensor
    q_end: Tensor
    theta: Tensor
    relative: Tensor
    velocity: Tensor
    centre: Tensor
    lever: Tensor | None


@dataclass(frozen=True)
class MidpointMotion:
    """Nodes from `start` over h (..., 1, 1) s, any number of them; frame: v and omega of frame a at mid step, None = at rest;
    support_motions: of the supports that move.
    """

    inertia: Inertia
    start: State
    h: Tensor
    frame: tuple[Tensor | None, Tensor | None]
    support_motions: tuple[SupportMotion, ...]

    @cached
    def momenta(self) -> Momenta:
        """At the start."""
        return self.inertia.momenta(self.start.rotation, self.centre_velocity, self.start.spin)

    @cached
    def lever(self) -> Tensor:
        """R_n e."""
        return self.inertia.lever(self.start.rotation)

    @cached
    def centre_velocity(self) -> Tensor:
        return self.inertia.centre_velocity(self.start.rotation, self.start.velocity, self.start.spin)

    def kinematics(self, u: Tensor, m: Tensor) -> StepKinematics:
        """Over u (..., N+1, p) m and the rotation m, both to mid step."""
        space, start, (v, omega) = self.inertia.space, self.start, self.frame
        q = space.multiply(start.rotation, m)
        q_end = space.normalize(space.multiply(q, m))
        turn = space.multiply(m, m)
        relative = theta = space.theta(turn)
        if omega is not None:
            carried = space.multiply(space.cayley(omega * self.h), space.multiply(start.rotation, turn))
            theta = space.theta(space.multiply(space.inverse(start.rotation), carried))
        velocity, middle, arm = 2 / self.h * u, start.position + u, None
        centre = velocity
        if self.inertia.offset is not None:
            arm = (self.lever + self.inertia.lever(q_end)) / 2
            centre = velocity + (space.lever_matrix(arm) @ space.to_frame(q, relative)[..., None])[..., 0] / self.h
        if v is not None:
            velocity, centre = velocity + v, centre + v
        if omega is not None:
            turning = space.skew(omega)
            velocity = velocity + (turning @ middle[..., None])[..., 0]
            centre = centre + (turning @ (middle if arm is None else middle + arm)[..., None])[..., 0]
        return StepKinematics(q, q_end, theta, relative, velocity, centre, arm)

    def spin_end(self, way: StepKinematics) -> Tensor:
        """Omega_{n+1}, section axes."""
        spin = 2 / self.h * way.theta - self.start.spin
        for one in self.support_motions:
            spin = spin if one.spin is None else set_node(spin, one.node, one.spin)
        return spin

    def velocity_end(self, way: StepKinematics, spin: Tensor) -> tuple[Tensor, Tensor]:
        """v_{n+1} and v_c,{n+1}, frame a."""
        inertia = self.inertia
        centre = 2 * way.centre - self.centre_velocity
        velocity = centre
        if inertia.offset is not None:
            velocity = centre - inertia.centre_velocity(way.q_end, torch.zeros_like(centre), spin)
        for one in self.support_motions:
            if one.velocity is not None:
                velocity = set_node(velocity, one.node, one.velocity)
                centre = inertia.centre_velocity(way.q_end, velocity, spin)
        return velocity, centre

    def accelerations(self, way: StepKinematics, angular: bool) -> tuple[Tensor, Tensor | None]:
        """Acceleration and, where it is asked for, angular acceleration, means over the step, absolute, frame a."""
        space, omega, start, end = self.inertia.space, self.frame[1], self.start, self.spin_end(way)

        def mean(before: Tensor, after: Tensor, skew: Callable[[Tensor], Tensor]) -> Tensor:
            rate = (after - before) / self.h
            return rate if omega is None else rate + (skew(omega) @ (after + before)[..., None])[..., 0] / 2

        turn = None
        if angular:
            turn = mean(space.to_frame(start.rotation, start.spin), space.to_frame(way.q_end, end), space.spin_skew)
        return mean(start.velocity, self.velocity_end(way, end)[0], space.skew), turn

    def accelerations_by(self, way: StepKinematics, angular: bool, R_end: Tensor | None, half: Tensor,
                         by_theta: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """Derivatives of `accelerations` by the move, see `MotionJacobian`; the other arguments as in `tangent`."""
        space, inertia, omega, rate = self.inertia.space, self.inertia, self.frame[1], 1 / self.dt
        if not angular and inertia.offset is None:
            return self.Z, None
        spin = space.to_frame(way.q_end, self.spin_end(way))
        by_spin = R_end @ (2 * rate * by_theta) - space.spin_skew(spin) @ (2 * half)  # of R_{n+1} Omega_{n+1}
        turn = rate * by_spin if omega is None else rate * by_spin + space.spin_skew(omega) @ by_spin / 2
        if inertia.offset is None:
            return self.Z, turn
        moved = space.lever_matrix(inertia.lever(way.q_end)) @ half  # half of what the spin moves R_{n+1} e by
        turned = space.lever_matrix(inertia.lever(way.q_end)) @ by_spin
        if space.turns:
            turned = turned + 2 * space.skew(spin) @ moved
        by = rate * turned if omega is None else rate * turned + space.skew(omega) @ turned / 2
        by = self.Z @ moved - by
        return torch.cat((self.Z.expand(*by.shape[:-1], space.position), by), -1), turn

    def balance(self, way: StepKinematics) -> tuple[Tensor, Tensor]:
        """Force and moment of inertia at the nodes (..., N+1, w), by differences and means over the step, and R_{n+1} J
        Omega_{n+1}.
        """
        spin = self.spin_end(way)
        _, centre = self.velocity_end(way, spin)
        before, after = self.momenta, self.inertia.momenta(way.q_end, centre, spin)
        rates = Momenta(*((b - a) / self.h for a, b in zip(before, after, strict=True)))
        forces = self.inertia.balance(
            rates, lambda: Momenta(*((a + b) / 2 for a, b in zip(before, after, strict=True))), way.lever, self.frame[1])
        return forces, after.angular

    @cached
    def R(self) -> Tensor:
        """R_n of spins."""
        return self.inertia.space.spin_matrix(self.start.rotation)

    @cached
    def dt(self) -> Tensor:
        """h as (..., 1, 1, 1)."""
        return self.h[..., None]

    @cached
    def Z(self) -> Tensor:
        """Derivative of an inertia force per mass by the centre's move: (2/dt + ~omega)^2."""
        dt, omega, space = self.dt, self.frame[1], self.inertia.space
        eye = torch.eye(space.position, dtype=dt.dtype, device=dt.device)
        if omega is None:
            return 4 / dt**2 * eye
        rate = 2 / dt * eye + space.skew(omega)
        return rate @ rate

    @cached
    def _masses(self) -> tuple[Tensor, Tensor | None]:
        return self.inertia.blocks(self.Z)

    def theta_by_spin(self, way: StepKinematics, R: Tensor) -> tuple[Tensor, Tensor]:
        """R_{n+1} of spins, and d(Theta) by the spin of R_mid, R there, (..., N+1, s, s)."""
        R_end = self.inertia.space.spin_matrix(way.q_end)
        return R_end, self.inertia.space.theta_by_turn(way.theta) @ (R_end + R).mT

    def tangent(self, way: StepKinematics, turning: Tensor, half: Tensor, R_end: Tensor | None, by_theta: Tensor | None
                ) -> tuple[Tensor, Tensor | None]:
        """Derivative of `balance`, see `Inertia.tangent`, by (dr_mid, spin of R_mid); turning is R_{n+1} J Omega_{n+1}, half
        (I + R_mid R_n^T)/2, and what `theta_by_spin` gives is read where there is rotary inertia.
        """
        inertia, space, dt, omega = self.inertia, self.inertia.space, self.dt, self.frame[1]
        angular = force = moved = None
        if inertia.inertia is not None:
            by_spin = inertia.angular_tangent(R_end, 2 / dt * by_theta, turning, 2 * half)
            angular = by_spin / dt if omega is None else by_spin / dt + space.spin_skew(omega) @ by_spin / 2
        if way.lever is None:
            return inertia.tangent(self._masses, angular, force, moved)
        moved = space.lever_matrix(inertia.lever(way.q_end)) @ half
        force = self.balance(way)[0][..., :space.position]
        return inertia.tangent(inertia.blocks(self.Z, way.lever, moved), angular, force, moved)
