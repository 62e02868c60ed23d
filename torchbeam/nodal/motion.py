"""Prescribed motion: of frame a, and of the supports in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from .. import quaternions as quat
from ..effects import Pose
from ..scene import Scene
from ..supports import Support
from .space import Space

INCREMENT = 1 / 8  # of a step: central differences of a support's motion over it are far below the step's own error


@dataclass(frozen=True)
class Carrying:
    """Functions of t (0-dim), in the space's coordinates."""

    scene: Scene
    space: Space

    def frame(self, t: Tensor) -> tuple[Tensor | None, Tensor | None]:
        """v (..., 1, p) m/s and omega (..., 1, s) rad/s of frame a; None = at rest."""
        frame = self.scene.frame
        v, omega = (None, None) if frame is None else (frame.velocity, frame.angular_velocity)
        v, omega = (None if x is None else self._value(x, t)[..., None, :] for x in (v, omega))
        return None if v is None else self.space.part_of_vector(v), None if omega is None else self.space.part_of_spin(omega)

    def pose(self, support: Support, t: Tensor) -> tuple[Tensor, Tensor]:
        """Position (..., 3) and quaternion (..., 4) of a support, frame a."""
        beam = self.scene.beam
        position, rotation = beam.nodes[..., support.node, :], beam.frames[..., support.node, :]
        if support.displacement is not None:
            position = position + self._value(support.displacement, t)
        if support.turn is not None:
            rotation = quat.multiply(quat.exponential(self._value(support.turn, t)), rotation)
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
        frame = self.scene.frame
        if frame is not None and frame.velocity is not None:
            velocity = velocity + self._value(frame.velocity, t)
        if frame is not None and frame.angular_velocity is not None:
            omega = self._value(frame.angular_velocity, t)
            velocity = velocity + torch.linalg.cross(*torch.broadcast_tensors(omega, position))
            spin = spin + omega
        return velocity, quat.rotate(quat.conjugate(rotation), spin)

    def root_pose(self, t: Tensor, dt: Tensor) -> Pose:
        """Where node 0 would be clamped, for what ties it there elastically."""
        root = self.scene.root
        support = Support(0, displacement=None if root is None else root.displacement, turn=None if root is None else root.rotation)
        position, rotation = self.pose(support, t)
        velocity, spin = self.absolute(support, t, dt)
        return Pose(position, quat.matrix(rotation), velocity, quat.rotate(rotation, spin))

    def _value(self, value: Any, t: Tensor) -> Tensor:
        beam = self.scene.beam
        return torch.as_tensor(value(t) if callable(value) else value, dtype=beam.nodes.dtype, device=beam.nodes.device)
