"""Importance sampling around design points."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..math.distributions import log_normal_probability, normal_score
from .design_point import DesignPoints
from .designs import Sobol
from .estimate import student_half
from .limit_state import LimitState


@dataclass(frozen=True)
class ImportanceRuns:
    """Probability (replicates,) of y > threshold by each of several Sobol sequences.

    beyond     (k, d) normal scores, the heaviest first, of what counts although it is likelier by
               the laws than around any of the points, which do not lead to it
    from_these share of the probability (of the rest, where the medians lie within the event)
    """

    probability: Tensor
    beyond: Tensor
    from_these: float


def importance_sampling(
    limit: LimitState, points: DesignPoints, n: int, replicates: int, seed: int
) -> ImportanceRuns:
    """Probability of y > threshold, by samples around the points.

    Samples follow the mixture of normal laws around the points, h(z) = sum_i w_i phi(z - z_i), w_i
    as Phi(-beta_i) (Melchers 1989): p = mean([y > threshold] phi(z)/h(z)), and
    phi(z)/h(z) = 1/sum_i w_i exp(z . z_i - |z_i|^2/2). Where the medians lie within the event, it
    is the rest that the points are next to, and p = 1 - mean([y <= threshold] phi(z)/h(z)).
    """
    d, each = limit.work.joint.dimension, n // replicates
    share = log_normal_probability(-points.beta.abs()).softmax(-1)
    u = Sobol(d + 1, seed, each).uniform(0, each * replicates)
    which = torch.searchsorted(share.cumsum(0), u[:, 0].contiguous()).clamp_max(len(share) - 1)
    z = points.z[which] + normal_score(u[:, 1:])
    exponent = z @ points.z.mT - points.z.square().sum(-1) / 2
    ratio = (-torch.logsumexp(share.log() + exponent, -1)).exp()
    counted = (limit(z) > limit.threshold) != points.usual
    weight = torch.where(counted, ratio, 0.0)
    mean = weight.reshape(replicates, each).mean(-1)
    heavy = counted & (exponent < 0).all(-1)
    heaviest = weight[heavy].argsort(descending=True)
    return ImportanceRuns(
        1 - mean if points.usual else mean,
        z[heavy][heaviest],
        (weight[heavy].sum() / weight.sum()).nan_to_num().item(),
    )


def interval(each: Tensor, level: float) -> tuple[float, float, float]:
    """Mean of replicates and Student's interval of it; from 0 to 1 where no sample was within the
    event, or none outside.
    """
    mean = each.mean().item()
    if mean in (0.0, 1.0):
        return mean, 0.0, 1.0
    half = mean * student_half(each / mean, level).item()  # squares of 1e-170 would be 0
    return mean, max(mean - half, 0.0), min(mean + half, 1.0)
