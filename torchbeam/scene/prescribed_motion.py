"""Prescribed motion: of frame a, and of the supports in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..core.functions_of_time import at_time, taken, with_rate, with_user_rate, within_dual_numbers
from ..core.leaves import with_values
from ..core.validation import concrete
from ..math import quaternions as quat
from ..math.quaternions import cross
from .effects import Pose
from .frame_turn import turn_between
from .supports import Support

STILL = 1e-6  # rad, and m: a support that is no further from where the beam has it has not begun


@dataclass(frozen=True)
class PrescribedMotion:
    """A scene's prescribed motions as functions of t, 0-dim or one of each sample; frame a. Their
    rates are exact, see `functions_of_time.with_rate`.
    """

    scene: Any

    def frame(self, t: Tensor) -> tuple[Tensor | None, Tensor | None]:
        """v (..., 3) m/s and omega (..., 3) rad/s of frame a; None = at rest."""
        frame = self.scene.frame
        rates = (None, None) if frame is None else (frame.velocity, frame.angular_velocity)
        return tuple(None if x is None else self._value(x, t) for x in rates)

    def turn(self, start: Tensor, end: Tensor) -> Tensor:
        """Quaternion (..., 4) by which frame a, which turns, does so from `start` to `end` (...) s,
        in its axes at `start`.
        """
        omega = self.scene.frame.angular_velocity
        if not callable(omega):
            return quat.exponential(omega * (end - start)[..., None])
        return turn_between(lambda t: self._value(omega, t), start, end)

    def pose(
        self,
        support: Support,
        t: Tensor,
        share: Tensor | float = 1.0,
        start: tuple[Tensor, Tensor] | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Position (..., 3) and quaternion (..., 4) of a support, after a share of its motion from
        where the beam has the node; or of the way from `start`, a pose likewise, turned the shorter
        way about one axis, where that is another.
        """
        beam = self.scene.beam
        position, rotation = beam.nodes[..., support.node, :], beam.frames[..., support.node, :]
        motion = self.displacement(support, t)
        pose = moved(position, rotation, *motion, share)
        if start is None or not support.displaced:
            return pose
        end, left = moved(position, rotation, *motion), 1 - share
        away = quat.logarithm(quat.multiply(start[1], quat.conjugate(end[1])))
        way = (
            end[0] + left * (start[0] - end[0]),
            quat.multiply(quat.exponential(left * away), end[1]),
        )
        begun = ~still(start, (position, rotation))[..., None]
        return torch.where(begun, way[0], pose[0]), torch.where(begun, way[1], pose[1])

    def displacement(self, support: Support, t: Tensor) -> tuple[Tensor | None, Tensor | None]:
        """Displacement m and turn rad (..., 3) of a support; None = none."""
        moves = support.displacement, support.turn
        return tuple(None if x is None else self._value(x, t) for x in moves)

    def rates(self, support: Support, t: Tensor) -> tuple[Tensor, Tensor]:
        """Velocity and spin (..., 3) of a support in frame a, in its axes, relative to it."""
        still = torch.zeros_like(self.scene.beam.nodes[..., support.node, :])
        velocity = spin = still
        if callable(support.displacement):
            _, velocity = self._moving("a displacement", support.displacement, t)
        if callable(support.turn):
            phi, rate = self._moving("a rotation", support.turn, t)
            spin = quat.spin_of_vector(phi, rate)
        return velocity, spin

    def absolute(self, support: Support, t: Tensor) -> tuple[Tensor, Tensor]:
        """Absolute velocity (..., 3), frame a, and spin (..., 3), section axes, of a clamp."""
        position, rotation = self.pose(support, t)
        velocity = spin = torch.zeros_like(position)
        if support.moves:
            velocity, spin = self.rates(support, t)
        v, omega = self.frame(t)
        if v is not None:
            velocity = velocity + v
        if omega is not None:
            velocity = velocity + cross(omega, position)
            spin = spin + omega
        return velocity, quat.rotate(quat.conjugate(rotation), spin)

    def acceleration(self, support: Support, t: Tensor) -> Tensor:
        """Rates (..., 2, 3) of a clamp's absolute velocity and spin, absolute, frame a."""

        def motion(now: Tensor) -> Tensor:
            v, spin = self.absolute(support, now)
            spin = quat.rotate(self.pose(support, now)[1], spin)
            return torch.stack(torch.broadcast_tensors(v, spin), -2)

        now, rate = with_rate(motion, t)
        omega = self.frame(t)[1]
        return rate if omega is None else rate + cross(omega[..., None, :], now)

    def root_pose(self, t: Tensor) -> Pose:
        """Pose of the support of node 0, for elastic clamps."""
        root, beam = self.scene.root, self.scene.beam
        if root is None and self.scene.frame is None:  # it rests where the beam has it
            position, rotation = beam.nodes[..., 0, :], beam.frames[..., 0, :]
            zero = torch.zeros_like(position)
            return Pose(position, quat.matrix(rotation), zero, zero)
        support = Support(0)
        if root is not None:
            support = with_values(support, displacement=root.displacement, turn=root.rotation)
        position, rotation = self.pose(support, t)
        velocity, spin = self.absolute(support, t)
        return Pose(position, quat.matrix(rotation), velocity, quat.rotate(rotation, spin))

    def _value(self, value: Any, t: Tensor) -> Tensor:
        nodes = self.scene.beam.nodes
        if not callable(value):
            return value
        return at_time(lambda now: taken("a motion function's value", value(now), nodes, 3), t)

    def _moving(self, name: str, function: Any, t: Tensor) -> tuple[Tensor, Tensor]:
        """The function's value and rate (..., 3)."""

        def value(now: Tensor) -> Tensor:
            return taken("a motion function's value", function(now), self.scene.beam.nodes, 3)

        return at_time(lambda now: with_user_rate(name, value, now), t)


def moved(
    position: Tensor,
    rotation: Tensor,
    displacement: Tensor | None,
    turn: Tensor | None,
    share: Tensor | float = 1.0,
) -> tuple[Tensor, Tensor]:
    """A position (..., 3) and quaternion (..., 4) after a share of a displacement and a turn."""
    if displacement is not None:
        position = position + share * displacement
    if turn is not None:
        rotation = quat.multiply(quat.exponential(share * turn), rotation)
    return position, rotation


def still(a: tuple[Tensor, Tensor], b: tuple[Tensor, Tensor]) -> Tensor:
    """(...) whether two poses, positions (..., 3) and quaternions (..., 4), are one."""
    moved = torch.linalg.vector_norm(a[0] - b[0], dim=-1)
    turned = torch.linalg.vector_norm(a[1] - quat.nearer(b[1], a[1]), dim=-1)
    return (moved <= STILL * (1 + torch.linalg.vector_norm(b[0], dim=-1))) & (turned <= STILL)


def turning(scene: Any) -> bool:
    """Whether frame a turns."""
    return scene.frame is not None and scene.frame.angular_velocity is not None


def orientation(scene: Any, shape: tuple[int, ...], t: Tensor | float = 0.0) -> Tensor | None:
    """Of frame a at t (...) s, in the inertial axes with which it coincides at t = 0: (..., 4),
    with the batch axes `shape` and those of a function; None where it does not turn.
    """
    if not turning(scene):
        return None
    nodes = scene.beam.nodes
    return oriented(scene, quat.identity(shape, nodes.dtype, nodes.device), 0.0, t)


def oriented(scene: Any, frame: Tensor, start: Tensor | float, end: Tensor | float) -> Tensor:
    """Orientation (..., 4) of frame a at `end` (...) s, if it is `frame` (..., 4) at `start`."""
    start, end = (torch.as_tensor(t, dtype=frame.dtype, device=frame.device) for t in (start, end))
    gap = end - start
    recorded = gap is not concrete(gap) or gap.requires_grad or within_dual_numbers()
    if not recorded and bool((gap == 0).all()):
        return frame
    return quat.multiply(frame, PrescribedMotion(scene).turn(start, end))
