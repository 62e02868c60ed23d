"""One implicit step of the nodal form, whatever the method: where its nodes, its supports and its
loads are.

Unknown are u and m, from the start to where the forces are in balance, at mid step or at the end,
and the stress.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..core.derivatives import cached
from ..core.leaves import leaf
from ..nodal import element_loads, interactions
from ..nodal import loads as external
from ..nodal.balance import Residual
from ..nodal.between_nodes import NodeMotion, Told, Where
from ..nodal.conditions import Conditions, conditions
from ..nodal.inertia import InertiaForces
from ..nodal.loads import Nodes
from ..scene.effects import Inputs
from ..state.state import State
from ..state.supported_nodes import set_node
from ..topology.protocols import Matrix, total
from .balance_problem import BalanceProblem
from .step_element import DIGITS
from .step_kinematics import SupportMotions, support_motions


@dataclass(frozen=True)
class StepProblem(BalanceProblem):
    """A step of length dt (0-dim or (...)) from `start`, with loads as at time t (0-dim, or (...)
    each sample's own) and inputs held over it.

    A method says how its nodes (`motion`, `TANGENT`) and elements (`element`) move, where it starts
    (`predictor`) and what the state after it is (`finish`).

    UNKNOWNS  u (..., N+1, p) m, m (..., N+1, ...), stress (..., N, k)
    TANGENT   derivatives of the nodes' motion
    INSTANT   of the step: when loads are taken
    PART      of the step's motion and rotation: what the unknowns u and m hold
    """

    start: State
    dt: Tensor = leaf(0)
    t: Tensor = leaf(0)
    inputs: Inputs = leaf(1)
    told: Told | None = leaf(2, default=None, kw_only=True)

    UNKNOWNS: ClassVar[type]
    TANGENT: ClassVar[type]
    INSTANT: ClassVar[float]
    PART: ClassVar[float]

    @property
    def motion(self) -> Any:
        """The nodes over the step."""
        raise NotImplementedError

    @property
    def of_elements(self) -> tuple[Any, ...]:
        """The fields of a `StepElement`."""
        model, start = self.model, self.start
        poses = model.assembly.poses(start.position, start.rotation)
        at_rest = model.space, model.law, model.length, model.reference, self.eigenstrain
        return *at_rest, self.h, poses, start.inelastic

    def predictor(self) -> Any:
        """Unknowns to start from."""
        raise NotImplementedError

    def finish(self, x: Any, reaction: Tensor) -> State:
        """The state at the end of the step."""
        raise NotImplementedError

    @cached
    def h(self) -> Tensor:
        """dt as (..., 1, 1)."""
        return self.dt[..., None, None]

    @cached
    def C(self) -> Tensor:
        if self.known is not None:
            return self.stiffness
        return self.model.tangent_stiffness(self.dt.detach())

    @cached
    def conditions(self) -> Conditions:
        """Of the instant at which loads are taken, and of supports at the end."""
        if self.known is not None:
            return self.known
        return conditions(self.model, self.t, self.inputs, self.t + (1 - self.INSTANT) * self.dt)

    @cached
    def support_motions(self) -> SupportMotions:
        """The supports that move, in frame a or with it."""
        return support_motions(self.model.space, self.conditions.supports, self.start, self.PART)

    def apply_supports(self, x: Any) -> Any:
        u, m = x.u, x.m
        for support in self.support_motions.poses:
            u = set_node(
                u, support.node, torch.where(support.position, support.u, u[..., support.node, :])
            )
            m = set_node(m, support.node, support.m) if support.rotation else m
        space = self.model.space
        for at, axis in self.model.constraints.hinges:
            m = set_node(
                m,
                at,
                space.of_nodes(at).hinged_turn(
                    m[..., at, :], self.start.rotation[..., at, :], axis
                ),
            )
        return x._replace(u=u, m=m)

    def about_hinges(self, spin: Tensor, rotation: Tensor) -> Tensor:
        """spin (..., N+1, s), section axes, of which hinges leave what is about their axis."""
        for at, axis in self.model.constraints.hinges:
            about_axis = self.model.space.of_nodes(at).about(
                rotation[..., at, :], spin[..., at, :], axis
            )
            spin = set_node(spin, at, about_axis)
        return spin

    @cached
    def _dead(self) -> Tensor | float:
        start = self.start
        nodes = Nodes(
            start.position,
            start.rotation,
            frame=self._frame_middle,
            internal=start.internal,
            dt=self.dt,
        )
        now = self.conditions
        return external.external(self.model, nodes, now, now.still, now.dead)

    @cached
    def _frame_middle(self) -> Tensor | None:
        turned = self.conditions.orientation
        return self.frame.orientation(self.start.frame, self.dt / 2) if turned is None else turned

    def rest_guess(self) -> Any:
        """Standing still: what a failed sample is differentiated at."""
        u = torch.zeros_like(self.start.position)
        return self.UNKNOWNS(u, self.model.space.identity(u), torch.zeros_like(self.start.stress))

    def update(self, x: Any, move: Tensor, dstress: Tensor) -> Any:
        """x after a move of the configuration whose forces are in balance; a spin s in frame a
        turns R_n R(m) from the left.
        """
        space = self.model.space
        turn = space.to_section(self.start.rotation, move[..., space.dims.position :])
        return self.UNKNOWNS(
            x.u + move[..., : space.dims.position],
            space.multiply(space.cayley(turn), x.m),
            x.stress + dstress,
        )

    def nodes(self, kinematics: Any, reads: frozenset[str] | None = None) -> Nodes:
        nodes = self.motion.nodes(kinematics, self.conditions.reads if reads is None else reads)
        dt = self.dt if self.INSTANT == 0.5 else None
        return nodes._replace(
            frame=self._frame_middle, internal=self.start.internal, dt=dt, told=self.told or {}
        )

    def merit(self, residual: Residual) -> Tensor | None:
        if not self.model.touches:
            return None
        return residual.square(self.model.spans.detach().amax((-1, -2)))

    def near(self, x: Any) -> Tensor:
        x = self.apply_supports(x)
        kinematics, now = self.motion.kinematics(x.u, x.m), self.conditions
        motion = self.node_motion(kinematics)
        each = [act.near_enough(motion) for act in self.model.interactions]
        if now.between:
            each.append(~self.idle(kinematics))
        each.append(self.body_near(kinematics))
        none = torch.zeros_like(self.dt, dtype=torch.bool)
        return none if (near := _any(each)) is None else near

    def between(self, last: Any, x: Any, share: Tensor) -> Any:
        u, m, stress = (
            torch.lerp(a, b, share[..., None, None]) for a, b in zip(last, x, strict=True)
        )
        return self.UNKNOWNS(u, self.model.space.normalize(m), stress)

    def telling(self, kinematics: Any, *_: Any) -> Told:
        told: dict[str, Tensor] = {}
        acts = self.model.interactions
        if not any(act.dissipative for act in acts) and not self.model.has_friction:
            return told
        motion, nodes = self.node_motion(kinematics), self.nodes(kinematics)
        for act in acts:
            told |= act.telling(motion)
        scene = self.model, nodes, self.conditions
        told |= external.telling(*scene) | element_loads.telling(*scene)
        return element_loads.forgotten(self.model, told, motion.way(), self.conditions)

    def after(self, told: Told) -> StepProblem:
        new = copy(self)  # with what it has cached, which does not depend on it
        vars(new)["told"] = told
        return new

    def seen(self, x: Any) -> Nodes:
        """`nodes` of the unknowns."""
        x = self.apply_supports(x)
        return self.nodes(self.motion.kinematics(x.u, x.m))

    def external(self, kinematics: Any) -> Tensor | float:
        """Loads at the nodes (..., N+1, w)."""
        now = self.conditions
        return (
            self._dead + external.external(self.model, self.nodes(kinematics), now, now.moving)
            if now.moving
            else self._dead
        )

    def all_loads(self, kinematics: Any) -> Tensor | float:
        """`external` with the loads between nodes."""
        load, between = self.external(kinematics), self.element_loads(kinematics)
        load = load if between is None else load + self.model.topology.scatter(between)
        now = self.conditions
        if not now.interactions:
            return load
        inner = interactions.Inner(None, self.start.memory, self.node_motion(kinematics).dt)
        return interactions.at_nodes(self.model.space, self.nodes(kinematics), now, load, inner)

    def node_balance(self, x: Any) -> tuple[Any, InertiaForces, Tensor | float]:
        kinematics = self.motion.kinematics(x.u, x.m)
        return kinematics, self.motion.balance(kinematics), self.external(kinematics)

    def node_tangent(self, kinematics: Any, inertia: InertiaForces) -> tuple[Any, Matrix]:
        nodes = self.TANGENT(self.motion, kinematics)
        matrix = nodes.inertia(inertia)
        if self.conditions.moving:
            matrix = matrix.minus(self.load_tangent(nodes))
        return nodes, total(matrix, self.element_load_matrix(kinematics, nodes))

    def node_motion(self, kinematics: Any, nodes: Any = None) -> NodeMotion:
        start, mean = self.start, self.INSTANT < 1

        def of_motion() -> Any:
            return self.TANGENT(self.motion, kinematics) if nodes is None else nodes

        return NodeMotion(
            self.conditions,
            lambda reads: self.nodes(kinematics, reads),
            lambda reads: self.motion_by(of_motion(), reads),
            (kinematics.position_end, kinematics.q_end),
            (start.position, start.rotation),
            mean,
            dt=self.dt if mean else None,
            moving=lambda: self.relative_motion(start),
            state=start,
            path=lambda: (
                self.h * self.frame.relative_velocity(kinematics.velocity, kinematics.position)
            ),
            way=lambda: self._way(kinematics),
            half=(lambda: of_motion().half) if mean else None,
            rates=(lambda: self._rates(kinematics)) if mean else None,
            by_move=(lambda: of_motion().rates_end) if mean else None,
            told=self.told or {},
        )

    def _rates(self, kinematics: Any) -> tuple[Where, Where]:
        """See `NodeMotion`."""
        start, spin_of = self.start, self.model.space.to_frame
        return (
            (start.velocity, spin_of(start.rotation, start.spin)),
            (kinematics.velocity_end, spin_of(kinematics.q_end, kinematics.spin_end)),
        )

    def finished(
        self, after: State, stress: Tensor, kinematics: Any, before: State | None = None
    ) -> State:
        """The state after the step with what is between nodes has; before: where forces act at
        the ends of the step, its start.
        """
        motion = self.node_motion(kinematics)
        fields = {
            "stress": stress,
            "work": after.work,
            **self.crept(after.position, after.rotation),
        }
        moves = partial(self.relative_motion, after)
        return replace(after, **self.model.finished(fields, motion, before, moves))

    def crept(self, position: Tensor, rotation: Tensor) -> dict[str, Tensor]:
        """What elements remember after the step, where their stress relaxes."""
        model = self.model
        if not model.station_count or model.law.arms is None:
            return {}
        strain = model.strain(model.kinematics(position, rotation))
        return {"inelastic": self.element.advanced(strain)}

    def relative_motion(self, state: State) -> tuple[Tensor, Tensor]:
        """Velocity and spin of the nodes (..., N+1, *), as seen in frame a."""
        spin = self.frame.relative_spin(state.spin, state.rotation)
        velocity = self.frame.relative_velocity(state.velocity, state.position)
        return velocity, self.model.space.to_frame(state.rotation, spin)

    def load_tangent(self, nodes: Any) -> Tensor | float:
        """Derivative of `external` by the nodes' moves, (..., N+1, w, w)."""
        by = self.motion_by(nodes)
        return external.tangent(self.model, self.nodes(nodes.kinematics), self.conditions, by)

    def motion_by(self, nodes: Any, reads: frozenset[str] | None = None) -> external.MotionJacobian:
        return external.motion_jacobian(nodes, self.conditions.reads if reads is None else reads)

    def passed_through(self, kinematics: Any) -> Tensor | None:
        now, motion = self.conditions, self.node_motion(kinematics)
        each = [act.passed_through(motion) for act in self.model.interactions]
        if now.between:
            each.append(element_loads.passed_through(self.model, self._way(kinematics), now))
        each.append(self.body_passed_through(kinematics))
        return _any(each)

    def body_passed_through(self, kinematics: Any) -> Tensor | None:
        """`passed_through` of bodies and obstacles."""
        return element_loads.body_passed_through(self.model, self._way(kinematics), self.conditions)

    def body_near(self, kinematics: Any) -> Tensor | None:
        """`near` of bodies and obstacles."""
        return element_loads.body_near(self.model, self._way(kinematics), self.conditions)

    @cached
    def rounding(self) -> Tensor:
        """Of a beam that flies on, the rounding of its momenta over a step is all that there is."""
        start, inertia, dims = self.start, self.model.inertia, self.model.space.dims

        def size(x: Tensor) -> Tensor:
            return x.detach().abs().sum(-1, keepdim=True)

        linear = inertia.mass.detach() * size(start.velocity)
        angular = torch.zeros_like(linear)
        if inertia.offset.present:
            linear = linear + inertia.mass.detach() * inertia.offset.by_arm(size(start.spin))
            angular = inertia.offset.by_arm(linear)
        if inertia.rotary.present:
            angular = angular + size(inertia.rotary.section_momentum(start.spin))
        share = DIGITS * torch.finfo(linear.dtype).eps / self.h.detach().abs()
        shape = linear.shape[:-1]
        momenta = linear.expand(*shape, dims.position), angular.expand(*shape, dims.spin)
        return share * torch.cat(momenta, -1)

    def _way(self, kinematics: Any) -> element_loads.Way:
        """Of the nodes over the step, in frame a."""
        start = self.start.position
        if self.PART == 0.5:
            return element_loads.Way(kinematics.position, kinematics.position - start, self.dt)
        half = (kinematics.position_end - start) / 2
        return element_loads.Way(start + half, half, self.dt)


def _any(each: list[Tensor | None]) -> Tensor | None:
    """(...) bool: whether one of those that are there is true; None where none is."""
    each = [x for x in each if x is not None]
    return torch.stack(torch.broadcast_tensors(*each)).any(0) if each else None
