"""What the nodes do over a step: where they get, how fast they are on average and in the end, what inertia asks for.

The equations are those of `step` and `inertia`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from ..state import State, put
from .given import Given
from .model import Model


class Way(NamedTuple):
    """What follows from the unknowns of the nodes: rotations at mid step and at the end; theta (absolute) and theta relative to
    frame a, section axes; mean velocities of node and centre of mass, absolute, frame a; e- (None without offset).
    """

    q: Tensor
    q_end: Tensor
    theta: Tensor
    relative: Tensor
    velocity: Tensor
    centre: Tensor
    arm: Tensor | None


@dataclass(frozen=True)
class Passage:
    """From `start`, in h (..., 1, 1) s; frame: v and omega of frame a at mid step; given: the supports that move."""

    model: Model
    start: State
    h: Tensor
    frame: tuple[Tensor | None, Tensor | None]
    given: tuple[Given, ...]

    @cached_property
    def angular_momentum(self) -> Tensor:
        """R J Omega_n, frame a."""
        H = self.model.inertia.angular_momentum(self.start.spin)
        return self.model.space.to_frame(self.start.rotation, H)

    @cached_property
    def arm(self) -> Tensor:
        """R_n e."""
        return self.model.inertia.arm(self.start.rotation)

    @cached_property
    def centre_velocity(self) -> Tensor:
        return self.model.inertia.centre_velocity(self.start.rotation, self.start.velocity, self.start.spin)

    def way(self, u: Tensor, m: Tensor) -> Way:
        """Over u (..., N+1, p) m and the rotation m, both to mid step."""
        space, start, (v, omega) = self.model.space, self.start, self.frame
        q = space.multiply(start.rotation, m)
        q_end = space.normalize(space.multiply(q, m))
        turn = space.multiply(m, m)
        relative = theta = space.theta(turn)
        if omega is not None:
            carried = space.multiply(space.cayley(omega * self.h), space.multiply(start.rotation, turn))
            theta = space.theta(space.multiply(space.inverse(start.rotation), carried))
        velocity, middle, arm = 2 / self.h * u, start.position + u, None
        centre = velocity
        if self.model.inertia.offset is not None:
            arm = (self.arm + self.model.inertia.arm(q_end)) / 2
            centre = velocity + (space.arm(arm) @ space.to_frame(q, relative)[..., None])[..., 0] / self.h
        if v is not None:
            velocity, centre = velocity + v, centre + v
        if omega is not None:
            turning = space.tilde(omega)
            velocity = velocity + (turning @ middle[..., None])[..., 0]
            centre = centre + (turning @ (middle if arm is None else middle + arm)[..., None])[..., 0]
        return Way(q, q_end, theta, relative, velocity, centre, arm)

    def spin_end(self, way: Way) -> Tensor:
        """Omega_{n+1}, section axes."""
        spin = 2 / self.h * way.theta - self.start.spin
        for one in self.given:
            spin = spin if one.spin is None else put(spin, one.node, one.spin)
        return spin

    def velocity_end(self, way: Way, spin: Tensor) -> tuple[Tensor, Tensor]:
        """v_{n+1} and v_c,{n+1}, frame a."""
        inertia = self.model.inertia
        centre = 2 * way.centre - self.centre_velocity
        velocity = centre
        if inertia.offset is not None:
            velocity = centre - inertia.centre_velocity(way.q_end, torch.zeros_like(centre), spin)
        for one in self.given:
            if one.velocity is not None:
                velocity = put(velocity, one.node, one.velocity)
                centre = inertia.centre_velocity(way.q_end, velocity, spin)
        return velocity, centre

    def inertia(self, way: Way) -> tuple[Tensor, Tensor]:
        """Force and moment of inertia at the nodes (..., N+1, w), and R_{n+1} J Omega_{n+1} (of no meaning without J)."""
        space, inertia, omega = self.model.space, self.model.inertia, self.frame[1]
        spin = self.spin_end(way)
        _, centre = self.velocity_end(way, spin)
        force = inertia.momentum((centre - self.centre_velocity) / self.h)
        if omega is not None:
            force = force + (space.tilde(omega) @ inertia.momentum((centre + self.centre_velocity) / 2)[..., None])[..., 0]
        turning = torch.zeros_like(spin)
        torque = turning
        if inertia.inertia is not None:
            turning = space.to_frame(way.q_end, inertia.angular_momentum(spin))
            torque = (turning - self.angular_momentum) / self.h
            if omega is not None:
                torque = torque + (space.hat(omega) @ (turning + self.angular_momentum)[..., None])[..., 0] / 2
        if way.arm is not None:
            torque = torque + (space.arm(way.arm).mT @ force[..., None])[..., 0]
        return torch.cat((force, torque), -1), turning
