"""Joints: what they ask of the nodes that they connect, and the forces by which they get it.

A joint sits at a point p and has axes F in each of its two parts, a and b: fixed in the axes of a
node, or in frame a. Each thing that it holds is a product of two vectors v and w, linear in
positions and axes of both nodes,

    g = v . w - c = 0        v = v_0 + s (r_b - r_a) + R_a v_a + R_b v_b        (w likewise)

    position along axis i      F_a,i . (p_b - p_a)
    rotation about x, y, z     -F_a,y . F_b,z    -F_a,z . F_b,x    -F_a,x . F_b,y
      about y and z alone       -F_a,z . F_b,x    F_a,y . F_b,x, which are independent whatever the
                                angle about x
    distance L                d . d/(2 L) - L/2,    d = p_b - p_a

Its force is a multiplier lambda per constraint, an unknown like the stress of an element: the
nodes' balances get (dg/dq)^T lambda. Over a step the gradient is that of the means of positions and
axes. With the step's Cayley vector Theta, R_{n+1} - R_n = Theta x (R_n + R_{n+1})/2, and g is
quadratic, so that lambda does the work lambda (g_{n+1} - g_n), none but for rounding; g = 0 holds
at the end of the step itself (Gonzalez 1999; Betsch and Steinmann 2002). There is no penalty and no
drift.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.leaves import leaf
from ..math.quaternions import cross, skew
from ..math.shapes import stacked
from ..state.instant import READINGS
from ..topology.framework import Framework
from .balls import Balls
from .between_nodes import BetweenNodes, NodeMotion, Placed, Rates
from .coordinates.spatial import Spatial
from .joint_motion import Factor, Pose, Vector, along, columns, end_moves
from .multipliers import Multipliers


@dataclass(frozen=True)
class Joints(BetweenNodes):
    """All joints of a scene, each with m = w constraints, of which those are there that `held`
    (J, w) has as 1.

    v, w    the two vectors;  c (..., J, w)
    moves   (w, 6): displacement and spin in space of a node's moves
    size    (...) m of the whole
    angles, travels  (J, w) 1 in the row of an angle, or of a travel, that is a coordinate of a
                     joint: free, or prescribed
    second  (J, w) 1 in the row of a joint's second coordinate
    balls   those of its joints that leave all turns, None = there are none
    across  what w becomes where it is turned about x by a right angle, in the rows of angles; zero
            in others
    parts   (J, w, 3, 3) 1 where v, w and across (third axis) have a constant, and a vector in the
            axes of the first and of the second node, 0 where there is none
    behind  how many rows of multipliers there are behind theirs
    """

    space: Spatial
    framework: Framework
    held: Tensor = leaf(2)
    v: Factor
    w: Factor
    c: Tensor = leaf(2)
    moves: Tensor = leaf(2)
    size: Tensor = leaf(0)
    angles: Tensor = leaf(2)
    travels: Tensor = leaf(2)
    second: Tensor = leaf(2)
    across: Factor
    parts: Tensor = leaf(4)
    balls: Balls | None
    behind: int = field(default=0, kw_only=True)

    present = True

    @property
    def count(self) -> int:
        return len(self.framework.joints)

    @property
    def held_count(self) -> int:
        """How many constraints there are."""
        return int(self.held.sum())

    @property
    def multipliers(self) -> Multipliers:
        """Their forces."""
        return Multipliers(self.held, self.size)

    def forces(self, stress: Tensor) -> Tensor:
        """(..., J, w) of the stress."""
        return stress.narrow(-2, stress.shape[-2] - self.count - self.behind, self.count)

    def balance(
        self, nodes: Tensor, gap: Tensor, stress: Tensor, motion: NodeMotion
    ) -> tuple[Tensor, Tensor]:
        acting, end, *_ = motion.placed(self.pose)
        force = self.held * self.forces(stress)
        return self._load(acting, self.w, force, nodes), stacked(gap, self.gap(end))

    def matrix(self, matrix: Any, stress: Tensor, motion: NodeMotion) -> Any:
        return self.tied(matrix, self.blocks(motion, self.forces(stress)), self.held)

    def tied(self, matrix: Any, blocks: Tensor, held: Tensor | None = None) -> Any:
        """A matrix with `blocks`, or with those of ends alone."""
        ties, alone = self.framework.joint_ties, blocks.shape[-3] == 2
        ties = tuple(tie[:-1] for tie in ties) if alone else ties
        return matrix.tied_too(ties, self.framework.of_ties(blocks), held)

    def finished(
        self, fields: dict[str, Any], motion: NodeMotion, before: Any, moving: Rates | None
    ) -> dict[str, Any]:
        placed = motion.placed(self.pose)
        stress, w = self.acting(fields["stress"], placed)
        wrench = self.wrench(placed, w, self.forces(stress))
        numbers = self._with_memory(wrench, placed)
        joints = self._readings(placed.end, self.after(placed), moving and moving(), numbers)
        return fields | {"stress": stress, "joints": joints}

    def reading(
        self, pose: Pose, before: Tensor, moving: tuple[Tensor, Tensor] | None = None
    ) -> Tensor:
        """(..., J, 12 or more) as in `State`, where nothing is known of forces: turns and memory as
        `before` has them; velocity and spin of nodes (..., N+1, *), as seen in frame a, None = at
        rest.
        """
        q = self.coordinate(pose, self.turns(before))
        wrench, memory = before[..., 6:].split((6, before.shape[-1] - READINGS), -1)
        numbers = torch.zeros_like(wrench)
        numbers = torch.cat((numbers, memory), -1) if memory.shape[-1] else numbers
        return self._readings(pose, q, moving, numbers)

    def _with_memory(self, wrench: Tensor, motion: Placed) -> Tensor:
        """Wrenches (..., J, 6), and behind them what joints remember, where some do."""
        return wrench

    def _readings(
        self, pose: Pose, q: Tensor, moving: tuple[Tensor, Tensor] | None, numbers: Tensor
    ) -> Tensor:
        """numbers: those behind coordinates and rates."""
        rate = torch.zeros_like(q) if moving is None else self.rate(pose, *moving)
        turn = spin = None
        if self.balls is not None:
            turn = self.balls.to_joints(self.balls.turn(pose), -2, self.count)
            spin = None if moving is None else self.spin(pose, *moving)
            spin = None if spin is None else self.balls.to_joints(spin, -2, self.count)
        return stacked(self._three(q, turn), self._three(rate, spin), numbers, axis=-1)

    def _three(self, rows: Tensor, vectors: Tensor | None) -> Tensor:
        """(..., J, 3) of rows (..., J, w) of coordinates, and of what balls have."""
        pair = [(rows * mask).sum(-1) for mask in (self.first, self.second)]
        three = torch.stack((*pair, torch.zeros_like(pair[0])), -1)
        return three if vectors is None else three + vectors

    @property
    def first(self) -> Tensor:
        """(J, w) 1 in the row of a joint's first coordinate; of a travel alone it is the second."""
        return self.angles + self.travels - self.second

    def turns(self, readings: Tensor) -> Tensor:
        """(..., J, w) rad of angles, in their rows, by what is read of joints (..., J, 2 or more),
        the two coordinates first.
        """
        return self.angles * self.given(readings)

    def given(self, readings: Tensor) -> Tensor:
        """(..., J, w) of coordinates, in their rows, likewise."""
        return readings[..., :1] * self.first + readings[..., 1:2] * self.second

    def acting(self, stress: Tensor, motion: Placed) -> tuple[Tensor, Factor]:
        """The stress with all forces of joints, and w where they act."""
        return stress, self.w

    def wrench(self, motion: Placed, w: Factor, force: Tensor) -> Tensor:
        """Force N and moment N m (..., J, 6) of the joints' forces on second parts."""
        by = self.gradient(self.v.at(motion.acting), w.at(motion.acting))
        return self.on_second(motion, torch.einsum("...jmk,...jm->...jk", by, -force))

    def on_second(self, motion: Placed, both: Tensor) -> Tensor:
        """Of wrenches (..., J, 12) on nodes: that on second parts, at the joints' points there,
        frame a; on the ground, which has no gradient, the opposite of what the first part gets.
        """
        apart = self.w.at(motion.acting)  # row 0: of the points, one where rotations are small
        arms, (push, moment) = apart.turning[..., 0, :], both.unflatten(-1, (2, 2, 3)).unbind(-2)
        moment = moment - cross(arms * arms.new_tensor([[-1.0], [1.0]]), push)
        ground = torch.tensor(
            [pair[1] is None for pair in self.framework.joints], device=both.device
        )[:, None]
        first, second = torch.cat((push, moment), -1).unbind(-2)
        if self.space.turns:
            first = first - pad(cross(apart.value[..., 0, :], first[..., :3]), (3, 0))
        return torch.where(ground, -first, second)

    def after(self, motion: Placed) -> Tensor:
        """(..., J, w) the coordinates, counted over turns where those before are known."""
        return self.coordinate(motion.end, self._near(motion.of.state))

    def _near(self, state: Any) -> Tensor | None:
        """(..., J, w) rad by a state, None = not known, that turns are counted from."""
        return None if state is None or state.joints is None else self.turns(state.joints)

    def turned(self, angle: Tensor) -> Factor:
        """w, turned about x by angles (..., J, w), 0 in rows of others."""
        c, s = torch.cos(angle)[..., None], torch.sin(angle)[..., None]
        fixed = c[..., None, :, :] * self.w.fixed + s[..., None, :, :] * self.across.fixed
        return Factor(c * self.w.constant + s * self.across.constant, self.w.shift, fixed)

    def coordinate(self, pose: Pose, near: Tensor | None = None) -> Tensor:
        """(..., J, w) m, or rad within half a turn of `near`, None = as drawn; else 0."""
        v, w, across = (factor.at(pose).value for factor in (self.v, self.w, self.across))
        product = (v * w).sum(-1)
        turns = self.angles > 0
        angle = torch.atan2(
            torch.where(turns, product, 0.0), torch.where(turns, -(v * across).sum(-1), 1.0)
        )
        if near is not None:
            turned = torch.round((near - angle) / (2 * torch.pi)).detach()
            angle = angle + 2 * torch.pi * turned * self.angles
        return angle + self.travels * (product - self.c)

    def coordinate_by(self, pose: Pose, coordinate: Tensor) -> Tensor:
        """(..., J, w, 12) its derivative by displacement and spin of both nodes, where it is."""
        v, across = self.v.at(pose), self.across.at(pose).value
        w = self.turned(coordinate * self.angles).at(pose)
        turns = self.angles > 0
        size = torch.hypot(
            torch.where(turns, (v.value * self.w.at(pose).value).sum(-1), 0.0),
            torch.where(turns, (v.value * across).sum(-1), 1.0),
        )
        return ((self.angles + self.travels) / size)[..., None] * self.gradient(v, w)

    def coordinate_rows(self, pose: Pose) -> Tensor:
        """(..., c, w nodes) derivatives by the nodes' moves of all c coordinates of joints."""
        return self._at_nodes(
            self.angles + self.travels, self.coordinate_by(pose, self.coordinate(pose))
        )

    def held_rows(self, pose: Pose) -> Tensor:
        """(..., m, w nodes) derivatives by the nodes' moves of all m constraints."""
        return self._at_nodes(self.held, self.gradient(self.v.at(pose), self.w.at(pose)))

    def gaps(self, pose: Pose, joints: Tensor) -> Tensor:
        """(..., m) m or rad by which they are open; prescribed ones are to be as in `joints`."""
        return self._flat(self.gap(pose))

    def _flat(self, rows: Tensor) -> Tensor:
        """(..., m) of (..., J, w)."""
        return rows.flatten(-2)[..., self.held.flatten().nonzero()[:, 0]]

    def _at_nodes(self, which: Tensor, by: Tensor) -> Tensor:
        """(..., r, w nodes) of rows `which` (J, w), by displacement and spin of both ends."""
        by = by @ torch.block_diag(self.moves, self.moves).mT
        columns = by.unflatten(-1, (2, -1)).movedim(-2, -3)  # (..., J, 2, m, w)
        rows = self.framework.by_nodes(columns)
        return rows.index_select(-2, which.flatten().nonzero()[:, 0])

    def coordinates(self, pose: Pose, near: Tensor) -> Tensor:
        """(..., c) m, or rad within half a turn of readings `near`: those of `coordinate_rows`."""
        q = self.coordinate(pose, self.turns(near))
        return q.flatten(-2)[..., (self.angles + self.travels).flatten().nonzero()[:, 0]]

    def rate(self, pose: Pose, velocity: Tensor, spin: Tensor) -> Tensor:
        """(..., J, w) m/s or rad/s of nodes that move so, frame a; 0 in rows of others."""
        motion = self.moving(velocity, spin)
        by = self.coordinate_by(pose, self.coordinate(pose))
        return (by @ motion.flatten(-2)[..., None])[..., 0]

    def spin(self, pose: Pose, velocity: Tensor, spin: Tensor) -> Tensor:
        """(..., B, 3) rad/s of balls' second parts against the first, axes of these."""
        return self.balls.spin(pose, self.moving(velocity, spin)[..., 3:])

    def moving(self, velocity: Tensor, spin: Tensor) -> Tensor:
        """(..., J, 2, 6) velocity and spin of both ends, in space."""
        return self.framework.at_joints(torch.cat((velocity, spin), -1)) @ self.moves

    def pose(self, position: Tensor, rotation: Tensor) -> Pose:
        """From nodes, in the space's coordinates."""
        space, ends = self.space, self.framework.at_joints
        r = ends(space.public_position(position))
        R = ends(space.axes(rotation).flatten(-2)).unflatten(-1, (3, 3))
        if space.turns:
            return Pose(r, R)
        theta = ends(space.public_spin(space.to_frame(rotation, rotation)))
        return Pose(r, skew(theta) @ R, R)

    def gap(self, pose: Pose) -> Tensor:
        """g (..., J, w): of positions m, of rotations rad."""
        v, w = self.v.at(pose).value, self.w.at(pose).value
        return self.held * ((v * w).sum(-1) - self.c)

    def _load(self, pose: Pose, w: Factor, force: Tensor, total: Tensor) -> Tensor:
        """total (..., N+1, w) with what the joints' forces (..., J, w) add to the nodes' balances:
        (dg/dq)^T lambda.
        """
        by = self.gradient(self.v.at(pose), w.at(pose))
        wrench = torch.einsum("...jmk,...jm->...jk", by, force).unflatten(-1, (2, 6))
        return self.framework.from_joints(wrench @ self.moves.mT, total)

    def blocks(self, motion: NodeMotion, force: Tensor) -> Tensor:
        """(..., J, 3, 3, w, w) of the tangent: balances of both ends, and constraints, by moves of
        these and the joints' forces (..., J, w).
        """
        return self._blocks(motion, self.w, self.w, self.held * force)

    def _blocks(
        self,
        motion: NodeMotion,
        w_acting: Factor,
        w_closing: Factor,
        force: Tensor,
        more: Callable[[Vector, Tensor], Tensor] | None = None,
        added: Tensor | None = None,
        more_along: tuple[Tensor, Tensor] | None = None,
    ) -> Tensor:
        """With w as it is where forces act, and where joints are closed; more(v, dg/dq) and
        `added` (..., J, 12, 12): what the forces' wrenches change by beside that; more_along:
        what further forces act along (..., J, w, 12), and their derivative by the moves of both
        nodes (..., J, 2, w, w). Moves are where forces act, the mean of start and end: of which the
        end makes `rate` times the displacement, and turns by rate * `half_turns` times the spin.
        """
        half, rate, (acting, end, *_) = motion.half_turns(), motion.rate, motion.placed(self.pose)
        v, w, v_end = self.v.at(acting), w_acting.at(acting), self.v.at(end)
        w_end = w_acting.at(end)
        by_v, by_w = self.v.by_moves(v_end.turning), w_acting.by_moves(w_end.turning)
        push = self.gradient(v, w)
        stiffness = self.curvature(v, w, by_v, by_w, v_end, w_end, force)
        if more is not None:
            stiffness = stiffness + more(v, push)
        stiffness = stiffness if added is None else stiffness + added
        if w_closing is not w_acting:
            w_end = w_closing.at(end)
            by_w = w_closing.by_moves(w_end.turning)
        closed = rate * (along(w_end.value, by_v) + along(v_end.value, by_w))  # (..., J, m, 12)
        E = torch.block_diag(self.moves, self.moves)  # (2 w, 12)
        spin = None if half is None else self.spins(half)
        held = self.held[..., None]
        constraint = columns(held * closed, E, spin)
        stiffness = columns(E @ stiffness, E, spin)
        if more_along is not None:
            pushed, force_by = more_along
            stiffness = stiffness + (pushed @ E.mT).mT[..., None, :, :] @ force_by
        stiffness = stiffness.unflatten(-2, (2, -1)).transpose(-4, -3)
        by_force = (push * held @ E.mT).mT.unflatten(-2, (2, -1))
        rows = stacked(stiffness, by_force[..., None, :, :], axis=-3)
        none = torch.diag_embed(1 - self.held)[:, None]  # forces that a joint has not are zero
        last_row = stacked(constraint, none, axis=-3)
        return stacked(rows, last_row[..., None, :, :, :], axis=-4)

    def spins(self, half: Tensor) -> Tensor:
        """(..., J, 2, w, w): what of a node's move its end takes, over `rate`."""
        half_turns = self.framework.at_joints(half.flatten(-2)).unflatten(-1, half.shape[-2:])
        return end_moves(half_turns, self.space.dims.position)

    def gradient(self, v: Vector, w: Vector) -> Tensor:
        """dg/dq (..., J, m, 12): by displacement and spin of the first node, then of the second."""
        apart = self.v.shift * w.value + self.w.shift * v.value
        a, b = (
            cross(turning_v, w.value) + cross(turning_w, v.value)
            for turning_v, turning_w in zip(v.turning.unbind(-3), w.turning.unbind(-3), strict=True)
        )
        return torch.cat((-apart, a, apart, b), -1)

    def curvature(
        self,
        v: Vector,
        w: Vector,
        by_v: Tensor,
        by_w: Tensor,
        v_end: Vector,
        w_end: Vector,
        force: Tensor,
    ) -> Tensor:
        """(..., J, 12, 12): derivative of lambda dg/dq, the wrenches on both nodes, by half the
        moves of the end.
        """
        if not self.space.turns:
            return force[..., :1, None] * force.new_zeros(12, 12)
        weight = force[..., None, None]
        # (..., J, 3, 12)
        apart = (weight * (self.v.shift[..., None] * by_w + self.w.shift[..., None] * by_v)).sum(-3)
        rows = [-apart, None, apart, None]
        for side in (0, 1):
            turned = [
                pad(-skew(end.turning[..., side, :, :]), (3 + 6 * side, 6 - 6 * side))
                for end in (v_end, w_end)
            ]
            moment = (
                skew(v.turning[..., side, :, :]) @ by_w
                - skew(w.value) @ turned[0]
                + skew(w.turning[..., side, :, :]) @ by_v
                - skew(v.value) @ turned[1]
            )
            rows[2 * side + 1] = (weight * moment).sum(-3)
        return torch.cat(torch.broadcast_tensors(*rows), -2)
