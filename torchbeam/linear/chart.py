"""Chart: coordinates of a configuration, and of a state, about another one, as moves of the
nodes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.validation import concrete
from ..math.dense import inverse_unchecked, solve_unchecked
from ..math.shapes import broadcast_shapes
from ..nodal.assembly import Assembly
from ..nodal.coordinates.spatial import Spatial
from ..nodal.joint_motion import NoJoints
from ..nodal.model import Model
from ..state.state import State
from .minimal_moves import pivots

ITERATIONS = 30


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
    """

    assembly: Assembly
    space: Spatial
    own: State
    length: Tensor
    joints: NoJoints
    bases: tuple[int, ...]
    strain: Tensor
    solve: Tensor
    free: Tensor

    @classmethod
    def of(cls, model: Model, state: State, moves: Tensor) -> Chart:
        """moves (..., w (N+1), n): by the coordinates that joints leave, where there are joints."""
        space, own = model.space, model.space.to_reduced(state)
        kinematics = model.kinematics(own.position, own.rotation)
        strain, none = space.strains(kinematics, model.length), torch.empty(0)
        chart = cls(
            model.assembly,
            space,
            own,
            model.length,
            model.joints,
            _bases(model),
            strain,
            none,
            model.constraints.moving.flatten().nonzero()[:, 0],
        )
        rows = chart._rows(own.position, own.rotation)
        solve = chart._told_by(moves, rows) if model.joints.count else inverse_unchecked(rows)
        return replace(chart, solve=solve)

    def __call__(self, position: Tensor, rotation: Tensor, joints: Tensor | None = None) -> Tensor:
        """q (..., w (N+1)) of a configuration in the space's coordinates; joints: as in `State`."""
        space, own, bases = self.space, self.own, list(self.bases)
        turn = space.logarithm(space.multiply(rotation, space.inverse(own.rotation)))
        turn = turn if space.turns else space.to_frame(own.rotation, turn)
        strain = space.strains(self._kinematics(position, rotation), self.length) - self.strain
        displacement = (position - own.position)[..., bases, :]
        turn = turn[..., bases, :]
        lead = broadcast_shapes(displacement.shape[:-2], turn.shape[:-2])
        moved = torch.cat([x.expand(*lead, *x.shape[-2:]) for x in (displacement, turn)], -1)
        parts = (
            moved.flatten(-2),
            strain.flatten(-2),
            *self._of_joints(position, rotation, joints),
        )
        lead = broadcast_shapes(*(x.shape[:-1] for x in parts))
        return (self.solve @ torch.cat([x.expand(*lead, -1) for x in parts], -1)[..., None])[..., 0]

    def coordinates(self, state: State) -> Tensor:
        """[q; q'; internal states less own ones] (..., 2 w (N+1) + Z) of a state in the space's
        coordinates.
        """
        rate = (
            self.by_moves(state.position, state.rotation)
            @ self._velocity(state).flatten(-2)[..., None]
        )[..., 0]
        lags = () if self.own.internal is None else (state.internal - self.own.internal,)
        parts = (self(state.position, state.rotation, state.joints), rate, *lags)
        lead = broadcast_shapes(*(x.shape[:-1] for x in parts))
        return torch.cat([x.expand(*lead, -1) for x in parts], -1)

    def moved(self, near: State, by: Tensor) -> State:
        """The state whose coordinates are those of `near` and `by` (..., 2 w (N+1) + Z) more, all
        in the space's coordinates; what supports hold stays as `near` has it, and so do stress,
        reaction, time. First derivatives by `by` are exact. Raises ValueError where there is none.
        """
        self._of_one_beam("a state at coordinates")
        space, own = self.space, self.own
        w = self.solve.shape[-1]
        q, rate, lags = (self.coordinates(near) + by).split((w, w, by.shape[-1] - 2 * w), -1)
        position, rotation = self._placed(near.position, near.rotation, q)
        J, velocity = self.by_moves(position, rotation), self._velocity(near).flatten(-2)
        velocity = velocity + self._free_moves(J, rate - (J @ velocity[..., None])[..., 0])
        velocity, spin = velocity.unflatten(-1, (-1, space.unknowns)).split(
            (space.dims.position, space.dims.spin), -1
        )
        before = space.to_frame(own.rotation, own.spin)
        return replace(
            near,
            position=position,
            rotation=rotation,
            spin=space.to_section(rotation, spin + before),
            velocity=velocity + own.velocity + self._carried(before, position),
            internal=None if own.internal is None else own.internal + lags,
        )

    def by_moves(self, position: Tensor, rotation: Tensor) -> Tensor:
        """J (..., w (N+1), w (N+1)): dq by moves of the nodes at a configuration, displacement and
        turn, frame a.
        """
        rows = self._rows(position, rotation)
        p, w = self.space.dims.position, self.space.unknowns
        parts = []
        for k, base in enumerate(self.bases):
            moved, turn = rows[..., k * w : k * w + p, :], rows[..., k * w + p : (k + 1) * w, :]
            parts += [moved, self._by_turn(rotation, base) @ turn]
        parts.append(rows[..., len(self.bases) * w :, :])
        lead = broadcast_shapes(*(x.shape[:-2] for x in parts))
        return self.solve @ torch.cat([x.expand(*lead, -1, -1) for x in parts], -2)

    def slopes(self, state: State) -> tuple[Tensor, Tensor]:
        """Derivatives of `coordinates` by a move of the state (see `nodal.moves`), (..., 2 w
        (N+1) + Z, 2 w (N+1) + Z), and of the move by coordinates, where what supports hold stays.
        With u the velocities less those of the model's own motion,

            dq = J m        dq' = J (v - W m) + d(J u)/dm m
            (W: what the model's own spin makes of a displacement)
        """
        self._of_one_beam("derivatives of a step")
        space, u, free = self.space, self._velocity(state), self.free
        J = self.by_moves(state.position, state.rotation)
        before = space.to_frame(self.own.rotation, self.own.spin)
        carried = pad(space.skew(before), (0, space.dims.spin, 0, space.dims.spin))
        rate = self._by_moves_of_rate(state, u) - J @ _of_each(carried)
        J = J.expand_as(rate)
        states = 0 if self.own.internal is None else self.own.internal.shape[-1]
        back = inverse_unchecked(J[..., free, :][..., free])
        after = _triangular(back, -back @ rate[..., free, :][..., free] @ back, states)
        w = J.shape[-1]
        at = torch.cat((free, w + free, 2 * w + torch.arange(states, device=free.device)))
        whole = after.new_zeros(*after.shape[:-1], 2 * w + states).index_copy(-1, at, after)
        whole = after.new_zeros(*after.shape[:-2], *2 * (2 * w + states,)).index_copy(-2, at, whole)
        return _triangular(J, rate, states), whole

    def _by_moves_of_rate(self, state: State, u: Tensor) -> Tensor:
        """d(J u)/dm (..., w (N+1), w (N+1)) by moves m of the nodes, with u (..., N+1, w) as it is
        in frame a.

        The geometric stiffness of a stress is the derivative of h B^T stress: that of a unit
        stress, times u, is that of the rate of its strain.
        """
        space, length, base = self.space, self.length, self.bases[0]
        kinematics = self._kinematics(state.position, state.rotation)
        own = self.assembly.to_elements(u)
        eye = torch.eye(space.dims.strain, dtype=u.dtype, device=u.device)
        lead = broadcast_shapes(own.shape[:-1], kinematics[0].shape[: u.ndim - 1])
        unit = eye.view(-1, *(1,) * len(lead), space.dims.strain).expand(-1, *lead, -1)
        K = space.geometric_stiffness(kinematics, unit, length)
        strains = torch.einsum(
            "k...ea,k...eab->...ekb",
            (own / length).expand(len(eye), *lead, -1),
            K.expand(len(eye), *lead, *K.shape[-2:]),
        )
        strains = torch.einsum("...ekb,meb->...ekm", strains, self._moves()).flatten(-3, -2)
        p, w = space.dims.position, space.unknowns
        root = strains.new_zeros(*strains.shape[:-2], w, strains.shape[-1])
        if space.turns and space.dims.spin > 1:
            by_turn = _rate_of_turn(
                space.of_nodes(base), self._turned(state.rotation, base), u[..., base, p:]
            )
            root[..., p:, base * w + p : (base + 1) * w] = by_turn
        return self.solve @ torch.cat((root, strains), -2)

    def _placed(self, position: Tensor, rotation: Tensor, q: Tensor) -> tuple[Tensor, Tensor]:
        """The configuration with the coordinates q, by Newton's method from another one; its last
        step is recorded.
        """
        space, size = self.space, self.length.detach().sum((-1, -2))[..., None]
        unit = torch.cat(
            (
                size.expand(*size.shape[:-1], space.dims.position),
                torch.ones(space.dims.spin).to(size).expand(*size.shape[:-1], space.dims.spin),
            ),
            -1,
        )[..., None, :]
        enough, before = torch.finfo(q.dtype).eps ** 0.5, float("inf")
        for _ in range(ITERATIONS):
            with torch.no_grad():
                J, at = self.by_moves(position, rotation), self(position, rotation)
                largest = (
                    (self._free_moves(J, q - at).unflatten(-1, (-1, space.unknowns)) / unit)
                    .abs()
                    .amax()
                )
            move = self._free_moves(J, q - at).unflatten(-1, (-1, space.unknowns))
            displacement, turn = move.split((space.dims.position, space.dims.spin), -1)
            turn = space.exponential(turn if space.turns else space.to_section(rotation, turn))
            position = position + displacement
            rotation = space.normalize(space.multiply(turn, rotation))
            if not concrete(largest > enough).any():
                return position, rotation
            position, rotation = position.detach(), rotation.detach()
            before = concrete(largest).item()
        raise ValueError(
            f"coordinates that no configuration has were given: its last move was {before:.1e} of "
            "the beam's length; a state nearer to the model's own is wanted"
        )

    def _free_moves(self, J: Tensor, change: Tensor) -> Tensor:
        """Moves of the nodes (..., w (N+1)) that change the free ones of q by those of `change`,
        and none that is held.
        """
        free = self.free
        own = solve_unchecked(J[..., free, :][..., free], change[..., free, None])[..., 0]
        return own.new_zeros(*own.shape[:-1], change.shape[-1]).index_copy(-1, free, own)

    def _kinematics(self, position: Tensor, rotation: Tensor) -> Any:
        return self.space.kinematics(*self.assembly.poses(position, rotation), self.length)

    def _rows(self, position: Tensor, rotation: Tensor) -> Tensor:
        """(..., r, w (N+1)): displacements and turns of the bases, strains and coordinates of
        joints by moves of the nodes, frame a.
        """
        w, moves = self.space.unknowns, self._moves()
        B = self.space.strain_operator(self._kinematics(position, rotation), self.length)
        rows = torch.einsum("...eij,mej->...eim", B, moves).flatten(-3, -2)
        eye = torch.eye(len(moves), dtype=rows.dtype, device=rows.device).unflatten(0, (-1, w))
        parts = [eye[list(self.bases)].flatten(0, 1), rows]
        if self.joints.count:
            parts.append(self.joints.coordinate_rows(self.joints.pose(position, rotation)))
        lead = broadcast_shapes(*(x.shape[:-2] for x in parts))
        return torch.cat([x.expand(*lead, *x.shape[-2:]) for x in parts], -2)

    def _of_joints(
        self, position: Tensor, rotation: Tensor, joints: Tensor | None
    ) -> tuple[Tensor, ...]:
        """Coordinates (..., c) of joints less those of `own`."""
        if not self.joints.count:
            return ()
        now, before = (
            self.joints.coordinates(self.joints.pose(*pose), counted[..., 0])
            for pose, counted in (
                ((position, rotation), joints),
                ((self.own.position, self.own.rotation), self.own.joints),
            )
        )
        return (now - before,)

    def _told_by(self, moves: Tensor, rows: Tensor) -> Tensor:
        """`solve` of fewer coordinates, of moves (..., w (N+1), n), by as many of the rows."""
        rows, w, bases = rows @ moves, self.space.unknowns, len(self.bases)
        at = torch.arange(rows.shape[-2], device=rows.device)
        strains = bases * w + self.strain.shape[-2:].numel()
        place = at % w < self.space.dims.position
        groups = at >= strains, (at >= bases * w) & (at < strains), ~place & (at < bases * w), place
        chosen = pivots(rows.mT, groups)
        told = moves @ inverse_unchecked(rows[..., chosen, :])
        return told.new_zeros(*told.shape[:-1], len(at)).index_copy(-1, chosen, told)

    def _of_one_beam(self, what: str) -> None:
        """ValueError for a structure."""
        if self.joints.count or len(self.bases) > 1:
            raise ValueError(
                f"{what} was asked for of a structure, where there are none; a linear model of one "
                "beam is wanted"
            )

    def _moves(self) -> Tensor:
        """(w (N+1), N, numbers) of the elements, by unit moves of the nodes."""
        w = self.space.unknowns
        eye = torch.eye(
            w * self.own.position.shape[-2], dtype=self.length.dtype, device=self.length.device
        )
        return self.assembly.to_elements(eye.unflatten(-1, (-1, w)))

    def _turned(self, rotation: Tensor, base: int) -> Tensor:
        """The base's rotation from its own."""
        return self.space.multiply(rotation, self.space.inverse(self.own.rotation))[..., base, :]

    def _by_turn(self, rotation: Tensor, base: int) -> Tensor:
        """Derivative of the base's turn by a turn that comes on top, from the left."""
        return self.space.of_nodes(base).logarithm_by_turn(self._turned(rotation, base)).mT

    def _velocity(self, state: State) -> Tensor:
        """Velocity and spin (..., N+1, w) of the nodes, frame a, beside those of the model's own
        motion.
        """
        space, own = self.space, self.own
        before = space.to_frame(own.rotation, own.spin)
        velocity = state.velocity - own.velocity - self._carried(before, state.position)
        spin = space.to_frame(state.rotation, state.spin) - before
        lead = broadcast_shapes(velocity.shape[:-1], spin.shape[:-1])
        return torch.cat((velocity.expand(*lead, -1), spin.expand(*lead, -1)), -1)

    def _carried(self, spin: Tensor, position: Tensor) -> Tensor:
        """What the model's own spin (frame a) makes of a displacement."""
        return (self.space.skew(spin) @ (position - self.own.position)[..., None])[..., 0]


def _bases(model: Model) -> tuple[int, ...]:
    """The first node of each part that a support holds, or else its first."""
    parts = [part.nodes for part in model.scene.beam.parts] or [slice(0, model.node_count)]
    held = model.constraints.nodes
    return tuple(
        min((n for n in held if part.start <= n < part.stop), default=part.start) for part in parts
    )


def _of_each(blocks: Tensor) -> Tensor:
    """Block diagonal (..., n w, n w) of blocks (..., n, w, w)."""
    n = blocks.shape[-3]
    own = torch.eye(n, dtype=blocks.dtype, device=blocks.device)
    return (own[:, None, :, None] * blocks[..., :, :, None, :]).flatten(-4, -3).flatten(-2)


def _triangular(A: Tensor, below: Tensor, states: int) -> Tensor:
    """[[A, 0, 0], [below, A, 0], [0, 0, I]], with so many rows of I."""
    X = torch.cat((torch.cat((A, torch.zeros_like(A)), -1), torch.cat((below, A), -1)), -2)
    own = torch.eye(states, dtype=A.dtype, device=A.device)
    return pad(X, (0, states, 0, states)) + pad(own, 2 * (X.shape[-1], 0)) if states else X


def _rate_of_turn(space: Spatial, q: Tensor, spin: Tensor) -> Tensor:
    """Derivative (..., s, s) by a turn from the left of what the spin (..., s) makes of the
    logarithm of q.
    """
    lead, s = broadcast_shapes(q.shape[:-1], spin.shape[:-1]), space.dims.spin
    with torch.enable_grad():
        x = spin.new_zeros(s, *lead, s, requires_grad=True)
        turned = space.multiply(space.exponential(x), q.detach())
        rate = (space.logarithm_by_turn(turned).mT @ spin.detach()[..., None])[..., 0]
        (slope,) = torch.autograd.grad(rate.movedim(0, -1).diagonal(dim1=-2, dim2=-1).sum(), x)
    return slope.movedim(0, -2)
