"""Law of another law's values between two bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..core.validation import refusal, shown
from ..math.distributions import (
    normal_probability,
    normal_score,
    probability_between,
    score_of_tails,
)
from .law_scores import as_own, has_tails, of_score, score, why_none
from .parametric_laws import TwoTails, Uniform, plain_number, set_fields

# probability of the range, where a law does not tell its upper tail: fewer digits than four are
# left of less
LEAST = 1e-12


@dataclass(frozen=True)
class Truncated(TwoTails):
    """A law with both `cdf` and `icdf`, or (least, largest), on condition that the value lies
    between `least` and `largest`.

    Examples:
        >>> positive = tb.laws.Truncated(tb.laws.Normal(1.0, 0.5), least=0.1)
        >>> tb.monte_carlo(lambda EI: EI, {"EI": positive}, 256, by_name=True).y.min() >= 0.1
        tensor(True)
    """

    law: Any
    least: float = -math.inf
    largest: float = math.inf

    def __post_init__(self) -> None:
        pair = isinstance(self.law, (tuple, list)) and len(self.law) == 2
        law = Uniform(*self.law) if pair else self.law
        if why := why_none(law):
            raise ValueError(
                f"the law {shown(law)} was given to Truncated, which {why}; another is wanted"
            )
        law = as_own(law) if hasattr(law, "ppf") else law
        if not hasattr(law, "icdf") or not hasattr(law, "cdf"):
            raise ValueError(
                f"the law {shown(self.law)} was given to Truncated; one with both cdf and icdf "
                "is wanted"
            )
        ends = {
            name: plain_number(f"Truncated's {name}", getattr(self, name), infinite=True)
            for name in ("least", "largest")
        }
        set_fields(self, law=law, **ends)
        if not self.least < self.largest:
            raise refusal(
                f"Truncated from {self.least:g} to {self.largest:g}", "least below largest"
            )
        within = probability_between(*self._ends(torch.ones(1, dtype=torch.float64)))
        if not within > (0.0 if has_tails(law) else LEAST):
            raise ValueError(
                f"Truncated from {self.least:g} to {self.largest:g} was given, where {shown(law)} "
                f"lies with the probability {within.item():.1g}; a wider range is wanted"
            )

    def icdf(self, u: Tensor) -> Tensor:
        return self.of_score(normal_score(u))

    def of_score(self, z: Tensor) -> Tensor:
        low, high = self._ends(z)
        within = probability_between(low, high)
        below = normal_probability(low) + normal_probability(z) * within
        above = normal_probability(-high) + normal_probability(-z) * within
        return of_score(self.law, score_of_tails(below, above)).clamp(self.least, self.largest)

    def _tails(self, x: Tensor) -> tuple[Tensor, Tensor]:
        low, high = self._ends(x)
        at = torch.minimum(
            torch.maximum(score(self.law, x.clamp(self._below, self.largest)), low), high
        )
        within = probability_between(low, high)
        return probability_between(low, at) / within, probability_between(at, high) / within

    @property
    def _below(self) -> float:
        """The next number below `least`, which is within: an `Empirical` value may lie there."""
        return math.nextafter(self.least, -math.inf)

    def _ends(self, like: Tensor) -> tuple[Tensor, Tensor]:
        """Normal scores of the law just below `least` and at `largest`."""
        ends = (like.new_tensor([x]) for x in (self._below, self.largest))
        return tuple(x if x.isinf() else score(self.law, x).to(like.dtype) for x in ends)
