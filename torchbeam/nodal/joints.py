"""Joints: what they ask of the nodes that they connect, and the forces by which they get it.

A joint sits at a point p and has axes F in each of its two parts, a and b: fixed in the axes of a node, or in frame a. Each
thing that it holds is a product of two vectors v and w, linear in positions and axes of both nodes,

    g = v . w - c = 0        v = v_0 + s (r_b - r_a) + R_a v_a + R_b v_b        (w likewise)

    position along axis i      F_a,i . (p_b - p_a)
    rotation about x, y, z     -F_a,y . F_b,z    -F_a,z . F_b,x    -F_a,x . F_b,y
      about y and z alone       -F_a,z . F_b,x    F_a,y . F_b,x, which are independent whatever the angle about x
    distance L                d . d/(2 L) - L/2,    d = p_b - p_a

Its force is a multiplier lambda per constraint, an unknown like the stress of an element: the nodes' balances get
(dg/dq)^T lambda. Over a step the gradient is that of the means of positions and axes. With the step's Cayley vector Theta,
R_{n+1} - R_n = Theta x (R_n + R_{n+1})/2, and g is quadratic, so that lambda does the work lambda (g_{n+1} - g_n), none but
for rounding; g = 0 holds at the end of the step itself (Gonzalez 1999; Betsch and Steinmann 2002). There is no penalty and no
drift.
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
from ..math.shapes import broadcast_shapes
from ..topology.framework import Framework
from ..topology.framework_matrix import JointBlocks
from .coordinates.spatial import Space

ROUNDING = 1000.0  # eps: places that floating point does not tell apart
CLOSED = 1e-6  # what a joint's gap over the size of the whole is measured against: 1e-8 of it is 1e-14 of that size


class NoJoints(Tree):
    """None: balances, stress and tangents are those of nodes and elements alone."""

    count = 0
    held_count = 0

    def split(self, stress: Tensor) -> tuple[Tensor, Tensor | None]:
        """Stress or gaps: (of the elements (..., N, k), of the joints (..., J, k))."""
        return stress, None

    def balance(self, nodes: Tensor, gap: Tensor, stress: Tensor, poses: Callable[[], tuple[Any, Any]]
                ) -> tuple[Tensor, Tensor]:
        """The nodes' balances with the joints' forces, and the gaps of the elements with theirs; poses: `Pose` where forces
        act, and where joints are to be closed.
        """
        return nodes, gap

    def joined(self, tangent: Any, stress: Tensor, poses: Callable[[], tuple[Any, Any]], half: Callable[[], Tensor] | None,
               rate: float) -> Any:
        """The tangent of a balance with that of the joints, see `Joints.blocks`."""
        return tangent

    def matrix(self, stiffness: Any, stress: Tensor, poses: Callable[[], tuple[Any, Any]]) -> Any:
        """A tangent stiffness of the nodes with that of the joints."""
        return stiffness

    def measure(self, size: Tensor, gap: Tensor | None) -> Tensor:
        """(...) a scaled residual, with that of the joints."""
        return size

    def spans(self, lengths: Tensor) -> Tensor:
        """(..., 1, 1) m, the size of what has no elements, whose lengths (..., 0, 1) are none."""
        return lengths.new_ones(1, 1)

    def asked(self, push: Tensor, gap: Tensor | None) -> Tensor:
        """Right-hand side of a system with the joints: loads on the nodes, and gaps that are to be closed."""
        return push

    def answered(self, solution: Tensor, change: Callable[[Tensor], Tensor]) -> tuple[Tensor, Tensor]:
        """(moves of the nodes, change of stress and of joint forces) of its solution; change(moves): that of the stress."""
        return solution, change(solution)


class Pose(NamedTuple):
    """Of both ends of each joint, frame a: position r (..., J, 2, 3) m and axes R (..., J, 2, 3, 3); of the ground 0."""

    r: Tensor
    R: Tensor

    def mean(self, other: Pose) -> Pose:
        return Pose((self.r + other.r) / 2, (self.R + other.R) / 2)


class Vector(NamedTuple):
    """One of the two of each constraint (..., J, m, 3), and what of it turns with the two nodes (..., J, 2, m, 3)."""

    value: Tensor
    turning: Tensor


@dataclass(frozen=True)
class Factor(Tree):
    """One of the two vectors of each constraint: `constant` v_0 (..., J, m, 3), shift s (J, m, 1), and v_a, v_b in the axes of
    the nodes: fixed (..., J, 2, m, 3).
    """

    constant: Tensor = leaf(3)
    shift: Tensor = leaf(3)
    fixed: Tensor = leaf(4)

    def at(self, pose: Pose) -> Vector:
        turning = self.fixed @ pose.R.mT
        apart = (pose.r[..., 1, :] - pose.r[..., 0, :])[..., None, :]
        return Vector(self.constant + self.shift * apart + turning.sum(-3), turning)

    def by_moves(self, turning: Tensor) -> Tensor:
        """(..., J, m, 3, 12) by displacement and spin of the first node, then of the second; turning: at the rotations that
        the spins turn.
        """
        shift = self.shift[..., None] * torch.eye(3, dtype=turning.dtype, device=turning.device)
        a, b = (-skew(part) for part in turning.unbind(-3))
        shift = shift.expand(*a.shape[:-2], 3, 3)
        return torch.cat((-shift, a, shift, b), -1)


@dataclass(frozen=True)
class Joints(NoJoints):
    """All joints of a scene, each with m = w constraints, of which those are there that `held` (J, w) has as 1.

    v, w    the two vectors;  c (..., J, w)
    moves   (w, 6): displacement and spin in space of a node's moves
    size    (...) m of the whole
    """

    space: Space
    framework: Framework
    held: Tensor = leaf(2)
    v: Factor
    w: Factor
    c: Tensor = leaf(2)
    moves: Tensor = leaf(2)
    size: Tensor = leaf(0)

    @property
    def count(self) -> int:
        return len(self.framework.joints)

    @property
    def held_count(self) -> int:
        """How many constraints there are."""
        return int(self.held.sum())

    def split(self, stress: Tensor) -> tuple[Tensor, Tensor]:
        N = stress.shape[-2] - self.count
        return stress.narrow(-2, 0, N), stress.narrow(-2, N, self.count)

    def balance(self, nodes: Tensor, gap: Tensor, stress: Tensor, poses: Callable[[], tuple[Pose, Pose]]
                ) -> tuple[Tensor, Tensor]:
        acting, end = poses()
        return self.load(acting, self.split(stress)[1], nodes), _stacked(gap, self.gap(end))

    def joined(self, tangent: Any, stress: Tensor, poses: Callable[[], tuple[Pose, Pose]], half: Callable[[], Tensor] | None,
               rate: float) -> Any:
        blocks = self.blocks(*poses(), self.split(stress)[1], None if half is None else half(), rate)
        return tangent._replace(matrix=tangent.matrix.joined(blocks))

    def matrix(self, stiffness: Any, stress: Tensor, poses: Callable[[], tuple[Pose, Pose]]) -> Any:
        return stiffness.joined(self.blocks(*poses(), self.split(stress)[1], None, 1.0))

    def measure(self, size: Tensor, gap: Tensor) -> Tensor:
        p = self.space.position
        apart = torch.maximum(gap[..., :p].abs().amax((-1, -2)) / self.size, gap[..., p:].abs().amax((-1, -2)))
        return torch.maximum(size, (apart - ROUNDING * torch.finfo(gap.dtype).eps).clamp(min=0) / CLOSED)

    def spans(self, lengths: Tensor) -> Tensor:
        return self.size[..., None, None]

    def asked(self, push: Tensor, gap: Tensor) -> Tensor:
        return _stacked(push, -gap)

    def answered(self, solution: Tensor, change: Callable[[Tensor], Tensor]) -> tuple[Tensor, Tensor]:
        N = self.framework.node_count
        moves = solution.narrow(-2, 0, N)
        return moves, _stacked(change(moves), solution.narrow(-2, N, self.count))

    def pose(self, position: Tensor, rotation: Tensor) -> Pose:
        """From nodes, in the space's coordinates."""
        R = self.space.axes(rotation)
        r = self.framework.at_joints(self.space.public_position(position))
        return Pose(r, self.framework.at_joints(R.flatten(-2)).unflatten(-1, (3, 3)))

    def gap(self, pose: Pose) -> Tensor:
        """g (..., J, w): of positions m, of rotations rad."""
        v, w = self.v.at(pose).value, self.w.at(pose).value
        return self.held * ((v * w).sum(-1) - self.c)

    def load(self, pose: Pose, force: Tensor, total: Tensor) -> Tensor:
        """total (..., N+1, w) with what the joints' forces (..., J, w) add to the nodes' balances: (dg/dq)^T lambda."""
        by = self._gradient(*(factor.at(pose) for factor in (self.v, self.w)))
        force = self.held * force
        wrench = torch.einsum("...jmk,...jm->...jk", by, force).unflatten(-1, (2, 6))
        return self.framework.from_joints(wrench @ self.moves.mT, total)

    def blocks(self, acting: Pose, end: Pose, force: Tensor, half: Tensor | None, rate: float) -> JointBlocks:
        """Of the tangent, by moves at `acting`, the mean of the start and `end`: of which the end makes `rate` times the
        displacement, and turns by rate * half (..., N+1, s, s) times the spin; None = I.
        """
        force = self.held * force
        (v, w), (v_end, w_end) = ([factor.at(pose) for factor in (self.v, self.w)] for pose in (acting, end))
        by_v, by_w = self.v.by_moves(v_end.turning), self.w.by_moves(w_end.turning)
        closed = rate * (_along(w_end.value, by_v) + _along(v_end.value, by_w))  # (..., J, m, 12)
        push = self._gradient(v, w)
        stiffness = self._curvature(v, w, by_v, by_w, v_end, w_end, force)
        E = torch.block_diag(self.moves, self.moves)  # (2 w, 12)
        spin = None if half is None else self._spins(half)
        held = self.held[..., None]

        def columns(by: Tensor) -> Tensor:
            """(..., J, n, 12) -> (..., J, 2, n, w)"""
            parts = (by @ E.mT).unflatten(-1, (2, -1)).movedim(-2, -3)
            return parts if spin is None else parts @ spin

        constraint = columns(held * closed)
        stiffness = columns(E @ stiffness).unflatten(-2, (2, -1)).transpose(-4, -3)
        force_by = (push * held @ E.mT).mT.unflatten(-2, (2, -1))
        return JointBlocks(self.held, stiffness, force_by, constraint)

    def _spins(self, half: Tensor) -> Tensor:
        """(..., J, 2, w, w): what of a node's move its end takes, over `rate`."""
        p, s = self.space.position, self.space.spin
        own = self.framework.at_joints(half.flatten(-2)).unflatten(-1, (s, s))
        eye = torch.eye(p, dtype=own.dtype, device=own.device).expand(*own.shape[:-2], p, p)
        return torch.cat((pad(eye, (0, s)), pad(own, (p, 0))), -2)

    def _gradient(self, v: Vector, w: Vector) -> Tensor:
        """dg/dq (..., J, m, 12): by displacement and spin of the first node, then of the second."""
        apart = self.v.shift * w.value + self.w.shift * v.value
        a, b = (torch.linalg.cross(turning_v, w.value) + torch.linalg.cross(turning_w, v.value)
                for turning_v, turning_w in zip(v.turning.unbind(-3), w.turning.unbind(-3), strict=True))
        return torch.cat((-apart, a, apart, b), -1)

    def _curvature(self, v: Vector, w: Vector, by_v: Tensor, by_w: Tensor, v_end: Vector, w_end: Vector, force: Tensor
                   ) -> Tensor:
        """(..., J, 12, 12): derivative of lambda dg/dq, the wrenches on both nodes, by half the moves of the end."""
        weight = force[..., None, None]
        apart = (weight * (self.v.shift[..., None] * by_w + self.w.shift[..., None] * by_v)).sum(-3)  # (..., J, 3, 12)
        rows = [-apart, None, apart, None]
        for side in (0, 1):
            turned = [pad(-skew(end.turning[..., side, :, :]), (3 + 6 * side, 6 - 6 * side)) for end in (v_end, w_end)]
            moment = (skew(v.turning[..., side, :, :]) @ by_w - skew(w.value) @ turned[0]
                      + skew(w.turning[..., side, :, :]) @ by_v - skew(v.value) @ turned[1])
            rows[2 * side + 1] = (weight * moment).sum(-3)
        return torch.cat(torch.broadcast_tensors(*rows), -2)


def _along(vector: Tensor, by: Tensor) -> Tensor:
    """vector (..., 3) times by (..., 3, n)."""
    return (vector[..., None, :] @ by)[..., 0, :]


def _stacked(rows: Tensor, more: Tensor) -> Tensor:
    """Both one after the other."""
    shape = broadcast_shapes(rows.shape[:-2], more.shape[:-2])
    return torch.cat((rows.expand(*shape, *rows.shape[-2:]), more.expand(*shape, *more.shape[-2:])), -2)
