"""Chart: coordinates of a configuration, and of a state, about another one, as moves of the
nodes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import isnan
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.validation import concrete
from ..math.dense import inverse_unchecked, solve_unchecked
from ..math.shapes import broadcast_shapes, stacked
from ..nodal.assembly import Assembly
from ..nodal.between_nodes import BetweenNodes
from ..nodal.coordinates.spatial import Spatial
from ..nodal.model import Model
from ..nodal.moves import remembered, remembering
from ..state.state import State
from .minimal_moves import pivots

ITERATIONS = 30
SLOW = 1e-3  # of the move before: a move after which the rows are taken anew


class Place(NamedTuple):
    """Of a configuration: q (..., w (N+1)), and dq by moves of the nodes, displacement and turn,
    frame a, (..., w (N+1), w (N+1)).
    """

    q: Tensor
    by_moves: Tensor


@dataclass(frozen=True)
class Chart:
    """Coordinates of a configuration as moves of the nodes about `own`: with B the operator of the
    elements' strains there,

        B q = strain - strain of own,    q of the base node = its displacement and turn, frame a

    Each part of a structure has a base. There q has as many moves as joints leave, and is told by
    the joints' coordinates, by strains and by bases as far as it takes these, in this order.

    length (..., N, 1) m, of the elements
    bases  the nodes that hold the beams
    strain (..., N, k) of `own`;  solve (..., w (N+1), r): from displacements and turns of the
                                  bases, strains and coordinates of joints to q
    free   (n,) places of the moves that supports leave free among the nodes' w (N+1)
    independent (..., n - m, w (N+1)): of q, the coordinates that all of it follows from where
           supports and the m constraints of joints hold
    """

    assembly: Assembly
    space: Spatial
    own: State
    length: Tensor
    joints: BetweenNodes
    bases: tuple[int, ...]
    strain: Tensor
    solve: Tensor
    free: Tensor
    independent: Tensor

    @classmethod
    def of(cls, model: Model, state: State, moves: Tensor) -> Chart:
        """moves (..., w (N+1), n): by the coordinates that joints leave, where there are joints."""
        space, reduced = model.space, model.space.to_reduced(state)
        kinematics = model.kinematics(reduced.position, reduced.rotation)
        strain, none = space.strains(kinematics, model.length), torch.empty(0)
        chart = cls(
            model.assembly,
            space,
            reduced,
            model.length,
            model.joints,
            _bases(model),
            strain,
            none,
            model.constraints.moving.flatten().nonzero()[:, 0],
            none,
        )
        rows = chart._rows(reduced.position, reduced.rotation)
        if model.joints.count:
            solve, independent = chart._independent(moves, rows)
        else:
            eye = torch.eye(rows.shape[-1], dtype=rows.dtype, device=rows.device)
            solve, independent = inverse_unchecked(rows), eye[chart.free]
        return replace(chart, solve=solve, independent=independent)

    def __call__(
        self,
        position: Tensor,
        rotation: Tensor,
        joints: Tensor | None = None,
        kinematics: Any = None,
    ) -> Tensor:
        """q (..., w (N+1)) of a configuration in the space's coordinates; joints: as in `State`;
        kinematics: of the elements, None = not known.
        """
        kinematics = self.kinematics(position, rotation) if kinematics is None else kinematics
        space, reference, bases = self.space, self.own, list(self.bases)
        turn = space.logarithm(space.multiply(rotation, space.inverse(reference.rotation)))
        turn = turn if space.turns else space.to_frame(reference.rotation, turn)
        strain = space.strains(kinematics, self.length) - self.strain
        displacement = (position - reference.position)[..., bases, :]
        turn = turn[..., bases, :]
        lead = broadcast_shapes(displacement.shape[:-2], turn.shape[:-2])
        moved = torch.cat([x.expand(*lead, *x.shape[-2:]) for x in (displacement, turn)], -1)
        parts = (
            moved.flatten(-2),
            strain.flatten(-2),
            *self._of_joints(position, rotation, joints),
        )
        return (self.solve @ stacked(*parts, axis=-1)[..., None])[..., 0]

    def place(self, state: State) -> Place:
        """Of the configuration of a state in the space's coordinates."""
        position, rotation = state.position, state.rotation
        kinematics = self.kinematics(position, rotation)
        q = self(position, rotation, state.joints, kinematics)
        return Place(q, self.by_moves(position, rotation, kinematics))

    def coordinates(self, state: State, place: Place | None = None) -> Tensor:
        """[q; q'; internal states less own ones] (..., 2 w (N+1) + Z) of a state in the space's
        coordinates; place: its, None = not known.
        """
        q, by_moves = self.place(state) if place is None else place
        rate = (by_moves @ self.velocity(state).flatten(-2)[..., None])[..., 0]
        of_reference = remembered(self.own)
        lags = () if of_reference is None else (remembered(state) - of_reference,)
        return stacked(q, rate, *lags, axis=-1)

    def moved(self, near: State, by: Tensor, place: Place | None = None) -> State:
        """The state whose coordinates are those of `near` and `by` (..., 2 w (N+1) + Z) more, all
        in the space's coordinates; what supports hold and joints prescribe stays as `near` has
        it, and so do stress, reaction, time; place: of `near`, None = not known. First derivatives
        by `by` are exact. Raises ValueError where there is none.
        """
        space, reference, w = self.space, self.own, self.solve.shape[-2]
        q, rate, lags = by.split((w, w, by.shape[-1] - 2 * w), -1)
        at, by_moves = self.place(near) if place is None else place
        before = self.independent_and_held(near.position, near.rotation, by_moves)
        position, rotation, joints = self._placed(near, at, q, before.detach())
        by_moves = self.by_moves(position, rotation)
        u, rows = (
            self.velocity(near).flatten(-2),
            self.independent_and_held(position, rotation, by_moves),
        )
        more = before - rows
        more = self.independent_alone(rate) + (more @ u[..., None])[..., 0]
        u = (u + self._free_moves(rows, more)).unflatten(-1, (-1, space.unknowns))
        velocity, spin = u.split((space.dims.position, space.dims.spin), -1)
        if self.joints.count:
            pose = self.joints.pose(position, rotation)
            joints = self.joints.reading(pose, joints, (velocity, spin))
        own_spin = space.to_frame(reference.rotation, reference.spin)
        return replace(
            near,
            position=position,
            rotation=rotation,
            spin=space.to_section(rotation, spin + own_spin),
            velocity=velocity + reference.velocity + self._carried(own_spin, position),
            joints=joints,
            **remembering(near, lags),
        )

    def by_moves(self, position: Tensor, rotation: Tensor, kinematics: Any = None) -> Tensor:
        """J (..., w (N+1), w (N+1)): dq by moves of the nodes at a configuration, displacement and
        turn, frame a; kinematics: of the elements, None = not known.
        """
        rows = self._rows(position, rotation, kinematics)
        if self.space.dims.spin == 1:  # a turn in the plane is its own logarithm
            return self.solve @ rows
        p, w = self.space.dims.position, self.space.unknowns
        parts = []
        for k, base in enumerate(self.bases):
            moved, turn = rows[..., k * w : k * w + p, :], rows[..., k * w + p : (k + 1) * w, :]
            parts += [moved, self._by_turn(rotation, base) @ turn]
        parts.append(rows[..., len(self.bases) * w :, :])
        return self.solve @ stacked(*parts)

    def independent_and_held(self, position: Tensor, rotation: Tensor, by_moves: Tensor) -> Tensor:
        """(..., n, w (N+1)): the independent coordinates, and behind them what joints hold, by
        moves of the nodes at a configuration, where all of q are so by them.
        """
        rows = self.independent @ by_moves
        if not self.joints.count:
            return rows
        return stacked(rows, self.joints.held_rows(self.joints.pose(position, rotation)))

    def independent_alone(self, q: Tensor) -> Tensor:
        """(..., n) of what `independent_and_held` has rows of: of q, and 0 of what joints hold."""
        moves = (self.independent @ q[..., None])[..., 0]
        return pad(moves, (0, len(self.free) - moves.shape[-1]))

    def _placed(
        self, near: State, at: Tensor, by: Tensor, rows: Tensor
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """The configuration whose coordinates are those of `near`, `at`, and `by` more, by Newton's
        method from that of `near`, where `rows` are `independent_and_held`, with readings of
        joints; its last step is recorded. Where nothing is, the rows stay as long as moves become
        short quickly (the chord method).
        """
        space, size = self.space, self.length.detach().sum((-1, -2))[..., None]
        if self.joints.count:
            size = self.joints.size.detach()[..., None]
        unit = torch.cat(
            (
                size.expand(*size.shape[:-1], space.dims.position),
                torch.ones(space.dims.spin).to(size).expand(*size.shape[:-1], space.dims.spin),
            ),
            -1,
        )[..., None, :]
        position, rotation, joints = near.position, near.rotation, near.joints
        q, at = at + by, at.detach()
        recorded = torch.is_grad_enabled() and q.requires_grad
        enough, largest, share = torch.finfo(q.dtype).eps, torch.inf, 0.0
        for k in range(ITERATIONS):
            anew = not k or recorded or share > SLOW
            if k:
                with torch.no_grad():
                    kinematics = self.kinematics(position, rotation)
                    at = self(position, rotation, joints, kinematics)
                    if anew:
                        by_moves = self.by_moves(position, rotation, kinematics)
                        rows = self.independent_and_held(position, rotation, by_moves)
            change = self.independent_alone(q - at)
            if self.joints.count:
                gaps = self.joints.gaps(self.joints.pose(position, rotation), near.joints).detach()
                change = change - pad(gaps, (self.independent.shape[-2], 0))
            move = self._free_moves(rows, change).unflatten(-1, (-1, space.unknowns))
            before, largest = largest, _largest((move.detach() / unit).abs())
            share = largest if anew else largest / before  # what is left of a move after it
            displacement, turn = move.split((space.dims.position, space.dims.spin), -1)
            turn = space.exponential(turn if space.turns else space.to_section(rotation, turn))
            position = position + displacement
            rotation = space.normalize(space.multiply(turn, rotation))
            if self.joints.count:
                joints = self.joints.reading(self.joints.pose(position, rotation), joints)
            if not largest * min(share, 1.0) > enough:
                return position, rotation, joints
            position, rotation = position.detach(), rotation.detach()
            joints = None if joints is None else joints.detach()
        raise ValueError(
            f"coordinates that no configuration has were given: its last move was {largest:.1e} of "
            "the beam's length; a state nearer to the model's own is wanted"
        )

    def _free_moves(self, rows: Tensor, change: Tensor) -> Tensor:
        """Moves of the nodes (..., w (N+1)) that change what `independent_and_held` has rows of by
        those (..., n), and none that is held.
        """
        free = self.free
        moves = solve_unchecked(rows[..., free], change[..., None])[..., 0]
        return moves.new_zeros(*moves.shape[:-1], rows.shape[-1]).index_copy(-1, free, moves)

    def kinematics(self, position: Tensor, rotation: Tensor) -> Any:
        return self.space.kinematics(*self.assembly.poses(position, rotation), self.length)

    def _rows(self, position: Tensor, rotation: Tensor, kinematics: Any = None) -> Tensor:
        """(..., r, w (N+1)): displacements and turns of the bases, strains and coordinates of
        joints by moves of the nodes, frame a.
        """
        w, moves = self.space.unknowns, self.unit_moves
        kinematics = self.kinematics(position, rotation) if kinematics is None else kinematics
        B = self.space.strain_operator(kinematics, self.length)
        rows = torch.einsum("...eij,mej->...eim", B, moves).flatten(-3, -2)
        eye = torch.eye(len(moves), dtype=rows.dtype, device=rows.device).unflatten(0, (-1, w))
        parts = [eye[list(self.bases)].flatten(0, 1), rows]
        if self.joints.count:
            parts.append(self.joints.coordinate_rows(self.joints.pose(position, rotation)))
        return stacked(*parts)

    def _of_joints(
        self, position: Tensor, rotation: Tensor, joints: Tensor | None
    ) -> tuple[Tensor, ...]:
        """Coordinates (..., c) of joints less those of `own`."""
        if not self.joints.count:
            return ()
        now, before = (
            self.joints.coordinates(self.joints.pose(*pose), counted)
            for pose, counted in (
                ((position, rotation), joints),
                ((self.own.position, self.own.rotation), self.own.joints),
            )
        )
        return (now - before,)

    def _independent(self, moves: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """`solve` and `independent` of fewer coordinates, of moves (..., w (N+1), n), by as many of
        the rows.
        """
        all_rows, rows, w, bases = rows, rows @ moves, self.space.unknowns, len(self.bases)
        at = torch.arange(rows.shape[-2], device=rows.device)
        strains = bases * w + self.strain.shape[-2:].numel()
        place = at % w < self.space.dims.position
        groups = at >= strains, (at >= bases * w) & (at < strains), ~place & (at < bases * w), place
        chosen = pivots(rows.mT, groups)
        solve = moves @ inverse_unchecked(rows[..., chosen, :])
        solve = solve.new_zeros(*solve.shape[:-1], len(at)).index_copy(-1, chosen, solve)
        return solve, all_rows[..., chosen, :]

    @cached_property
    def unit_moves(self) -> Tensor:
        """(w (N+1), N, numbers) of the elements, by unit moves of the nodes."""
        w = self.space.unknowns
        eye = torch.eye(
            w * self.own.position.shape[-2], dtype=self.length.dtype, device=self.length.device
        )
        return self.assembly.to_elements(eye.unflatten(-1, (-1, w)))

    def turned(self, rotation: Tensor, base: int) -> Tensor:
        """The base's rotation from its own."""
        return self.space.multiply(rotation, self.space.inverse(self.own.rotation))[..., base, :]

    def _by_turn(self, rotation: Tensor, base: int) -> Tensor:
        """Derivative of the base's turn by a turn that comes on top, from the left."""
        return self.space.of_nodes(base).logarithm_by_turn(self.turned(rotation, base)).mT

    def velocity(self, state: State) -> Tensor:
        """Velocity and spin (..., N+1, w) of the nodes, frame a, beside those of the model's own
        motion.
        """
        space, reference = self.space, self.own
        before = space.to_frame(reference.rotation, reference.spin)
        velocity = state.velocity - reference.velocity - self._carried(before, state.position)
        spin = space.to_frame(state.rotation, state.spin) - before
        return stacked(velocity, spin, axis=-1)

    def _carried(self, spin: Tensor, position: Tensor) -> Tensor:
        """What the model's own spin (frame a) makes of a displacement."""
        return (self.space.skew(spin) @ (position - self.own.position)[..., None])[..., 0]


def _largest(moves: Tensor) -> float:
    """Of samples that are numbers: those that are not hold up no others."""
    if not moves.numel():
        return 0.0
    largest = concrete(moves.amax()).item()
    return concrete(moves.nan_to_num(nan=0.0).amax()).item() if isnan(largest) else largest


def _bases(model: Model) -> tuple[int, ...]:
    """The first node of each part that a support holds, or else its first."""
    parts = [part.nodes for part in model.scene.beam.parts] or [slice(0, model.node_count)]
    held = model.constraints.nodes
    return tuple(
        min((n for n in held if part.start <= n < part.stop), default=part.start) for part in parts
    )
