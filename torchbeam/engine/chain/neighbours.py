"""Places that are near each other along one beam: they come no nearer than its bending lets them,
however far it moves, so that the list of pairs need not hold them.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ...nodal.touching import Touching, spread

REACH = 4  # numbers of nodes between two, from the least on that may touch
MARGIN = 0.25  # of the way from where they are along a straight beam to where they might touch
STRETCH = 1.1  # by so much an element may become longer until the next list


class Neighbours(NamedTuple):
    """Of a beam's nodes from `first` on, (..., n, 3): elements are no longer than `longest`
    (..., n-1) m, and two nodes of which one is m further no nearer than least[m] (..., n-m) m, 0 =
    whatever they do, as long as no place near one may touch a place near the other.
    """

    first: int
    longest: Tensor
    least: dict[int, Tensor]

    def nearer(self, position: Tensor) -> Tensor:
        """(K) bool: whether they do in a step, of positions (K + 1, ..., nodes, 3), in a straight
        line between one and the next.
        """
        x = position.detach()[..., self.first : self.first + self.longest.shape[-1] + 1, :]
        half = (spread(x.diff(dim=0)) / 2).square()[..., None]
        too_long = x.diff(dim=-2).square().sum(-1) > self.longest.square()
        nearer = (too_long[1:] | too_long[:-1]).flatten(1).any(1)
        for m, least in self.least.items():
            apart = (x[..., m:, :] - x[..., :-m, :]).square().sum(-1)
            within = torch.minimum(apart[1:], apart[:-1]) - half < least.square()
            nearer = nearer | (within & (least > 0)).flatten(1).any(1)
        return nearer


def neighbours(touching: Touching, position: Tensor) -> tuple[Neighbours, Tensor] | None:
    """Of nodes at (..., nodes, 3) m those that are surely apart, and which pairs (P, K) of the
    beam's places and pieces they are; None where its pieces are another part's.

    All of a piece is within half of an element from its node.
    """
    if not touching.itself:
        return None
    first, n = touching.along
    x, s = position.detach()[..., first : first + n, :], touching.s.detach()[..., first : first + n]
    count = touching.places.count
    allowed = touching.allowed[..., ::count, :] > 0
    longest = STRETCH * torch.linalg.vector_norm(x.diff(dim=-2), dim=-1)
    wide = torch.maximum(pad(longest, (1, 0)), pad(longest, (0, 1))) / 2
    reach = (touching.radii.sum(-1) + touching.contact.thickness).detach()[..., None]
    far = torch.zeros(n, n, dtype=torch.bool, device=x.device)
    nearest = (m for m in range(1, n) if allowed.diagonal(m, -2, -1).any())
    start = next(nearest, n)
    least = {}
    for m in range(start, min(start + REACH, n)):
        asked = reach + wide[..., m:] + wide[..., :-m]
        apart = torch.linalg.vector_norm(x[..., m:, :] - x[..., :-m, :], dim=-1)
        straight = s[..., m:] - s[..., :-m]
        may = allowed.diagonal(m, -2, -1)
        clear = ~may | (apart > asked + MARGIN * (straight - asked).clamp(min=0.0))
        clear = clear.reshape(-1, n - m).all(0)
        far.diagonal(m).copy_(clear)
        far.diagonal(-m).copy_(clear)
        least[m] = torch.where(clear & may, asked, 0.0)
    return Neighbours(first, longest, least), far.repeat_interleave(count, 0)
