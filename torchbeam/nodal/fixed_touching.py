"""Parts that touch, of which the pairs that are near are known."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch

from ..math.shapes import broadcast_shapes
from .surface_pairs import SurfacePairs
from .touching import Nearby, PairLaw
from .touching_forces import AllTouching, Near
from .touching_pairs import PairMotion, TouchingPairs

# axes of the constants of a pair
RANKS = {"own": 1, "measure": 0, "control": 2, "ends": 1, "radii": 1, "taper": 1}
SURFACE = {"centre": 1, "axes": 2, "half": 1, "rounding": 0}
RANKS |= SURFACE
RANKS |= dict.fromkeys(("thickness", "slope", "friction", "slip_speed", "damping"), 0)


@dataclass(frozen=True)
class FixedTouching(AllTouching):
    """Of all of a scene those pairs that are known, each with its six nodes and its law."""

    pairs: TouchingPairs | None
    nodes: tuple[tuple[int, ...], ...]
    laws: tuple[PairLaw, ...]

    def near(self, motion: PairMotion | None) -> list[Near]:
        if self.pairs is None:
            return []
        return [Near(self.pairs, torch.tensor(self.nodes, device=self.moves.device))]


def fixed(touching: AllTouching, near: list[Nearby]) -> FixedTouching:
    """With these pairs alone, of each of its places and pieces; what the law of a pair has not is
    1 where another's of the scene has it, near or not: one program is for all such lists.
    """
    each = [*zip(touching.each, near, strict=True)]
    laws = tuple(one.law for one, own in each for _ in own.point)
    nodes = tuple(tuple(row) for _, own in each for row in own.nodes.tolist())
    kind = SurfacePairs if any(one.law.surface for one in touching.each) else TouchingPairs
    pairs = joined([one.pairs(own) for one, own in each], kind) if nodes else None
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
