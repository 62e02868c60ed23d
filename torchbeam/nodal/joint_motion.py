"""Where joints are and what acts in them, at one instant or over a step; and what of their
constraints follows from that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.leaves import Tree, leaf
from ..math.quaternions import skew


class Pose(NamedTuple):
    """Of both ends of each joint, frame a: position r (..., J, 2, 3) m and axes R
    (..., J, 2, 3, 3); of the ground 0.
    """

    r: Tensor
    R: Tensor

    def mean(self, other: Pose) -> Pose:
        return Pose((self.r + other.r) / 2, (self.R + other.R) / 2)


def end_moves(half: Tensor, p: int) -> Tensor:
    """(..., p + s, p + s): what of nodes' moves, displacements (p) and spins, their ends take, of
    which spins are turned by `half` (..., s, s).
    """
    s = half.shape[-1]
    eye = torch.eye(p, dtype=half.dtype, device=half.device).expand(*half.shape[:-2], p, p)
    return torch.cat((pad(eye, (0, s)), pad(half, (p, 0))), -2)


class JointValues(NamedTuple):
    """At one instant, of what is given: efforts N or N m, and coordinates m or rad that are
    prescribed, (..., J, w), None = no joint has one.
    """

    effort: Tensor | None = None
    coordinate: Tensor | None = None


NO_VALUES = JointValues()


class JointDrive(NamedTuple):
    """What acts in joints: values; turns (..., J, 2) coordinates before, None = unknown; dt
    (...) s, None = laws of an instant, at rest; share (...), as far as loads are raised, None =
    all; moving() velocity and spin (..., N+1, *) of nodes before the step, or at an instant, None =
    at rest, as seen in frame a.
    """

    values: JointValues
    turns: Tensor | None = None
    dt: Tensor | None = None
    share: Tensor | None = None
    moving: Callable[[], tuple[Tensor, Tensor]] | None = None

    def raised(self, x: Tensor) -> Tensor:
        return x if self.share is None else self.share[..., None, None] * x


class JointMotion(NamedTuple):
    """Where the forces of joints act, where joints are closed, and where they were before a step
    (None = there is none).
    """

    acting: Pose
    end: Pose
    start: Pose | None = None
    drive: JointDrive | None = None


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
        turning = self.fixed @ pose.R.mT
        apart = (pose.r[..., 1, :] - pose.r[..., 0, :])[..., None, :]
        return Vector(self.constant + self.shift * apart + turning.sum(-3), turning)

    def by_moves(self, turning: Tensor) -> Tensor:
        """(..., J, m, 3, 12) by displacement and spin of the first node, then of the second;
        turning: at the rotations that the spins turn.
        """
        shift = self.shift[..., None] * torch.eye(3, dtype=turning.dtype, device=turning.device)
        a, b = (-skew(part) for part in turning.unbind(-3))
        shift = shift.expand(*a.shape[:-2], 3, 3)
        return torch.cat((-shift, a, shift, b), -1)


class NoJoints(Tree):
    """None: balances, stress and tangents are those of nodes and elements alone."""

    count = 0
    dissipative = False
    smooth = True
    rubs = False  # whether one has friction
    limited = False  # whether one has limits
    held_count = 0

    def split(self, stress: Tensor) -> tuple[Tensor, Tensor | None]:
        """Stress or gaps: (of the elements (..., N, k), of the joints (..., J, k))."""
        return stress, None

    def with_forces(self, stress: Tensor, forces: Tensor | None) -> Tensor:
        """Stress of the elements, and behind it rows of joints with the forces (..., m) of what
        they hold, None = 0.
        """
        return stress

    def balance(
        self, nodes: Tensor, gap: Tensor, stress: Tensor, poses: Callable[[], tuple[Any, Any]]
    ) -> tuple[Tensor, Tensor]:
        """The nodes' balances with the joints' forces, and the gaps of the elements with theirs;
        poses: `Pose` where forces act, and where joints are to be closed.
        """
        return nodes, gap

    def efforts(self, values: JointValues) -> Tensor | None:
        """(..., J, p + 1) N and N m, the sizes of efforts as joints are drawn, those that are given
        and those by limits that exclude this; None = there are none.
        """
        return None

    def joined(
        self,
        tangent: Any,
        stress: Tensor,
        poses: Callable[[], tuple[Any, Any]],
        half: Callable[[], Tensor] | None,
        rate: float,
    ) -> Any:
        """The tangent of a balance with that of the joints, see `Joints.blocks`."""
        return tangent

    def matrix(self, stiffness: Any, stress: Tensor, poses: Callable[[], tuple[Any, Any]]) -> Any:
        """A tangent stiffness of the nodes with that of the joints."""
        return stiffness

    def damping(self, poses: Callable[[], tuple[Any, Any]]) -> Any | None:
        """`JointBlocks` of the nodes' balances by their velocities, at rest; None = there is no
        damping.
        """
        return None

    def measure(self, size: Tensor, gap: Tensor | None) -> Tensor:
        """(...) a scaled residual, with that of the joints."""
        return size

    def values(self, joints: tuple[Any, ...], t: Tensor, inputs: Any, end: Tensor) -> JointValues:
        """Of the joints of a scene: efforts at t (...), prescribed coordinates at `end` (...)."""
        return NO_VALUES

    def finished(
        self,
        stress: Tensor,
        motion: Callable[[], Any],
        moving: Callable[[], tuple[Tensor, Tensor]] | None = None,
        work: Tensor | None = None,
        before: Tensor | None = None,
    ) -> dict[str, Any]:
        """Fields of the state after a step: its stress and, with joints, these; work (...) J so
        far, and theirs. moving() velocity and spin of nodes, as seen in frame a, None = at rest;
        before: see `DrivenJoints.work`.
        """
        return {"stress": stress}

    def spans(self, lengths: Tensor) -> Tensor:
        """(..., 1, 1) m, the size of what has no elements, whose lengths (..., 0, 1) are none."""
        return lengths.new_ones(1, 1)

    def asked(self, push: Tensor, gap: Tensor | None) -> Tensor:
        """Right-hand side of a system with the joints: loads on the nodes, and gaps that are to be
        closed.
        """
        return push

    def answered(
        self, solution: Tensor, change: Callable[[Tensor], Tensor]
    ) -> tuple[Tensor, Tensor]:
        """(moves of the nodes, change of stress and of joint forces) of its solution;
        change(moves): that of the stress.
        """
        return solution, change(solution)
