"""Sections of beams, as thick as pictures in space and views draw them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..scene.parts import Part
from ..scene.scene import Scene
from .axis import nodes_of, rows_of
from .obstacles import radius_of
from .solids import rounds

SIDE = 0.01  # of the beams' length: side of a section of which nothing is known
SIDES = 0.003, 0.2  # of the same: least and largest
# of a section, by width and height
CORNERS = torch.tensor([(-1, -1), (1, -1), (1, 1), (-1, 1)], dtype=torch.float64) / 2


@dataclass(frozen=True)
class Sections:
    """sides: of each beam width and height (intervals, 2) m in each interval between its nodes: of
    the rectangle with its EA and EI, of a batch the first sample's. places: arc lengths of its
    nodes (intervals + 1) m, likewise. size: m, of all.
    """

    scene: Scene | None
    size: float
    sides: tuple[Tensor, ...]
    places: tuple[Tensor, ...] = ()

    @classmethod
    def of(cls, scene: Scene | None, state: Any) -> Sections:
        """Sizes as in the first of states."""
        position, rows = nodes_of(state)[0][0], rows_of(state)
        lengths = [position[row].diff(dim=0).norm(dim=-1).sum() for row in rows]
        extent = (position.amax(0) - position.amin(0)).norm()
        size = max(x.item() for x in (*lengths, extent))
        counts = [len(range(len(position))[row]) - 1 for row in rows]
        if scene is None or not counts:
            return cls(scene, size, tuple(torch.full((n, 2), SIDE * size).double() for n in counts))
        n = scene.beam.station_count  # one an interval, of any order
        S = scene.beam.compliance.detach().diagonal(dim1=-2, dim2=-1)
        S = S.expand(*S.shape[:-2], n, 6).reshape(-1, n, 6)[0].double().cpu()
        sides = torch.sqrt(12 * S[:, :1] / S[:, [5, 4]])
        sides = torch.where(torch.isfinite(sides) & (sides > 0), sides, SIDE * size)
        sides = sides.clamp(*(share * size for share in SIDES))
        lengths = scene.beam.length.detach().reshape(-1, n)[0].split(counts)
        places = tuple(torch.nn.functional.pad(x.cumsum(0), (1, 0)) for x in lengths)
        return cls(scene, size, sides.split(counts), places)

    def corners(
        self, k: int, part: Part | None, count: int, batch: Sequence[int] = (), sample: int = 0
    ) -> Tensor:
        """(count, corners, 2) m of beam k at `count` points along it: round as contacts take it, or
        the rectangle of EA and EI.
        """
        if self.scene is not None:
            s = between(self.places[k], count)
            radius = radius_of(self.scene, part, s, batch, sample)
            if radius is not None:
                return rounds(radius.double().cpu())
        side = self.sides[k]
        at = torch.linspace(0, len(side), count).long().clamp(max=len(side) - 1)
        return CORNERS * side[at, None]


def between(values: Tensor, count: int) -> Tensor:
    """(count, ...) of values at nodes (n, ...), between them."""
    at = torch.linspace(0, len(values) - 1, count, dtype=torch.float64)
    left = at.long().clamp(max=len(values) - 2)
    share = (at - left).to(values).reshape(-1, *(1 for _ in values.shape[1:]))
    return (1 - share) * values[left] + share * values[left + 1]


def across(axes: Tensor, count: int) -> Tensor:
    """(count, 3, k) of unit vectors at nodes (n, 3, k), between them."""
    return torch.nn.functional.normalize(between(axes, count), dim=-2)
