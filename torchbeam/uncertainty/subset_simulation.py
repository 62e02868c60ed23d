"""Subset simulation: a rare event as the last of several, each ten times less likely."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ..math.distributions import binomial_interval
from .estimate import student_half
from .limit_state import LimitState

SHARE = 0.1  # of the samples of a level that go on
ACCEPTED = 0.44  # share of moves that the step is adapted to
LEVELS = 30
# of those that go on: samples at the bound itself, for which a level's probability would be wrong
EQUAL = 0.1


@dataclass(frozen=True)
class SubsetRuns:
    """Independent runs: probability (runs,) by each; thresholds (levels, runs) on the way, NaN
    after the last of a run; samples of a level of each.
    """

    probability: Tensor
    thresholds: Tensor
    samples: int

    def interval(self, level: float) -> tuple[float, float, float]:
        """Mean of the runs and its interval: Student's of the logarithm, to first order, since runs
        differ by factors. Where all ended with the first level, whose samples are independent,
        Clopper and Pearson's; where none came to the threshold, up to ten times the probability of
        the last level, which itself is known to a factor.
        """
        p = self.probability
        mean = p.mean().item()
        if mean == 0:
            return 0.0, 0.0, SHARE ** (LEVELS - 1)
        if self.thresholds.isnan().all():
            trials = len(p) * self.samples
            return mean, *binomial_interval(round(mean * trials), trials, level)
        factor = math.exp(student_half(p, level).item() / mean)
        return mean, mean / factor, min(mean * factor, 1.0)


def subset_simulation(
    limit: LimitState, samples: int, runs: int, seed: int, failed: float = -math.inf
) -> SubsetRuns:
    """Probability of y > threshold by `runs` independent runs of `samples` a level each, all as one
    batch. (Au and Beck 2001.)

    From a level's samples the tenth with the largest y begin Markov chains, of ten states each,
    that stay above the least of them. A move is z' = sqrt(1 - s^2) z + s w, w normal, taken if
    y(z') stays above: it keeps the normal law, in any number of dimensions; s is adapted, run by
    run, so that 44 % of the moves are taken. (Papaioannou et al. 2015.) failed: y of samples that
    failed, -inf or inf.

    Raises ValueError where most samples of a level failed, and where many have the same y: no bound
    parts a tenth of those.
    """
    draw = torch.Generator().manual_seed(seed)
    d = limit.work.joint.dimension
    seeds = round(SHARE * samples)
    z = torch.randn(runs, samples, d, generator=draw, dtype=torch.float64)
    y = limit(z.flatten(0, 1), failed).reshape(runs, samples)
    probability = torch.zeros(runs, dtype=torch.float64)
    scale = torch.full((runs, 1, 1), 0.6, dtype=torch.float64)
    active, thresholds = torch.arange(runs), []
    for level in range(LEVELS):
        y, order = y.sort(-1, descending=True)
        z = z.gather(1, order[..., None].expand_as(z))
        bound = (y[:, seeds - 1] + y[:, seeds]) / 2
        if torch.isneginf(bound).any():
            raise ValueError(
                "more than nine tenths of the samples of a level failed "
                f"({', '.join(limit.failures)}); no rare event can be found among so few"
            )
        last = bound >= limit.threshold
        for run in (~last & (y[:, seeds - 1] == y[:, seeds])).nonzero()[:, 0].tolist():
            # a state that a chain stays in counts once
            equal = len(z[run, y[run] == bound[run]].unique(dim=0))
            if equal > 1 + seeds * EQUAL:
                raise ValueError(
                    f"a y that is {bound[run]:.6g} at {equal} of {samples} samples of a level was "
                    "given; one that varies all the way to the threshold is wanted, or plain "
                    "samples"
                )
        hits = (y > limit.threshold).double().mean(-1)
        probability[active] = torch.where(last, SHARE**level * hits, 0.0)
        thresholds.append(
            torch.full((runs,), torch.nan, dtype=torch.float64).index_put(
                (active[~last],), bound[~last]
            )
        )
        z, y, bound, active = z[~last, :seeds], y[~last, :seeds], bound[~last], active[~last]
        scale = scale[~last]
        if not len(active):
            break
        states, values = [z], [y]
        for step in range(round(1 / SHARE) - 1):
            move = torch.randn(z.shape, generator=draw, dtype=z.dtype)
            trial = (1 - scale.square()).sqrt() * z + scale * move
            trial_y = limit(trial.flatten(0, 1), failed).reshape(y.shape)
            taken = trial_y >= bound[:, None]
            z, y = torch.where(taken[..., None], trial, z), torch.where(taken, trial_y, y)
            states.append(z)
            values.append(y)
            rate = taken.double().mean(-1)[:, None, None]
            scale = (scale * ((rate - ACCEPTED) / math.sqrt(step + 1)).exp()).clamp(0.01, 1.0)
        z, y = torch.cat(states, 1), torch.cat(values, 1)
    return SubsetRuns(probability, torch.stack(thresholds), samples)
