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
from ..nodal.balance import CondensedTangent, Linearisation, Residual, largest, restrained_forces, size_of_strain
from ..nodal.conditions import Conditions, conditions
from ..nodal.frame import FixedFrame
from ..nodal.inertia import InertiaForces
from ..nodal.joints import Pose
from ..nodal.loads import Nodes
from ..nodal.rows import Rows
from ..scene.effects import Inputs
from ..state.state import State
from ..state.supported_nodes import set_node
from ..topology.protocols import Matrix
from .energy_projection import conserved
from .step_element import ElementBalance, MidpointElement
from .step_kinematics import MidpointMotion, MidpointTangent, StepKinematics
from .support_motion import SupportMotions, support_motions


class MidpointUnknowns(NamedTuple):
    """The unknowns: u (..., N+1, p) m, m (..., N+1, ...) from R_n to R_mid, stress (..., N, k) N and N m."""

    u: Tensor
    m: Tensor
    stress: Tensor


@dataclass(frozen=True)
class MidpointProblem(Tree):
    """A step of length dt (0-dim or (...)) from `start`, with loads as at time t (0-dim, or (...) each sample's own) and
    inputs held over it. model: `Model`; where others say what the `conditions` are, rows of it.

    conserve  scale the velocities at the end so that kinetic + strain energy changes by the work of the loads less what
              damping takes, exactly; by at most 1/2 %, the rest waits for a step with more kinetic energy
    """

    model: Rows
    start: State
    dt: Tensor = leaf(0)
    t: Tensor = leaf(0)
    inputs: Inputs = leaf(1)
    conserve: bool = False

    UNKNOWNS = MidpointUnknowns
    TANGENT = MidpointTangent
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
    def conditions(self) -> Conditions:
        """Of the instant at which loads are taken, and of supports at the end."""
        return conditions(self.model, self.t, self.inputs, self.t + (1 - self.INSTANT) * self.dt)

    @property
    def eigenstrain(self) -> Tensor | float:
        """What the beam bends by itself."""
        return self.conditions.eigenstrain

    @property
    def frame(self) -> FixedFrame:
        """Frame a at that instant."""
        return self.conditions.frame

    @cached
    def support_motions(self) -> SupportMotions:
        """The supports that move, in frame a or with it."""
        return support_motions(self.model.space, self.conditions.supports, self.start, self.PART)

    @cached
    def motion(self) -> MidpointMotion:
        """The nodes over the step."""
        return MidpointMotion(self.model.inertia, self.start, self.h, self.frame, self.support_motions.clamps)

    @cached
    def element(self) -> MidpointElement:
        """The elements over the step."""
        return MidpointElement(*self._elements)

    @cached
    def _elements(self) -> tuple[Any, ...]:
        """Fields of `StepElement`."""
        model, start = self.model, self.model.assembly.poses(self.start.position, self.start.rotation)
        return model.space, model.law, model.length, self.h, model.reference, start, self.eigenstrain

    def apply_supports(self, x: MidpointUnknowns) -> MidpointUnknowns:
        """x with the supports where they have to be."""
        u, m = x.u, x.m
        for one in self.support_motions.poses:
            u = set_node(u, one.node, torch.where(one.position, one.u, u[..., one.node, :]))
            m = set_node(m, one.node, one.m) if one.rotation else m
        space = self.model.space
        for at, axis in self.model.constraints.hinges:
            m = set_node(m, at, space.of_nodes(at).hinged_turn(m[..., at, :], self.start.rotation[..., at, :], axis))
        return x._replace(u=u, m=m)

    def about_hinges(self, spin: Tensor, rotation: Tensor) -> Tensor:
        """spin (..., N+1, s), section axes, of which hinges leave what is about their axis."""
        for at, axis in self.model.constraints.hinges:
            kept = self.model.space.of_nodes(at).about(rotation[..., at, :], spin[..., at, :], axis)
            spin = set_node(spin, at, kept)
        return spin

    @cached
    def _dead(self) -> Tensor | float:
        start = self.start
        nodes = Nodes(start.position, start.rotation, frame=self._frame_middle, internal=start.internal, dt=self.dt)
        now = self.conditions
        return external.external(self.model, nodes, now, now.still, now.dead)

    @cached
    def _frame_middle(self) -> Tensor | None:
        given = self.conditions.orientation
        return self.frame.orientation(self.start.frame, self.dt / 2) if given is None else given

    def predictor(self) -> MidpointUnknowns:
        """Constant velocity, and the stress of the step before."""
        start, frame = self.start, self.frame
        velocity = frame.relative_velocity(start.velocity, start.position)
        spin = frame.relative_spin(start.spin, start.rotation)
        if self.support_motions.nodes:  # what is held does not move in frame a, whatever the mean of its velocities
            velocity, spin = self.model.constraints.slide * velocity, self.model.constraints.turn * spin
        m = self.model.space.cayley(spin * self.h / 2)
        return self.apply_supports(MidpointUnknowns(velocity * self.h / 2, m, start.stress))

    def rest_guess(self) -> MidpointUnknowns:
        """Standing still: what a failed sample is differentiated at."""
        u = torch.zeros_like(self.start.position)
        return self.UNKNOWNS(u, self.model.space.identity(u), torch.zeros_like(self.start.stress))

    def update(self, x: MidpointUnknowns, move: Tensor, dstress: Tensor) -> MidpointUnknowns:
        """x after a move of the mid-step configuration; a spin s in frame a turns R_n R(m) from the left."""
        space = self.model.space
        turn = space.to_section(self.start.rotation, move[..., space.position:])
        return self.UNKNOWNS(x.u + move[..., :space.position], space.multiply(space.cayley(turn), x.m), x.stress + dstress)

    def nodes(self, way: StepKinematics) -> Nodes:
        """What loads see."""
        nodes = self.motion.nodes(way, self.conditions.reads)
        return nodes._replace(frame=self._frame_middle, internal=self.start.internal, dt=self.dt)

    def seen(self, x: MidpointUnknowns) -> Nodes:
        """`nodes` of the unknowns."""
        x = self.apply_supports(x)
        return self.nodes(self.motion.kinematics(x.u, x.m))

    def external(self, way: StepKinematics) -> Tensor | float:
        """Loads at the nodes (..., N+1, w)."""
        now = self.conditions
        return self._dead + external.external(self.model, self.nodes(way), now, now.moving) if now.moving else self._dead

    def node_balance(self, x: MidpointUnknowns) -> tuple[StepKinematics, InertiaForces, Tensor | float]:
        """Motion of the nodes, what it asks of them, and loads; each node's own, but for the mass that neighbours share."""
        way = self.motion.kinematics(x.u, x.m)
        return way, self.motion.balance(way), self.external(way)

    def node_tangent(self, way: StepKinematics, inertia: InertiaForces) -> tuple[MidpointTangent, Matrix]:
        """Derivatives of the motion, and those of inertia less loads, by the nodes' moves."""
        nodes = self.TANGENT(self.motion, way)
        matrix = nodes.inertia(inertia)
        return nodes, matrix.minus(self.load_tangent(nodes)) if self.conditions.moving else matrix

    def element_balance(self, x: MidpointUnknowns, way: StepKinematics) -> ElementBalance:
        """The elements, whose nodes move so."""
        stress, _ = self.model.joints.split(x.stress)
        return self.element.balance(stress, *(self.model.assembly.poses(*pose) for pose in way.poses))

    def residual(self, x: MidpointUnknowns) -> tuple[Residual, StepKinematics, ElementBalance, InertiaForces]:
        """The balance at x; with it what the nodes and the elements do there."""
        model, h = self.model, self.model.length
        x = self.apply_supports(x)
        way, inertia, load = self.node_balance(x)
        element = self.element_balance(x, way)
        nodes = inertia.wrench + model.assembly.to_nodes(element.forces) - load
        nodes, gap = model.joints.balance(nodes, element.gap, x.stress, lambda: self.joint_poses(way))
        restrained = restrained_forces(model, element.acting, self.eigenstrain, h)
        sizes = largest(model.space.position, h, element.forces, load, inertia.wrench, restrained)
        sizes = *sizes, size_of_strain(element.felt, self.eigenstrain)
        return Residual(model.constraints, nodes, gap, *sizes, model.joints, h), way, element, inertia

    def joint_poses(self, way: StepKinematics) -> tuple[Pose, Pose]:
        """Means over the step, and at its end."""
        joints = self.model.joints
        end = joints.pose(way.position_end, way.q_end)
        return joints.pose(self.start.position, self.start.rotation).mean(end), end

    def tangent(self, x: MidpointUnknowns, way: StepKinematics, element: ElementBalance, inertia: InertiaForces
                ) -> CondensedTangent:
        """By the nodes' moves, see `TANGENT`."""
        joints = self.model.joints
        nodes, matrix = self.node_tangent(way, inertia)
        tangent = self.element.tangent(element, joints.split(x.stress)[0], lambda: self.model.assembly.ends(nodes.half, 2))
        condensed = CondensedTangent.of(self.model.assembly, tangent.stiffness, matrix, tangent.hB, self.C, tangent.E)
        return joints.joined(condensed, x.stress, lambda: self.joint_poses(way), lambda: nodes.half, 2.0)

    def linearise(self, x: MidpointUnknowns, way: StepKinematics, element: ElementBalance, inertia: InertiaForces
                  ) -> Linearisation:
        return Linearisation.of(self.model, self.tangent(x, way, element, inertia))

    def load_tangent(self, nodes: MidpointTangent) -> Tensor | float:
        """Derivative of `external` by the nodes' moves, (..., N+1, w, w)."""
        by = external.motion_jacobian(nodes, self.conditions.reads)
        return external.tangent(self.model, self.nodes(nodes.way), self.conditions, by)

    def finish(self, x: MidpointUnknowns, reaction: Tensor) -> State:
        """The state at the end of the step."""
        model, start, space = self.model, self.start, self.model.space
        x = self.apply_supports(x)
        way = self.motion.kinematics(x.u, x.m)
        spin, velocity = way.spin_end, way.velocity_end
        load = self.external(way)
        work, turn = start.work, space.to_frame(way.q, way.theta)
        if not isinstance(load, float):
            work = work + (load * torch.cat((self.h * way.velocity, turn), -1)).sum((-1, -2))
        for k, node in enumerate(self.support_motions.nodes):
            made = torch.cat((self.dt[..., None] * way.velocity[..., node, :], turn[..., node, :]), -1)
            work = work + (reaction[..., k, :] * made).sum(-1)
        if not self.support_motions.nodes:  # what stands still has no velocity, whatever rounding has left
            velocity, spin = model.constraints.slide * velocity, self.about_hinges(model.constraints.turn * spin, way.q_end)
        after = replace(
            start, position=way.position_end, rotation=way.q_end, velocity=velocity, spin=spin, stress=x.stress,
            reaction=reaction, work=work, t=start.t + self.dt, frame=self.frame.orientation(start.frame, self.dt),
            internal=external.advanced(model, self.nodes(way), self.conditions))
        return conserved(self.model, start, after, self.dt, self.eigenstrain) if self.conserve else after
