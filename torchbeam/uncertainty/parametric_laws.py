"""Laws of one random number by their parameters, which may be tensors (0-dim) with gradients.

Each has `icdf` of a uniform variate u, `of_score` of a normal score z, the standard normal variable
of the same probability, and undoes them by `cdf` and `score`. Scores tell both tails, u only the
lower one: close to 1 it has no digits left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..core.arguments import number
from ..core.validation import refusal
from ..math.distributions import (
    log_normal_probability,
    normal_probability,
    normal_score,
    score_of_tails,
)


class TwoTails:
    """Base class of laws that tell both tails: their `cdf`, and the `score` of the smaller one."""

    def cdf(self, x: Tensor) -> Tensor:
        return self._tails(x)[0]

    def score(self, x: Tensor) -> Tensor:
        return score_of_tails(*self._tails(x))

    def _tails(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Probabilities below and above x."""
        raise NotImplementedError


class ByParameters:
    """Base class of laws by parameters: finite numbers, those named in `positive` above zero."""

    positive: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        kind, names = type(self).__name__, [field.name for field in fields(self)]
        checked = {n: checked_number(f"{kind}'s {n}", getattr(self, n)) for n in names}
        set_fields(self, **checked)
        for name in self.positive:
            if not checked[name] > 0:
                raise refusal(f"{kind}'s {name} = {checked[name]:g}", "a positive number")
        if "least" in checked and not self.least < self.largest:
            raise refusal(f"{kind} from {self.least:g} to {self.largest:g}", "least below largest")


class ByScore(ByParameters):
    """Base class of laws whose values are simple functions of normal scores."""

    def icdf(self, u: Tensor) -> Tensor:
        return self.of_score(normal_score(u))

    def cdf(self, x: Tensor) -> Tensor:
        return normal_probability(self.score(x))


@dataclass(frozen=True)
class Constant(ByParameters):
    """A constant: a column of theta that is not random.

    Examples:
        >>> fixed = {"EI": tb.laws.Constant(1.0), "P": tb.laws.Normal(1.0, 0.1)}
        >>> tb.monte_carlo(deflection, fixed, 256, by_name=True).mean
        tensor(0.3333)
    """

    value: float

    def icdf(self, u: Tensor) -> Tensor:
        return torch.zeros_like(u) + self.value


@dataclass(frozen=True)
class Uniform(TwoTails, ByParameters):
    """Uniform between `least` and `largest`.

    Examples:
        >>> tolerance = tb.laws.Uniform(least=0.9, largest=1.1)
        >>> tb.monte_carlo(lambda EI: EI, {"EI": tolerance}, 256, by_name=True).mean
        tensor(1.)
    """

    least: float | Tensor
    largest: float | Tensor

    def icdf(self, u: Tensor) -> Tensor:
        return self.least + (self.largest - self.least) * u

    def of_score(self, z: Tensor) -> Tensor:
        width = self.largest - self.least
        return torch.where(
            z < 0,
            self.least + width * normal_probability(z),
            self.largest - width * normal_probability(-z),
        )

    def _tails(self, x: Tensor) -> tuple[Tensor, Tensor]:
        width = self.largest - self.least
        return ((x - self.least) / width).clamp(0, 1), ((self.largest - x) / width).clamp(0, 1)


@dataclass(frozen=True)
class Normal(ByScore):
    """Normal with `mean` and standard `deviation`.

    Examples:
        >>> load = tb.laws.Normal(mean=1.0, deviation=0.1)
        >>> tb.monte_carlo(lambda P: P, {"P": load}, 256, by_name=True).mean
        tensor(1.0000)
    """

    mean: float | Tensor
    deviation: float | Tensor

    positive = ("deviation",)

    def of_score(self, z: Tensor) -> Tensor:
        return self.mean + self.deviation * z

    def score(self, x: Tensor) -> Tensor:
        return (x - self.mean) / self.deviation


@dataclass(frozen=True)
class LogNormal(ByScore):
    """exp of a normal variable. `mean` and standard `deviation` belong to the lognormal variable
    itself; both are positive.

    sigma^2 = ln(1 + (deviation/mean)^2), mu = ln(mean) - sigma^2/2

    Examples:
        >>> stiffness = tb.laws.LogNormal(
        ...     mean=1.0, deviation=0.1
        ... )  # of the values, not of their logarithm
        >>> tb.monte_carlo(lambda EI: EI, {"EI": stiffness}, 256, by_name=True).mean
        tensor(1.0000)
    """

    mean: float | Tensor
    deviation: float | Tensor

    positive = ("mean", "deviation")

    @property
    def sigma(self) -> float:
        """Standard deviation of the logarithm."""
        ratio = (self.deviation / self.mean) ** 2
        return ratio.log1p().sqrt() if isinstance(ratio, Tensor) else math.sqrt(math.log1p(ratio))

    @property
    def mu(self) -> float:
        """Mean of the logarithm."""
        log = self.mean.log() if isinstance(self.mean, Tensor) else math.log(self.mean)
        return log - self.sigma**2 / 2

    def of_score(self, z: Tensor) -> Tensor:
        return (self.mu + self.sigma * z).exp()

    def score(self, x: Tensor) -> Tensor:
        return (x.clamp_min(0).log() - self.mu) / self.sigma


@dataclass(frozen=True)
class Triangular(TwoTails, ByParameters):
    """Density that rises straight from `least` to `mode` and falls straight to `largest`.

    Examples:
        >>> expert = tb.laws.Triangular(least=0.8, mode=1.0, largest=1.1)
        >>> tb.monte_carlo(lambda EI: EI, {"EI": expert}, 256, by_name=True).mean
        tensor(0.9667)
    """

    least: float | Tensor
    mode: float | Tensor
    largest: float | Tensor

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.least <= self.mode <= self.largest:
            raise ValueError(
                f"Triangular's mode = {self.mode:g} was given for {self.least:g} to "
                f"{self.largest:g}; one between is wanted"
            )

    def icdf(self, u: Tensor) -> Tensor:
        return self._of_tails(u, 1 - u)

    def of_score(self, z: Tensor) -> Tensor:
        return self._of_tails(normal_probability(z), normal_probability(-z))

    def _of_tails(self, p: Tensor, q: Tensor) -> Tensor:
        """Value with the probabilities p below and q above it."""
        width, rise = self.largest - self.least, self.mode - self.least
        rises = (p * width < rise) | (rise == width)
        below = torch.where(rises, p * width * rise, 1.0).sqrt()
        above = torch.where(rises, 1.0, q * width * (width - rise)).sqrt()
        return torch.where(rises, self.least + below, self.largest - above)

    def _tails(self, x: Tensor) -> tuple[Tensor, Tensor]:
        x, width = x.clamp(self.least, self.largest), self.largest - self.least
        rise, fall = self.mode - self.least, self.largest - self.mode
        below = (x - self.least) ** 2 / (width * rise) if rise else torch.zeros_like(x)
        above = (self.largest - x) ** 2 / (width * fall) if fall else torch.zeros_like(x)
        return torch.where(x < self.mode, below, 1 - above), torch.where(
            x < self.mode, 1 - below, above
        )


@dataclass(frozen=True)
class Weibull(TwoTails, ByParameters):
    """P(X > x) = exp(-(x/scale)^shape); with shape = 1 the exponential law of mean `scale`.

    Examples:
        >>> strength = tb.laws.Weibull(scale=1.0, shape=8.0)
        >>> tb.monte_carlo(lambda s: s, {"s": strength}, 256, by_name=True).mean
        tensor(0.9419)
    """

    scale: float | Tensor
    shape: float | Tensor = 1.0

    positive = ("scale", "shape")

    def icdf(self, u: Tensor) -> Tensor:
        return self.scale * (-torch.log1p(-u)) ** (1 / self.shape)

    def of_score(self, z: Tensor) -> Tensor:
        return self.scale * (-log_normal_probability(-z)) ** (1 / self.shape)

    def _tails(self, x: Tensor) -> tuple[Tensor, Tensor]:
        exponent = -((x.clamp_min(0) / self.scale) ** self.shape)
        return -torch.expm1(exponent), exponent.exp()


@dataclass(frozen=True)
class Gumbel(TwoTails, ByParameters):
    """Law of the largest of many: P(X <= x) = exp(-exp(-(x - location)/scale)); the mean is
    location + 0.57722 scale.

    Examples:
        >>> gust = tb.laws.Gumbel(location=1.0, scale=0.1)  # the largest of a year
        >>> tb.monte_carlo(deflection, {"EI": laws["EI"], "P": gust}, 256, by_name=True).quantile(
        ...     0.98
        ... )
        tensor(0.4935)
    """

    location: float | Tensor
    scale: float | Tensor

    positive = ("scale",)

    def icdf(self, u: Tensor) -> Tensor:
        return self.location - self.scale * (-u.log()).log()

    def of_score(self, z: Tensor) -> Tensor:
        return self.location - self.scale * (-log_normal_probability(z)).log()

    def _tails(self, x: Tensor) -> tuple[Tensor, Tensor]:
        exponent = -(-(x - self.location) / self.scale).exp()
        return exponent.exp(), -torch.expm1(exponent)


def checked_number(name: str, value: Any) -> float | Tensor:
    """One finite number, or the tensor given where it carries a gradient. ValueError otherwise."""
    checked = number(name, value)
    return value if isinstance(value, Tensor) and value.requires_grad else checked


def plain_number(name: str, value: Any, *, infinite: bool = False) -> float:
    """One number without derivatives; ValueError otherwise, as for a tensor with a gradient."""
    if isinstance(value, Tensor) and value.requires_grad:
        raise refusal(f"{name} that carries a gradient", "a number")
    return number(name, value, infinite=infinite)


def set_fields(law: Any, /, **values: Any) -> None:
    for name, value in values.items():
        object.__setattr__(law, name, value)
