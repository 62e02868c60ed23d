"""Law of values that were observed."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..core.validation import converted, finite
from ..math.distributions import normal_probability
from .parametric_laws import TwoTails, set_fields


@dataclass(frozen=True)
class Empirical(TwoTails):
    """Observed values, equally likely, or weighted by `weights`.

    Args:
        values: (K,)
        weights: (K,) positive, of any sum

    Examples:
        >>> measured = tb.laws.Empirical(torch.tensor([0.9, 1.0, 1.0, 1.2]))
        >>> tb.monte_carlo(deflection, {"EI": measured, "P": laws["P"]}, 256, by_name=True).mean
        tensor(0.3287)
    """

    values: Tensor
    weights: Tensor | None = None

    def __post_init__(self) -> None:
        values = finite("Empirical's values", converted(self.values, torch.float64)).cpu()
        weights = torch.ones_like(values)
        if self.weights is not None:
            weights = converted(self.weights, torch.float64).cpu()
        if (
            values.ndim != 1
            or not len(values)
            or weights.shape != values.shape
            or not (weights > 0).all()
            or not (torch.isfinite(weights).all())
        ):
            raise ValueError(
                f"values {tuple(values.shape)} and weights {tuple(weights.shape)} were given to "
                "Empirical; (K,) finite values, and positive weights of as many, are wanted"
            )
        values, order = values.sort()
        weights = weights[order] / weights.max()
        set_fields(self, values=values, weights=weights / weights.sum())

    def icdf(self, u: Tensor) -> Tensor:
        place = torch.searchsorted(self._below[1:], u.double().contiguous())
        return self.values[place.clamp_max(len(self.values) - 1)]

    def of_score(self, z: Tensor) -> Tensor:
        return self.icdf(normal_probability(z))

    def _tails(self, x: Tensor) -> tuple[Tensor, Tensor]:
        below = self._below[torch.searchsorted(self.values, x.double().contiguous(), right=True)]
        return below, 1 - below

    @property
    def _below(self) -> Tensor:
        """Probabilities (K + 1,) of values below the k-th, from 0 to 1."""
        below = torch.cat((self.weights.new_zeros(1), self.weights.cumsum(0)))
        return below / below[-1]

    def __repr__(self) -> str:
        return (
            f"Empirical({len(self.values)} values from {self.values[0].item():.4g} to "
            f"{self.values[-1].item():.4g})"
        )
