"""Balls among the joints of a scene: where they are, how their parts stand to each other, and what
acts in them, see `ball_laws`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.leaves import Tree, leaf, map_leaves
from ..math.quaternions import skew
from .ball_laws import BallLaws, BallStep, moment
from .joint_motion import Pose
from .rotation_vector import Turn, axial


class Axes(NamedTuple):
    """Of both parts (..., B, 3, 3), columns, frame a."""

    a: Tensor
    b: Tensor

    @property
    def relative(self) -> Tensor:
        return self.a.mT @ self.b


@dataclass(frozen=True)
class Balls(Tree):
    """at: their places among the J joints; ground (J, 2, 1, 1) 1 where a part is the ground; own
    (..., J, 2, 3, 3) the joint's axes in those of its nodes; laws of all J joints; torques: whether
    one is given.
    """

    at: tuple[int, ...]
    ground: Tensor = leaf(4)
    own: Tensor = leaf(4)
    laws: BallLaws
    torques: bool

    @property
    def act(self) -> bool:
        laws = self.laws
        some = laws.stiffness, laws.damping, laws.friction, laws.limit_stiffness
        return self.torques or any(x is not None for x in some)

    def of(self, x: Tensor, axis: int) -> Tensor:
        """Of all joints (axis, counted from the last): those of balls."""
        if len(self.at) == x.shape[axis]:
            return x
        return x.index_select(axis, torch.tensor(self.at, device=x.device))

    def to_joints(self, x: Tensor, axis: int, count: int) -> Tensor:
        """The inverse, zero elsewhere."""
        if len(self.at) == count:
            return x
        shape = list(x.shape)
        shape[axis] = count
        return x.new_zeros(shape).index_copy(axis, torch.tensor(self.at, device=x.device), x)

    @property
    def own_laws(self) -> BallLaws:
        """Those of balls alone."""
        return map_leaves(lambda x, axes: self.of(x, -axes), self.laws)

    def axes(self, pose: Pose) -> Axes:
        eye = torch.eye(3, dtype=pose.R.dtype, device=pose.R.device)
        axes = (self.of(pose.R, -4) + self.of(self.ground, -4) * eye) @ self.of(self.own, -4)
        return Axes(*axes.unbind(-3))

    def spin(self, pose: Pose, spins: Tensor) -> Tensor:
        """(..., B, 3) rad/s of b against a, axes of a; spins (..., J, 2, 3), frame a."""
        first, second = self.of(spins, -3).unbind(-2)
        return (self.axes(pose).a.mT @ (second - first)[..., None])[..., 0]

    def turn(self, pose: Pose) -> Tensor:
        """(..., B, 3) rad, the rotation vectors."""
        return Turn.of(self.axes(pose).relative).vector

    def conjugate(self, step: BallStep) -> Tensor:
        return self.own_laws.conjugate(step)[0]

    def moment(self, C: Tensor, acting: Pose) -> Tensor:
        """M (..., B, 3), frame a: on a; on b its opposite."""
        axes = self.axes(acting)
        return moment(C, axes.a, axes.b)

    def moment_by(self, step: BallStep, acting: Pose, end: Pose, rate: float) -> Tensor:
        """(..., B, 3, 6): M by half the spins of both ends, of which the end takes `rate`."""
        axes, ends = self.axes(acting), self.axes(end)
        unit = skew(torch.eye(3, dtype=end.R.dtype, device=end.R.device))  # by each component
        a, b = ((unit @ x[..., None, :, :]) for x in (ends.a, ends.b))  # (..., B, 3, 3, 3)
        relative = ends.a.mT[..., None, :, :] @ b  # by a spin of b; of a its opposite
        C, by = self.own_laws.conjugate(step, rate * relative)
        C, to_a, to_b = C[..., None, :, :], axes.a[..., None, :, :], axes.b.mT[..., None, :, :]
        bent = to_a @ by @ to_b
        first, second = a @ C @ to_b - bent, to_a @ C @ b.mT + bent
        return axial(torch.cat(torch.broadcast_tensors(first, second), -3)).mT

    def spin_rows(self, pose: Pose) -> Tensor:
        """(..., B, 3, 12): the spin by displacement and spin of both ends."""
        a = self.axes(pose).a.mT
        none = torch.zeros_like(a)
        return torch.cat((none, -a, none, a), -1)
