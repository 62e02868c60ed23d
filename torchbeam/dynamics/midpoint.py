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
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import cached
from ..core.leaves import Tree, leaf
from ..nodal import loads as external
from ..nodal.assembly import ends
from ..nodal.balance import Linearisation, Residual, largest, restrained_forces, size_of_strain
from ..nodal.loads import MotionJacobian, Nodes
from ..nodal.model import Model
from ..scene.effects import Inputs
from ..state.state import State, set_node
from .energy_projection import conserved
from .step_element import ElementBalance, MidpointElement
from .step_kinematics import MidpointMotion, StepKinematics
from .support_motion import SupportMotion, support_motions

SPINS = frozenset({"spin", "angular_acceleration"})
MOTIONS = frozenset({"velocity", "acceleration", *SPINS})


class MidpointUnknowns(NamedTuple):
    """The unknowns: u (..., N+1, p) m, m (..., N+1, ...) from R_n to R_mid, stress (..., N, k) N and N m."""

    u: Tensor
    m: Tensor
    stress: Tensor


@dataclass(frozen=True)
class MidpointProblem(Tree):
    """A step of length dt (0-dim or (...)) from `start`, with loads as at time t (0-dim, or (...) each sample's own) and
    inputs held over it.

    conserve  scale the velocities at the end so that kinetic + strain energy changes by the work of the loads less what
              damping takes, exactly; by at most 1/2 %, the rest waits for a step with more kinetic energy
    """

    model: Model
    start: State
    dt: Tensor = leaf(0)
    t: Tensor = leaf(0)
    inputs: Inputs = leaf(1)
    conserve: bool = False

    INSTANT = 0.5  # of the step: when loads are taken
    PART = 0.5  # of the step's rotation: what the unknown m holds

    @cached
    def h(self) -> Tensor:
        """dt as (..., 1, 1)."""
        return self.dt[..., None, None]

    @cached
    def C(self) -> Tensor:
        """S^-1 of the tangent."""
        return self.model.tangent_stiffness(self.dt.detach())

    @cached
    def strain(self) -> Tensor:
        return self.model.strain(self.model.kinematics(self.start.position, self.start.rotation))

    @cached
    def eigenstrain(self) -> Tensor | float:
        """What the beam bends by itself."""
        return self.model.eigenstrain(self.t, self.inputs)

    @cached
    def frame(self) -> tuple[Tensor | None, Tensor | None]:
        """v, omega of frame a at mid step."""
        return self.model.frame(self.t)

    @cached
    def frame_end(self) -> Tensor | None:
        """The frame's orientation at the end."""
        if self.start.frame is None:
            return None
        space = self.model.space
        return space.multiply(self.start.frame, space.exponential(self.frame[1][..., 0, :] * self.dt[..., None]))

    @cached
    def support_motions(self) -> tuple[SupportMotion, ...]:
        """The supports that move, in frame a or with it."""
        return support_motions(self.model, self.start, self.t + (1 - self.INSTANT) * self.dt, self.PART)

    @cached
    def motion(self) -> MidpointMotion:
        """The nodes over the step."""
        return MidpointMotion(self.model.inertia, self.start, self.h, self.frame, self.support_motions)

    @cached
    def element(self) -> MidpointElement:
        """The elements over the step."""
        model = self.model
        return MidpointElement(model.space, model.law, model.length, self.h, model.reference, self.strain, self.eigenstrain)

    def apply_supports(self, x: MidpointUnknowns) -> MidpointUnknowns:
        """x with the supports where they have to be."""
        u, m = x.u, x.m
        for one in self.support_motions:
            if one.u is not None:
                u = set_node(u, one.node, torch.where(one.position, one.u, u[..., one.node, :]))
                m = set_node(m, one.node, one.m) if one.rotation else m
        space = self.model.space
        for at, axis in self.model.constraints.hinges:
            before = self.start.rotation[..., at, :]
            turned = space.hinged(space.multiply(before, m[..., at, :]), before, axis, at)
            m = set_node(m, at, space.multiply(space.inverse(before), turned))
        return x._replace(u=u, m=m)

    def about_hinges(self, spin: Tensor, rotation: Tensor) -> Tensor:
        """spin (..., N+1, s), section axes, of which hinges leave what is about their axis."""
        for at, axis in self.model.constraints.hinges:
            spin = set_node(spin, at, self.model.space.about(rotation, spin, axis, at))
        return spin

    @cached
    def _dead(self) -> Tensor | float:
        nodes = Nodes(self.start.position, self.start.rotation, None, None, self._frame_middle, self.start.internal, self.dt)
        return external.external(self.model, nodes, self.t, self.inputs, self.model.loads[1])

    @cached
    def _frame_middle(self) -> Tensor | None:
        if self.start.frame is None:
            return None
        space = self.model.space
        return space.multiply(self.start.frame, space.exponential(self.frame[1][..., 0, :] * self.dt[..., None] / 2))

    def predictor(self) -> MidpointUnknowns:
        """Constant velocity, and the stress of the step before."""
        space, start = self.model.space, self.start
        v, omega = self.frame
        velocity, spin = start.velocity, start.spin
        if v is not None:
            velocity = velocity - v
        if omega is not None:
            velocity = velocity - (space.skew(omega) @ start.position[..., None])[..., 0]
            spin = spin - space.to_section(start.rotation, omega)
        if self.support_motions:  # what is held does not move in frame a, whatever the mean of its velocities
            velocity, spin = self.model.constraints.slide * velocity, self.model.constraints.turn * spin
        return self.apply_supports(MidpointUnknowns(velocity * self.h / 2, space.cayley(spin * self.h / 2), start.stress))

    def rest_guess(self) -> MidpointUnknowns:
        """Standing still: what a failed sample is differentiated at."""
        u = torch.zeros_like(self.start.position)
        return MidpointUnknowns(u, self.model.space.identity(u), torch.zeros_like(self.start.stress))

    def update(self, x: MidpointUnknowns, move: Tensor, dstress: Tensor) -> MidpointUnknowns:
        """x after a move of the mid-step configuration; a spin s in frame a turns R_n R(m) from the left."""
        space = self.model.space
        turn = space.to_section(self.start.rotation, move[..., space.position:])
        return MidpointUnknowns(x.u + move[..., :space.position], space.multiply(space.cayley(turn), x.m), x.stress + dstress)

    def nodes(self, x: MidpointUnknowns, way: StepKinematics) -> Nodes:
        """What loads see: the middle of the step, velocities its mean."""
        spin = self.model.space.to_frame(way.q, way.theta) / self.h
        return Nodes(self.start.position + x.u, way.q, way.velocity, spin, self._frame_middle, self.start.internal, self.dt,
                     *(self.motion.accelerations(way, self._angular) if self.model.adds_mass else ()))

    def seen(self, x: MidpointUnknowns) -> Nodes:
        """`nodes` of the unknowns alone."""
        x = self.apply_supports(x)
        return self.nodes(x, self.motion.kinematics(x.u, x.m))

    def external(self, x: MidpointUnknowns, way: StepKinematics) -> Tensor | float:
        """Loads at the nodes (..., N+1, w)."""
        moving = self.model.loads[0]
        if not moving:
            return self._dead
        return self._dead + external.external(self.model, self.nodes(x, way), self.t, self.inputs, moving)

    def node_balance(self, x: MidpointUnknowns) -> tuple[StepKinematics, Tensor, Tensor, Tensor | float]:
        """Motion of the nodes at x, their inertia forces (..., N+1, w), R_{n+1} J Omega_{n+1}, and the loads (..., N+1, w). Of
        each node alone, but for the half-consistent mass of an element, which knows its two nodes.
        """
        way = self.motion.kinematics(x.u, x.m)
        inertia, turning = self.motion.balance(way)
        return way, inertia, turning, self.external(x, way)

    def node_tangent(self, x: MidpointUnknowns, way: StepKinematics, turning: Tensor
                     ) -> tuple[Tensor, Tensor | None, Tensor]:
        """Derivative of inertia less loads by (dr_mid, spin of R_mid): at a node (..., N+1, w, w) and between neighbours, see
        `Inertia.tangent`; and half the spin of R_{n+1} by the spin of R_mid (..., N+1, s, s).
        """
        space, motion = self.model.space, self.motion
        R = space.spin_matrix(way.q)
        half = space.mean_rotation(R, motion.R)
        R_end = by_theta = None
        if self.model.inertia.inertia is not None or SPINS & self._read:
            R_end, by_theta = motion.theta_by_spin(way, R)
        diagonal, coupling = motion.tangent(way, turning, half, R_end, by_theta)
        if self.model.loads[0]:
            diagonal = diagonal - self.load_tangent(x, way, R, R_end, half, by_theta)
        return diagonal, coupling, half

    def element_balance(self, x: MidpointUnknowns, way: StepKinematics) -> ElementBalance:
        """The elements at x, whose nodes move so."""
        middle = *ends(self.start.position + x.u), *ends(way.q)
        end = *ends(self.start.position + 2 * x.u), *ends(way.q_end)
        return self.element.balance(middle, end, x.stress)

    def residual(self, x: MidpointUnknowns) -> tuple[Residual, StepKinematics, Any, Any, Tensor]:
        """The balance at x; with it what follows from x, the elements at mid step and at the end, and R_{n+1} J Omega_{n+1}."""
        model, space, h = self.model, self.model.space, self.model.length
        x = self.apply_supports(x)
        way, inertia, turning, load = self.node_balance(x)
        element = self.element_balance(x, way)
        nodes = inertia + space.to_nodes(element.forces) - load
        restrained = restrained_forces(model, element.middle, self.eigenstrain, h)
        sizes = largest(space.position, h, element.forces, load, inertia, restrained)
        sizes = *sizes, size_of_strain(element.felt, self.eigenstrain)
        return Residual(model.constraints, nodes, element.gap, *sizes), way, element.middle, element.end, turning

    def linearise(self, x: MidpointUnknowns, way: StepKinematics, middle: Any, end: Any, turning: Tensor) -> Linearisation:
        """The tangent by (dr_mid, spin of R_mid): R_{n+1} follows with spin (I + R_mid R_n^T) spin_mid."""
        diagonal, coupling, half = self.node_tangent(x, way, turning)
        element = self.element.tangent(middle, end, x.stress, *ends(half, 2))
        return Linearisation.condense(self.model, element.stiffness, diagonal, element.hB, self.C, element.E, coupling)

    def load_tangent(self, x: MidpointUnknowns, way: StepKinematics, R: Tensor, R_end: Tensor | None, half: Tensor,
                     by_theta: Tensor | None) -> Tensor | float:
        """Derivative of `external` by (dr_mid, spin of R_mid), (..., N+1, w, w); R of R_mid, R_end, half and by_theta as in
        `MidpointMotion.tangent`.
        """
        space, motion, omega, by = self.model.space, self.motion, self.frame[1], None
        if self._read:
            eye = torch.eye(space.position, dtype=R.dtype, device=R.device)
            velocity = 2 / motion.dt * eye if omega is None else 2 / motion.dt * eye + space.skew(omega)
            spin = R @ by_theta - space.spin_skew(space.to_frame(way.q, way.theta)) if SPINS & self._read else half
            accelerations = (motion.accelerations_by(way, self._angular, R_end, half, by_theta)
                             if self.model.adds_mass else ())
            by = MotionJacobian(velocity, spin / motion.dt, *accelerations)
        return external.tangent(self.model, self.nodes(x, way), self.t, self.inputs, self.model.loads[0], by)

    @property
    def _angular(self) -> bool:
        return "angular_acceleration" in self.model.read

    @cached
    def _read(self) -> frozenset[str]:
        """Motions that loads read."""
        return self.model.read & MOTIONS

    def finish(self, x: MidpointUnknowns, reaction: Tensor) -> State:
        """The state at the end of the step."""
        model, start, space = self.model, self.start, self.model.space
        x = self.apply_supports(x)
        way = self.motion.kinematics(x.u, x.m)
        spin = self.motion.spin_end(way)
        velocity, _ = self.motion.velocity_end(way, spin)
        load = self.external(x, way)
        work, turn = start.work, space.to_frame(way.q, way.theta)
        if not isinstance(load, float):
            work = work + (load * torch.cat((self.h * way.velocity, turn), -1)).sum((-1, -2))
        for k, one in enumerate(self.support_motions):
            made = torch.cat((self.dt[..., None] * way.velocity[..., one.node, :], turn[..., one.node, :]), -1)
            work = work + (reaction[..., k, :] * made).sum(-1)
        if not self.support_motions:  # what stands still has no velocity, whatever rounding has left
            velocity, spin = model.constraints.slide * velocity, self.about_hinges(model.constraints.turn * spin, way.q_end)
        after = replace(
            start, position=start.position + 2 * x.u, rotation=way.q_end, velocity=velocity, spin=spin, stress=x.stress,
            reaction=reaction, work=work, t=start.t + self.dt, frame=self.frame_end,
            internal=self._internal(self.nodes(x, way)))
        return conserved(self.model, start, after, self.dt, self.eigenstrain) if self.conserve else after

    def _internal(self, nodes: Nodes) -> Tensor | None:
        """The user loads' own states at the end."""
        return None if self.start.internal is None else external.advanced(self.model, nodes, self.t, self.inputs)
