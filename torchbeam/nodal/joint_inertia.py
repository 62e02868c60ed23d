"""Inertia along joints' coordinates: what acts over a step, kinetic energy, mass of small motions.

An inertia A of a coordinate q is that of T = A q'^2/2: of the motion of one part against the other
alone. It is a rotor's behind a gear, or the armature of a motor (Featherstone 2008, section 9.6):
what it takes from one part it gives the other, and its spin has no gyroscopic moment. With the
rates r that nodes' velocities make at both ends of a step, and g the derivative of q,

    force    -A (r_{n+1} - r_n)/dt along        (g_n + g_{n+1})/2 of an angle
                                                g at the means of positions and axes of a travel

The impulses add up to A r, whatever the step. A hinge's g are spins about an axis that is fixed in
both parts, e; their sections turn by Theta_a and Theta_b in frame a over the step, and dt (r_n +
r_{n+1})/2 is e . (Theta_b - Theta_a) with the mean e. So the force takes A r^2/2, to rounding. That
of a slider does so where its axis does not turn, else to second order; so does that of a universal
joint.

With q = v . w of `joints`, w turned by q, and nodes that move with V, displacement and spin,

    r = v' . w + v . w'         dr = w d(v') + v' dw + v d(w') + w' dv + g dV

where what of v and w turns with a node of the spin s, t, has t' = s x t and d(t') = s x dt.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..math.quaternions import skew
from .between_nodes import NodeMotion, Placed, Rates, Where
from .joint_laws import CoordinateStep
from .joint_motion import Factor, Pose, along, columns
from .joints import Joints


class Inertial(NamedTuple):
    """Forces against coordinates (..., J, w) N or N m, and what they act along (..., J, w, 12), by
    displacement and spin of both ends.
    """

    force: Tensor
    along: Tensor

    @property
    def wrenches(self) -> Tensor:
        """(..., J, 12) that the balances of both ends have of them."""
        return (self.force[..., None] * self.along).sum(-2)


@dataclass(frozen=True)
class JointInertia:
    """Of joints, of their coordinates (..., J, w) kg m^2 or kg."""

    joints: Joints
    inertia: Tensor

    def over(self, motion: Placed, step: CoordinateStep) -> Inertial:
        """What it does over a step."""
        joints, (before, after) = self.joints, motion.of.rates()
        ends = (motion.start, step.before, before), (motion.end, step.after, after)
        start, end = (self._coordinates_by(pose, q) for pose, q, _ in ends)
        gain = self._rates(end, after) - self._rates(start, before)
        means = self._coordinates_by(motion.acting, torch.zeros_like(step.after))
        angles, travels = joints.angles[..., None], joints.travels[..., None]
        means = travels * means + angles * (start + end) / 2
        return Inertial(self.inertia * gain / step.dt, means)

    def at(self, pose: Pose, at: Tensor, acceleration: Rates | None) -> Inertial | None:
        """What it does at rest; None = no acceleration is known."""
        if acceleration is None:
            return None
        by = self._coordinates_by(pose, at)
        return Inertial(self.inertia * self._rates(by, acceleration()), by)

    def _coordinates_by(self, pose: Pose, coordinate: Tensor) -> Tensor:
        """(..., J, w, 12) the derivative by displacement and spin of both ends of closed joints."""
        joints = self.joints
        w = joints.turned(coordinate * joints.angles).at(pose)
        return (joints.angles + joints.travels)[..., None] * joints.gradient(joints.v.at(pose), w)

    def _rates(self, by: Tensor, moving: Where) -> Tensor:
        """(..., J, w) of nodes with velocity and spin (..., N+1, *), by such derivatives."""
        return (by @ self.joints.moving(*moving).flatten(-2)[..., None])[..., 0]

    def by_moves(self, motion: Placed, after: Tensor, force: Tensor) -> tuple[Tensor, Tensor]:
        """(..., J, 12, 12): what the wrenches of a step change by where forces stay as they are, by
        half the moves of ends; (..., J, 2, w, w) by what these change, by the moves of both nodes.
        """
        joints, of, end, rate = self.joints, motion.of, motion.end, motion.of.rate
        moving, half = joints.moving(*of.rates()[1]).flatten(-2), of.half_turns()
        angle, right = after * joints.angles, torch.pi / 2 * joints.angles
        turned = joints.turned(angle)
        v, v_by, speed, speed_by = _moved(joints.v, end, moving)
        w, w_by, turning, turning_by = _moved(turned, end, moving)
        across = joints.angles[..., None] * self._coordinates_by(end, after + right)
        by_end = joints.coordinate_by(end, after)
        # of an angle what acts along the derivative at the end turns with it, of a travel at mid
        sides = ((motion.acting, joints.w, joints.travels), (end, turned, joints.angles))
        tilt = (force[..., None] * across).mT @ by_end
        for pose, factor, rows in sides:
            at = joints.v.at(pose), factor.at(pose)
            ends = joints.v.at(end), factor.at(end)
            by = joints.v.by_moves(ends[0].turning), factor.by_moves(ends[1].turning)
            tilt = tilt + joints.curvature(*at, *by, *ends, rows * force)
        by = along(w.value, speed_by) + along(speed, w_by)
        by = by + along(v.value, turning_by) + along(turning, v_by)
        by = by + (across @ moving[..., None]) * by_end
        E = torch.block_diag(joints.moves, joints.moves)
        moves = joints.framework.at_joints(of.by_move().flatten(-2))
        moves = moves.unflatten(-1, (joints.space.unknowns, -1))
        by = rate * columns(by, E, None if half is None else joints.spins(half))
        by = by + columns(self._coordinates_by(end, after), E, moves)
        mass = (joints.angles + joints.travels) * self.inertia / of.dt[..., None, None]
        return tilt, mass[..., None, :, None] * by

    def kinetic_energy(self, position: Tensor, rotation: Tensor, *moving: Tensor) -> Tensor:
        """(...) J of nodes that move with velocity and spin (..., N+1, *), axes of sections."""
        joints, (velocity, spin) = self.joints, moving
        pose, spin = joints.pose(position, rotation), joints.space.to_frame(rotation, spin)
        rate = self._rates(joints.coordinate_by(pose, joints.coordinate(pose)), (velocity, spin))
        return (self.inertia * rate**2).sum((-1, -2)) / 2

    def mass(self, matrix: Any, motion: NodeMotion) -> Any:
        """A mass matrix with its own, at rest."""
        joints = self.joints
        pose = motion.placed(joints.pose).end
        by = joints.coordinate_by(pose, joints.coordinate(pose))
        return joints.tied(matrix, joints.between_ends(by, self.inertia))


def _moved(factor: Factor, pose: Pose, moving: Tensor) -> tuple[Any, Tensor, Tensor, Tensor]:
    """A vector of ends that move (..., J, 12); its derivative (..., J, m, 3, 12) by the moves of
    these, its rate (..., J, m, 3), and the derivative of that.
    """
    vector = factor.at(pose)
    by = factor.by_moves(vector.turning)
    _, a, _, b = by.split(3, -1)
    a, b = (
        skew(spin)[..., None, :, :] @ x for spin, x in ((moving[..., 3:6], a), (moving[..., 9:], b))
    )
    none = torch.zeros_like(a)
    if pose.drawn is not None:
        a = b = none
    rate_by = torch.cat((none, a, none, b), -1)
    return vector, by, (by @ moving[..., None, :, None])[..., 0], rate_by
