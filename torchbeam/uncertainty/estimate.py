"""Estimates with intervals: from independent samples, or independent replicates of a design."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import torch
from torch import Tensor

from ..core.validation import converted, refusal, shown
from ..math.distributions import (
    binomial_interval,
    binomial_ranks,
    normal_probability,
    student_quantile,
)

# samples of a replicate beyond a quantile or threshold, below which replicates do not tell the
# error
FEW = 5
RESAMPLES = 1000  # of a bootstrap
SHOWN = 6  # numbers in an estimate's text
Ends = tuple[float, float, float]  # estimate, low, high
Statistic = Callable[[Tensor], Tensor]  # samples (n, ...) -> (...)


@dataclass(frozen=True)
class Estimate:
    """Estimate with an interval that covers the true value in `level` of all runs: `estimate, low,
    high = ...`. An index selects numbers: `e[0]`, `e[..., 2]`.

    Args:
        estimate, low, high: tensors of one shape
        level: share of all runs in which the interval covers the true value
        samples: number of good samples
        method: method of the interval
        reasons: number of samples left out, by reason

    Examples:
        >>> samples = tb.monte_carlo(deflection, laws, 256, replicates=16, by_name=True)
        >>> mean = samples.mean_interval()
        >>> mean.low < mean.estimate < mean.high  # of 95 %, see `level`
        tensor(True)
    """

    estimate: Tensor
    low: Tensor
    high: Tensor
    level: float
    samples: int
    method: str
    reasons: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def about(cls, centre: Tensor, half: Tensor, *rest: Any) -> Estimate:
        """Estimate with an interval of that half width."""
        return cls(centre, centre - half, centre + half, *rest)

    @property
    def failed(self) -> int:
        return sum(self.reasons.values())

    @property
    def relative_error(self) -> Tensor:
        """Half the interval's width over the estimate's size; 0 of no width, as of a y at rest."""
        width = self.high - self.low
        return torch.where(width == 0, 0.0, width / (2 * self.estimate.abs()))

    def __iter__(self) -> Iterator[Tensor]:
        return iter((self.estimate, self.low, self.high))

    def __getitem__(self, index: Any) -> Estimate:
        """Of some of the numbers, by an index of a tensor. Raises IndexError where there are none
        such.
        """
        try:
            estimate, low, high = (x[index] for x in self)
        except (IndexError, TypeError, RuntimeError, ValueError):
            shape = tuple(self.estimate.shape)
            raise IndexError(
                f"Estimate[{shown(index)}] was asked for; "
                + (f"its numbers are of shape {shape}" if shape else "it is a single number")
            ) from None
        return replace(self, estimate=estimate, low=low, high=high)

    def __repr__(self) -> str:
        lost = f"; {failures(self.reasons)}" if self.failed else ""
        rows = [*zip(*(x.flatten()[:SHOWN].tolist() for x in self), strict=True)]
        text = "; ".join(f"{e:.5g}, {a:.5g} to {b:.5g}" for e, a, b in rows)
        if self.estimate.numel() > 1:
            text = (
                f"{tuple(self.estimate.shape)}: {text}{'; ...' * (self.estimate.numel() > SHOWN)}"
            )
        return (
            f"Estimate({text} at {100 * self.level:g} % by {self.method}; {self.samples} "
            f"samples{lost})"
        )


def failures(reasons: Mapping[str, int]) -> str:
    """Failed samples in words, with their reasons: "3 failed, 2: buckled, 1: y is not finite"."""
    return f"{sum(reasons.values())} failed" + "".join(
        f", {n}: {why}" for why, n in reasons.items()
    )


def replicated_well(groups: int, samples: int) -> bool:
    """Whether the scatter of so many replicates with good samples tells the error: of one it does
    not, and of one sample in each the samples themselves do, which are independent.
    """
    return groups > 1 and samples >= 2 * groups


def about_their_mean(independent: bool, replicates: int, groups: int, n: int) -> int:
    """By how much n falls short where squares of n samples are taken about their own mean: by 1 if
    they are independent, as those of replicates that give one `group` are, and not by any of Sobol
    sequences, whose mean is nearer to that of the law than of n independent samples by far.
    """
    return int(independent or n == 1 or (replicates > 1 and groups == 1))


def probabilities(levels: Any) -> Tensor:
    """Levels of quantiles, () or (K,), float64; ValueError for what are no probabilities."""
    values = converted(levels, torch.float64)
    if values.ndim > 1 or not ((values >= 0) & (values <= 1)).all():
        raise refusal(
            f"levels = {shown(levels)}", "probabilities, one or a sequence,", were=True, are=True
        )
    return values


def mean(groups: Sequence[Tensor], level: float, reasons: Mapping[str, int]) -> Estimate:
    """Mean of groups of samples (m, ...): each group is a replicate; of one group the samples are
    independent. Student's interval, infinite of one sample.
    """
    if len(groups) > 1:
        return replicated(groups, lambda y: y.mean(0), level, reasons)
    y = groups[0]
    centre = y.mean(0)
    half = student_half(y, level) if len(y) > 1 else centre + math.inf
    return Estimate.about(centre, half, level, len(y), "Student's t", reasons)


def quantile(
    groups: Sequence[Tensor], levels: Tensor, level: float, reasons: Mapping[str, int]
) -> Estimate:
    """Quantiles (K, ...) at `levels` (K,). By replicates where each has at least FEW samples beyond
    the quantile: the interval of the probability at the quantile, from the replicates' shares, is
    that of the level (Woodruff 1952). Otherwise between order statistics (binomial), which holds
    for any law.
    """
    pooled = torch.cat(list(groups)).sort(0).values
    centre = quantile_of_sorted(pooled, levels)
    few = len(pooled) / len(groups) * torch.minimum(levels, 1 - levels) < FEW
    low, high, methods = centre.clone(), centre.clone(), set()
    for k, q in enumerate(levels.tolist()):
        if len(groups) > 1 and not few[k]:
            half = share_half(
                torch.stack([(y <= centre[k]).double().mean(0) for y in groups]), level, len(pooled)
            )
            for bound, place, side in ((low, q - half, -math.inf), (high, q + half, math.inf)):
                within = (place >= 0) & (place <= 1)
                level_rank = place.clamp(0, 1) * (len(pooled) - 1)
                bound[k] = torch.where(within, between(pooled, level_rank), side)
            methods.add(f"{len(groups)} replicates")
            continue
        ranks = binomial_ranks(q, len(pooled), level)
        low[k] = pooled[ranks[0] - 1] if ranks[0] else -math.inf
        high[k] = pooled[ranks[1] - 1] if ranks[1] <= len(pooled) else math.inf
        methods.add("order statistics")
    # which is between order statistics, and may be below the one that is a bound
    low, high = torch.minimum(low, centre), torch.maximum(high, centre)
    return Estimate(centre, low, high, level, len(pooled), " and ".join(sorted(methods)), reasons)


def probability(groups: Sequence[Tensor], level: float, reasons: Mapping[str, int]) -> Estimate:
    """Probability (...) of what is True in groups of samples (m, ...). By replicates where each has
    FEW or more of either kind, otherwise by Clopper and Pearson's interval, which is never too
    short for independent samples.
    """
    hits = torch.stack([y.sum(0, dtype=torch.float64) for y in groups])  # (groups, ...)
    sizes = hits.new_tensor([len(y) for y in groups])
    n = int(sizes.sum())
    total = hits.sum(0)
    centre = total / n
    flat = total.flatten().tolist()
    known = {count: binomial_interval(count, n, level) for count in set(flat)}
    low, high = (
        hits.new_tensor([known[count][side] for count in flat]).reshape(total.shape)
        for side in (0, 1)
    )
    if len(groups) == 1:
        return Estimate(centre, low, high, level, n, "Clopper and Pearson", reasons)
    half = share_half(hits / sizes.reshape(-1, *[1] * total.ndim), level, n)
    many = torch.minimum(total, n - total) >= FEW * len(groups)
    low = torch.where(many, centre - half, low).clamp_min(0)
    high = torch.where(many, centre + half, high).clamp_max(1)
    method = "Clopper and Pearson"
    if many.any():
        fallback = "" if many.all() else f", or {method} where they are few"
        method = f"{len(groups)} replicates{fallback}"
    return Estimate(centre, low, high, level, n, method, reasons)


def replicated(
    groups: Sequence[Tensor],
    statistic: Statistic,
    level: float,
    reasons: Mapping[str, int],
    fewest: int = 1,
) -> Estimate:
    """Any statistic of all samples, with Student's interval from its scatter among replicates of
    `fewest` samples or more.
    """
    pooled = torch.cat(list(groups))
    centre, each = _values(
        statistic, [pooled, *(y for y in groups if len(y) >= fewest)]
    ).tensor_split([1])
    method = f"{len(each)} replicates"
    half = student_half(each, level)
    return Estimate.about(centre[0], half, level, len(pooled), method, reasons)


def bootstrap(
    y: Tensor, statistic: Statistic, level: float, reasons: Mapping[str, int]
) -> Estimate:
    """Any statistic of independent samples y (n, ...), with the interval between percentiles of
    that of samples drawn from them (Efron 1979), further out by sqrt(n/(n - 1)) and by Student's
    law, without which few samples make it too short (Hesterberg 2015, section 5.3); infinite of one
    sample.
    """
    draw = torch.Generator().manual_seed(0)
    drawn = (y[torch.randint(len(y), (len(y),), generator=draw)] for _ in range(RESAMPLES))
    centre, each = _values(statistic, chain((y,), drawn)).tensor_split([1])
    if len(y) == 1:
        half = torch.full_like(centre[0], math.inf)
        return Estimate(centre[0], -half, half, level, 1, "bootstrap", reasons)
    far = each.new_tensor(
        math.sqrt(len(y) / (len(y) - 1)) * student_quantile((1 + level) / 2, len(y) - 1)
    )
    ranks = normal_probability(torch.stack((-far, far)))
    low, high = quantile_of_sorted(each.sort(0).values, ranks)
    return Estimate(centre[0], low, high, level, len(y), "bootstrap", reasons)


def _values(statistic: Statistic, samples: Iterable[Tensor]) -> Tensor:
    """Values (K, ...) of a statistic of K sets of samples; ValueError where shapes differ."""
    values: list[Tensor] = []
    for y in samples:
        value = statistic(y)
        if not isinstance(value, Tensor) or value.is_complex():
            raise refusal(
                f"a statistic that gave a {type(value).__name__}", "a tensor of real numbers"
            )
        if values and value.shape != values[0].shape:
            raise ValueError(
                f"a statistic that gave {tuple(values[0].shape)} of all samples and "
                f"{tuple(value.shape)} of some was given; one shape is wanted"
            )
        values.append(value.detach().double())
    return torch.stack(values)


def student_half(each: Tensor, level: float) -> Tensor:
    """Half of Student's interval (...) of the mean of independent values (R, ...), at least two."""
    return each.std(0) / math.sqrt(len(each)) * student_quantile((1 + level) / 2, len(each) - 1)


def share_half(shares: Tensor, level: float, n: int) -> Tensor:
    """Half the interval of a probability (...) from its shares (R, ...) in replicates of n samples
    together; where these agree to the last sample, the rule of three.
    """
    return student_half(shares, level).clamp_min(-math.log((1 - level) / 2) / n)


def between(y: Tensor, place: Tensor) -> Tensor:
    """Values (...) of rows y (n, ...) at places (...) from 0 to n - 1, linear between rows."""
    below = place.floor().long()
    a, b = (y.gather(0, k[None])[0] for k in (below, (below + 1).clamp_max(len(y) - 1)))
    return torch.lerp(a, b, place - below)


def quantile_of_sorted(y: Tensor, levels: Tensor) -> Tensor:
    """Quantiles (K, ...) at `levels` (K,) of sorted samples (n, ...), linear between order
    statistics (of any number: torch.quantile takes 16 million).
    """
    place = levels.double() * (len(y) - 1)
    below = place.floor().long()
    part = (place - below).to(y.dtype).reshape(-1, *[1] * (y.ndim - 1))
    return torch.lerp(y[below], y[(below + 1).clamp_max(len(y) - 1)], part)
