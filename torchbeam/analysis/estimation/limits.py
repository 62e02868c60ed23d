"""Limits: bounds of what is estimated, and the estimate within them that is most likely."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .unknowns import Unknowns
from .weighting import ROUNDS

FARTHEST = 10.0  # first deviations of a parameter's coordinate, and of its walk of LONG intervals
LONG = 1e4


@dataclass(frozen=True)
class Limits:
    """Bounds least, largest (p,) of the numbers at `places` (p,) of x."""

    places: Tensor
    least: Tensor
    largest: Tensor

    @classmethod
    def of(cls, unknowns: Unknowns, moves: int) -> Limits:
        """Of the parameters behind so many numbers: their own bounds, and FARTHEST."""
        p = unknowns.of_model
        mean = unknowns.start[:p]
        spread = unknowns.deviation[:p].square() + LONG * unknowns.added[:p].square()
        reach = FARTHEST * spread.sqrt()
        least, largest = mean - reach, mean + reach
        if unknowns.parameters is not None:
            own = unknowns.parameters.bounds(unknowns.parameters.x[0])
            least, largest = torch.maximum(least, own[0].to(mean)), torch.minimum(largest, own[1].to(mean))
        return cls(moves + torch.arange(p, device=mean.device), least, largest)

    def change(self, x: Tensor, factor: Tensor) -> Tensor:
        """(..., size) by which x (..., size) of this factor (..., s, size) comes within the bounds:
        the most likely one there (Simon 2010, IET Control Theory 4, 1303, section 2.4).
        """
        change, own = torch.zeros_like(x), x[..., self.places]
        out = ((own < self.least) | (own > self.largest)).any(-1)
        if not out.any():
            return change
        best, root = own[out], factor.expand(*x.shape[:-1], *factor.shape[-2:])[out]
        by = root.mT @ root[..., self.places]
        H = torch.linalg.inv_ex(by[..., self.places, :])[0]
        inside = within(H, best, self.least, self.largest)
        found = (by @ (H @ (inside - best)[..., None]))[..., 0]
        found[..., self.places] = inside - best
        change[out] = found
        return change


def within(H: Tensor, best: Tensor, least: Tensor, largest: Tensor) -> Tensor:
    """x (..., p) within bounds (p,) at which (x - best)^T H (x - best) is least, by the primal-dual
    active set method (Hintermueller, Ito and Kunisch 2003).
    """
    x, held = best, torch.zeros_like(best, dtype=torch.bool)
    size = H.diagonal(dim1=-2, dim2=-1)
    for _ in range(ROUNDS):
        pulled = x - (H @ (x - best)[..., None])[..., 0] / size
        before, held = held, (pulled < least) | (pulled > largest)
        if torch.equal(before, held):
            break
        at = torch.where(held, torch.maximum(torch.minimum(pulled, largest), least) - best, 0.0)
        free = ~held[..., :, None] & ~held[..., None, :]
        A = torch.where(free, H, torch.diag_embed(size))
        b = torch.where(held, size * at, -(H @ at[..., None])[..., 0])
        x = best + torch.linalg.solve_ex(A, b[..., None])[0][..., 0]
    return torch.maximum(torch.minimum(x, largest), least)
