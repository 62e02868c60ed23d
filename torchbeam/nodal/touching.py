"""Beams and bodies that touch each other. Places x along one of them meet the `centreline` c of the
other at its nearest place: with r = x - c, the gap is |r| less both radii, and the force per length

    f = p u - friction p s        on x, and -f on c

As x and c are sums of nodes' positions, with shares that a step holds fixed,
2 (mean of r) . (r_{n+1} - r_n) = |r_{n+1}|^2 - |r_n|^2: with u = 2 (mean of r)/(|r_n| + |r_{n+1}|)
and p the difference of the law's potential over that of the gap, f does as much work as the
potential of these two places has lost (Gonzalez 1996); momentum and angular momentum stay. Between
two beams both have such places, and each half of the force.

Friction acts at a place between, which divides r as the radii do, against the slip of both
surfaces there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.leaves import leaf, wants_gradient
from ..core.validation import concrete
from ..math.concrete import mapped
from ..scene.effects.contact_law import damped, potential, pressure, rubbing
from ..scene.effects.contact_terms import ContactTerms
from ..scene.effects.drag import norm
from ..scene.effects.load_point import SPIN, VELOCITY, jacobians
from ..topology.cut import added
from .centreline import bernstein, nearest
from .coordinates.spatial import Spatial
from .touching_motion import NoTouching, TouchingMotion


class Nearby(NamedTuple):
    """Which of the places along one part may touch which pieces of the other, U pairs: their
    numbers (U), and the nodes (U, 6) of both.
    """

    point: Tensor
    piece: Tensor
    nodes: Tensor


class Meeting(NamedTuple):
    """Of U pairs: shares (..., U, 6) of their nodes in r (..., U, 3) m; gap (..., U, 1) m; pressure
    N/m, p and p without damping (..., U, 1); u (..., U, 3), rub N/m, slip m/s (..., U, 3),
    None = there is no friction; measure (..., U, 1) m, 0 where another piece is nearest.
    """

    shares: Tensor
    r: Tensor
    gap: Tensor
    pressure: Tensor
    elastic: Tensor
    u: Tensor
    slip: Tensor | None
    rub: Tensor | None
    measure: Tensor

    @property
    def force(self) -> Tensor:
        """(..., U, 3) N on the place of the first part."""
        force = self.pressure * self.u
        return self.measure * (force if self.rub is None else force + self.rub)


@dataclass(frozen=True)
class Touching(NoTouching):
    """Places along one part, and the pieces of another, or of the same beam.

    contact   the law; pair: its place among the scene's; first: whether places are on its first
              part
    points    of each place its three nodes; shares (..., P, 3) of these; measure (..., P) m of
              the beam's length, 1 of a body, 0 of what a sample has fewer; which of the pieces it
              may touch: allowed (..., P, K), 1 or 0
    pieces    of each piece its three nodes; control (K, 3, 3), ends (K, 2): see `centreline`
    radii     (..., 2) m of both
    """

    contact: ContactTerms
    pair: int
    first: bool
    points: tuple[tuple[int, int, int], ...]
    pieces: tuple[tuple[int, int, int], ...]
    shares: Tensor = leaf(2)
    measure: Tensor = leaf(1)
    allowed: Tensor = leaf(2)
    control: Tensor = leaf(3)
    ends: Tensor = leaf(2)
    radii: Tensor = leaf(1)

    def nearby(self, motion: TouchingMotion, all_of_them: bool = False) -> Nearby:
        """By the spheres about pieces; all pairs where samples are seen one at a time."""
        device = motion.position.device
        points, pieces = (torch.tensor(x, device=device) for x in (self.points, self.pieces))
        pairs = concrete((self.allowed > 0).detach())
        pairs = pairs.flatten(0, -3).any(0) if pairs.ndim > 2 else pairs
        if not all_of_them and not mapped(motion.position):
            x = concrete(motion.position.detach())
            place = (self.shares[..., None] * x[..., points, :]).sum(-2)
            own = x[..., pieces[:, 1], :]
            corners = self.control @ x[..., pieces, :] - own[..., None, :]
            reach = torch.linalg.vector_norm(corners, dim=-1).amax(-1)
            reach = reach + (self.radii.sum(-1) + self.contact.thickness)[..., None].detach()
            reach = reach[..., None, :]
            if motion.half is not None:
                half = concrete(motion.half.detach())
                moves = torch.linalg.vector_norm(half, dim=-1)
                there = torch.linalg.vector_norm(
                    (self.shares[..., None] * half[..., points, :]).sum(-2), dim=-1
                )
                reach = reach + moves[..., pieces].amax(-1)[..., None, :] + there[..., None]
            apart = place[..., :, None, :] - own[..., None, :, :]
            near = concrete((apart.square().sum(-1) <= reach.square()).detach())
            pairs = pairs & near.flatten(0, -3).any(0) if near.ndim > 2 else pairs & near
        point, piece = concrete(pairs).nonzero().unbind(-1)
        return Nearby(point, piece, torch.cat((points[point], pieces[piece]), -1))

    def meeting(
        self,
        near: Nearby,
        x: Tensor,
        half: Tensor | None,
        velocity: Tensor | None,
        spin: Tensor | None,
    ) -> Meeting:
        """Of the pairs, whose nodes are at x (..., U, 6, 3) m, and move so, see
        `TouchingMotion`.
        """
        law, own, nodes = self.contact, self.shares[..., near.point, :], x[..., 3:, :]
        control, ends = self.control[near.piece], self.ends[near.piece] > 0
        place = (own[..., None] * x[..., :3, :]).sum(-2)
        t, within = nearest(place, nodes, control, ends)
        other = (bernstein(t)[..., None, :] @ control)[..., 0, :]
        shares = torch.cat((own.expand_as(other), -other), -1)

        def apart(values: Tensor) -> Tensor:
            return (shares[..., None] * values).sum(-2)

        r = apart(x)
        change = None if half is None else apart(half)
        lengths = [norm(r)] if half is None else [norm(r - change), norm(r + change)]
        size = (lengths[0] + lengths[-1]) / 2
        u = r / torch.where(size > 0, size, torch.ones_like(size))
        d, slope = law.thickness[..., None, None], law.slope[..., None, None]
        room = d + self.radii.sum(-1)[..., None, None]
        elastic = p = pressure(room - lengths[0], room - lengths[-1], d, slope)
        if law.damping is not None and velocity is not None:
            approach = -(apart(velocity) * u).sum(-1, keepdim=True)
            p = p * damped(approach * law.damping[..., None, None] / d)
        slip = rub = None
        if law.friction is not None and velocity is not None:
            slip = self._slip(shares, r, apart(velocity), spin)
            rub = -law.friction[..., None, None] * p
            rub = rub * rubbing(slip, law.slip_speed[..., None, None])
        allowed = self.allowed[..., near.point, near.piece]
        measure = (self.measure[..., near.point] * allowed * within)[..., None]
        return Meeting(shares, r, norm(r) - (room - d), p, elastic, u, slip, rub, measure)

    def wrenches(self, meeting: Meeting) -> Tensor:
        """(..., U, 6, 6) N and N m on the nodes."""
        force = meeting.force
        moment = -torch.linalg.cross(*torch.broadcast_tensors(meeting.r, force))
        by_node = meeting.shares[..., None] * force[..., None, :]
        turned = (self._levers(meeting.shares)[..., None]) * moment[..., None, :]
        return torch.cat(torch.broadcast_tensors(by_node, turned), -1)

    def _slip(self, shares: Tensor, r: Tensor, velocity: Tensor, spin: Tensor) -> Tensor:
        """(..., U, 3) m/s of the first part's surface on the second's."""
        turn = (self._levers(shares)[..., None] * spin).sum(-2)
        slip = velocity - torch.linalg.cross(*torch.broadcast_tensors(turn, r))
        size = norm(r)
        n = r / torch.where(size > 0, size, torch.ones_like(size))
        return slip - (slip * n).sum(-1, keepdim=True) * n

    def _levers(self, shares: Tensor) -> Tensor:
        """(..., U, 6): the shares, each of its part's share in both radii."""
        own, other = self.radii.unbind(-1)
        both = own + other
        first = torch.where(both > 0, own / torch.where(both > 0, both, 1.0), 0.5)
        levers = torch.stack((first, first - 1), -1).repeat_interleave(3, -1)
        return levers[..., None, :] * shares

    def at(self, near: Nearby, motion: TouchingMotion) -> tuple[Tensor | None, ...]:
        """Of the pairs' nodes (..., U, 6, 3): position, half, velocity, spin."""
        return tuple(None if x is None else x[..., near.nodes, :] for x in motion[:4])

    def slopes(self, near: Nearby, motion: TouchingMotion) -> tuple[Tensor, ...]:
        """Derivatives (..., U, 6, 6, 6, 3) of `wrenches` by positions, velocities and spins; the
        last two where the law asks for them.
        """
        x, half, *rates = self.at(near, motion)
        names = [k for k, name in enumerate((VELOCITY, SPIN)) if name in self.reads]
        given = [x, *(rates[k] for k in names if rates[k] is not None)]

        def pushed(x: Tensor, *moving: Tensor) -> Tensor:
            x, *moving = (part.unflatten(-1, (6, 3)) for part in (x, *moving))
            velocity, spin = (*moving, None, None)[:2]
            now = None if half is None else half + (x - x.detach())
            return self.wrenches(self.meeting(near, x, now, velocity, spin)).flatten(-2)

        slopes = jacobians(pushed, *(part.flatten(-2) for part in given))
        return tuple(x.unflatten(-1, (6, 3)).unflatten(-3, (6, 6)) for x in slopes)

    def energy(self, motion: TouchingMotion, side: float) -> Tensor:
        """(...) J at the end of a step (side 1), or at its start (-1)."""
        near = self.nearby(motion)
        x, half, *_ = self.at(near, motion)
        found = self.meeting(near, x if half is None else x + side * half, None, None, None)
        d, slope = (v[..., None, None] for v in (self.contact.thickness, self.contact.slope))
        return (found.measure * potential(d - found.gap, d, slope)).sum((-1, -2))

    def work(self, motion: TouchingMotion) -> Tensor:
        done = self.energy(motion, -1.0) - self.energy(motion, 1.0)
        if not self.lossy or motion.dt is None:
            return done
        near = self.nearby(motion)
        x, half, velocity, spin = self.at(near, motion)
        found = self.meeting(near, x, half, velocity, spin)
        apart = (found.shares[..., None] * velocity).sum(-2)
        power = (found.pressure - found.elastic) * (found.u * apart).sum(-1, keepdim=True)
        if found.rub is not None:
            power = power + (found.rub * found.slip).sum(-1, keepdim=True)
        return done + motion.dt * (found.measure * power).sum((-1, -2))

    def passed(self, motion: TouchingMotion) -> Tensor:
        near = self.nearby(motion)
        x, half, *_ = self.at(near, motion)
        found = self.meeting(near, x, half, None, None)
        change = (found.shares[..., None] * half).sum(-2)
        before, after = found.r - change, found.r + change
        turned = (before * after).sum(-1, keepdim=True) < 0
        return ((found.gap < 0) & turned & (found.measure > 0))[..., 0].any(-1)

    @property
    def lossy(self) -> bool:
        return self.contact.lossy

    @property
    def reads(self) -> frozenset[str]:
        law = self.contact
        asked = {VELOCITY} if law.lossy else set()
        return frozenset(asked | ({SPIN} if law.friction is not None else set()))


@dataclass(frozen=True)
class AllTouching(NoTouching):
    """All of a scene. moves (w, 6): displacement and spin in space of a node's moves."""

    space: Spatial
    each: tuple[Touching, ...]
    moves: Tensor = leaf(2)

    present = True

    @property
    def lossy(self) -> bool:
        return any(one.lossy for one in self.each)

    @property
    def reads(self) -> frozenset[str]:
        return frozenset().union(*(one.reads for one in self.each))

    def loaded(self, nodes: Tensor, motion: Callable[[], TouchingMotion]) -> Tensor:
        now = motion()
        for one in self.each:
            near = one.nearby(now)
            if not len(near.point):
                continue
            push = one.wrenches(one.meeting(near, *one.at(near, now)))
            rows = tuple(near.nodes.flatten().tolist())
            push = -(push @ self.moves.mT).flatten(-3, -2)
            nodes = added(nodes, rows, push, nodes.shape[-2], 1)
        return nodes

    def matrix(self, matrix: Any, motion: Callable[[], TouchingMotion]) -> Any:
        return self._tied(matrix, motion(), self._by_moves)

    def damping(self, matrix: Any, position: Tensor) -> Any:
        still = torch.zeros_like(position)
        sizes = self.space.dims.position, self.space.dims.spin
        names = (VELOCITY, SPIN)
        eyes = (torch.eye(n, dtype=position.dtype, device=position.device)[None] for n in sizes)
        by = dict(zip(names, eyes, strict=True))
        motion = TouchingMotion(position, None, still, still, None, lambda: by)
        return self._tied(matrix, motion, self._by_rates)

    def _tied(self, matrix: Any, now: TouchingMotion, blocks_of: Callable[..., Tensor]) -> Any:
        """A matrix with blocks (..., U, 6, 6, w, w) of the pairs that have some."""
        pairs, blocks = [], []
        for one in self.each:
            near = one.nearby(now)
            if not len(near.point):
                continue
            own = -torch.einsum("vi,...abiw->...abvw", self.moves, blocks_of(one, near, now))
            if not mapped(own) and not wants_gradient(own):  # zeros may carry derivatives
                some = concrete(own.detach() != 0).flatten(-4).any(-1)
                some = some.flatten(0, -2).any(0) if some.ndim > 1 else some
                near, own = Nearby(*(x[some] for x in near)), own[..., some, :, :, :, :]
            pairs.append(near.nodes)
            blocks.append(own)
        if not sum(map(len, pairs)):
            return matrix
        nodes = torch.cat(pairs)
        tie, at = nodes.unique(return_inverse=True)
        at, n = at.view_as(nodes), len(tie)
        rows = tuple((at[:, :, None] * n + at[:, None, :]).flatten().tolist())
        shape = torch.broadcast_shapes(*(x.shape[:-5] for x in blocks))
        every = torch.cat([x.expand(*shape, *x.shape[-5:]) for x in blocks], -5).flatten(-5, -3)
        return matrix.tied_too(tuple(tie.tolist()), added(None, rows, every, n * n, 2))

    def work(self, motion: Callable[[], TouchingMotion]) -> Tensor:
        now = motion()
        return sum(one.work(now) for one in self.each)

    def passed(self, motion: Callable[[], TouchingMotion]) -> Tensor:
        now = motion()
        return torch.stack(torch.broadcast_tensors(*(one.passed(now) for one in self.each))).any(0)

    def _by_moves(self, one: Touching, near: Nearby, motion: TouchingMotion) -> Tensor:
        """(..., U, 6, 6, 6, w): derivative of what acts on a pair's nodes by their moves."""
        by_x, *by_rates = one.slopes(near, motion)
        whole = torch.einsum("...aibj,wj->...abiw", by_x, self.moves[:, :3])
        return whole + self._rates(near, motion, by_rates)

    def _by_rates(self, one: Touching, near: Nearby, motion: TouchingMotion) -> Tensor:
        """The same by velocities and spins alone."""
        by_x, *by_rates = one.slopes(near, motion)
        return self._rates(near, motion, by_rates) + by_x.new_zeros(()).expand(
            *by_x.shape[:-4], 6, 6, 6, len(self.moves)
        )

    def _rates(
        self, near: Nearby, motion: TouchingMotion, by_rates: list[Tensor]
    ) -> Tensor | float:
        p, moves, whole = self.space.dims.position, self.moves, 0.0
        by = motion.by() if by_rates else {}
        for name, slope in zip((VELOCITY, SPIN), by_rates, strict=False):
            if name not in by:
                continue
            own, more = by[name], len(moves) - by[name].shape[-1]
            if name == VELOCITY:
                rate = pad(moves[:p, :3].mT @ own, (0, more))
            else:
                rate = pad(moves[p:, 3:].mT @ own, (more, 0))
            same = rate.shape[-3] == 1
            rate = rate[..., None, :, :, :] if same else rate[..., near.nodes, :, :]
            whole = whole + torch.einsum("...aibj,...bjw->...abiw", slope, rate)
        return whole
