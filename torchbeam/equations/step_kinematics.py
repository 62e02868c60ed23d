"""Nodal kinematics and inertia forces of one midpoint step, and where supports that move lead their
nodes; the equations are those of `midpoint` and `inertia`.

Local: a node needs no other, but for the mass that neighbours share.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.derivatives import cached
from ..math.shapes import stacked
from ..nodal.conditions import SupportConditions
from ..nodal.coordinates.spatial import Spatial
from ..nodal.frame import FixedFrame
from ..nodal.inertia import Inertia, InertiaForces, Momenta
from ..nodal.loads import Nodes
from ..nodal.mass_offset import NoMassOffset
from ..scene.effects import INERTIAL
from ..state.state import State
from ..state.supported_nodes import set_node
from ..topology.protocols import Matrix


class SupportPose(NamedTuple):
    """Where a support that moves leads its node: u (..., p) to the positions that it holds, a mask
    (p,), and m (...) to the rotation, where it holds that.
    """

    node: int
    position: Tensor
    rotation: bool
    u: Tensor
    m: Tensor


class ClampMotion(NamedTuple):
    """Velocity (..., p), frame a, and spin (..., s), section axes, of a clamp at a step's end."""

    node: int
    velocity: Tensor
    spin: Tensor


class SupportMotions(NamedTuple):
    """Supports of a beam that moves with frame a or with one of them: nodes of all, poses of those
    that move in frame a, and clamps. None, where nothing moves.
    """

    nodes: tuple[int, ...] = ()
    poses: tuple[SupportPose, ...] = ()
    clamps: tuple[ClampMotion, ...] = ()


def support_motions(
    space: Spatial, supports: tuple[SupportConditions, ...], start: State, part: float
) -> SupportMotions:
    """From `start` to where supports are at the end; u and m lead a part (1/2 or 1) of the way."""
    poses, clamps = [], []
    for support in supports:
        at, node_space = support.node, space.of_nodes(support.node)
        if support.pose is not None:
            position, rotation = node_space.pose(*support.pose)
            m = space.multiply(space.inverse(start.rotation[..., at, :]), rotation)
            whole = bool(support.fixed[space.dims.position :].all())
            poses.append(
                SupportPose(
                    at,
                    support.fixed[: space.dims.position] > 0,
                    whole,
                    (position - start.position[..., at, :]) * part,
                    space.sqrt(m) if part == 0.5 else m,
                )
            )
        if support.motion is not None:
            clamps.append(ClampMotion(at, *space.motion(*support.motion)))
    return SupportMotions(tuple(support.node for support in supports), tuple(poses), tuple(clamps))


class StepKinematics(NamedTuple):
    """Motion of the nodes over a step, from its unknowns. Mid step: position, rotation q, mean
    velocity of node and centre of mass (absolute, frame a), theta (absolute, section axes) and
    lever e-. End: position, rotation, lever, spin (section axes), velocity of node and centre.
    """

    position: Tensor
    q: Tensor
    velocity: Tensor
    centre: Tensor
    theta: Tensor
    lever: NoMassOffset
    position_end: Tensor
    q_end: Tensor
    lever_end: NoMassOffset
    spin_end: Tensor
    velocity_end: Tensor
    centre_end: Tensor

    @property
    def poses(self) -> tuple[tuple[Tensor, Tensor], ...]:
        """Position and rotation at mid step and at the end."""
        return (self.position, self.q), (self.position_end, self.q_end)


@dataclass(frozen=True)
class MidpointMotion:
    """Nodes from `start` over h (..., 1, 1) s; frame a at mid step; clamps that move."""

    inertia: Inertia
    start: State
    h: Tensor
    frame: FixedFrame
    clamps: tuple[ClampMotion, ...]

    @cached
    def momenta(self) -> Momenta:
        """At the start."""
        return self.inertia.momenta(self.start.rotation, self.centre_velocity, self.start.spin)

    @cached
    def lever(self) -> NoMassOffset:
        """R_n e."""
        return self.inertia.offset.turned(self.start.rotation)

    @cached
    def centre_velocity(self) -> Tensor:
        start = self.start
        return self.lever.velocity(
            start.velocity, lambda: self.inertia.space.to_frame(start.rotation, start.spin)
        )

    @cached
    def R(self) -> Tensor:
        """R_n of spins."""
        return self.inertia.space.spin_matrix(self.start.rotation)

    @cached
    def dt(self) -> Tensor:
        """h as (..., 1, 1, 1)."""
        return self.h[..., None]

    @cached
    def rate(self) -> Tensor:
        """2/dt (..., 1, 1, 1) 1/s."""
        return 2 / self.dt

    @cached
    def V(self) -> Tensor:
        """Derivative of the mean velocity by the move: 2/dt + ~omega."""
        eye = torch.eye(self.inertia.space.dims.position, dtype=self.h.dtype, device=self.h.device)
        return self.frame.rate_by(self.rate * eye, lambda: eye)

    @cached
    def Z(self) -> Tensor:
        """Derivative of an inertia force per mass by the centre's move: (2/dt + ~omega)^2."""
        return self.frame.rate_by(self.rate * self.V, lambda: self.V)

    @cached
    def masses(self) -> Matrix:
        """M Z."""
        return self.inertia.masses(self.Z)

    def kinematics(self, u: Tensor, m: Tensor) -> StepKinematics:
        """Over u (..., N+1, p) m and the rotation m, both to mid step."""
        space, start, frame, h = self.inertia.space, self.start, self.frame, self.h
        q, turn = space.multiply(start.rotation, m), space.multiply(m, m)
        q_end = space.normalize(space.multiply(q, m))
        relative = space.theta(turn)
        theta = frame.theta(relative, start.rotation, turn, h)
        lever_end = self.inertia.offset.turned(q_end)
        lever = self.lever.mean(lever_end)
        position = start.position + u
        velocity = frame.velocity(2 / h * u, position)
        centre = lever.velocity(velocity, lambda: frame.spin(space.to_frame(q, relative) / h))
        spin_end, centre_end = 2 / h * theta - start.spin, 2 * centre - self.centre_velocity
        for clamp in self.clamps:
            spin_end = set_node(spin_end, clamp.node, clamp.spin)

        def turning() -> Tensor:
            return space.to_frame(q_end, spin_end)

        velocity_end = lever_end.velocity(centre_end, lambda: -turning())
        for clamp in self.clamps:
            velocity_end = set_node(velocity_end, clamp.node, clamp.velocity)
            centre_end = lever_end.velocity(velocity_end, turning)
        return StepKinematics(
            position,
            q,
            velocity,
            centre,
            theta,
            lever,
            start.position + 2 * u,
            q_end,
            lever_end,
            spin_end,
            velocity_end,
            centre_end,
        )

    def balance(self, kinematics: StepKinematics) -> InertiaForces:
        """By differences and means over the step."""
        before = self.momenta
        after = self.inertia.momenta(kinematics.q_end, kinematics.centre_end, kinematics.spin_end)
        force = self._rate(self.frame.rate, before.linear, after.linear)
        moment = self.inertia.rotary.present_or(
            after.angular, lambda: self._rate(self.frame.spin_rate, before.angular, after.angular)
        )
        return InertiaForces(kinematics.lever.wrench(force, moment), after.angular)

    def nodes(self, kinematics: StepKinematics, read: frozenset[str]) -> Nodes:
        """What loads see: the middle of the step, velocities and, of those that they read,
        accelerations its mean.
        """
        spin = self.inertia.space.to_frame(kinematics.q, kinematics.theta) / self.h
        accelerations = {name: getattr(self, name)(kinematics) for name in INERTIAL if name in read}
        return Nodes(kinematics.position, kinematics.q, kinematics.velocity, spin, **accelerations)

    def acceleration(self, kinematics: StepKinematics) -> Tensor:
        """Mean over the step, absolute, frame a."""
        return self._rate(self.frame.rate, self.start.velocity, kinematics.velocity_end)

    def angular_acceleration(self, kinematics: StepKinematics) -> Tensor:
        """The same of spins."""
        to_frame, start = self.inertia.space.to_frame, self.start
        return self._rate(
            self.frame.spin_rate,
            to_frame(start.rotation, start.spin),
            to_frame(kinematics.q_end, kinematics.spin_end),
        )

    def _rate(self, rate: Callable[..., Tensor], before: Tensor, after: Tensor) -> Tensor:
        """The rate by a frame's `rate` of a vector over the step: by its difference and mean."""
        return rate((after - before) / self.h, lambda: (after + before) / 2)


@dataclass(frozen=True)
class MidpointTangent:
    """Derivatives of the motion `way` by the move (dr_mid, spin of R_mid), each made where it is
    asked for; those of what loads see have its names. R_{n+1} follows with the spin
    (I + R_mid R_n^T) spin_mid.
    """

    motion: MidpointMotion
    kinematics: StepKinematics

    @cached
    def R(self) -> Tensor:
        """R_mid of spins."""
        return self.motion.inertia.space.spin_matrix(self.kinematics.q)

    @cached
    def R_end(self) -> Tensor:
        return self.motion.inertia.space.spin_matrix(self.kinematics.q_end)

    @cached
    def half(self) -> Tensor:
        """(I + R_mid R_n^T)/2: half the spin of R_{n+1}."""
        return self.motion.inertia.space.mean_rotation(self.R, self.motion.R)

    @cached
    def theta(self) -> Tensor:
        """d(Theta), section axes, (..., N+1, s, s)."""
        return (
            self.motion.inertia.space.theta_by_turn(self.kinematics.theta)
            @ (self.R_end + self.R).mT
        )

    @cached
    def lever_end(self) -> Tensor:
        """Half of d(R_{n+1} e), (..., N+1, p, s)."""
        return self.kinematics.lever_end.A @ self.half

    @cached
    def spin_end(self) -> Tensor:
        """d(R_{n+1} Omega_{n+1})."""
        space = self.motion.inertia.space
        return self.R_end @ (self.motion.rate * self.theta) - space.spin_skew(self._spin_end) @ (
            2 * self.half
        )

    @cached
    def _spin_end(self) -> Tensor:
        return self.motion.inertia.space.to_frame(self.kinematics.q_end, self.kinematics.spin_end)

    def inertia(self, forces: InertiaForces) -> Matrix:
        """Of `MidpointMotion.balance`."""
        motion, rotary = self.motion, self.motion.inertia.rotary

        def angular() -> Tensor:
            by = rotary.momentum_by(
                self.R_end, motion.rate * self.theta, forces.angular, 2 * self.half
            )
            return self._rate(motion.frame.spin_rate_by, by)

        masses = self.kinematics.lever.tangent(
            motion.masses, lambda: self.lever_end, lambda: forces.wrench
        )
        return rotary.matrix(masses, angular)

    @cached
    def velocity(self) -> Tensor:
        return self.motion.V

    @cached
    def spin(self) -> Tensor:
        space, kinematics = self.motion.inertia.space, self.kinematics
        return (
            self.R @ self.theta - space.spin_skew(space.to_frame(kinematics.q, kinematics.theta))
        ) / self.motion.dt

    @cached
    def acceleration(self) -> Tensor:
        motion = self.motion

        def by_spin() -> Tensor:
            return motion.Z @ self.lever_end - self._rate(
                motion.frame.rate_by, self._lever_velocity
            )

        return self.kinematics.lever.acceleration_by(motion.Z, by_spin)

    @cached
    def rates_end(self) -> Tensor:
        """Of velocity and spin at the end (..., N+1, w, w), frame a."""
        by, space = 2 * self.motion.V, self.motion.inertia.space

        def by_spin() -> Tensor:
            return by @ self.lever_end - self._lever_velocity

        velocity = self.kinematics.lever.acceleration_by(by, by_spin)
        width = space.unknowns - velocity.shape[-1]
        spin = pad(self.spin_end, (space.dims.position, 0))
        return stacked(pad(velocity, (0, width)), spin)

    @cached
    def _lever_velocity(self) -> Tensor:
        """d(R_{n+1} Omega_{n+1} x R_{n+1} e) by spins."""
        kinematics, space = self.kinematics, self.motion.inertia.space
        turned = kinematics.lever_end.A @ self.spin_end
        if space.turns:
            turned = turned + 2 * space.skew(self._spin_end) @ self.lever_end
        return turned

    @cached
    def angular_acceleration(self) -> Tensor:
        return self._rate(self.motion.frame.spin_rate_by, self.spin_end)

    def _rate(self, rate: Callable[..., Tensor], by: Tensor) -> Tensor:
        """Derivative of a rate over the step, `by` being that of the vector at the end."""
        return rate(by / self.motion.dt, lambda: by / 2)
