"""Where the ends of joints are, and what of their constraints follows from that."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.leaves import Tree, leaf
from ..math.quaternions import skew


class Pose(NamedTuple):
    """Of both ends of each joint, frame a: position r (..., J, 2, 3) m and axes R
    (..., J, 2, 3, 3); of the ground 0. drawn: of small rotations theta the axes as drawn; R is then
    what they change by, ~theta drawn.
    """

    r: Tensor
    R: Tensor
    drawn: Tensor | None = None

    def mean(self, other: Pose) -> Pose:
        return Pose((self.r + other.r) / 2, (self.R + other.R) / 2, self.drawn)


def end_moves(half: Tensor, p: int) -> Tensor:
    """(..., p + s, p + s): what of nodes' moves, displacements (p) and spins, their ends take, of
    which spins are turned by `half` (..., s, s).
    """
    s = half.shape[-1]
    eye = torch.eye(p, dtype=half.dtype, device=half.device).expand(*half.shape[:-2], p, p)
    return torch.cat((pad(eye, (0, s)), pad(half, (p, 0))), -2)


def columns(by: Tensor, ends: Tensor, moves: Tensor | None) -> Tensor:
    """(..., J, 2, n, w) by the moves of both nodes, of derivatives (..., J, n, 12) by those of ends
    in space, which are `ends` (2 w, 12) of them; moves (..., J, 2, w, w): see `end_moves`.
    """
    parts = (by @ ends.mT).unflatten(-1, (2, -1)).movedim(-2, -3)
    return parts if moves is None else parts @ moves


def along(vector: Tensor, by: Tensor) -> Tensor:
    """vector (..., 3) times by (..., 3, n)."""
    return (vector[..., None, :] @ by)[..., 0, :]


class JointValues(NamedTuple):
    """At one instant, of what is given: efforts N or N m, and coordinates m or rad that are
    prescribed, (..., J, w), None = no joint has one.
    """

    effort: Tensor | None = None
    coordinate: Tensor | None = None


NO_VALUES = JointValues()


class Vector(NamedTuple):
    """One of the two of each constraint (..., J, m, 3), and what of it turns with the two nodes
    (..., J, 2, m, 3).
    """

    value: Tensor
    turning: Tensor


@dataclass(frozen=True)
class Factor(Tree):
    """One of the two vectors of each constraint: `constant` v_0 (..., J, m, 3), shift s (J, m, 1),
    and v_a, v_b in the axes of the nodes: fixed (..., J, 2, m, 3).
    """

    constant: Tensor = leaf(3)
    shift: Tensor = leaf(3)
    fixed: Tensor = leaf(4)

    def at(self, pose: Pose) -> Vector:
        fixed = turning = self.fixed @ pose.R.mT
        if pose.drawn is not None:
            turning = self.fixed @ pose.drawn.mT
        apart = (pose.r[..., 1, :] - pose.r[..., 0, :])[..., None, :]
        return Vector(self.constant + self.shift * apart + fixed.sum(-3), turning)

    def by_moves(self, turning: Tensor) -> Tensor:
        """(..., J, m, 3, 12) by displacement and spin of the first node, then of the second;
        turning: at the rotations that the spins turn.
        """
        shift = self.shift[..., None] * torch.eye(3, dtype=turning.dtype, device=turning.device)
        a, b = (-skew(part) for part in turning.unbind(-3))
        shift = shift.expand(*a.shape[:-2], 3, 3)
        return torch.cat((-shift, a, shift, b), -1)
