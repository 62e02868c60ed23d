"""Beams and bodies that touch each other: which of the places along one of them may touch which
pieces of the other, and the forces of these `TouchingPairs` on the nodes. Between two beams both
have such places, and each half of the force.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.leaves import Tree, leaf, wants_gradient
from ..core.remembered import remembered
from ..core.validation import concrete
from ..math.concrete import mapped
from ..math.shapes import broadcast_shapes
from ..scene.effects.contact_terms import ContactTerms
from ..scene.effects.drag import norm
from ..scene.effects.load_point import POSITION, ROTATION, SPIN, VELOCITY
from ..topology.cut import added
from .centreline import least_distance, piece_nodes
from .coordinates.spatial import Spatial
from .surface_pairs import BODY, SurfacePairs
from .touching_motion import NoTouching, TouchingMotion
from .touching_pairs import PairMotion, TouchingPairs
from .touching_places import Places, places_along


def spread(x: Tensor) -> Tensor:
    """(...) of the nodes' x (..., nodes, 3): no two of them differ by more."""
    return torch.linalg.vector_norm(x.amax(-2) - x.amin(-2), dim=-1)


class PairLaw(NamedTuple):
    """Whether pairs have friction, and damping; whether their pieces are surfaces of bodies."""

    rubs: bool
    damps: bool
    surface: bool


class Nearby(NamedTuple):
    """Which of the places along one part may touch which pieces of the other, U pairs: their
    numbers (U), and the nodes (U, 6) of both.
    """

    point: Tensor
    piece: Tensor
    nodes: Tensor


@dataclass(frozen=True)
class Touching(Tree):
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
    def radii(self) -> Tensor:
        """(..., 2) m of both, of what has places first."""
        law = self.contact
        own = self.s.new_zeros(()) if law.radius is None else law.radius
        both = [own, own if law.other_radius is None else law.other_radius]
        return torch.stack(torch.broadcast_tensors(*(both if self.first else both[::-1])), -1)

    @property
    def points(self) -> int | None:
        """Places in a piece; None = by the radii."""
        return self.contact.points

    @property
    def places(self) -> Places:
        """P places: shares (..., P, 3) of their three nodes; measure (..., P) m of the beam's
        length, 1 of a body, 0 of what a sample has fewer.
        """
        law = self.contact
        given = law.thickness.detach(), self.points, self.share
        return remembered(places_along, *self.along, self.s, self.radii.detach(), *given)

    @property
    def allowed(self) -> Tensor:
        """(..., P, K), 1 or 0: which of the pieces a place may touch."""
        count = self.places.count
        if not self.itself:
            return self.s.new_ones(self.along[1] * count, len(self.pieces))
        radii = self.radii.detach()[..., 0]
        return remembered(_allowed, *self.along, count, self.s.detach(), radii, self.contact.apart)

    def nearby(self, motion: TouchingMotion, skin: Tensor | float = 0.0) -> Nearby:
        """Those with no more than a skin m of `slack`; all pairs where samples are seen one at a
        time.
        """
        if mapped(motion.position):
            pairs = self._every
            return self.chosen(pairs.flatten(0, -3).any(0) if pairs.ndim > 2 else pairs)
        return self.chosen(self.slack(motion, skin) <= skin)

    def slack(self, motion: TouchingMotion, skin: Tensor | float = torch.inf) -> Tensor:
        """(P, K) m: by how much the gap of each place to each piece is wider than where forces
        begin, at least, in the nearest sample, wherever they are in the step; inf where it may not
        touch it. No gap changes by more than two nodes move towards each other. What is surely
        wider than a skin m is less closely looked at.
        """
        every = self._every
        shape = every.shape[-2:]
        slack = self.ball_slack(motion).repeat_interleave(self.places.count, -2)
        slack = torch.where(every, slack, torch.inf)
        slack, every = slack.reshape(-1, *shape).amin(0), every.reshape(-1, *shape).any(0)
        near = self.chosen(every & (slack <= skin))
        closely = self._between(motion, near)
        slack[near.point, near.piece] = closely.expand(1, *closely.shape).flatten(0, -2).amin(0)
        return slack

    def ball_slack(self, motion: TouchingMotion) -> Tensor:
        """(..., n, K) m: the same of balls about the nodes of places and of pieces, in which these
        are.
        """
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
        own = ([node for _, node, _ in part] for part in self.nodes)
        points, pieces = own
        x, v = (a[..., points, None, :] - a[..., None, pieces, :] for a in (position, velocity))
        size = norm(x)[..., 0]
        return -(x * v).sum(-1) / torch.where(size > 0, size, 1.0)

    def _between(self, motion: TouchingMotion, near: Nearby) -> Tensor:
        """(..., U) m: the same of pairs."""
        shares = self.places.shares[..., near.point, :, None]

        def of(x: Tensor) -> tuple[Tensor, Tensor]:
            x = concrete(x.detach())
            own, other = near.nodes[:, :3], near.nodes[:, 3:]
            return (shares * x[..., own, :]).sum(-2), x[..., other, :]

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
    def nodes(self) -> tuple[tuple[tuple[int, int, int], ...], ...]:
        """The three of each of the n nodes that have places, and of each piece."""
        return piece_nodes(*self.along), self.pieces

    @property
    def reach(self) -> Tensor:
        """(...) m between axes where forces begin."""
        return concrete((self.radii.sum(-1) + self.contact.thickness).detach())

    def _nodes(self, device: torch.device) -> tuple[Tensor, Tensor]:
        """Of each place (P, 3), and of each piece (K, 3)."""
        points, pieces = (_numbers(own, device) for own in self.nodes)
        return points.repeat_interleave(self.places.count, 0), pieces

    def chosen(self, pairs: Tensor) -> Nearby:
        """Those where pairs (P, K) bool is true."""
        point, piece = concrete(pairs).nonzero().unbind(-1)
        points, pieces = self._nodes(pairs.device)
        return Nearby(point, piece, torch.cat((points[point], pieces[piece]), -1))

    def pairs(self, near: Nearby) -> TouchingPairs:
        """Their constants."""
        law, places, (point, piece) = self.contact, self.places, near[:2]

        def of_all(x: Tensor | None) -> Tensor | None:
            return None if x is None else x[..., None]

        return TouchingPairs(
            places.shares[..., point, :],
            places.measure[..., point] * self.allowed[..., point, piece],
            self.control[piece],
            self.ends[piece],
            self.radii[..., None, :],
            of_all(law.thickness),
            of_all(law.slope),
            of_all(law.friction),
            of_all(law.slip_speed if law.rubs else None),
            of_all(law.damping),
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
        return PairLaw(self.contact.rubs, self.contact.damping is not None, False)


@lru_cache(64)
def _numbers(triples: tuple[tuple[int, int, int], ...], device: torch.device) -> Tensor:
    return torch.tensor(triples, device=device)


def _allowed(first: int, nodes: int, count: int, s: Tensor, radius: Tensor, apart: float) -> Tensor:
    """Of a beam itself: those that are so many radii (...) m from each other along it, s (..., N+1)
    m, and have an element between them.
    """
    along = s[..., first : first + nodes]
    away = (along[..., :, None] - along[..., None, :]).abs() >= (apart * radius)[..., None, None]
    number = torch.arange(nodes, device=s.device)
    away = away & ((number[:, None] - number).abs() > 1)
    return away.to(s).repeat_interleave(count, -2)


def of_nodes(nodes: Tensor, motion: TouchingMotion) -> PairMotion:
    """The motion of the nodes (U, 6) of pairs."""
    moves = (None if x is None else x[..., nodes, :] for x in motion[:4])
    axes = None
    if motion.axes is not None:
        axes = tuple(R[..., nodes[:, BODY], :, :] for R in motion.axes)
    return PairMotion(*moves, motion.secant, axes)


# axes of the constants of a pair
RANKS = {"own": 1, "measure": 0, "control": 2, "ends": 1, "radii": 1}
SURFACE = {"centre": 1, "axes": 2, "half": 1, "rounding": 0}
RANKS |= SURFACE
RANKS |= dict.fromkeys(("thickness", "slope", "friction", "slip_speed", "damping"), 0)


class Near(NamedTuple):
    """Pairs that may touch each other, and their nodes (U, 6)."""

    pairs: TouchingPairs
    nodes: Tensor


@dataclass(frozen=True)
class AnyTouching(NoTouching):
    """Parts that touch. moves (w, 6): displacement and spin in space of a node's moves. A subclass
    knows which pairs are `near`.
    """

    space: Spatial
    moves: Tensor = leaf(2)

    present = True

    def near(self, motion: TouchingMotion) -> list[Near]:
        """Those that may touch over this motion."""
        raise NotImplementedError

    def loaded(self, nodes: Tensor, motion: Callable[[], TouchingMotion]) -> Tensor:
        now = motion()
        for pairs, own in self.near(now):
            push = -(pairs.wrenches(of_nodes(own, now)) @ self.moves.mT).flatten(-3, -2)
            nodes = added(nodes, tuple(own.flatten().tolist()), push, nodes.shape[-2], 1)
        return nodes

    def matrix(self, matrix: Any, motion: Callable[[], TouchingMotion]) -> Any:
        return self._tied(matrix, motion(), self.by_moves)

    def damping(self, matrix: Any, position: Tensor, axes: Tensor) -> Any:
        still = torch.zeros_like(position)
        sizes = self.space.dims.position, self.space.dims.spin
        names = (VELOCITY, SPIN)
        eyes = (torch.eye(n, dtype=position.dtype, device=position.device)[None] for n in sizes)
        by = dict(zip(names, eyes, strict=True))
        motion = TouchingMotion(position, None, still, still, None, lambda: by, axes=(axes,))
        return self._tied(matrix, motion, self._by_rates)

    def _tied(self, matrix: Any, now: TouchingMotion, blocks_of: Callable[..., Tensor]) -> Any:
        """A matrix with blocks (..., U, 6, 6, w, w) of the pairs that have some."""
        nodes, blocks = [], []
        for near in self.near(now):
            own, block = near.nodes, blocks_of(near, now)
            if not mapped(block) and not wants_gradient(block):  # zeros may carry derivatives
                some = concrete(block.detach() != 0).flatten(-4).any(-1)
                some = some.flatten(0, -2).any(0) if some.ndim > 1 else some
                own, block = own[some], block[..., some, :, :, :, :]
            nodes.append(own)
            blocks.append(block)
        if not sum(map(len, nodes)):
            return matrix
        nodes = torch.cat(nodes)
        tie, at = nodes.unique(return_inverse=True)
        at, n = at.view_as(nodes), len(tie)
        rows = tuple((at[:, :, None] * n + at[:, None, :]).flatten().tolist())
        shape = broadcast_shapes(*(x.shape[:-5] for x in blocks))
        every = torch.cat([x.expand(*shape, *x.shape[-5:]) for x in blocks], -5).flatten(-5, -3)
        return matrix.tied_too(tuple(tie.tolist()), added(None, rows, every, n * n, 2))

    def work(self, motion: Callable[[], TouchingMotion]) -> Tensor | float:
        now = motion()
        return sum(pairs.work(of_nodes(own, now), now.dt) for pairs, own in self.near(now))

    def passed(self, motion: Callable[[], TouchingMotion]) -> Tensor | None:
        now = motion()
        each = [pairs.passed(of_nodes(own, now)) for pairs, own in self.near(now)]
        return torch.stack(torch.broadcast_tensors(*each)).any(0) if each else None

    def by_moves(self, near: Near, motion: TouchingMotion) -> Tensor:
        """(..., U, 6, 6, w, w): derivative of the balances of a pair's nodes by their moves."""
        of_pairs = of_nodes(near.nodes, motion)
        slopes = near.pairs.slopes(of_pairs)
        change = slopes.pop(POSITION) @ self.moves[:, :3].mT + self._rates(near, motion, slopes)
        return self._balances(near.pairs.blocks(of_pairs, change))

    def _by_rates(self, near: Near, motion: TouchingMotion) -> Tensor:
        """The same by velocities and spins alone."""
        of_pairs = of_nodes(near.nodes, motion)
        slopes = near.pairs.slopes(of_pairs)
        by_x, slopes = slopes.pop(POSITION), {n: x for n, x in slopes.items() if n != ROTATION}
        none = by_x.new_zeros(*by_x.shape[:-1], len(self.moves))
        return self._balances(near.pairs.blocks(of_pairs, none + self._rates(near, motion, slopes)))

    def _balances(self, blocks: Tensor) -> Tensor:
        """From wrenches (..., 6, w) to balances."""
        return -torch.einsum("vi,...abiw->...abvw", self.moves, blocks)

    def _rates(
        self, near: Near, motion: TouchingMotion, slopes: dict[str, Tensor]
    ) -> Tensor | float:
        p, moves, whole = self.space.dims.position, self.moves, 0.0
        by = motion.by() if slopes else {}
        for name, slope in slopes.items():
            if name == ROTATION and name not in by:  # it turns as the moves do
                whole = whole + slope @ moves[:, 3:].mT
                continue
            if name not in by:
                continue
            own, more = by[name], len(moves) - by[name].shape[-1]
            if name == VELOCITY:
                rate = pad(moves[:p, :3].mT @ own, (0, more))
            else:
                rate = pad(moves[p:, 3:].mT @ own, (more, 0))
            same = rate.shape[-3] == 1
            rate = rate[..., None, :, :, :] if same else rate[..., near.nodes, :, :]
            whole = whole + slope @ rate
        return whole


@dataclass(frozen=True)
class AllTouching(AnyTouching):
    """All of a scene."""

    each: tuple[Touching, ...]

    @property
    def lossy(self) -> bool:
        return any(one.lossy for one in self.each)

    @property
    def reads(self) -> frozenset[str]:
        return frozenset().union(*(one.reads for one in self.each))

    def near(self, motion: TouchingMotion) -> list[Near]:
        near = [(one, one.nearby(motion)) for one in self.each]
        return [Near(one.pairs(own), own.nodes) for one, own in near if len(own.point)]


@dataclass(frozen=True)
class OnePair(AnyTouching):
    """Of six nodes, which are all that there are."""

    pairs: TouchingPairs

    lossy = property(lambda self: self.pairs.lossy)
    reads = property(lambda self: self.pairs.reads)

    def near(self, motion: TouchingMotion | None) -> list[Near]:
        return [Near(self.pairs, torch.arange(6, device=self.moves.device)[None])]


@dataclass(frozen=True)
class FixedTouching(AllTouching):
    """Of all of a scene those pairs that are known, each with its six nodes and its law."""

    pairs: TouchingPairs | None
    nodes: tuple[tuple[int, ...], ...]
    laws: tuple[PairLaw, ...]

    def near(self, motion: TouchingMotion | None) -> list[Near]:
        if self.pairs is None:
            return []
        return [Near(self.pairs, torch.tensor(self.nodes, device=self.moves.device))]


def fixed(touching: AllTouching, near: list[Nearby]) -> FixedTouching:
    """With these pairs alone, of each of its places and pieces; what the law of a pair has not is
    1 where another's has it.
    """
    each = [(one, own) for one, own in zip(touching.each, near, strict=True) if len(own.point)]
    laws = tuple(one.law for one, own in each for _ in own.point)
    nodes = tuple(tuple(row) for _, own in each for row in own.nodes.tolist())
    kind = SurfacePairs if any(one.law.surface for one in touching.each) else TouchingPairs
    pairs = joined([one.pairs(own) for one, own in each], kind) if each else None
    return FixedTouching(touching.space, touching.moves, touching.each, pairs, nodes, laws)


def joined(parts: list[TouchingPairs], kind: type[TouchingPairs]) -> TouchingPairs:
    """One behind the other, a row for each pair in all of their constants, and in those of a
    kind.
    """
    counts = [part.own.shape[-2] for part in parts]
    rows = {}
    for name in (own.name for own in fields(kind)):
        own, rank = [getattr(part, name, None) for part in parts], RANKS[name]
        if name in SURFACE:
            own = [parts[0].own.new_ones(1, *(3,) * rank) if x is None else x for x in own]
        like = next((x for x in own if x is not None), None)
        if like is None:
            rows[name] = None
            continue
        tail = like.shape[like.ndim - rank :]
        own = [like.new_ones(1, *tail) if x is None else x for x in own]
        lead = broadcast_shapes(*(x.shape[: x.ndim - rank - 1] for x in own))
        whole = (x.expand(*lead, n, *tail) for x, n in zip(own, counts, strict=True))
        rows[name] = torch.cat([*whole], -1 - rank)
    return kind(**rows)
