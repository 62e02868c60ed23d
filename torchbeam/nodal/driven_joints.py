"""Joints in which something acts: an effort along their coordinate, or a coordinate that is
prescribed.

The angle phi of a hinge follows from its own axes in both parts: with v = -F_a,y and w = F_b,z, sin
phi = v . w, and with w turned about x by alpha

    v . w(alpha) = sin(phi - alpha)        w(alpha) = cos alpha F_b,z + sin alpha F_b,y

Prescribed, it is one more row that is held, v . w(alpha) = 0 at the end of the step, sin going on
as 2 - sin beyond a right angle, where it would come to a second root. An effort tau,
and the force of that row, act along the gradient of v . w(m) at the mean of positions and axes, m
half way between the angles before and after: it does the work 2 sin((phi_{n+1} - phi_n)/2) tau over
the step, for products of vectors keep their difference there. A travel is a row by itself, whose
force does the work of its difference.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.leaves import leaf
from ..math.shapes import stacked
from ..scene.coordinate_law import Travel
from ..scene.effects.values import Inputs, scalar_at, value_at
from ..state.instant import READINGS
from .balls import BallLaws, Balls, BallStep
from .between_nodes import NodeMotion, Placed, Rates
from .coordinate_laws import CoordinateLaws
from .joint_inertia import Inertial, JointInertia
from .joint_laws import CoordinateStep, JointLaws
from .joint_motion import Factor, JointValues, Pose, Vector
from .joints import Joints
from .multipliers import CLOSED
from .rotation_vector import Turn


class Driven(NamedTuple):
    """What acts at one motion: the coordinates over the step; w where forces act and where joints
    are closed, and c there; the effort (..., J, w) along the coordinates, and its derivative by
    them; what joints remember after it (..., J, m), None = nothing; what inertia does, None = there
    is none.
    """

    step: CoordinateStep
    acting: Factor
    closing: Factor
    offset: Tensor
    effort: Tensor
    effort_by: Tensor
    memory: Tensor | None = None
    inertial: Inertial | None = None


@dataclass(frozen=True)
class DrivenJoints(Joints):
    """With `laws`; prescribed (J, w) 1 where a coordinate is, which `held` counts in; own_laws:
    of coordinates, that say by themselves what they resist by, None = there are none.
    """

    laws: JointLaws
    prescribed: Tensor = leaf(2)
    own_laws: CoordinateLaws | None = None

    @property
    def inertia(self) -> JointInertia | None:
        """Of their coordinates; None = there is none."""
        return None if self.laws.inertia is None else JointInertia(self, self.laws.inertia)

    def kinetic_energy(self, position: Tensor, rotation: Tensor, *moving: Tensor) -> Tensor:
        return self.inertia.kinetic_energy(position, rotation, *moving)

    def mass(self, matrix: Any, motion: NodeMotion) -> Any:
        return matrix if self.inertia is None else self.inertia.mass(matrix, motion)

    @property
    def dissipative(self) -> bool:
        """Whether there is damping or friction."""
        return self.own_laws is not None or any(laws.dissipative for laws in self._all_laws)

    @property
    def limited(self) -> bool:
        return any(laws.limit_stiffness is not None for laws in self._all_laws)

    @property
    def smooth(self) -> bool:
        remembers = self.own_laws is not None and self.own_laws.memory > 0
        return not (self.limited or self.has_friction or remembers)

    @property
    def has_friction(self) -> bool:
        return any(laws.friction is not None for laws in self._all_laws)

    @property
    def _all_laws(self) -> tuple[JointLaws | BallLaws, ...]:
        return (self.laws,) if self.balls is None else (self.laws, self.balls.laws)

    @property
    def acting_balls(self) -> Balls | None:
        """Balls in which something acts."""
        return self.balls if self.balls is not None and self.balls.act else None

    @property
    def turning_rows(self) -> Tensor:
        """(J, w) 1 in the rows of turns of balls, which their constraints and efforts have not."""
        if self.balls is None:
            return torch.zeros_like(self.held)
        rows = self.moves[:, 3:].abs().sum(-1).expand(len(self.balls.at), -1)
        return self.balls.to_joints(rows, -2, self.count)

    def driven(self, motion: Placed) -> Driven:
        of = motion.of
        values, near, goal, inertial = of.now.joints, self._near(of.state), None, None
        if values.coordinate is not None:
            goal = self.prescribed * of.raised(values.coordinate)
        near = goal if near is None else near
        if of.dt is None:
            after = self.coordinate(motion.end, near)
            step = CoordinateStep(after, after, self.angles > 0, None, None)
            inertial = self.inertia and self.inertia.at(motion.end, after, of.acceleration)
        else:
            before = self.coordinate(motion.start, near)
            after = self.coordinate(motion.end, before)
            rate = None if self.laws.friction is None else self.rate(motion.start, *of.moving())
            step = CoordinateStep(before, after, self.angles > 0, of.dt[..., None, None], rate)
            inertial = self.inertia and self.inertia.over(motion, step)
        effort, by, memory = *self.laws.effort(step), None
        if self.own_laws is not None:
            resistance, slope, memory = self._resistance(step, of)
            effort, by = effort - resistance, by - slope
        if of.dt is None and of.moving is not None and self.laws.dissipative:
            effort = effort - self.laws.damper * self.rate(motion.end, *of.moving())
        if values.effort is not None:
            effort = effort + self._coordinates * of.raised(values.effort)
        acting = self.turned(self._middle(step))
        closing, offset = self.w, self.c
        if goal is not None:
            turn, more = self._beyond(self.prescribed * self.angles * (step.after - goal))
            closing = self.turned(goal * self.angles + turn)
            offset = self.c + goal * self.travels - more
        return Driven(step, acting, closing, offset, effort, by, memory, inertial)

    def _resistance(self, step: CoordinateStep, of: NodeMotion) -> tuple[Tensor, Tensor, Tensor]:
        """Of `own_laws` (..., J, w), which their work over the step is counted by; the derivative
        by the coordinates after it; what joints remember then.
        """
        rows, travel = self._coordinates, self._travel(step, of)
        load, slope, memory = self.own_laws.response(travel)
        load, slope = rows * load[..., None], rows * slope[..., None]
        if step.dt is not None:
            ratio, ratio_by = step.arc()
            load, slope = load * ratio, slope * ratio + load * ratio_by
        return load, slope, memory

    def _travel(self, step: CoordinateStep, of: NodeMotion) -> Travel:
        """By the state before, None = joints were as drawn."""
        rows, state = self._coordinates, of.state
        after, before = (rows * step.after).sum(-1), (rows * step.before).sum(-1)
        memory, known = after.new_zeros(self.count, self.own_laws.memory), None
        if state is not None and state.joints is not None:
            memory, known = state.joints[..., READINGS:], (rows * self.given(state.joints)).sum(-1)
        if step.dt is None:
            before = torch.zeros_like(after) if known is None else known
        dt = None if step.dt is None else step.dt[..., 0]
        return Travel(before, after, memory, of.now.t, dt)

    def _with_memory(self, wrench: Tensor, motion: Placed) -> Tensor:
        if self.own_laws is None or not self.own_laws.memory:
            return wrench
        return stacked(wrench, self.driven(motion).memory, axis=-1)

    @staticmethod
    def _beyond(off: Tensor) -> tuple[Tensor, Tensor]:
        """Of angles rad that are `off` by more than a right angle: half a turn, and +-2, by which a
        gap goes on to grow instead of coming to a second root, sin -> 2 - sin; else 0.
        """
        off = (off - 2 * torch.pi * torch.round(off / (2 * torch.pi))).detach()
        beyond = (off.abs() > torch.pi / 2).to(off)
        return torch.pi * beyond, 2 * torch.sign(off) * beyond

    def balance(
        self, nodes: Tensor, gap: Tensor, stress: Tensor, motion: NodeMotion
    ) -> tuple[Tensor, Tensor]:
        placed = motion.placed(self.pose)
        driven = self.driven(placed)
        product = (self.v.at(placed.end).value * driven.closing.at(placed.end).value).sum(-1)
        nodes = self._load(placed.acting, driven.acting, self._forces(stress, driven), nodes)
        if driven.inertial is not None:
            both = driven.inertial.wrenches.unflatten(-1, (2, 6)) @ self.moves.mT
            nodes = self.framework.from_joints(both, nodes)
        if self.acting_balls is not None:
            M = self._ball_moment(placed)
            first, second = (torch.cat((torch.zeros_like(M), x), -1) for x in (-M, M))
            both = torch.stack((first, second), -2) @ self.moves.mT
            nodes = self.framework.from_joints(both, nodes)
        return nodes, stacked(gap, self.held * (product - driven.offset))

    def efforts(self, now: Any) -> Tensor | None:
        """Sizes of efforts as joints are drawn: given ones, of limits that exclude this, and of
        springs whose coordinates are off by rounding, a gap of `CLOSED`.
        """
        values, p = now.joints, self.space.dims.position
        drawn = torch.zeros_like(self.c)
        laws, _ = self.laws.effort(CoordinateStep(drawn, drawn, self.angles > 0, None, None))
        total = laws.abs() if values.effort is None else laws.abs() + values.effort.abs()
        if self.laws.stiffness is not None:
            turns = torch.arange(total.shape[-1], device=total.device) >= p
            unit = torch.where(turns, 1.0, self.size[..., None, None])
            total = total + CLOSED * self.laws.stiffness * unit
        force, moment = total[..., :p].sum(-1, True), total[..., p:].sum(-1, True)
        if self.acting_balls is not None and self.balls.laws.stiffness is not None:
            moment = moment + CLOSED * self.balls.laws.stiffness.abs().amax((-1, -2))[..., None]
        return torch.cat((force.expand(*force.shape[:-1], p), moment), -1)

    def blocks(self, motion: NodeMotion, force: Tensor) -> Tensor:
        rate, placed = motion.rate, motion.placed(self.pose)
        driven = self.driven(placed)
        force, inertial = self.held * force - driven.effort, driven.inertial
        by_end = self.coordinate_by(placed.end, driven.step.after)  # (..., J, m, 12)

        def more(v: Vector, push: Tensor) -> Tensor:
            """By the coordinate after the step: of the effort, and of the forces' direction."""
            middle = self._middle(driven.step) + torch.pi / 2 * self.angles
            across = self.gradient(v, self.turned(middle).at(placed.acting))
            turning = force[..., None] * (self.angles[..., None] * across)
            return (turning - rate * driven.effort_by[..., None] * push).mT @ by_end

        added = None if self.acting_balls is None else self._ball_stiffness(placed, rate)
        along = None
        if inertial is not None:
            tilt, force_by = self.inertia.by_moves(placed, driven.step.after, inertial.force)
            added, along = tilt if added is None else added + tilt, (inertial.along, force_by)
        return self._blocks(motion, driven.acting, driven.closing, force, more, added, along)

    def _ball_step(self, motion: Placed) -> BallStep:
        of, balls = motion.of, self.balls
        torque = spin = None
        if balls.torques:
            torque = balls.of(of.raised(of.now.joints.effort) @ self.moves[:, 3:], -2)
        after = balls.axes(motion.end).relative
        if of.dt is None:
            if of.moving is not None and balls.laws.dissipative:
                spin = self.spin(motion.end, *of.moving())
            return BallStep(after, after, None, spin, torque)
        if balls.laws.friction is not None:
            spin = self.spin(motion.start, *of.moving())
        return BallStep(balls.axes(motion.start).relative, after, of.dt[..., None], spin, torque)

    def _ball_moment(self, motion: Placed) -> Tensor:
        """M (..., J, 3) on first parts, frame a: of second parts its opposite."""
        M = self.balls.moment(self.balls.conjugate(self._ball_step(motion)), motion.acting)
        return self.balls.to_joints(M, -2, self.count)

    def _ball_stiffness(self, motion: Placed, rate: float) -> Tensor:
        """(..., J, 12, 12): what they add to the balances of both ends, by half the ends' moves."""
        by = self.balls.moment_by(self._ball_step(motion), motion.acting, motion.end, rate)
        none = torch.zeros_like(by[..., :3])
        by = torch.cat((none, by[..., :3], none, by[..., 3:]), -1)
        none = torch.zeros_like(by)
        return self.balls.to_joints(torch.cat((none, -by, none, by), -2), -3, self.count)

    def damping(self, matrix: Callable[[], Any], motion: NodeMotion) -> Any:
        """Of dampers, and of friction as it is next to no motion."""
        if not self.dissipative:
            return None
        placed, blocks = motion.placed(self.pose), 0.0
        step = self.driven(placed).step
        damper = self.laws.damper if self.laws.dissipative else None
        if self.own_laws is not None:
            more = self.own_laws.damper(self._travel(step, motion))
            more = None if more is None else self._coordinates * more[..., None]
            damper = more if damper is None else damper if more is None else damper + more
        if damper is not None:
            blocks = self.between_ends(self.coordinate_by(placed.end, step.after), damper)
        if self.balls is not None and self.balls.laws.dissipative:
            damper = self.balls.own_laws.damper[..., None]
            of_balls = self.between_ends(self.balls.spin_rows(placed.end), damper)
            blocks = blocks + self.balls.to_joints(of_balls, -5, self.count)
        return None if isinstance(blocks, float) else self.tied(matrix(), blocks)

    def between_ends(self, rows: Tensor, weight: Tensor) -> Tensor:
        """(..., J, 2, 2, w, w): rows^T weight rows of rows (..., J, n, 12) by displacement and spin
        of both ends, with a weight (..., J, n) of each.
        """
        w, by = self.space.unknowns, rows @ torch.block_diag(self.moves, self.moves).mT
        blocks = by.mT @ (weight[..., None] * by)
        return blocks.unflatten(-1, (2, w)).unflatten(-3, (2, w)).transpose(-3, -2)

    def acting(self, stress: Tensor, motion: Placed) -> tuple[Tensor, Factor]:
        driven = self.driven(motion)
        force = self._forces(stress, driven)
        if self.acting_balls is not None:  # as on a, in its axes
            M = self.balls.of(self._ball_moment(motion), -2)[..., None]
            moments = (self.balls.axes(motion.end).a.mT @ M)[..., 0] @ self.moves[:, 3:].mT
            force = force + self.balls.to_joints(moments, -2, self.count)
        last = stress.shape[-2] - self.behind
        parts = stress.narrow(-2, 0, last - self.count), force, stress.narrow(-2, last, self.behind)
        return stacked(*parts), driven.acting

    def wrench(self, motion: Placed, w: Factor, force: Tensor) -> Tensor:
        wrench = super().wrench(motion, w, (1 - self.turning_rows) * force)
        inertial = self.driven(motion).inertial if self.inertia else None
        if inertial is not None:
            wrench = wrench - self.on_second(motion, inertial.wrenches)
        if self.acting_balls is None:
            return wrench
        M = self._ball_moment(motion)
        return wrench - torch.cat((torch.zeros_like(M), M), -1)

    def held_rows(self, pose: Pose) -> Tensor:
        by = self.gradient(self.v.at(pose), self.w.at(pose))
        coordinate_by = self.coordinate_by(pose, self.coordinate(pose))
        return self._at_nodes(
            self.held, torch.where(self.prescribed[..., None] > 0, coordinate_by, by)
        )

    def gaps(self, pose: Pose, joints: Tensor) -> Tensor:
        wanted = self.given(joints)
        moved = self.coordinate(pose, wanted) - wanted
        return self._flat(torch.where(self.prescribed > 0, moved, self.gap(pose)))

    def after(self, motion: Placed) -> Tensor:
        return self.driven(motion).step.after

    def values(self, scene: Any, t: Tensor, inputs: Inputs, end: Tensor) -> JointValues:
        """Efforts at t, prescribed coordinates at `end`."""
        times = (("effort", t), ("prescribed", end))
        return JointValues(*(self.value(scene.joints, name, at, inputs) for name, at in times))

    def value(self, joints: tuple[Any, ...], name: str, t: Tensor, inputs: Inputs) -> Tensor | None:
        """(..., J, w) of what is given of each joint, in the rows of its coordinates."""
        total, balls = None, () if self.balls is None else self.balls.at
        values = [
            (k, None if k in balls else rows, getattr(joint.law(coordinate), name))
            for k, joint in enumerate(joints)
            for coordinate, rows in enumerate((self.first, self.second))
            if coordinate in joint.coordinates and not (coordinate and k in balls)
        ]
        for k, rows, value in values:
            if value is None:
                continue
            if rows is None:  # of a torque its numbers, in the rows of turns
                numbers = value_at(value, t, inputs, self.c) @ self.moves[:, 3:].mT
                numbers = numbers[..., None, :]
            else:
                numbers = scalar_at("what acts in a joint", value, t, inputs, self.c)
                numbers = numbers[..., None, None] * rows
            part = numbers * (torch.arange(self.count, device=numbers.device) == k)[:, None]
            total = part if total is None else total + part
        return total

    def finished(
        self, fields: dict[str, Any], motion: NodeMotion, before: Any, moving: Rates | None
    ) -> dict[str, Any]:
        fields = super().finished(fields, motion, before, moving)
        if "work" not in fields:
            return fields
        work = self.work(fields["stress"], motion.placed(self.pose), before)
        return fields | {"work": fields["work"] + work}

    def work(self, stress: Tensor, motion: Placed, before: Any) -> Tensor:
        """(...) J over a step after which the forces are those; before: the state at its start,
        where they act at its ends, else None.
        """
        step = self.driven(motion).step
        force, travelled = self.forces(stress), step.difference()[0]
        if before is not None:
            force = (force + self.forces(before.stress)) / 2
            travelled = step.after - self.coordinate(motion.start, step.after)
        total = -(force * self._coordinates * travelled).sum((-1, -2))
        if self.acting_balls is None:
            return total
        ball = self._ball_step(motion)
        if before is None:
            change = ball.after - ball.before
            return total - (self.balls.conjugate(ball) * change).sum((-1, -2, -3))
        start = self.balls.axes(motion.start).relative
        turn = Turn.of(ball.after - start).y  # of small rotations
        turn = Turn.of(ball.after @ start.mT).vector if self.space.turns else turn
        turn = turn @ self.moves[:, 3:].mT
        return total - (self.balls.of(force, -2) * turn).sum((-1, -2))

    @property
    def _coordinates(self) -> Tensor:
        return self.angles + self.travels

    def _forces(self, stress: Tensor, driven: Driven) -> Tensor:
        return self.held * self.forces(stress) - driven.effort

    def _middle(self, step: CoordinateStep) -> Tensor:
        """(..., J, w) rad"""
        return (step.before + step.after) / 2 * self.angles
