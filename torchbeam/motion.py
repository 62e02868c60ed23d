"""Prescribed motion: of frame a, and of the supports in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from . import quaternions as quat
from .checks import axis_last
from .effects import Pose
from .supports import Support

GAP = 1e-4  # s: central differences of a motion, where there is no step
INCREMENT = 1 / 8  # of a step: central differences of a support's motion over it are far below the step's own error


@dataclass(frozen=True)
class Carrying:
    """A scene's prescribed motions as functions of t (0-dim), frame a."""

    scene: Any

    def frame(self, t: Tensor) -> tuple[Tensor | None, Tensor | None]:
        """v (..., 3) m/s and omega (..., 3) rad/s of frame a; None = at rest."""
        frame = self.scene.frame
        given = (None, None) if frame is None else (frame.velocity, frame.angular_velocity)
        return tuple(None if x is None else self._value(x, t) for x in given)

    def pose(self, support: Support, t: Tensor, share: Tensor | float = 1.0) -> tuple[Tensor, Tensor]:
        """Position (..., 3) and quaternion (..., 4) of a support, after a share (..., 1) of its motion."""
        beam = self.scene.beam
        position, rotation = beam.nodes[..., support.node, :], beam.frames[..., support.node, :]
        if support.displacement is not None:
            position = position + share * self._value(support.displacement, t)
        if support.turn is not None:
            rotation = quat.multiply(quat.exponential(share * self._value(support.turn, t)), rotation)
        return position, rotation

    def rates(self, support: Support, t: Tensor, dt: Tensor) -> tuple[Tensor, Tensor]:
        """Velocity and spin (..., 3) of a support in frame a, both in frame a's axes, relative to it."""
        gap = INCREMENT * dt
        (r0, q0), (r1, q1) = self.pose(support, t - gap), self.pose(support, t + gap)
        return (r1 - r0) / (2 * gap), quat.logarithm(quat.multiply(q1, quat.conjugate(q0))) / (2 * gap)

    def absolute(self, support: Support, t: Tensor, dt: Tensor) -> tuple[Tensor, Tensor]:
        """Absolute velocity (..., 3), frame a, and spin (..., 3), section axes, of a clamp."""
        position, rotation = self.pose(support, t)
        velocity, spin = self.rates(support, t, dt) if support.moves else (torch.zeros_like(position),) * 2
        v, omega = self.frame(t)
        if v is not None:
            velocity = velocity + v
        if omega is not None:
            velocity = velocity + torch.linalg.cross(*torch.broadcast_tensors(omega, position))
            spin = spin + omega
        return velocity, quat.rotate(quat.conjugate(rotation), spin)

    def root_pose(self, t: Tensor, dt: Tensor) -> Pose:
        """Where node 0 would be clamped, for what ties it there elastically."""
        root = self.scene.root
        support = Support(0) if root is None else Support(0, displacement=root.displacement, turn=root.rotation)
        position, rotation = self.pose(support, t)
        velocity, spin = self.absolute(support, t, dt)
        return Pose(position, quat.matrix(rotation), velocity, quat.rotate(rotation, spin))

    def _value(self, value: Any, t: Tensor) -> Tensor:
        nodes = self.scene.beam.nodes
        value = torch.as_tensor(value(t) if callable(value) else value, dtype=nodes.dtype, device=nodes.device)
        return axis_last("a motion function's value", value, 3)
