"""Weighting: how much each reading counts, by how far it is from what was expected."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ...core.arguments import choice, level_of
from ...math.shapes import stacked
from ...math.square_root import Conditioned, conditioned
from ..identification.losses import HUBER, STUDENT

LOSSES: dict[str, Callable[[Tensor], Tensor]] = {  # weights of squares, by readings' deviations
    "huber": lambda u: HUBER / u.abs().clamp(min=HUBER),
    "student": lambda u: (STUDENT + 1) / (STUDENT + u.square()),
}
ROUNDS = 20  # in which weights, or what stands at a bound, are found
SETTLED = 1e-4  # of a weight: a change that is none
FARTHEST = 1e5  # expected deviations: an error that says no more than a larger one


class Beyond(NamedTuple):
    """Of readings that a gate leaves out, (...): how many, and their log density at the gate."""

    count: Tensor
    log_density: Tensor


@dataclass(frozen=True)
class Weighting:
    """Weights (..., m) of squares of readings' errors.

    loss   their weights by residuals over noise; None = 1 (squares)
    reach  expected deviations of an error, beyond which a reading is left out
    noise  (m,) deviation of each reading
    """

    loss: Callable[[Tensor], Tensor] | None
    reach: float
    noise: Tensor

    @classmethod
    def of(cls, loss: str | None, gate: float | None, noise: Tensor) -> Weighting:
        """Raises ValueError for another loss, and for a gate that is no probability."""
        law = None if loss is None else LOSSES[choice("loss", loss, tuple(LOSSES))]
        if gate is None:
            return cls(law, math.inf, noise)
        return cls(law, NormalDist().inv_cdf((1 + level_of("gate", gate)) / 2), noise)

    def __call__(self, sources: Tensor, error: Tensor) -> Tensor:
        """0 where a reading is left out or missing (NaN), from sources (..., s, m) of unit variance
        of what was expected, and errors (..., m).

        A loss weighs the residuals after the update, as does iteratively reweighted least squares
        of the readings and what was expected (Karlgaard and Schaub 2007, J. Guidance 30, 885).
        """
        seen = self.within_gate(sources, error)
        weight = seen.to(error)
        if self.loss is None:
            return weight
        e = torch.where(seen, error, 0.0)
        sources = torch.where(seen[..., None, :], sources, 0.0)
        known, share = sources.mT @ sources, torch.ones_like(weight)
        for _ in range(ROUNDS):
            own = self.noise.square() / share
            S = known + torch.diag_embed(own)
            residual = own * torch.linalg.solve_ex(S, e[..., None])[0][..., 0]
            after = self.loss(residual / self.noise)
            moves = ((after - share).abs() > SETTLED * after).any(-1, keepdim=True)
            if not moves.any():
                break
            share = torch.where(moves, after, share)  # of those that are settled no more
        return weight * share

    def clipped(self, sources: Tensor, error: Tensor) -> Tensor:
        """Errors (..., m), for a loss no farther than that of a reading that says nothing."""
        if self.loss is None:
            return error
        far = FARTHEST * self.deviation(sources)
        return error.minimum(far).maximum(-far)

    def within_gate(self, sources: Tensor, error: Tensor) -> Tensor:
        """(..., m) bool: whether a reading is neither missing nor left out."""
        if self.reach == math.inf:
            return ~torch.isnan(error)
        return error.abs() <= self.reach * self.deviation(sources)

    def deviation(self, sources: Tensor) -> Tensor:
        """(..., m) of errors that are expected."""
        return (sources.square().sum(-2) + self.noise.square()).sqrt()

    def beyond(self, sources: Tensor, error: Tensor, weight: Tensor) -> Beyond:
        """What weights say of readings that are left out."""
        left = ~torch.isnan(error) & (weight == 0)
        if not left.any():
            none = error.new_zeros(error.shape[:-1])
            return Beyond(none, none)
        spread = self.deviation(sources)
        each = -(self.reach**2) / 2 - (spread * math.sqrt(2 * math.pi)).log()
        return Beyond(left.sum(-1).to(error), torch.where(left, each, 0.0).sum(-1))

    def conditioned(
        self, by_x: Tensor, sources: Tensor, error: Tensor, weight: Tensor
    ) -> tuple[Tensor, Conditioned]:
        """What readings of errors (..., m) and weights (..., m) say of the rest of sources (..., s,
        m + n); and by_x (..., size, m + n), without readings of no weight.
        """
        seen = weight > 0
        rest = sources.shape[-1] - error.shape[-1]
        kept = pad(seen, (0, rest), value=True)[..., None, :]
        own = torch.where(seen, self.noise / weight**0.5, 1.0)
        whole = stacked(torch.where(kept, sources, 0.0), pad(torch.diag_embed(own), (0, rest)))
        return torch.where(kept, by_x, 0.0), conditioned(whole, torch.where(seen, error, 0.0))
