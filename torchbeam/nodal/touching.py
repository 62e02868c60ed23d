"""Places along one part that may touch pieces of another, or of the same beam: how much each stands
for, which of them are near, and by how much they are apart. Between two beams both have such
places, and each half of the force.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.leaves import Tree, leaf
from ..core.remembered import remembered
from ..core.validation import concrete
from ..math.concrete import is_vmapped
from ..scene.effects.contact_terms import ContactTerms, thinnest, widest
from ..scene.effects.drag import norm
from ..scene.effects.load_point import SPIN, VELOCITY
from ..scene.effects.obstacle import Obstacle
from ..scene.stations import Table
from .centreline import bernstein, control_shares, least_distance, piece_nodes
from .touching_pairs import PairMotion, TouchingPairs

DENSITY = 2.0  # places in half of the length along which two that cross touch


class Places(NamedTuple):
    """P places along a part, `count` in each of its pieces; see `PartContact`."""

    count: int
    shares: Tensor
    measure: Tensor


def places_along(
    first: int,
    nodes: int,
    s: Tensor,
    radii: Tensor,
    thickness: Tensor,
    points: int | None,
    share: float,
) -> Places:
    """Of a part of `nodes` nodes from `first` on, at the arclength s (..., N+1) m; each has `share`
    of the force. radii (..., 2) m, thickness (...) m; points in a piece, None = by these.
    """
    if nodes == 1:
        return Places(1, s.new_tensor([[0.0, 1.0, 0.0]]), s.new_ones(1))
    control = s.new_tensor(control_shares(nodes))
    corners = (control @ s[..., piece_nodes(first, nodes), None])[..., 0]
    lengths = corners.diff(dim=-1)  # (..., n, 2), halves of what the curve begins and ends with
    number = _number(lengths, radii.detach(), thickness.detach(), points)
    count = int(concrete(number).amax())
    t = (torch.arange(count, dtype=s.dtype, device=s.device) + 0.5) / number
    t = t.clamp(max=1)[..., None, :]  # 1: a place that this sample has not
    shares = (bernstein(t) @ control).flatten(-3, -2)
    speed = 2 * (lengths[..., :1] * (1 - t) + lengths[..., 1:] * t)
    return Places(count, shares, share * (speed / number[..., None] * (t < 1)).flatten(-2))


def _number(lengths: Tensor, radii: Tensor, thickness: Tensor, points: int | None) -> Tensor:
    """(..., 1) places of a piece, each sample's own: `DENSITY` in half of the length along which
    two beams touch that cross at a right angle, or as the pair says.
    """
    if points:
        return radii.new_tensor([float(points)])
    D = radii.sum(-1)
    half = (thickness * (2 * D + thickness)).sqrt()
    longest = lengths.detach().sum(-1).amax(-1)
    return (DENSITY * longest / half).ceil().clamp(min=1)[..., None]


def spread(x: Tensor) -> Tensor:
    """(...) of the nodes' x (..., nodes, 3): no two of them differ by more."""
    return torch.linalg.vector_norm(x.amax(-2) - x.amin(-2), dim=-1)


class PairLaw(NamedTuple):
    """Whether pairs have friction, and damping; the shape of their pieces where these are surfaces
    of bodies, None = they are curves; whether these taper.
    """

    has_friction: bool
    has_damping: bool
    surface: type[Obstacle] | None
    has_taper: bool = False


class Nearby(NamedTuple):
    """Which of the places along one part may touch which pieces of the other, U pairs: their
    numbers (U), and the nodes (U, 6) of both.
    """

    point: Tensor
    piece: Tensor
    nodes: Tensor


@dataclass(frozen=True)
class PartContact(Tree):
    """Places along one part, and the pieces of another, or of the same beam.

    contact   the law; pair: its place among the scene's; first: whether places are on its first
              part
    along     the first of the nodes that have places, and how many; share of the force that these
              have; itself: whether pieces are of the same beam
    pieces    of each piece its three nodes; control (K, 3, 3), ends (K, 2): see `centreline`
    s         (..., N+1) m, arclength of all nodes

    What the law's numbers say is read at each call, as they may be written to.
    """

    contact: ContactTerms
    pair: int
    first: bool
    along: tuple[int, int]
    share: float
    itself: bool
    pieces: tuple[tuple[int, int, int], ...]
    control: Tensor = leaf(3)
    ends: Tensor = leaf(2)
    s: Tensor = leaf(1)

    @property
    def profiles(self) -> tuple[Tensor | Table, Tensor | Table]:
        """Radii as they are given, (...) m or a `Table`, of what has places first."""
        law = self.contact
        first_radius = self.s.new_zeros(()) if law.radius is None else law.radius
        other = first_radius if law.other_radius is None else law.other_radius
        return (first_radius, other) if self.first else (other, first_radius)

    @property
    def radii(self) -> Tensor:
        """(..., 2) m of both, of what has places first; the largest where they taper."""
        return torch.stack(torch.broadcast_tensors(*map(widest, self.profiles)), -1)

    def _at_nodes(self, part: int, near: Nearby) -> Tensor | None:
        """(..., U, 3) m of nodes of places (0), or of pieces (1); None = the same all along."""
        profile, first = self.profiles[part], 3 * part
        if not isinstance(profile, Table):
            return None
        return profile.ramps(self.s)[..., near.nodes[:, first : first + 3]]

    @property
    def points(self) -> int | None:
        """Places in a piece; None = by the radii."""
        return self.contact.points

    @property
    def places(self) -> Places:
        """P places: shares (..., P, 3) of their three nodes; measure (..., P) m of the beam's
        length, 1 of a body, 0 of what a sample has fewer.
        """
        law, thin = self.contact, torch.broadcast_tensors(*map(thinnest, self.profiles))
        sizes = torch.stack(thin, -1).detach(), law.thickness.detach(), self.points, self.share
        return remembered(places_along, *self.along, self.s, *sizes)

    @property
    def allowed(self) -> Tensor:
        """(..., P, K), 1 or 0: which of the pieces a place may touch."""
        count = self.places.count
        if not self.itself:
            return self.s.new_ones(self.along[1] * count, len(self.pieces))
        s, profile = self.s.detach(), self.profiles[0]
        if isinstance(profile, Table):
            first, nodes = self.along
            radius = profile.ramps(s).detach()[..., first : first + nodes]
            radii = (radius[..., :, None] + radius[..., None, :]) / 2
        else:
            radii = profile.detach()[..., None, None]
        return remembered(_allowed, *self.along, count, s, radii, self.contact.apart)

    def nearby(self, motion: PairMotion, skin: Tensor | float = 0.0) -> Nearby:
        """Those with no more than a skin m of `slack`; all that may touch where it is infinite, or
        samples are seen one at a time.
        """
        if is_vmapped(motion.position) or (isinstance(skin, float) and skin == torch.inf):
            pairs = self._every
            return self.chosen(pairs.flatten(0, -3).any(0) if pairs.ndim > 2 else pairs)
        return self.chosen(self.slack(motion, skin) <= skin)

    def slack(self, motion: PairMotion, skin: Tensor | float = torch.inf) -> Tensor:
        """(P, K) m: by how much the gap of each place to each piece is wider than where forces
        begin, at least, in the nearest sample, wherever they are in the step; inf where it may not
        touch it. No gap changes by more than two nodes move towards each other. What is surely
        wider than a skin m is less closely looked at.
        """
        every = self._every
        shape = every.shape[-2:]
        slack = self.ball_slack(motion).repeat_interleave(self.places.count, -2)
        slack = torch.where(every, slack, torch.inf)
        if not slack.numel():
            return slack.new_full(shape, torch.inf)  # there is no sample
        slack, every = slack.reshape(-1, *shape).amin(0), every.reshape(-1, *shape).any(0)
        near = self.chosen(every & (slack <= skin))
        closely = self._between(motion, near)
        slack[near.point, near.piece] = closely.expand(1, *closely.shape).flatten(0, -2).amin(0)
        return slack

    def ball_slack(self, motion: PairMotion) -> Tensor:
        """(..., n, K) m: the same of balls about the nodes of places and pieces that hold these."""
        x = concrete(motion.position.detach())

        def ball(triples: Tensor) -> tuple[Tensor, Tensor]:
            nodes = x[..., triples, :]
            centre = nodes[..., 1:2, :]
            return centre[..., 0, :], norm(nodes - centre)[..., 0].amax(-1) / 2

        points, pieces = self._nodes(x.device)
        (a, of_a), (b, of_b) = ball(points[:: self.places.count]), ball(pieces)
        apart = torch.cdist(a, b, compute_mode="donot_use_mm_for_euclid_dist")
        slack = apart - of_a[..., :, None] - of_b[..., None, :] - self.reach[..., None, None]
        if motion.half is not None:
            slack = slack - spread(concrete(motion.half.detach()))[..., None, None]
        return slack

    def nearing(self, position: Tensor, velocity: Tensor) -> Tensor:
        """(..., n, K) m/s by which they come nearer to each other, nodes at (..., nodes, 3) m with
        these velocities.
        """
        middles = ([node for _, node, _ in part] for part in self.nodes)
        points, pieces = middles
        x, v = (a[..., points, None, :] - a[..., None, pieces, :] for a in (position, velocity))
        size = norm(x)[..., 0]
        return -(x * v).sum(-1) / torch.where(size > 0, size, 1.0)

    def _between(self, motion: PairMotion, near: Nearby) -> Tensor:
        """(..., U) m: the same of pairs."""
        shares = self.places.shares[..., near.point, :, None]

        def of(x: Tensor) -> tuple[Tensor, Tensor]:
            x = concrete(x.detach())
            points, other = near.nodes[:, :3], near.nodes[:, 3:]
            return (shares * x[..., points, :]).sum(-2), x[..., other, :]

        place, nodes = of(motion.position)
        slack = least_distance(place, self.control[near.piece] @ nodes) - self.reach[..., None]
        if motion.half is not None:
            place, nodes = of(motion.half)
            moves = torch.linalg.vector_norm(nodes - place[..., None, :], dim=-1)
            slack = slack - moves.amax(-1)
        allowed = self._every[..., near.point, near.piece]
        return torch.where(allowed, concrete(slack.detach()), torch.inf)

    @property
    def _every(self) -> Tensor:
        """(..., P, K): `allowed`, of all samples, to decide by."""
        return concrete(self.allowed.detach()) > 0

    @property
    def may_touch(self) -> Tensor:
        """(..., n, K) bool: `allowed`, by the nodes of places."""
        return self._every[..., :: self.places.count, :]

    @property
    def every(self) -> int:
        """How many pairs of places and pieces there are."""
        return self.places.shares.shape[-2] * len(self.pieces)

    @property
    def nodes(self) -> tuple[tuple[tuple[int, int, int], ...], ...]:
        """The three of each of the n nodes that have places, and of each piece."""
        return piece_nodes(*self.along), self.pieces

    @property
    def reach(self) -> Tensor:
        """(...) m between axes where forces begin."""
        return concrete((self.radii.sum(-1) + self.contact.thickness).detach())

    def _nodes(self, device: torch.device) -> tuple[Tensor, Tensor]:
        """Of each place (P, 3), and of each piece (K, 3)."""
        points, pieces = (_numbers(triples, device) for triples in self.nodes)
        return points.repeat_interleave(self.places.count, 0), pieces

    def chosen(self, pairs: Tensor) -> Nearby:
        """Those where pairs (P, K) bool is true."""
        point, piece = concrete(pairs).nonzero().unbind(-1)
        points, pieces = self._nodes(pairs.device)
        return Nearby(point, piece, torch.cat((points[point], pieces[piece]), -1))

    def pairs(self, near: Nearby) -> TouchingPairs:
        """Their constants."""
        law, places, (point, piece) = self.contact, self.places, near[:2]
        shares, radii = places.shares[..., point, :], self.radii[..., None, :]
        point_radii, taper = (self._at_nodes(part, near) for part in (0, 1))
        if point_radii is not None:
            both = torch.broadcast_tensors((shares * point_radii).sum(-1), radii[..., 1])
            radii = torch.stack(both, -1)

        def of_all(x: Tensor | None) -> Tensor | None:
            return None if x is None else x[..., None]

        return TouchingPairs(
            shares,
            places.measure[..., point] * self.allowed[..., point, piece],
            self.control[piece],
            self.ends[piece],
            radii,
            of_all(law.thickness),
            of_all(law.slope),
            of_all(law.friction),
            of_all(law.slip_speed if law.rubs else None),
            of_all(law.damping),
            taper,
        )

    @property
    def lossy(self) -> bool:
        return self.contact.lossy

    @property
    def reads(self) -> frozenset[str]:
        """See `TouchingPairs`."""
        asked = {VELOCITY} if self.lossy else set()
        return frozenset(asked | ({SPIN} if self.contact.rubs else set()))

    @property
    def law(self) -> PairLaw:
        has_taper = isinstance(self.profiles[1], Table)
        return PairLaw(self.contact.rubs, self.contact.damping is not None, None, has_taper)


@lru_cache(64)
def _numbers(triples: tuple[tuple[int, int, int], ...], device: torch.device) -> Tensor:
    return torch.tensor(triples, device=device)


def _allowed(first: int, nodes: int, count: int, s: Tensor, radius: Tensor, apart: float) -> Tensor:
    """Of a beam itself: those that are so many radii m (..., 1, 1), or of each two of its n nodes
    (..., n, n), from each other along it, s (..., N+1) m, and have an element between them.
    """
    along = s[..., first : first + nodes]
    away = (along[..., :, None] - along[..., None, :]).abs() >= apart * radius
    number = torch.arange(nodes, device=s.device)
    away = away & ((number[:, None] - number).abs() > 1)
    return away.to(s).repeat_interleave(count, -2)
