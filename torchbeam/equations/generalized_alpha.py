"""One step of the generalized-alpha method: force balance at the end of the step, high frequencies
damped at will.

Chung and Hulbert 1993, on the nodes' rotations as Arnold and Bruels 2007. With a the algorithmic
acceleration, q" the true one, psi = log(R_n^T R_{n+1}) the rotation vector of the step and rho the
spectral radius at infinite frequency,

    alpha_m = (2 rho - 1)/(rho + 1)    alpha_f = rho/(rho + 1)    gamma = 1/2 - alpha_m + alpha_f
    beta = (gamma + 1/2)^2/4
    r_{n+1} - r_n, psi  = dt v_n + dt^2 ((1/2 - beta) a_n + beta a_{n+1})
    v_{n+1}             = v_n + dt ((1 - gamma) a_n + gamma a_{n+1})
    (1 - alpha_f) q"_{n+1} + alpha_f q"_n = (1 - alpha_m) a_{n+1} + alpha_m a_n

where v holds velocity (frame a) and spin (section axes), and at the end of the step

    M q"                        + to_nodes(h B^T [F; M])_force  - f = 0
    R (J q" + Omega x J Omega)  + to_nodes(h B^T [F; M])_moment - m = 0          S
                                [F; M] = strain + rate (strain rate)

The strain rate follows from the strains as q" does from v (Jansen, Whiting and Hulbert 2000):
damping is second order too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import cached
from ..core.leaves import leaf
from ..nodal import interactions
from ..nodal import loads as external
from ..nodal.conditions import Conditions, conditions
from ..nodal.element_loads import at_nodes
from ..state.state import State, plain
from .alpha_kinematics import EndKinematics, EndMotion, EndTangent, GeneralizedAlpha
from .step_element import EndElement
from .step_problem import StepProblem


@dataclass(frozen=True)
class AlphaState(State):
    """What the method remembers beside the state; stress and reaction are those at the state's
    instant.

    acceleration  (..., N+1, 2 w) q" and a: of position m/s^2, frame a, and of spin rad/s^2, section
                  axes, in the coordinates of the scene's space (w = 6; 3 in a plane)
    straining     (..., N, 2 k) strain rate 1/s and 1/(m s), and its algorithmic counterpart,
                  likewise (k = 6; 3 in a plane)
    """

    acceleration: Tensor = leaf(2)
    straining: Tensor = leaf(2)

    @classmethod
    def between(
        cls, state: State, velocity: Tensor, spin: Tensor, strain: Tensor, dt: Tensor
    ) -> AlphaState:
        """`state` with the mean rates up to a state a step later, over which velocity, spin and
        strain rose by so much (in the space's coordinates).
        """
        h = dt[..., None, None]
        mean = torch.cat((velocity, spin), -1) / h
        return cls(
            **vars(state),
            acceleration=torch.cat((mean, mean), -1),
            straining=torch.cat((strain, strain), -1) / h,
        )

    def plain(self) -> State:
        """What every method knows of the state."""
        return plain(self)


class EndUnknowns(NamedTuple):
    """u (..., N+1, p) m and m (..., N+1, ...) over the step, stress (..., N, k) N and N m."""

    u: Tensor
    m: Tensor
    stress: Tensor


@dataclass(frozen=True)
class GeneralizedAlphaProblem(StepProblem):
    """A step of dt (0-dim or (...)) from `start`, loads as at time t, its end, inputs held.
    before: of `known` conditions, those at the start; None = they are the same there.
    """

    start: AlphaState
    rho_inf: float = 0.8
    before: Conditions | None = None

    UNKNOWNS = EndUnknowns
    TANGENT = EndTangent
    INSTANT = 1.0
    PART = 1.0

    @cached
    def method(self) -> GeneralizedAlpha:
        """The coefficients."""
        return GeneralizedAlpha.of(self.rho_inf)

    @cached
    def motion(self) -> EndMotion:
        """The nodes at the end."""
        return EndMotion(self.model.inertia, self.start, self.h, self.method)

    @cached
    def element(self) -> EndElement:
        """The elements at the end."""
        return EndElement(*self.of_elements, self.start.straining, self.method)

    def predictor(self) -> EndUnknowns:
        """Constant velocity, and the stress of the step before."""
        turn = self.model.space.exponential(self.start.spin * self.h)
        return self.apply_supports(
            EndUnknowns(self.start.velocity * self.h, turn, self.start.stress)
        )

    def finish(self, x: EndUnknowns, reaction: Tensor) -> AlphaState:
        """The state at the end of the step; the work by the mean of the loads at its two ends."""
        model, space, start = self.model, self.model.space, self.start
        x = self.apply_supports(x)
        kinematics = self.motion.kinematics(x.u, x.m)
        v, true, a = kinematics.v, kinematics.true, kinematics.algorithmic
        p = space.dims.position
        moves = self.moves(kinematics)
        work = start.work + self.work(kinematics)
        for k, node in enumerate(self.support_motions.nodes):
            work = work + (
                (start.reaction[..., k, :] + reaction[..., k, :]) / 2 * moves[..., node, :]
            ).sum(-1)
        if not self.support_motions.nodes:
            free = torch.cat(
                (model.constraints.slide, model.constraints.turn.expand(-1, space.dims.spin)), -1
            )
            v, true, a = free * v, free * true, free * a
            v = torch.cat((v[..., :p], self.about_hinges(v[..., p:], kinematics.q_end)), -1)
        after = replace(
            start,
            position=kinematics.position_end,
            rotation=kinematics.q_end,
            velocity=v[..., :p],
            spin=v[..., p:],
            reaction=reaction,
            work=work,
            t=start.t + self.dt,
            acceleration=torch.cat((true, a), -1),
            straining=self.straining(kinematics),
        )
        return self.finished(after, x.stress, kinematics, start)

    def moves(self, kinematics: EndKinematics) -> Tensor:
        """(..., N+1, w) m and rad, by which loads do work over the step."""
        space, shift = self.model.space, kinematics.position_end - self.start.position
        turn = space.to_frame(kinematics.q_end, space.logarithm(kinematics.m))
        return torch.cat((shift, turn), -1)

    def work(self, kinematics: EndKinematics) -> Tensor | float:
        """(...) J of all loads over the step."""
        load = self.all_loads(kinematics)
        if isinstance(load, float):
            return load
        return ((self.external_before() + load) / 2 * self.moves(kinematics)).sum((-1, -2))

    @cached
    def conditions_before(self) -> Conditions:
        """At the start."""
        if self.known is not None:
            return replace(self.before or self.known, t=self.t - self.dt)
        return conditions(self.model, self.t - self.dt, self.inputs)

    def external_before(self) -> Tensor | float:
        """Loads at the nodes (..., N+1, w), at the start."""
        before = self.conditions_before
        nodes = self.motion.nodes_before(before.reads)
        load = external.external(self.model, nodes, before, total=before.dead)
        load = load + at_nodes(self.model, nodes, before) if before.between else load
        inner = interactions.Inner(None, self.start.memory)
        return interactions.at_nodes(self.model.space, nodes, before, load, inner)

    def straining(self, kinematics: EndKinematics) -> Tensor:
        """See `AlphaState`, at the end; nothing asks for it where strains are not damped."""
        model = self.model
        if not (model.topology.element_count and model.law.damped):
            return self.start.straining
        return torch.cat(
            self.element.rates(
                model.strain(model.kinematics(kinematics.position_end, kinematics.q_end))
            ),
            -1,
        )


torch.serialization.add_safe_globals([AlphaState])
