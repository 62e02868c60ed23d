"""Importance sampling of a rare event around its design points."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ..math.distributions import binomial_interval, log_normal_probability, normal_score
from .design_point import DesignPoints
from .designs import Sobol
from .estimate import Ends, student_half
from .limit_state import LimitState


@dataclass(frozen=True)
class ImportanceRuns:
    """Probability of the rare side of the threshold, by each of several Sobol sequences.

    probability (2, replicates) without failed samples, and with those of them that are likelier
                around the points than by the laws
    beyond      (k, d) normal scores, the heaviest first, of good samples that count although they
                are likelier by the laws than around any of the points, which do not lead to them
    share       of the probability that these samples have
    failed      number of failed samples that are likelier around the points than by the laws
    counting    of these and of those on the rare side
    """

    probability: Tensor
    beyond: Tensor
    share: float
    failed: int
    counting: int


def importance_sampling(
    limit: LimitState, points: DesignPoints, n: int, replicates: int, seed: int
) -> ImportanceRuns:
    """Probability of y > threshold, by samples around the points; where the medians lie within this
    event, of the rest, y <= threshold, which the points are next to.

    Samples follow the mixture of normal laws around the points, h(z) = sum_i w_i phi(z - z_i), w_i
    as Phi(-beta_i) (Melchers 1989): p = mean([y > threshold] phi(z)/h(z)).
    """
    d, each = limit.work.joint.dimension, n // replicates
    shares = _log_shares(points)
    u = Sobol(d + 1, seed, each).uniform(0, each * replicates)
    which = torch.searchsorted(shares.exp().cumsum(0), u[:, 0].contiguous())
    z = points.z[which.clamp_max(len(shares) - 1)] + normal_score(u[:, 1:])
    exponent, ratio = _ratio(points, z)
    y = limit(z)
    failed = torch.isneginf(y)
    weight = torch.where(~failed & ((y > limit.threshold) != points.usual), ratio, 0.0)
    failures = torch.where(failed & (ratio < 1), ratio, 0.0)
    heavy = torch.where((exponent < 0).all(-1), weight, 0.0)
    heaviest = heavy.argsort(descending=True)[: int((heavy > 0).sum())]
    return ImportanceRuns(
        torch.stack((weight, weight + failures)).reshape(2, replicates, each).mean(-1),
        z[heaviest],
        (heavy.sum() / weight.sum()).nan_to_num().item(),
        int((failures > 0).sum()),
        int((weight + failures > 0).sum()),
    )


def by_sides(
    limit: LimitState,
    runs: ImportanceRuns,
    points: DesignPoints,
    n: int,
    seed: int,
    level: float,
    failed_exceed: bool,
) -> Ends:
    """Probability of y > threshold, and its interval.

    Where failed samples lie on the rare side, those of n plain samples are added that fail where
    the laws are no less likely than the mixture: `importance_sampling` left these out. Where they
    do not, few of them take from the probability what the scatter of runs does not tell.
    """
    counts = failed_exceed != points.usual
    rare = _interval(runs.probability[int(counts)], level)
    if counts:
        draw = torch.Generator().manual_seed(seed)
        z = torch.randn(n, limit.work.joint.dimension, generator=draw, dtype=torch.float64)
        missed = int((torch.isneginf(limit(z)) & (_ratio(points, z)[1] >= 1)).sum())
        more = missed / n, *binomial_interval(missed, n, level)
    else:
        lost = runs.failed / max(runs.counting, 1)
        least, most = binomial_interval(runs.failed, runs.counting, level)
        more = 0.0, rare[0] * (lost - most), rare[0] * (lost - least)
    if limit.failures:
        rare = _sum(rare, more)
    return (1 - rare[0], 1 - rare[2], 1 - rare[1]) if points.usual else rare


def _interval(each: Tensor, level: float) -> Ends:
    """Mean of replicates and Student's interval of it; from 0 to 1 where no sample was within the
    event.
    """
    mean = each.mean().item()
    if mean == 0:
        return 0.0, 0.0, 1.0
    half = mean * student_half(each / mean, level).item()  # squares of 1e-170 would be 0
    return mean, max(mean - half, 0.0), min(mean + half, 1.0)


def _sum(*parts: Ends) -> Ends:
    """Of independent estimates: distances of bounds from estimates add as squares (Zou and Donner
    2008).
    """
    estimate = sum(middle for middle, _, _ in parts)
    down = math.hypot(*(middle - low for middle, low, _ in parts))
    up = math.hypot(*(high - middle for middle, _, high in parts))
    return min(estimate, 1.0), max(estimate - down, 0.0), min(estimate + up, 1.0)


def _log_shares(points: DesignPoints) -> Tensor:
    """Logarithms (k,) of the mixture's w."""
    return log_normal_probability(-points.beta.abs()).log_softmax(-1)


def _ratio(points: DesignPoints, z: Tensor) -> tuple[Tensor, Tensor]:
    """Logarithm (N, k) of phi(z - z_i)/phi(z) = exp(z . z_i - |z_i|^2/2), and phi(z)/h(z) (N,)."""
    exponent = z @ points.z.mT - points.z.square().sum(-1) / 2
    return exponent, (-torch.logsumexp(_log_shares(points) + exponent, -1)).exp()
