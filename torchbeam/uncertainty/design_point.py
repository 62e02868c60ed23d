"""Design points: the likeliest places of a rare event, by the first-order reliability method; and
importance sampling around them.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..math.distributions import log_normal_probability, normal_score
from .designs import Sobol
from .estimate import student_half
from .limit_state import LimitState

SAME = 0.1  # distance, in normal scores, at which two are one
AGAIN = 4  # times that as many starts are added, as long as a point is told by one alone
SHORTENED = 6  # halvings of a step that are tried at once
# largest distance, in normal scores, of a point from the ray along its gradient, and of its step
FIXED = 1e-4
# largest distance, in normal scores, that is looked at: a law's numbers overflow far out
FARTHEST = 45.0
FAR = 5.0  # distance, in normal scores, of random starts that are far out


@dataclass(frozen=True)
class DesignPoints:
    """Local minima of |z| on y(z) = threshold, the nearest first: z (k, d) normal scores, beta (k,)
    their distances (negative where the medians lie within the event), led (k,) how many starts led
    to each.
    """

    z: Tensor
    beta: Tensor
    led: Tensor

    @property
    def usual(self) -> bool:
        """Whether the medians lie within the event: it is more likely than not."""
        return self.beta[0].item() < 0


def all_design_points(limit: LimitState, starts: int, seed: int) -> DesignPoints:
    """Design points from random starts, and as many again as long as there is one that a single
    start led to: about as large a share of them leads to points that none has found (Good 1953).
    """
    d = limit.work.joint.dimension
    points = design_points(limit, random_starts(starts, d, seed))
    for again in range(1, AGAIN + 1):
        if (points.led > 1).all():
            break
        more = random_starts(starts, d, seed + again)[1:]
        points = design_points(limit, torch.cat((points.z.repeat_interleave(points.led, 0), more)))
    return points


def random_starts(starts: int, dimension: int, seed: int) -> Tensor:
    """Normal scores (starts, d): the medians, and random ones in pairs z, -z, of which one is where
    the other of two opposite branches is. Every other pair is far out, where a branch that is flat
    among usual values rises above the others.
    """
    draw = torch.Generator().manual_seed(seed)
    z = torch.randn(starts // 2, dimension, generator=draw, dtype=torch.float64)
    z[1::2] *= FAR / z[1::2].norm(dim=-1, keepdim=True)
    return torch.cat((z.new_zeros(1, dimension), torch.stack((z, -z), 1).flatten(0, 1)))[:starts]


def design_points(limit: LimitState, z: Tensor, steps: int = 60) -> DesignPoints:
    """Design points from several starts z (starts, d) at once, in normal scores.

    With g = threshold - y: z -> (grad g . z - g) grad g/|grad g|^2 (Hasofer and Lind 1974; Rackwitz
    and Fiessler 1978), of which so much is taken that |z|^2/2 + c |g| falls, c = (2 |z| + 10)/|grad
    g| (Zhang and Der Kiureghian 1995). Raises ValueError where no start ends at a point: y that
    does not depend on the parameters, never comes to the threshold, or is not smooth.
    """
    starts = len(z)
    leader = torch.arange(starts)  # the first start that is where a start is, whose way it goes
    y, slope = limit.gradient(z)
    ends = torch.zeros(starts, dtype=torch.bool)
    fractions = 0.5 ** torch.arange(SHORTENED, dtype=torch.float64)
    size = None
    for _ in range(steps):
        alone = leader == torch.arange(starts)
        together = (torch.cdist(z, z) <= SAME).tril(-1) & alone & alone[:, None]
        leader = torch.where(together.any(-1), together.double().argmax(-1), leader)
        g, steep = limit.threshold - y, slope.norm(dim=-1)
        usable = torch.isfinite(g) & (steep > 0) & torch.isfinite(steep)
        size = g.abs().nan_to_num(0, 0, 0).amax() if size is None else size
        target = (
            -((-slope * z).sum(-1) - g)[:, None] * slope / steep.clamp_min(1e-300).square()[:, None]
        )
        # the target of a flat y is beyond all numbers
        target = target * (FARTHEST / target.norm(dim=-1, keepdim=True)).clamp_max(1.0)
        towards = target - z
        near = towards.norm(dim=-1) <= FIXED
        ends = usable & near & (g.abs() <= FIXED * torch.maximum(steep, size * 1e-6))
        going = usable & ~ends & (leader == torch.arange(starts))
        if not going.any():
            break
        weight = (2 * z.norm(dim=-1) + 10) / steep.clamp_min(1e-300)
        trial = z[going, None] + fractions[:, None] * towards[going, None]
        value = limit(trial.flatten(0, 1)).reshape(trial.shape[:2])
        merit = trial.square().sum(-1) / 2 + weight[going, None] * (limit.threshold - value).abs()
        now = (z.square().sum(-1) / 2 + weight * g.abs())[going, None]
        better = torch.isfinite(value) & (merit < now)
        # none: the shortest
        first = torch.where(better.any(-1), better.double().argmax(-1), SHORTENED - 1)
        z = z.index_put((going,), trial[torch.arange(len(trial)), first])
        new = limit.gradient(z[going])
        y, slope = y.index_put((going,), new[0]), slope.index_put((going,), new[1])
    if not ends.any():
        blunt = "".join(
            f" (the law of {name!r} does not tell values more than 7 deviations up apart)"
            for name in limit.work.joint.without_tails[:1]
        )
        raise ValueError(
            f"no design point was found from {starts} starts in {steps} steps; a y that is smooth "
            f'and comes to the threshold is wanted{blunt}, or method="subset"'
        )
    beta = (z * slope / slope.norm(dim=-1, keepdim=True)).sum(-1)
    point = torch.full((starts,), -1)  # that a start led to
    distinct: list[int] = []
    for k in beta.abs().argsort().tolist():
        if ends[k] and leader[k] == k:
            same = [i for i, j in enumerate(distinct) if (z[k] - z[j]).norm() <= SAME]
            point[k] = same[0] if same else len(distinct)
            distinct += [] if same else [k]
    for _ in range(starts.bit_length()):
        leader = leader[leader]
    led = torch.bincount(point[leader] + 1, minlength=len(distinct) + 1)[1:]
    return DesignPoints(z[distinct], beta[distinct], led)


@dataclass(frozen=True)
class ImportanceRuns:
    """Probability (2, replicates) of y > threshold by each of several Sobol sequences: with failed
    samples as no event, and as the event.

    beyond     (k, d) normal scores, the heaviest first, of what counts although it is likelier by
               the laws than around any of the points, which do not lead to it
    from_these share of the probability (of the rest, where the medians lie within the event) that
               such samples have, the larger of both
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
    y = limit(z)
    above = torch.stack((y > limit.threshold, (y > limit.threshold) | torch.isneginf(y)))
    weight = torch.where(above != points.usual, ratio, 0.0)
    mean = weight.reshape(2, replicates, each).mean(-1)
    heavy = torch.where((exponent < 0).all(-1), weight, 0.0)
    heaviest = heavy[0].argsort(descending=True)[: int((heavy[0] > 0).sum())]
    return ImportanceRuns(
        1 - mean if points.usual else mean,
        z[heaviest],
        (heavy.sum(-1) / weight.sum(-1)).nan_to_num().amax().item(),
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
