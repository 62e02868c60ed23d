"""Beams and bodies that touch each other: the forces of `TouchingPairs` on the nodes, and what ties
these in tangents; also where the pairs that are near are known.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.leaves import AXES, leaf, wants_gradient
from ..core.validation import concrete
from ..math.concrete import is_vmapped
from ..math.shapes import broadcast_shapes, stacked
from ..scene.effects.load_point import POSITION, ROTATION, SPIN, VELOCITY
from ..scene.effects.obstacle import Obstacle
from ..topology.places import added
from .between_nodes import BetweenNodes, NodeMotion, Rates, Told
from .coordinates.spatial import Spatial
from .surface_pairs import BODY, SurfacePairs, count_of
from .touching import Nearby, PairLaw, PartContact
from .touching_pairs import PairMotion, TouchingPairs


def of_nodes(nodes: Tensor, motion: PairMotion, told: Tensor | None = None) -> PairMotion:
    """The motion of the nodes (U, 6) of pairs; what they are told."""
    moves = (None if x is None else x[..., nodes, :] for x in motion[:4])
    axes = None
    if motion.axes is not None:
        axes = tuple(R[..., nodes[:, BODY], :, :] for R in motion.axes)
    return PairMotion(*moves, told, axes)


class NearPairs(NamedTuple):
    """Pairs that may touch each other, their nodes (U, 6), and which of all pairs (U) they are."""

    pairs: TouchingPairs
    nodes: Tensor
    rows: Tensor

    def told(self, motion: NodeMotion) -> Tensor | None:
        """(..., U, 6) by the last iteration."""
        told = motion.told.get("pairs")
        return None if told is None else told[..., self.rows, :]


@dataclass(frozen=True)
class ContactPairs(BetweenNodes):
    """Parts that touch. moves (w, 6): displacement and spin in space of a node's moves. A subclass
    knows which pairs are `near`.
    """

    space: Spatial
    moves: Tensor = leaf(2)

    present = True
    reads: ClassVar[frozenset[str]] = frozenset()

    @property
    def every(self) -> int:
        """How many pairs there are, near or not."""
        raise NotImplementedError

    @property
    def smooth(self) -> bool:
        return not self.dissipative

    def moves_of(self, motion: NodeMotion) -> PairMotion:
        """Of all nodes, where forces act; at an instant nothing rubs."""
        space, reads, mean = self.space, self.reads, motion.mean
        at, start = motion.nodes(reads), motion.before
        moving = {VELOCITY: space.public_vector, SPIN: space.public_spin}
        rates = [
            to(getattr(at, name)) if start is not None and name in reads else None
            for name, to in moving.items()
        ]
        return PairMotion(
            space.public_position(at.position),
            space.public_vector(at.position - start[0]) if mean else None,
            *rates,
            axes=self._axes(motion, mean),
        )

    def way_of(self, motion: NodeMotion) -> PairMotion:
        """The same over the whole of the step, wherever forces act."""
        way, space = motion.way(), self.space
        return self.moves_of(motion)._replace(
            position=space.public_position(way.middle),
            half=space.public_vector(way.half),
            axes=self._axes(motion, True),
        )

    def _axes(self, motion: NodeMotion, over: bool) -> tuple[Tensor, ...] | None:
        """Of the nodes (..., N+1, 3, 3) after the step, and before it where it is over one."""
        if ROTATION not in self.reads:
            return None
        where = (motion.before, motion.after) if over else (motion.after,)
        return tuple(self.space.axes(rotation) for _, rotation in where)

    def near(self, motion: PairMotion) -> list[NearPairs]:
        """Those that may touch over this motion."""
        raise NotImplementedError

    def balance(
        self, nodes: Tensor, gap: Tensor, stress: Tensor, motion: NodeMotion
    ) -> tuple[Tensor, Tensor]:
        return self.loaded(nodes, motion), gap

    def loaded(self, nodes: Tensor, motion: NodeMotion) -> Tensor:
        """The nodes' balances (..., nodes, w), with the forces of these."""
        now = self.moves_of(motion)
        for pairs, nodes_of_pairs, _ in self.near(now):
            push = -(pairs.wrenches(of_nodes(nodes_of_pairs, now)) @ self.moves.mT).flatten(-3, -2)
            nodes = added(nodes, tuple(nodes_of_pairs.flatten().tolist()), push, nodes.shape[-2], 1)
        return nodes

    def matrix(self, matrix: Any, stress: Tensor, motion: NodeMotion) -> Any:
        now = self.moves_of(motion)
        return self._tied(matrix, now, lambda near: self.by_moves(near, motion, now))

    def damping(self, matrix: Callable[[], Any], motion: NodeMotion) -> Any:
        if not self.dissipative:
            return None
        position, rotation = motion.after
        position, axes = self.space.public_position(position), self.space.axes(rotation)
        still = torch.zeros_like(position)
        sizes = self.space.dims.position, self.space.dims.spin
        names = (VELOCITY, SPIN)
        eyes = (torch.eye(n, dtype=position.dtype, device=position.device)[None] for n in sizes)
        by = dict(zip(names, eyes, strict=True))
        now = PairMotion(position, None, still, still, axes=(axes,))
        return self._tied(matrix(), now, lambda near: self._by_rates(near, now, by))

    def _tied(self, matrix: Any, now: PairMotion, blocks_of: Callable[[NearPairs], Tensor]) -> Any:
        """A matrix with blocks (..., U, 6, 6, w, w) of the pairs that have some."""
        nodes, blocks = [], []
        for near in self.near(now):
            pair_nodes, block = near.nodes, blocks_of(near)
            if not is_vmapped(block) and not wants_gradient(block):  # zeros may carry derivatives
                some = concrete(block.detach() != 0).flatten(-4).any(-1)
                some = some.flatten(0, -2).any(0) if some.ndim > 1 else some
                pair_nodes, block = pair_nodes[some], block[..., some, :, :, :, :]
            nodes.append(pair_nodes)
            blocks.append(block)
        if not sum(map(len, nodes)):
            return matrix
        nodes = torch.cat(nodes)
        tie, at = nodes.unique(return_inverse=True)
        at, n = at.view_as(nodes), len(tie)
        rows = tuple((at[:, :, None] * n + at[:, None, :]).flatten().tolist())
        every = stacked(*blocks, axis=-5).flatten(-5, -3)
        return matrix.tied_too((tuple(tie.tolist()),), added(None, rows, every, n * n, 2))

    def work(self, motion: NodeMotion) -> Tensor | float:
        """(...) J over a step."""
        now = self.way_of(motion)
        return sum(
            pairs.work(of_nodes(nodes, now), motion.dt) for pairs, nodes, _ in self.near(now)
        )

    def finished(
        self, fields: dict[str, Any], motion: NodeMotion, before: Any, moving: Rates | None
    ) -> dict[str, Any]:
        return fields | {"work": fields["work"] + self.work(motion)} if "work" in fields else fields

    def telling(self, motion: NodeMotion) -> Told:
        """Those that are far tell nothing."""
        now, way = self.moves_of(motion), self.way_of(motion)
        none = self.moves.new_zeros(self.every, 6)
        for near in self.near(now):
            if near.pairs.friction is not None:
                far = near.pairs.far(of_nodes(near.nodes, way))[..., None]
                told = near.pairs.telling(of_nodes(near.nodes, now, near.told(motion)))
                told = torch.where(far, 0.0, told)
                none = none.expand(*told.shape[:-2], -1, -1).index_copy(-2, near.rows, told)
        return {"pairs": none}

    def near_enough(self, motion: NodeMotion) -> Tensor | None:
        return self._any(motion, lambda pairs, moves: (~pairs.far(moves)).any(-1))

    def passed_through(self, motion: NodeMotion) -> Tensor | None:
        return self._any(motion, lambda pairs, own: pairs.passed_through(own))

    def _any(
        self, motion: NodeMotion, what: Callable[[TouchingPairs, PairMotion], Tensor]
    ) -> Tensor | None:
        way = self.way_of(motion)
        each = [what(pairs, of_nodes(nodes, way)) for pairs, nodes, _ in self.near(way)]
        return torch.stack(torch.broadcast_tensors(*each)).any(0) if each else None

    def by_moves(self, near: NearPairs, motion: NodeMotion, now: PairMotion) -> Tensor:
        """(..., U, 6, 6, w, w): derivative of the balances of a pair's nodes by their moves, of a
        motion with these `moves_of`.
        """
        of_pairs = of_nodes(near.nodes, now, near.told(motion))
        slopes = near.pairs.slopes(of_pairs)
        change, by = slopes.pop(POSITION) @ self.moves[:, :3].mT, {}
        if slopes and motion.before is not None:
            by = motion.by(self.reads)
            half = motion.half_turns() if ROTATION in self.reads else None
            by = by if half is None else by | {ROTATION: 2 * half}
        change = change + self._rates(near, by, slopes)
        return self._balances(near.pairs.blocks(of_pairs, change))

    def _by_rates(self, near: NearPairs, now: PairMotion, by: dict[str, Tensor]) -> Tensor:
        """The same by velocities and spins alone."""
        of_pairs = of_nodes(near.nodes, now)
        slopes = near.pairs.slopes(of_pairs)
        by_x, slopes = slopes.pop(POSITION), {n: x for n, x in slopes.items() if n != ROTATION}
        none = by_x.new_zeros(*by_x.shape[:-1], len(self.moves))
        return self._balances(near.pairs.blocks(of_pairs, none + self._rates(near, by, slopes)))

    def _balances(self, blocks: Tensor) -> Tensor:
        """From wrenches (..., 6, w) to balances."""
        return -torch.einsum("vi,...abiw->...abvw", self.moves, blocks)

    def _rates(
        self, near: NearPairs, by: dict[str, Tensor], slopes: dict[str, Tensor]
    ) -> Tensor | float:
        p, moves, whole = self.space.dims.position, self.moves, 0.0
        for name, slope in slopes.items():
            if name == ROTATION and name not in by:  # it turns as the moves do
                whole = whole + slope @ moves[:, 3:].mT
                continue
            if name not in by:
                continue
            rate_by, more = by[name], len(moves) - by[name].shape[-1]
            if name == VELOCITY:
                rate = pad(moves[:p, :3].mT @ rate_by, (0, more))
            else:
                rate = pad(moves[p:, 3:].mT @ rate_by, (more, 0))
            same = rate.shape[-3] == 1
            rate = rate[..., None, :, :, :] if same else rate[..., near.nodes, :, :]
            whole = whole + slope @ rate
        return whole


@dataclass(frozen=True)
class ScenePairs(ContactPairs):
    """All of a scene."""

    each: tuple[PartContact, ...]

    @property
    def dissipative(self) -> bool:
        return any(part_contact.lossy for part_contact in self.each)

    @property
    def reads(self) -> frozenset[str]:
        return frozenset().union(*(part_contact.reads for part_contact in self.each))

    @property
    def every(self) -> int:
        return sum(part_contact.every for part_contact in self.each)

    def near(self, motion: PairMotion) -> list[NearPairs]:
        near, first = [], 0
        for part_contact in self.each:
            if len((pairs := part_contact.nearby(motion)).point):
                rows = first + pairs.point * len(part_contact.pieces) + pairs.piece
                near.append(NearPairs(part_contact.pairs(pairs), pairs.nodes, rows))
            first += part_contact.every
        return near


@dataclass(frozen=True)
class OnePair(ContactPairs):
    """Of six nodes, which are all that there are."""

    pairs: TouchingPairs

    dissipative = property(lambda self: self.pairs.lossy)
    reads = property(lambda self: self.pairs.reads)
    every = 1

    def near(self, motion: PairMotion | None) -> list[NearPairs]:
        nodes = torch.arange(6, device=self.moves.device)[None]
        return [NearPairs(self.pairs, nodes, nodes[:, 0])]


@dataclass(frozen=True)
class KnownPairs(ContactPairs):
    """Of all of a scene those pairs that are known, each with its six nodes and its law."""

    each: tuple[PartContact, ...]
    pairs: TouchingPairs | None
    nodes: tuple[tuple[int, ...], ...]
    laws: tuple[PairLaw, ...]

    dissipative, reads = ScenePairs.dissipative, ScenePairs.reads

    @property
    def every(self) -> int:
        return len(self.nodes)

    def near(self, motion: PairMotion | None) -> list[NearPairs]:
        if self.pairs is None:
            return []
        nodes = torch.tensor(self.nodes, device=self.moves.device)
        return [NearPairs(self.pairs, nodes, torch.arange(len(nodes), device=nodes.device))]


def fixed(touching: ScenePairs, near: list[Nearby]) -> KnownPairs:
    """With these pairs alone, of each of its places and pieces; what the law of a pair has not is
    1 where another's of the scene has it, near or not: one program is for all such lists.
    """
    each = [*zip(touching.each, near, strict=True)]
    laws = tuple(part_contact.law for part_contact, near_pairs in each for _ in near_pairs.point)
    nodes = tuple(tuple(row) for _, near_pairs in each for row in near_pairs.nodes.tolist())
    shapes = [part_contact.law.surface for part_contact in touching.each]
    count = max((count_of(shape) for shape in shapes if shape is not None), default=0)
    pairs = (
        joined([part_contact.pairs(near_pairs) for part_contact, near_pairs in each], count)
        if nodes
        else None
    )
    return KnownPairs(touching.space, touching.moves, touching.each, pairs, nodes, laws)


def joined(parts: list[TouchingPairs], count: int) -> TouchingPairs:
    """One behind the other, a row for each pair in all of their constants: of `SurfacePairs` of
    whatever shapes, with so many numbers, unless that is 0.
    """
    counts, rows = [part.own.shape[-2] for part in parts], {}
    for field in fields(SurfacePairs if count else TouchingPairs):
        if AXES not in field.metadata:
            continue
        constants = [getattr(part, field.name, None) for part in parts]
        if field.name == "numbers":
            none = parts[0].own.new_ones(1, 0)
            constants = [none if x is None else x for x in constants]
            constants = [pad(x, (0, count - x.shape[-1]), value=1.0) for x in constants]
        rank = field.metadata[AXES] - 1  # of the constants of a pair
        like = next((x for x in constants if x is not None), None)
        if like is None:
            rows[field.name] = None
            continue
        tail = like.shape[like.ndim - rank :]
        constants = [like.new_ones(1, *tail) if x is None else x for x in constants]
        lead = broadcast_shapes(*(x.shape[: x.ndim - rank - 1] for x in constants))
        whole = (x.expand(*lead, n, *tail) for x, n in zip(constants, counts, strict=True))
        rows[field.name] = torch.cat([*whole], -1 - rank)
    return SurfacePairs(**rows, shape=Obstacle) if count else TouchingPairs(**rows)
