"""Limits: bounds of what is estimated, and the estimate within them that is most likely."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import choice
from ...core.validation import as_tensor, refusal, shown
from .unknowns import Unknowns, by_name
from .weighting import ROUNDS

FARTHEST = 10.0  # deviations of a parameter's coordinate, of its prior and of a walk so LONG
LONG = 1e4  # intervals


@dataclass(frozen=True)
class Limits:
    """Bounds least, largest (k,) of the unknowns behind z, of `moves` numbers, in x; declared (k,)
    bool: which were asked for. The others are FARTHEST of parameters, and none.
    """

    moves: int
    least: Tensor
    largest: Tensor
    declared: Tensor

    @classmethod
    def of(cls, unknowns: Unknowns, moves: int, bounds: Mapping[str, Any] | None) -> Limits:
        """bounds: name of an offset or a force -> (least, largest). Raises ValueError for bounds of
        another form, and of what is no such unknown.
        """
        p, mean = unknowns.of_model, unknowns.start
        least, largest = (torch.full_like(mean, end) for end in (-torch.inf, torch.inf))
        if unknowns.parameters is not None:
            ends = unknowns.parameters.bounds(unknowns.parameters.x[0])
            least[:p], largest[:p] = (end.to(mean) for end in ends)
        for name, pair in by_name("bounds", bounds).items():
            i = unknowns.names.index(choice("a name of bounds", name, unknowns.names))
            ends = as_tensor(pair, least.dtype, least.device)
            if i < p or ends.shape != (2,) or not ends[0] < ends[1]:
                wanted = "(least, largest) of an offset or a force, or tb.Parameter(bounds=),"
                raise refusal(f"bounds[{name!r}] = {shown(pair)}", wanted)
            least[i], largest[i] = ends
        declared = torch.isfinite(least) | torch.isfinite(largest)
        spread = (unknowns.deviation.square() + LONG * unknowns.added.square()).sqrt()
        reach = torch.where(torch.arange(len(mean)).to(mean) < p, FARTHEST * spread, torch.inf)
        least, largest = least.maximum(mean - reach), largest.minimum(mean + reach)
        return cls(moves, least, largest, declared)

    @cached_property
    def places(self) -> Tensor:
        """(b,) of x: those that have bounds."""
        return self.moves + self._bounded.nonzero()[:, 0]

    @cached_property
    def ends(self) -> tuple[Tensor, Tensor]:
        """Bounds (b,) of these."""
        return self.least[self._bounded], self.largest[self._bounded]

    @property
    def _bounded(self) -> Tensor:
        return torch.isfinite(self.least) | torch.isfinite(self.largest)

    def of_constants(self, unknowns: Unknowns) -> Limits:
        """Those of what is constant. Raises ValueError for others that were asked for."""
        changes = (unknowns.added > 0) | (unknowns.stays < 1)
        for i in (self.declared & changes).nonzero()[:, 0].tolist():
            raise refusal(f"bounds of {unknowns.names[i]!r}, which changes,", "what is constant")
        least = torch.where(changes, -torch.inf, self.least)
        return replace(self, least=least, largest=torch.where(changes, torch.inf, self.largest))

    def change(self, x: Tensor, factor: Tensor) -> Tensor:
        """(..., size) by which x (..., size) of this factor (..., s, size) comes within the bounds:
        the most likely one there (Simon 2010, IET Control Theory and Applications 4, 1303).
        """
        change, values, (least, largest) = torch.zeros_like(x), x[..., self.places], self.ends
        out = ((values < least) | (values > largest)).any(-1)
        if not out.any():
            return change
        best, root = values[out], factor.expand(*x.shape[:-1], *factor.shape[-2:])[out]
        by = root.mT @ root[..., self.places]
        H = torch.linalg.inv_ex(by[..., self.places, :])[0]
        inside = within(H, best, least, largest)
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
