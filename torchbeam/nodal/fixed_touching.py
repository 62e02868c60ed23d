"""Parts that touch, of which the pairs that are near are known."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch.nn.functional import pad

from ..core.leaves import AXES
from ..math.shapes import broadcast_shapes
from ..scene.effects.obstacle import Obstacle
from .surface_pairs import SurfacePairs, count_of
from .touching import Nearby, PairLaw, PartContact
from .touching_forces import ContactPairs, NearPairs, ScenePairs
from .touching_pairs import PairMotion, TouchingPairs


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
