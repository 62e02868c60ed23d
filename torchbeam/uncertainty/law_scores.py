"""Normal scores of any law: of the laws here exact in both tails, of others by probabilities."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, distributions

from ..math.distributions import normal_probability, score_of_tails
from .parametric_laws import Gumbel, Normal, Uniform, Weibull


@dataclass(frozen=True)
class ExpTransformed:
    """exp of a variable with a law here."""

    law: Any

    def of_score(self, z: Tensor) -> Tensor:
        return self.law.of_score(z).exp()

    def score(self, x: Tensor) -> Tensor:
        return self.law.score(x.clamp_min(0).log())


# what SciPy's newer classes call quantiles and probabilities, from below and from above
NEWER = {"ppf": "icdf", "isf": "iccdf", "cdf": "cdf", "sf": "ccdf"}


@dataclass(frozen=True)
class OfScipy:
    """A distribution of SciPy, frozen or of its newer classes, which has both tails of its own."""

    frozen: Any

    def icdf(self, u: Tensor) -> Tensor:
        return self._of("ppf", u)

    def of_score(self, z: Tensor) -> Tensor:
        low = self._of("ppf", normal_probability(z))
        return torch.where(z < 0, low, self._of("isf", normal_probability(-z)))

    def cdf(self, x: Tensor) -> Tensor:
        return self._of("cdf", x)

    def score(self, x: Tensor) -> Tensor:
        return score_of_tails(self._of("cdf", x), self._of("sf", x))

    def _of(self, name: str, x: Tensor) -> Tensor:
        name = name if hasattr(self.frozen, "ppf") else NEWER[name]
        value = getattr(self.frozen, name)(x.detach().cpu().numpy())
        return torch.as_tensor(value, dtype=x.dtype, device=x.device)


TORCHS = {
    distributions.Uniform: lambda law: Uniform(law.low, law.high),
    distributions.Normal: lambda law: Normal(law.loc, law.scale),
    distributions.LogNormal: lambda law: ExpTransformed(Normal(law.loc, law.scale)),
    distributions.Exponential: lambda law: Weibull(1 / law.rate),
    distributions.Weibull: lambda law: Weibull(law.scale, law.concentration),
    distributions.Gumbel: lambda law: Gumbel(law.loc, law.scale),
}


def as_own(law: Any) -> Any:
    """A law that tells scores in place of a pair, or of one of torch's or SciPy's; others as they
    are.
    """
    if isinstance(law, (tuple, list)):
        return Uniform(*law)
    if is_of_scipy(law):
        return OfScipy(law)
    make = TORCHS.get(type(law))
    return law if make is None or law.batch_shape else make(law)


def is_of_scipy(law: Any) -> bool:
    return hasattr(law, "ppf") or hasattr(law, NEWER["isf"])


def why_none(law: Any) -> str | None:
    """Why a law with quantiles is not of one number, as one of torch or SciPy may be; or None."""
    if is_of_scipy(law):
        try:
            middle = OfScipy(law).icdf(torch.full((1,), 0.5))
        except TypeError:
            return "has parameters that are not given"
        return None if middle.numel() == 1 else f"has {tuple(middle.shape)} numbers, not one"
    if not isinstance(law, distributions.Distribution):
        return None
    if law.event_shape or law.batch_shape.numel() != 1:
        return f"has {tuple(law.batch_shape + law.event_shape)} numbers, not one"
    try:
        law.icdf(torch.full((1,), 0.5, dtype=torch.float64))
    except NotImplementedError:
        return "has no quantiles (icdf)"
    return None


def has_tails(law: Any) -> bool:
    """Whether a law tells values of scores, and so both tails; a `Truncated` or `ExpTransformed`
    one does as its own law does.
    """
    known = as_own(law)
    return hasattr(known, "of_score") and (not hasattr(known, "law") or has_tails(known.law))


def of_score(law: Any, z: Tensor) -> Tensor:
    """Values (N,) of normal scores z (N,). A law that does not tell scores is asked for the value
    of a probability, which is 1 but for rounding from z = 8 on; where it has none of a small one,
    it is that of rounding, at z = -8.
    """
    law = as_own(law)
    if hasattr(law, "of_score"):
        return law.of_score(z)
    value = law.icdf if hasattr(law, "icdf") else law
    rounding = torch.finfo(z.dtype).eps / 2
    u = normal_probability(z).clamp(torch.finfo(z.dtype).tiny, 1 - rounding)
    x = value(u)
    shaped = isinstance(x, Tensor) and x.shape == u.shape
    lost = ~torch.isfinite(x) if shaped else torch.zeros_like(u, dtype=torch.bool)
    return value(torch.where(lost, u.clamp_min(rounding), u)) if lost.any() else x


def score(law: Any, x: Tensor) -> Tensor:
    """Normal scores (N,) of values x (N,) of a law with `score` or `cdf`."""
    law = as_own(law)
    if hasattr(law, "score"):
        return law.score(x)
    below = law.cdf(_inside(law, x)).clamp(0, 1).to(x.dtype)
    return score_of_tails(below, 1 - below)


def _inside(law: Any, x: Tensor) -> Tensor:
    """x, moved into the support of a distribution of torch, which refuses others."""
    support = getattr(law, "support", None)
    low, high = (
        float(getattr(support, name, at))
        for name, at in (("lower_bound", -math.inf), ("upper_bound", math.inf))
    )
    # a bound may be outside of the support
    eps, tiny = torch.finfo(x.dtype).eps, torch.finfo(x.dtype).tiny
    inside = (
        at if math.isinf(at) else at + side * max(abs(at) * eps, tiny)
        for at, side in ((low, 1), (high, -1))
    )
    return x.clamp(*inside)
