"""Weighting: how much each reading counts, by how far it is from what was expected."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist
from typing import NamedTuple

import torch
from torch import Tensor

from ...core.arguments import choice, level_of
from ..identification.losses import HUBER, STUDENT

LOSSES: dict[str, Callable[[Tensor], Tensor]] = {  # weights of squares, by readings' deviations
    "huber": lambda u: HUBER / u.abs().clamp(min=HUBER),
    "student": lambda u: (STUDENT + 1) / (STUDENT + u.square()),
}
ROUNDS = 20  # in which weights, or what stands at a bound, are found
SETTLED = 1e-4  # change of weights that is none
FARTHEST = 1e5  # expected deviations: a loss takes what is beyond for so far


class Beyond(NamedTuple):
    """Of readings that a gate leaves out, (...): how many, and their log density at the gate."""

    count: Tensor
    log_density: Tensor


@dataclass(frozen=True)
class Weighting:
    """Weights (..., m) of squares of readings' errors.

    loss   their weights by residuals over noise; None = 1 (squares)
    reach  expected deviations of an error, beyond which a reading is left out
    """

    loss: Callable[[Tensor], Tensor] | None
    reach: float

    @classmethod
    def of(cls, loss: str | None, gate: float | None) -> Weighting:
        """Raises ValueError for another loss, and for a gate that is no probability."""
        law = None if loss is None else LOSSES[choice("loss", loss, tuple(LOSSES))]
        if gate is None:
            return cls(law, math.inf)
        return cls(law, NormalDist().inv_cdf((1 + level_of("gate", gate)) / 2))

    def __call__(self, sources: Tensor, noise: Tensor, error: Tensor) -> Tensor:
        """0 where a reading is left out or missing (NaN), from sources (..., s, m) of unit variance
        of what was expected, noise (m,) and error (..., m).

        A loss weighs the residuals after the update, as does iteratively reweighted least squares
        of the readings and what was expected (Karlgaard and Schaub 2007, J. Guidance 30, 885).
        """
        seen = self.within_gate(sources, noise, error)
        weight = seen.to(error)
        if self.loss is None:
            return weight
        far = FARTHEST * self.deviation(sources, noise)
        e = torch.where(seen, torch.minimum(torch.maximum(error, -far), far), 0.0)
        sources = torch.where(seen[..., None, :], sources, 0.0)
        known, share = sources.mT @ sources, torch.ones_like(weight)
        for _ in range(ROUNDS):
            own = noise.square() / share
            S = known + torch.diag_embed(own)
            residual = own * torch.linalg.solve_ex(S, e[..., None])[0][..., 0]
            before, share = share, self.loss(residual / noise)
            if not ((share - before).abs() > SETTLED).any():
                break
        return weight * share

    def within_gate(self, sources: Tensor, noise: Tensor, error: Tensor) -> Tensor:
        """(..., m) bool: whether a reading is neither missing nor left out."""
        if self.reach == math.inf:
            return ~torch.isnan(error)
        return error.abs() <= self.reach * self.deviation(sources, noise)

    def deviation(self, sources: Tensor, noise: Tensor) -> Tensor:
        """(..., m) of errors that are expected."""
        return (sources.square().sum(-2) + noise.square()).sqrt()

    def beyond(self, sources: Tensor, noise: Tensor, error: Tensor, weight: Tensor) -> Beyond:
        """What weights say of readings that are left out."""
        left = ~torch.isnan(error) & (weight == 0)
        if not left.any():
            none = error.new_zeros(error.shape[:-1])
            return Beyond(none, none)
        spread = self.deviation(sources, noise)
        each = -(self.reach**2) / 2 - (spread * math.sqrt(2 * math.pi)).log()
        return Beyond(left.sum(-1).to(error), torch.where(left, each, 0.0).sum(-1))
