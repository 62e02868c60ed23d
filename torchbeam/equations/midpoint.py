"""One implicit step of the nodal form: mean strain, mid-step forces, Cayley rotations.

Unknown at mid step: u = r_mid - r_n and the rotation from R_n to R_mid (m, so that R_{n+1} = R_n
R(m)^2), and the stress, which is a mean over the step. With dt the step and Theta = 2 tan(angle/2)
n of the whole step's rotation (Simo and Wong 1991: the increment that keeps the energy of a free
body), see `inertia` for x, v_c, e-:

    v_{n+1} = 4 u/dt - v_n                          Omega_{n+1} = 2 Theta/dt - Omega_n
    M (v_c,{n+1} - v_c,n)/dt + to_nodes(h B_mid^T [F; M])_force - f = 0
    (R_{n+1} J Omega_{n+1} - R_n J Omega_n)/dt + e- x (the force of inertia)
        + to_nodes(h B_mid^T [F; M])_moment - m = 0
    S [F; M] = (strain_n + strain_{n+1})/2 + rate (strain_{n+1} - strain_n)/dt

Momentum is exact; the energy is kept to third order in the step, far better than by the strain at
mid step (Simo, Tarnow and Doblare 1995; Romero and Armero 2002). What is left over can be taken out
of the velocities: see `conserve`.

In a frame a that moves with v, omega at mid step, velocities are absolute: their mean is 2
u/dt + v + omega x r_mid, d/dt of a momentum is its difference over dt and omega x its mean, and
Theta is that of R_n^T Cay(omega dt) R_{n+1}. A steady motion with the frame is then steady in the
step as well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import cached
from ..nodal import loads as external
from ..state.state import State
from .energy_projection import conserved
from .step_element import MidpointElement
from .step_kinematics import MidpointMotion, MidpointTangent, StepKinematics
from .step_problem import StepProblem


class MidpointUnknowns(NamedTuple):
    """u (..., N+1, p) m, m (..., N+1, ...) from R_n to R_mid, stress (..., N, k) N and N m."""

    u: Tensor
    m: Tensor
    stress: Tensor


@dataclass(frozen=True)
class MidpointProblem(StepProblem):
    """See above.

    conserve  scale the velocities at the end so that kinetic + strain energy changes by the work of
              the loads less what damping takes, exactly; by at most 1/2 %, the rest waits for a
              step with more kinetic energy
    """

    conserve: bool = False

    UNKNOWNS = MidpointUnknowns
    TANGENT = MidpointTangent
    INSTANT = 0.5
    PART = 0.5

    @cached
    def motion(self) -> MidpointMotion:
        """The nodes over the step."""
        return MidpointMotion(
            self.model.inertia, self.start, self.h, self.frame, self.support_motions.clamps
        )

    @cached
    def element(self) -> MidpointElement:
        """The elements over the step."""
        return MidpointElement(*self.of_elements)

    def predictor(self) -> MidpointUnknowns:
        """Constant velocity, and the stress of the step before."""
        start, frame = self.start, self.frame
        velocity = frame.relative_velocity(start.velocity, start.position)
        spin = frame.relative_spin(start.spin, start.rotation)
        # what is held does not move in frame a, whatever the mean of its velocities
        if self.support_motions.nodes:
            velocity = self.model.constraints.slide * velocity
            spin = self.model.constraints.turn * spin
        m = self.model.space.cayley(spin * self.h / 2)
        return self.apply_supports(MidpointUnknowns(velocity * self.h / 2, m, start.stress))

    def moves(self, kinematics: StepKinematics) -> Tensor:
        """(..., N+1, w) m and rad, by which loads do work over the step."""
        turn = self.model.space.to_frame(kinematics.q, kinematics.theta)
        return torch.cat((self.h * kinematics.velocity, turn), -1)

    def work(self, kinematics: StepKinematics) -> Tensor | float:
        """(...) J of all loads over the step."""
        load = self.all_loads(kinematics)
        return load if isinstance(load, float) else (load * self.moves(kinematics)).sum((-1, -2))

    def finish(self, x: MidpointUnknowns, reaction: Tensor) -> State:
        """The state at the end of the step."""
        model, start = self.model, self.start
        x = self.apply_supports(x)
        kinematics = self.motion.kinematics(x.u, x.m)
        spin, velocity = kinematics.spin_end, kinematics.velocity_end
        # of this step alone: a difference of sums would depend on what was before
        work = torch.zeros_like(start.work) + self.work(kinematics)
        if self.support_motions.nodes:
            moves = self.moves(kinematics)
            for k, node in enumerate(self.support_motions.nodes):
                work = work + (reaction[..., k, :] * moves[..., node, :]).sum(-1)
        # what stands still has no velocity, whatever rounding has left
        if not self.support_motions.nodes:
            velocity = model.constraints.slide * velocity
            spin = self.about_hinges(model.constraints.turn * spin, kinematics.q_end)
        after = replace(
            start,
            position=kinematics.position_end,
            rotation=kinematics.q_end,
            velocity=velocity,
            spin=spin,
            reaction=reaction,
            work=work,
            t=start.t + self.dt,
            frame=self.frame.orientation(start.frame, self.dt),
            internal=external.advanced(model, self.nodes(kinematics), self.conditions),
        )
        after = self.finished(after, x.stress, kinematics)
        if self.conserve:
            after = conserved(model, start, after, self.dt, self.eigenstrain, model.free_pieces)
        return replace(after, work=start.work + after.work)
