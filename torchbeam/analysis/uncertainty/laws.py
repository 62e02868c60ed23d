"""Laws of random parameters. One number: of a uniform variate or of a normal score.

A law is (least, largest), uniform between; one of the classes here; anything with `icdf`, as
torch.distributions have; or a function of u (N,), uniform in (0, 1). `RandomField` is a law of many numbers.
Parameters of Constant, Uniform, Normal, LogNormal, Triangular, Weibull and Gumbel may be tensors (0-dim) with gradients.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import number
from ...core.validation import as_tensor, finite, shown
from ...math.distributions import normal_probability, normal_score
from .random_field import RandomField

__all__ = ["Constant", "Empirical", "Gumbel", "LogNormal", "Normal", "RandomField", "Triangular", "Truncated", "Uniform",
           "Weibull"]
Law = Any


@dataclass(frozen=True)
class Constant:
    """Always the same value: a column of theta that is not random."""

    value: float

    def __post_init__(self) -> None:
        _set(self, value=_value("Constant's value", self.value))

    def icdf(self, u: Tensor) -> Tensor:
        return torch.zeros_like(u) + self.value


@dataclass(frozen=True)
class Uniform:
    """Uniform between `least` and `largest`."""

    least: float
    largest: float

    def __post_init__(self) -> None:
        _ordered(self, "least", "largest")

    def icdf(self, u: Tensor) -> Tensor:
        return self.least + (self.largest - self.least) * u

    def cdf(self, x: Tensor) -> Tensor:
        return ((x - self.least) / (self.largest - self.least)).clamp(0, 1)


@dataclass(frozen=True)
class Normal:
    """Normal with `mean` and standard `deviation`."""

    mean: float
    deviation: float

    def __post_init__(self) -> None:
        _positive(self, "mean", deviation=True)

    def of_score(self, z: Tensor) -> Tensor:
        return self.mean + self.deviation * z

    def icdf(self, u: Tensor) -> Tensor:
        return self.of_score(normal_score(u))

    def cdf(self, x: Tensor) -> Tensor:
        return normal_probability((x - self.mean) / self.deviation)


@dataclass(frozen=True)
class LogNormal:
    """exp of a normal variable, with the `mean` and standard `deviation` of the variable itself, both positive.

    sigma^2 = ln(1 + (deviation/mean)^2), mu = ln(mean) - sigma^2/2
    """

    mean: float
    deviation: float

    def __post_init__(self) -> None:
        _positive(self, mean=True, deviation=True)

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

    def icdf(self, u: Tensor) -> Tensor:
        return self.of_score(normal_score(u))

    def cdf(self, x: Tensor) -> Tensor:
        return normal_probability((x.clamp_min(0).log() - self.mu) / self.sigma)


@dataclass(frozen=True)
class Triangular:
    """Density that rises straight from `least` to `mode` and falls straight to `largest`."""

    least: float
    mode: float
    largest: float

    def __post_init__(self) -> None:
        _ordered(self, "least", "largest")
        _set(self, mode=_value("Triangular's mode", self.mode))
        if not self.least <= self.mode <= self.largest:
            raise ValueError(f"Triangular's mode = {self.mode:g} was given for {self.least:g} to {self.largest:g}; one between "
                             "is wanted")

    def icdf(self, u: Tensor) -> Tensor:
        width, rise = self.largest - self.least, self.mode - self.least
        below = self.least + (u * width * rise).sqrt()
        above = self.largest - ((1 - u) * width * (width - rise)).sqrt()
        return torch.where(u * width < rise, below, above)

    def cdf(self, x: Tensor) -> Tensor:
        x, width = x.clamp(self.least, self.largest), self.largest - self.least
        rise, fall = self.mode - self.least, self.largest - self.mode
        below = (x - self.least) ** 2 / (width * rise) if rise else torch.zeros_like(x)
        above = 1 - (self.largest - x) ** 2 / (width * fall) if fall else torch.ones_like(x)
        return torch.where(x < self.mode, below, above)


@dataclass(frozen=True)
class Weibull:
    """P(X > x) = exp(-(x/scale)^shape); with shape = 1 the exponential law of mean `scale`."""

    scale: float
    shape: float = 1.0

    def __post_init__(self) -> None:
        _positive(self, scale=True, shape=True)

    def icdf(self, u: Tensor) -> Tensor:
        return self.scale * (-torch.log1p(-u)) ** (1 / self.shape)

    def cdf(self, x: Tensor) -> Tensor:
        return -torch.expm1(-((x.clamp_min(0) / self.scale) ** self.shape))


@dataclass(frozen=True)
class Gumbel:
    """Largest of many: P(X <= x) = exp(-exp(-(x - location)/scale)); the mean is location + 0.57722 scale."""

    location: float
    scale: float

    def __post_init__(self) -> None:
        _positive(self, "location", scale=True)

    def icdf(self, u: Tensor) -> Tensor:
        return self.location - self.scale * (-u.log()).log()

    def cdf(self, x: Tensor) -> Tensor:
        return (-(-(x - self.location) / self.scale).exp()).exp()


@dataclass(frozen=True)
class Truncated:
    """A law with both `cdf` and `icdf`, or (least, largest), on condition that the value lies between `least` and `largest`."""

    law: Law
    least: float = -math.inf
    largest: float = math.inf

    def __post_init__(self) -> None:
        law = Uniform(*self.law) if isinstance(self.law, (tuple, list)) and len(self.law) == 2 else self.law
        if not hasattr(law, "icdf") or not hasattr(law, "cdf"):
            raise ValueError(f"the law {shown(self.law)} was given to Truncated; one with both cdf and icdf is wanted")
        _set(self, law=law, least=number("Truncated's least", self.least, infinite=True),
             largest=number("Truncated's largest", self.largest, infinite=True))
        if not self.least < self.largest:
            raise ValueError(f"Truncated from {self.least:g} to {self.largest:g} was given; least below largest is wanted")
        low, high = self._limits(torch.ones(1, dtype=torch.float64))
        if not high - low > 1e-12:
            raise ValueError(f"Truncated from {self.least:g} to {self.largest:g} was given, where {shown(law)} lies with the "
                             f"probability {(high - low).item():.1g}; a wider range is wanted")

    def icdf(self, u: Tensor) -> Tensor:
        low, high = self._limits(u)
        return self.law.icdf(low + u * (high - low)).clamp(self.least, self.largest)

    def cdf(self, x: Tensor) -> Tensor:
        low, high = self._limits(x)
        at = self.law.cdf(_inside(self.law, x.clamp(self._below, self.largest)))
        return ((at - low) / (high - low)).clamp(0, 1)

    @property
    def _below(self) -> float:
        """The next number below `least`, which is itself within: an `Empirical` value may lie there."""
        return math.nextafter(self.least, -math.inf)

    def _limits(self, like: Tensor) -> tuple[Tensor, Tensor]:
        """Probabilities of the law below `least` and below `largest`."""
        low, high = ((at if math.isinf(x) else self.law.cdf(_inside(self.law, like.new_tensor([x]))).clamp(0, 1).to(like.dtype))
                     for x, at in ((self._below, like.new_zeros(1)), (self.largest, like.new_ones(1))))
        return low, high


@dataclass(frozen=True)
class Empirical:
    """Values that were observed, each as likely as the others, or by `weights`.

    values   (K,);  weights (K,) positive, of any sum
    """

    values: Tensor
    weights: Tensor | None = None

    def __post_init__(self) -> None:
        values = finite("Empirical's values", as_tensor(self.values, torch.float64)).cpu()
        weights = torch.ones_like(values) if self.weights is None else as_tensor(self.weights, torch.float64).cpu()
        if values.ndim != 1 or not len(values) or weights.shape != values.shape or not (weights > 0).all() or not (
                torch.isfinite(weights).all()):
            raise ValueError(f"values {tuple(values.shape)} and weights {tuple(weights.shape)} were given to Empirical; (K,) "
                             "finite values, and positive weights of as many, are wanted")
        values, order = values.sort()
        _set(self, values=values, weights=weights[order] / weights.sum())

    def icdf(self, u: Tensor) -> Tensor:
        place = torch.searchsorted(self.weights.cumsum(0), u.double().contiguous())
        return self.values[place.clamp_max(len(self.values) - 1)]

    def cdf(self, x: Tensor) -> Tensor:
        below = torch.cat((self.weights.new_zeros(1), self.weights.cumsum(0)))
        return below[torch.searchsorted(self.values, x.double().contiguous(), right=True)]

    def __repr__(self) -> str:
        return f"Empirical({len(self.values)} values from {self.values[0].item():.4g} to {self.values[-1].item():.4g})"


def _inside(law: Law, x: Tensor) -> Tensor:
    """x, moved into the support of a distribution of torch, which refuses others."""
    support = getattr(law, "support", None)
    low, high = (float(getattr(support, name, at)) for name, at in (("lower_bound", -math.inf), ("upper_bound", math.inf)))
    eps, tiny = torch.finfo(x.dtype).eps, torch.finfo(x.dtype).tiny  # a bound may be outside of the support
    inside = (at if math.isinf(at) else at + side * max(abs(at) * eps, tiny) for at, side in ((low, 1), (high, -1)))
    return x.clamp(*inside)


def _value(name: str, value: Any) -> float | Tensor:
    """One finite number; as the tensor that was given where it carries a gradient. ValueError otherwise."""
    found = number(name, value)
    return value if isinstance(value, Tensor) and value.requires_grad else found


def _set(law: Any, /, **values: Any) -> None:
    for name, value in values.items():
        object.__setattr__(law, name, value)


def _ordered(law: Any, low: str, high: str) -> None:
    kind = type(law).__name__
    _set(law, **{name: _value(f"{kind}'s {name}", getattr(law, name)) for name in (low, high)})
    if not getattr(law, low) < getattr(law, high):
        raise ValueError(f"{kind} from {getattr(law, low):g} to {getattr(law, high):g} was given; {low} below {high} is wanted")


def _positive(law: Any, *any_: str, **positive: bool) -> None:
    kind = type(law).__name__
    _set(law, **{name: _value(f"{kind}'s {name}", getattr(law, name)) for name in (*any_, *positive)})
    for name in positive:
        if not getattr(law, name) > 0:
            raise ValueError(f"{kind}'s {name} = {getattr(law, name):g} was given; a positive number is wanted")
