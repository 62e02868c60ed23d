"""Small displacements and rotations: the element and the nodes, linear about the undeformed beam.

A rotation is a rotation vector in the section's undeformed axes; two of them add. Strains are B_0 times the nodes' moves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from .. import quaternions as quat
from ..scene import Scene
from ..state import State
from . import element
from .space import Space


class Moves(NamedTuple):
    """(..., N, 9): dr_j - dr_i m, spin i, spin j rad, frame a."""

    nine: Tensor


@dataclass(frozen=True)
class Small(Space):
    """nodes (..., N+1, 3) m;  frames (..., N+1, 4), R (..., N+1, 3, 3) undeformed section axes -> a;  B (..., N, 6, 9)."""

    nodes: Tensor
    frames: Tensor
    R: Tensor
    B: Tensor

    turns: ClassVar[bool] = False

    @classmethod
    def of(cls, scene: Scene) -> Small:
        beam = scene.beam
        h = beam.length[..., None]
        return cls(beam.nodes, beam.frames, quat.matrix(beam.frames),
                   element.strain_operator(element.kinematics(beam.nodes, beam.frames, h), h))

    def enter(self, state: State) -> State:
        if state.frame is not None:
            raise ValueError("a state in a frame that turns was given; small rotations want one that does not")
        return replace(state, rotation=self.enter_rotation(state.rotation))

    def leave(self, state: State) -> State:
        return replace(state, rotation=quat.multiply(self.frames, quat.exponential(state.rotation)))

    def pose(self, position: Tensor, rotation: Tensor, node: int) -> tuple[Tensor, Tensor]:
        return position, quat.logarithm(quat.multiply(quat.conjugate(self.frames[..., node, :]), rotation))

    # The element

    def kinematics(self, position: Tensor, rotation: Tensor, length: Tensor) -> Moves:
        moves = torch.broadcast_tensors(position - self.nodes, self.to_frame(rotation, rotation))
        return Moves(self.to_elements(torch.cat(moves, -1)))

    def strains(self, kin: Moves, length: Tensor, reference: Tensor | float = 0.0) -> Tensor:
        return (self.B @ kin.nine[..., None])[..., 0] - reference

    def forces(self, kin: Moves, stress: Tensor, length: Tensor) -> Tensor:
        return length * (self.B.mT @ stress[..., None])[..., 0]

    def strain_operator(self, kin: Moves, length: Tensor) -> Tensor:
        return self.B.expand(*torch.broadcast_shapes(self.B.shape[:-2], kin.nine.shape[:-1]), 6, 9)

    def geometric_stiffness(self, kin: Moves, stress: Tensor, length: Tensor) -> Tensor:
        return torch.zeros_like(kin.nine[..., None] + kin.nine[..., None, :])

    # Rotations

    def axes(self, rotation: Tensor, node: int | None = None) -> Tensor:
        return self.R if node is None else self.R[..., node, :, :]

    def matrix(self, q: Tensor) -> Tensor:
        return self.R[..., self.R.shape[-3] - q.shape[-2]:, :, :]

    spin_matrix = matrix

    def to_frame(self, q: Tensor, spin: Tensor) -> Tensor:
        R = self.R[..., self.R.shape[-3] - q.shape[-2]:, :, :]  # of all nodes, or of those that a clamp at node 0 leaves
        return (R @ spin[..., None])[..., 0]

    def enter_rotation(self, q: Tensor) -> Tensor:
        return quat.logarithm(quat.multiply(quat.conjugate(self.frames), q))

    def rotation_rate(self, q: Tensor, spin: Tensor) -> Tensor:
        return spin

    def to_section(self, q: Tensor, spin: Tensor) -> Tensor:
        R = self.R[..., self.R.shape[-3] - q.shape[-2]:, :, :]
        return (R.mT @ spin[..., None])[..., 0]

    def multiply(self, p: Tensor, q: Tensor) -> Tensor:
        return p + q

    def inverse(self, q: Tensor) -> Tensor:
        return -q

    def none(self, like: Tensor) -> Tensor:
        return torch.zeros_like(like)

    def half(self, q: Tensor) -> Tensor:
        return q / 2

    def normalize(self, q: Tensor) -> Tensor:
        return q

    cayley = theta = exponential = logarithm = normalize

    def cosine(self, q: Tensor) -> Tensor:
        return torch.ones_like(q[..., 0])

    def theta_by_turn(self, theta: Tensor) -> Tensor:
        return torch.eye(3, dtype=theta.dtype, device=theta.device).expand(*theta.shape, 3)

    logarithm_by_turn = theta_by_turn

    def carried(self, R: Tensor, before: Tensor) -> Tensor:
        return torch.eye(3, dtype=R.dtype, device=R.device).expand_as(R)

    def hat(self, spin: Tensor) -> Tensor:
        return torch.zeros_like(spin)[..., None] * spin[..., None, :]
