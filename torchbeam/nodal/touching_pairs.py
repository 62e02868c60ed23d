"""Pairs of a place along one part and a piece of the `centreline` of another, which may touch. A
place x meets the centreline c at its nearest place there: with r = x - c, the gap is |r| less both
radii, where it is least along c, and the force per length

    f = p u - friction p s        on x, and -f on c

As x and c are sums of nodes' positions, with shares that a step holds fixed,
2 (mean of r) . (r_{n+1} - r_n) = |r_{n+1}|^2 - |r_n|^2: with u = 2 (mean of r)/(|r_n| + |r_{n+1}|)
and p the difference of the law's potential over that of the gap, f does as much work as the
potential of these two places has lost (Gonzalez 1996); momentum and angular momentum stay.

Friction acts at a place between, which divides r as the radii do, against the slip of both
surfaces there.

A pair knows of the three nodes of the place only the place itself, which moves as they do by its
shares: of the six nodes four points are left, the place and the nodes of the piece.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.leaves import Tree, batch_shapes, leaf
from ..math.quaternions import cross
from ..math.shapes import broadcast_shapes
from ..scene.effects.contact_law import damped, potential, pressure, rubbing, telling
from ..scene.effects.drag import norm
from ..scene.effects.load_point import POSITION, SPIN, VELOCITY, jacobians
from .centreline import bernstein, least_distance, nearest

POINTS = (0, 0, 0, 1, 2, 3)  # which of the four points each of the six nodes is part of


class PairMotion(NamedTuple):
    """Of all nodes (..., N+1, 3), or of U pairs of the nodes (..., U, 6, 3), or of the points
    (..., U, 4, 3), frame a: position m where forces act; half m by which they move on either side
    of it over a step, None = at an instant; velocity m/s and spin rad/s there, absolute, None = at
    rest; told (..., U, 6), see `contact_law.telling`, None = nothing; axes (..., N+1, 3, 3), or
    (..., U, 3, 3) of a piece's own node, before and after a step, at an instant once, None =
    nothing reads them.
    """

    position: Tensor
    half: Tensor | None = None
    velocity: Tensor | None = None
    spin: Tensor | None = None
    told: Tensor | None = None
    axes: tuple[Tensor, ...] | None = None


class ContactPoint(NamedTuple):
    """Of U pairs: shares (..., U, 3) of the piece's nodes in its nearest place; r (..., U, 3) m;
    gap (..., U, 1) m; pressure N/m, p and p without damping (..., U, 1); u (..., U, 3), rub N/m,
    slip m/s (..., U, 3), None = there is no friction; measure (..., U, 1) m, 0 where another piece
    is nearest.
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
class TouchingPairs(Tree):
    """Constants of U pairs.

    own      (..., U, 3): shares of the place's three nodes
    measure  (..., U) m of the beam's length, 1 of a body, 0 of what a sample has not
    control  (..., U, 3, 3), ends (..., U, 2): of the pieces, see `centreline`
    radii    (..., U, 2) m of the place, and the largest of the piece
    thickness m, slope N/m^2, friction, slip_speed m/s, damping s (..., U): see `Contact`; the last
             three None = absent
    taper    (..., U, 3) m, radii at the piece's nodes, which run along it as the curve does;
             None = they are alike
    """

    own: Tensor = leaf(2)
    measure: Tensor = leaf(1)
    control: Tensor = leaf(3)
    ends: Tensor = leaf(2)
    radii: Tensor = leaf(2)
    thickness: Tensor = leaf(1)
    slope: Tensor = leaf(1)
    friction: Tensor | None = leaf(1)
    slip_speed: Tensor | None = leaf(1)
    damping: Tensor | None = leaf(1)
    taper: Tensor | None = leaf(2)

    @property
    def lossy(self) -> bool:
        return self.friction is not None or self.damping is not None

    @property
    def reads(self) -> frozenset[str]:
        """What of the motion the forces depend on, beside positions."""
        asked = {VELOCITY} if self.lossy else set()
        return frozenset(asked | ({SPIN} if self.friction is not None else set()))

    def points(self, motion: PairMotion) -> PairMotion:
        """From the nodes' motion that of the four points."""

        def four(x: Tensor) -> Tensor:
            place = (self.own[..., None] * x[..., :3, :]).sum(-2, keepdim=True)
            return torch.cat((place, x[..., 3:, :].expand(*place.shape[:-2], 3, 3)), -2)

        return PairMotion(*(None if x is None else four(x) for x in motion[:4]), motion.told)

    def slack(self, motion: PairMotion) -> Tensor:
        """(..., U) m: by how much the gap is wider than where forces begin, at least, wherever both
        are in the step.
        """
        x, half, *_ = self.points(motion)
        apart = least_distance(x[..., 0, :], self.control @ x[..., 1:, :])
        slack = apart - self.radii.sum(-1) - self.thickness
        if half is None:
            return slack
        return slack - norm(half[..., 1:, :] - half[..., :1, :])[..., 0].amax(-1)

    def far(self, motion: PairMotion) -> Tensor:
        """(..., U) bool: whether they do not press, wherever both are in the step."""
        return (self.slack(motion) > 0) | (self.measure <= 0)

    def nearest(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """t and within (..., U) of the points (..., U, 4, 3), see `centreline.nearest`."""
        return nearest(x[..., 0, :], x[..., 1:, :], self.control, self.ends > 0, self.taper)

    def radii_at(self, shares: Tensor) -> Tensor:
        """(..., U, 2) m of both where these shares (..., U, 3) of the piece's nodes are."""
        if self.taper is None:
            return self.radii
        other = (shares * self.taper).sum(-1)
        return torch.stack(torch.broadcast_tensors(self.radii[..., 0], other), -1)

    def closest_point(self, points: PairMotion) -> ContactPoint:
        """Of the pairs, whose points move so."""
        x, half, velocity, spin, *_ = points
        t, within = self.nearest(x)
        shares = (bernstein(t)[..., None, :] @ self.control)[..., 0, :]

        def apart(values: Tensor) -> Tensor:
            return values[..., 0, :] - (shares[..., None] * values[..., 1:, :]).sum(-2)

        r = apart(x)
        change = None if half is None else apart(half)
        lengths = [norm(r)] if half is None else [norm(r - change), norm(r + change)]
        size = (lengths[0] + lengths[-1]) / 2
        u = r / torch.where(size > 0, size, torch.ones_like(size))
        d, slope = self.thickness[..., None], self.slope[..., None]
        room = d + self.radii_at(shares).sum(-1)[..., None]
        elastic = p = pressure(room - lengths[0], room - lengths[-1], d, slope)
        if self.damping is not None and velocity is not None:
            approach = -(apart(velocity) * u).sum(-1, keepdim=True)
            p = p * damped(approach * self.damping[..., None] / d)
        slip = rub = None
        if self.friction is not None and velocity is not None:
            slip = self._slip(shares, r, apart(velocity), spin)
            rub = self._rub(points, p, slip)
        measure = (self.measure * within)[..., None]
        return ContactPoint(shares, r, norm(r) - (room - d), p, elastic, u, slip, rub, measure)

    def _rub(self, points: PairMotion, p: Tensor, slip: Tensor) -> Tensor:
        """(..., U, 3) N/m of friction on the place."""
        sense = rubbing(slip, self.slip_speed[..., None], points.told)
        return -self.friction[..., None] * p * sense

    def telling(self, motion: PairMotion) -> Tensor:
        """(..., U, 6) what friction tells the next iteration."""
        points = self.points(motion)
        return telling(self.closest_point(points).slip, self.slip_speed[..., None], points.told)

    def _slip(self, shares: Tensor, r: Tensor, velocity: Tensor, spin: Tensor) -> Tensor:
        """(..., U, 3) m/s of the first part's surface on the second's."""
        levers = self._levers(shares)
        turn = (levers[..., None] * spin).sum(-2)
        slip = velocity - cross(turn, r)
        size = norm(r)
        n = r / torch.where(size > 0, size, torch.ones_like(size))
        return slip - (slip * n).sum(-1, keepdim=True) * n

    def _levers(self, shares: Tensor) -> Tensor:
        """(..., U, 4): of each point its part's share in both radii, times its own in the place."""
        radius, other = self.radii_at(shares).unbind(-1)
        both = radius + other
        first = torch.where(both > 0, radius / torch.where(both > 0, both, 1.0), 0.5)[..., None]
        rest = (1 - first) * shares
        return torch.cat((first.expand(*rest.shape[:-1], 1), rest), -1)

    def _actions(self, points: PairMotion) -> tuple[Tensor, Tensor | None, Tensor]:
        """Force (..., U, 3) N on the place; moment N m of friction, divided by `_levers`,
        None = there is none; shares of the contact point.
        """
        contact_point = self.closest_point(points)
        force = contact_point.force
        if contact_point.rub is None:
            return force, None, contact_point.shares
        return force, -cross(contact_point.r, force), contact_point.shares

    def wrenches(self, motion: PairMotion) -> Tensor:
        """(..., U, 6, 6) N and N m on the nodes, which move so."""
        force, moment, shares = self._actions(self.points(motion))
        by_point = self._signed(shares)[..., None] * force[..., None, :]
        turned = torch.zeros_like(by_point)
        if moment is not None:
            turned = self._levers(shares)[..., None] * moment[..., None, :]
        four = torch.cat(torch.broadcast_tensors(by_point, turned), -1)
        return self._weights[..., None] * four[..., POINTS, :]

    @property
    def _weights(self) -> Tensor:
        """(..., U, 6): how much of its point each node is."""
        return torch.cat((self.own, torch.ones_like(self.own)), -1)

    @staticmethod
    def _signed(shares: Tensor) -> Tensor:
        """(..., U, 4): of the force on the place what each point has."""
        return torch.cat((torch.ones_like(shares[..., :1]), -shares), -1)

    def slopes(self, motion: PairMotion) -> dict[str, Tensor]:
        """Derivatives (..., U, 6, n, 3) of the n numbers of `_actions` by the position of each of
        the nodes, and by what else is read.
        """
        points = self.points(motion)
        rates = zip((VELOCITY, SPIN), points[2:4], strict=True)
        asked = {name: x for name, x in rates if name in self.reads and x is not None}
        half = points.half

        def actions(x: Tensor, *moving: Tensor) -> Tensor:
            x, *moving = (part.unflatten(-1, (4, 3)) for part in (x, *moving))
            velocity, spin = (*moving, None, None)[:2]
            now = None if half is None else half + (x - x.detach())
            found = self._actions(PairMotion(x, now, velocity, spin, points.told))
            return torch.cat([part for part in found if part is not None], -1)

        batch = broadcast_shapes(points.position.shape[:-3], *batch_shapes(self))
        arguments = [points.position, *asked.values()]
        if any(x.shape[:-3] != batch for x in arguments):
            arguments = [x.expand(*batch, *x.shape[-3:]) for x in arguments]
        slopes = jacobians(actions, *(x.flatten(-2) for x in arguments))
        by_point = (slope.unflatten(-1, (4, 3)).movedim(-2, -3) for slope in slopes)
        weights = self._weights[..., None, None]
        by_node = (weights * slope[..., POINTS, :, :] for slope in by_point)
        return dict(zip((POSITION, *asked), by_node, strict=True))

    def blocks(self, motion: PairMotion, change: Tensor) -> Tensor:
        """From changes (..., U, 6, n, w) of `_actions` by w numbers of each of the nodes those of
        `wrenches`, (..., U, 6, 6, 6, w): of each node by each.
        """
        force, moment, shares = self._actions(self.points(motion))
        by_force, *by_moment, by_shares = change.split(3, -2)
        moved = torch.cat((torch.zeros_like(by_shares[..., :1, :]), by_shares), -2)

        def of_points(share: Tensor, by: Tensor, rest: Tensor, action: Tensor) -> Tensor:
            """(..., 4, 6, 3, w) of an action whose `share` changes by `rest` (..., 6, 4, w)."""
            whole = share[..., :, None, None, None] * by[..., None, :, :, :]
            return whole + rest.transpose(-3, -2)[..., None, :] * action[..., None, None, :, None]

        rows = of_points(self._signed(shares), by_force, -moved, force)
        turned = torch.zeros_like(rows)
        if moment is not None:
            levers = self._levers(shares)
            rest = (1 - levers[..., :1, None, None]) * moved
            if self.taper is not None:
                both = self.radii_at(shares).sum(-1)
                both = torch.where(both > 0, both, 1.0)
                thicker = (by_shares * self.taper[..., None, :, None]).sum(-2, keepdim=True)
                first = -(levers[..., 0] / both)[..., None, None, None] * thicker
                rest = rest + self._signed(shares)[..., None, :, None] * first
            turned = of_points(levers, by_moment[0], rest, moment)
        four = torch.cat(torch.broadcast_tensors(rows, turned), -2)
        return self._weights[..., None, None, None] * four[..., POINTS, :, :, :]

    def energy(self, motion: PairMotion, side: float) -> Tensor:
        """(...) J at the end of a step (side 1), or at its start (-1)."""
        x, half, *_ = self.points(motion)
        contact_point = self.closest_point(
            PairMotion(x if half is None else x + side * half, None, None, None)
        )
        d, slope = self.thickness[..., None], self.slope[..., None]
        return (contact_point.measure * potential(d - contact_point.gap, d, slope)).sum((-1, -2))

    def work(self, motion: PairMotion, dt: Tensor | None) -> Tensor:
        """(...) J over a step of dt (...), None = of the potential alone."""
        done = self.energy(motion, -1.0) - self.energy(motion, 1.0)
        if not self.lossy or dt is None:
            return done
        points = self.points(motion)
        contact_point = self.closest_point(points)
        apart = self.parting(points, contact_point.shares)
        power = (contact_point.pressure - contact_point.elastic) * (contact_point.u * apart).sum(
            -1, keepdim=True
        )
        if contact_point.rub is not None:
            power = power + (contact_point.rub * contact_point.slip).sum(-1, keepdim=True)
        return done + dt * (contact_point.measure * power).sum((-1, -2))

    def parting(self, points: PairMotion, shares: Tensor) -> Tensor:
        """(..., U, 3) m/s of the place as seen from where it is nearest, by shares of the piece."""
        return (self._signed(shares)[..., None] * points.velocity).sum(-2)

    def passed_through(self, motion: PairMotion) -> Tensor:
        """(...) bool: whether one of them goes through the other's axis over the step: surfaces
        overlap when the place is nearest to the axis, as it moves on a line across the piece, and
        it is then on the other side of it.
        """
        points = self.points(motion)
        x, half = points.position, points.half
        t, _ = self.nearest(x)
        r, change = (_across(t, self.control, part, x) for part in (x, half))
        size = change.square().sum(-1)
        when = -(r * change).sum(-1) / torch.where(size > 0, size, torch.ones_like(size))
        when = when.clamp(-1.0, 1.0)[..., None, None]
        middle = x + when * half
        contact_point = self.closest_point(PairMotion(middle, None, None, None))
        t, _ = self.nearest(middle)
        before, after = (_across(t, self.control, x + side * half, middle) for side in (-1.0, 1.0))
        turned = (before * after).sum(-1) < 0
        near = (contact_point.gap < 0) & (contact_point.measure > 0)
        return (near[..., 0] & turned).any(-1)


def _across(t: Tensor, control: Tensor, values: Tensor, points: Tensor) -> Tensor:
    """(..., 3): by how much values (..., 4, 3) of the place and of the piece's place at t (...)
    differ, across the tangent that the piece has there with its nodes at `points` (..., 4, 3).
    """
    shares = bernstein(t)[..., None, :] @ control
    apart = values[..., 0, :] - (shares @ values[..., 1:, :])[..., 0, :]
    first, second = (control @ points[..., 1:, :]).diff(dim=-2).unbind(-2)
    tangent = first + t[..., None] * (second - first)
    size = tangent.square().sum(-1, keepdim=True)
    along = (apart * tangent).sum(-1, keepdim=True) / torch.where(size > 0, size, 1.0)
    return apart - along * tangent
