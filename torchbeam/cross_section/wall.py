"""Wall: a line with plies, and the rows of places across it at the line's stations."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from .elements import plain
from .material import Material

LEAST_ACROSS = 4  # elements across a wall
SMOOTH = 0.87  # cosine: below 30 degrees, a turn is one of a curve


@dataclass(eq=False)
class Wall:
    """A wall. points: (..., n, 2) m. thickness: of each ply (...) m. vertices: numbers of places,
    equal where lines share one. rows: of each station, its places across (..., plies + 1, 2).
    across: elements across each ply. feet: of a station on which a wall stands, such rows between
    that wall's plies (..., k, plies + 1, 2), and its elements across each.
    """

    points: Tensor
    thickness: list[Tensor]
    angle: list[Tensor]
    material: list[Material]
    first: float  # of the thickness, to the right of the line
    vertices: list[int] = field(default_factory=list)
    rows: dict[int, Tensor] = field(default_factory=dict)
    feet: dict[int, tuple[Tensor, int]] = field(default_factory=dict)
    across: int = 0

    def __post_init__(self) -> None:
        self.across = -(-LEAST_ACROSS // len(self.thickness))

    @property
    def closed(self) -> bool:
        return self.vertices[0] == self.vertices[-1]

    @property
    def direction(self) -> Tensor:
        """(..., n - 1, 2) of its segments."""
        return torch.nn.functional.normalize(self.points.diff(dim=-2), dim=-1)

    @property
    def offsets(self) -> Tensor:
        """(..., plies + 1) m to the left of the line."""
        t = torch.stack(torch.broadcast_tensors(*self.thickness), -1)
        return torch.nn.functional.pad(t.cumsum(-1), (1, 0)) - self.first * t.sum(-1, keepdim=True)

    def end(self, station: int) -> tuple[Tensor, Tensor]:
        """Direction away from an end, station 0 or -1, and offsets to the left of it."""
        if station == 0:
            return self.direction[..., 0, :], self.offsets
        return -self.direction[..., -1, :], -self.offsets.flip(-1)

    def around(self, k: int) -> tuple[Tensor, Tensor]:
        """Directions of the segments before and behind a station within the line."""
        return self.direction[..., k - 1, :], self.direction[..., k, :]

    def away(self, k: int, step: int) -> list[int]:
        """Stations from k on, forward or backward: to the next turn, the end, or half-way round."""
        count = len(self.vertices) - 1
        stations: list[int] = []
        k %= count + 1
        while len(stations) < ((count - 1) // 2 if self.closed else count):
            k = (k + step) % count if self.closed else k + step
            end = not self.closed and k in (0, count)
            stations.append(-1 if end and k else k)
            if end or turns(*self.around(k)):
                break
        return stations

    def divide(self, depths: list[Tensor], near: float) -> None:
        """Plies in parts, so that one ends at each of these offsets (...) m within the wall."""
        own = self.offsets.unbind(-1)
        known = [first_number(x) for x in own]
        new = [
            x
            for x in depths
            if known[0] < first_number(x) < known[-1]
            and min(abs(first_number(x) - y) for y in known) > near
        ]
        every = sorted([*own, *new], key=first_number)
        ply = [sum(first_number(x) > y for y in known[1:-1]) for x in every[1:]]
        self.thickness = [b - a for a, b in pairwise(every)]
        self.angle = [self.angle[k] for k in ply]
        self.material = [self.material[k] for k in ply]


def turns(come: Tensor, go: Tensor) -> bool:
    """Whether a line makes a corner where these directions (..., 2) meet, in any sample."""
    return bool((plain((come * go).sum(-1)) < SMOOTH).any())


def first_sample(x: Tensor, axes: int) -> np.ndarray:
    """The first sample of a tensor with so many axes of its own."""
    known = plain(x)
    return known.reshape(-1, *known.shape[known.ndim - axes :])[0]


def first_number(x: Tensor) -> float:
    return float(first_sample(x, 0))


def left(direction: Tensor) -> Tensor:
    y, z = direction.unbind(-1)
    return torch.stack((-z, y), -1)
