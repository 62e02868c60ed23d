"""Inertia along joints' coordinates: what rates gain over a step, the kinetic energy, the mass of
small motions.

A coordinate q, the product v . w of `joints` with w turned by q, has the rate r = (v . w)' of nodes
that move with V, displacement and spin; V . H, its derivative by where they are, has the turning
parts t of both vectors, which spins s move with s x t:

    r = v' . w + v . w'        V . H = w d(v') + v' dw + v d(w') + w' dv,    d(s x t) = s x (d x t)

An inertia A is that of T = A r^2/2, of both parts' relative motion alone: what it takes from one
part the other one gets. Without a part that it turns, as that of a motor's rotor against its
support, its axis has no angular momentum (the armature of MuJoCo and Featherstone 2008, section
9.6).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..math.quaternions import skew
from .between_nodes import NodeMotion, Placed, Where
from .joint_laws import JointLaws
from .joint_motion import Factor, Pose, columns
from .joints import Joints, along


@dataclass(frozen=True)
class InertialJoints(Joints):
    """With `laws`, of which some may have an inertia."""

    laws: JointLaws

    @property
    def has_inertia(self) -> bool:
        return self.laws.inertia is not None

    def gain(self, motion: Placed, before: Tensor, after: Tensor) -> Tensor | None:
        """(..., J, w) m/s or rad/s, what the rates of coordinates (..., J, w) gain over a step;
        None = nothing asks for it.
        """
        if self.laws.inertia is None:
            return None
        start, end = motion.of.rates()
        return self._rate(motion.end, after, end) - self._rate(motion.start, before, start)

    def _rate(self, pose: Pose, coordinate: Tensor, moving: Where) -> Tensor:
        """(..., J, w) of nodes with velocity and spin (..., N+1, *) at closed joints."""
        w = self.turned(coordinate * self.angles)
        by = self._gradient(self.v.at(pose), w.at(pose))
        return (self.angles + self.travels) * (by @ self._both(moving)[..., None])[..., 0]

    def _both(self, moving: Where) -> Tensor:
        """(..., J, 12) velocity and spin of both ends, in space."""
        return self._moving(*moving).flatten(-2)

    def inertial_forces_by(self, motion: Placed, after: Tensor) -> Tensor | None:
        """(..., J, 2, w, w) of forces against the coordinates by moves of both nodes, in the place
        of the latter third from the last; None = there are none.
        """
        inertia, of = self.laws.inertia, motion.of
        if inertia is None or of.dt is None:
            return None
        moving, half = self._both(of.rates()[1]), of.half_turns()
        E = torch.block_diag(self.moves, self.moves)
        by_pose = of.rate * self._rate_by(motion.end, after, moving)
        w = self.turned(after * self.angles).at(motion.end)
        moves = self.framework.at_joints(of.by_move().flatten(-2))
        moves = moves.unflatten(-1, (self.space.unknowns, -1))
        by = columns(self._gradient(self.v.at(motion.end), w), E, moves)
        by = by + columns(by_pose, E, None if half is None else self._spins(half))
        mass = (self.angles + self.travels) * inertia / of.dt[..., None, None]
        return mass[..., None, :, None] * by

    def _rate_by(self, pose: Pose, coordinate: Tensor, moving: Tensor) -> Tensor:
        """(..., J, w, 12) by displacement and spin of both ends that move with `moving`
        (..., J, 12).
        """
        angle = coordinate * self.angles
        v, v_by, speed, speed_by = self._moved(self.v, pose, moving)
        w, w_by, turning, turning_by = self._moved(self.turned(angle), pose, moving)
        by = along(w, speed_by) + along(speed, w_by) + along(v, turning_by) + along(turning, v_by)
        across = self.turned(angle + torch.pi / 2 * self.angles).at(pose)
        across = self.angles[..., None] * self._gradient(self.v.at(pose), across)
        rate = (across @ moving[..., None])[..., 0]
        return by + rate[..., None] * self.coordinate_by(pose, coordinate)

    @staticmethod
    def _moved(factor: Factor, pose: Pose, moving: Tensor) -> tuple[Tensor, ...]:
        """A vector and its rate (..., J, m, 3), with their derivatives (..., J, m, 3, 12): the
        vector, its derivative, the rate, that of the rate.
        """
        value, turning = factor.at(pose)
        by = factor.by_moves(turning)
        rate = (by @ moving[..., None, :, None])[..., 0]
        _, a, _, b = by.split(3, -1)
        spin_a, spin_b = (skew(s)[..., None, :, :] for s in (moving[..., 3:6], moving[..., 9:]))
        a, b = spin_a @ a, spin_b @ b
        none = torch.zeros_like(a)
        return value, by, rate, torch.cat((none, a, none, b), -1)

    def kinetic_energy(self, position: Tensor, rotation: Tensor, *moving: Tensor) -> Tensor | float:
        if self.laws.inertia is None:
            return 0.0
        pose, (velocity, spin) = self.pose(position, rotation), moving
        rate = self._rate(
            pose, self.coordinate(pose), (velocity, self.space.to_frame(rotation, spin))
        )
        return (self.laws.inertia * rate**2).sum((-1, -2)) / 2

    def mass(self, matrix: Any, motion: NodeMotion) -> Any:
        if self.laws.inertia is None:
            return matrix
        pose = motion.placed(self.pose).end
        by = self.coordinate_by(pose, self.coordinate(pose))
        return self.tied(matrix, self.between_ends(by, self.laws.inertia))

    def between_ends(self, rows: Tensor, weight: Tensor) -> Tensor:
        """(..., J, 2, 2, w, w): rows^T weight rows of rows (..., J, n, 12) by displacement and spin
        of both ends, with a weight (..., J, n) of each.
        """
        w, by = self.space.unknowns, rows @ torch.block_diag(self.moves, self.moves).mT
        blocks = by.mT @ (weight[..., None] * by)
        return blocks.unflatten(-1, (2, w)).unflatten(-3, (2, w)).transpose(-3, -2)
