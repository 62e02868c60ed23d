"""Statistics of few runs: interquartile means and probabilities of improvement, with stratified
bootstrap intervals (Agarwal et al. 2021, "Deep reinforcement learning at the edge of the
statistical precipice").
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

RESAMPLES = 10_000
LEVEL = 0.95


class Estimate(NamedTuple):
    """A statistic (...) and its confidence interval."""

    value: np.ndarray
    low: np.ndarray
    high: np.ndarray


def interquartile_mean(runs: np.ndarray) -> np.ndarray:
    """(...) of runs (..., n): the mean of the middle half; a run on its edge counts by its part."""
    n = runs.shape[-1]
    edges = np.clip(np.arange(n + 1), n / 4, 3 * n / 4)
    return np.sort(runs, -1) @ np.diff(edges) / (n / 2)


def improvement(runs: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(...) probability that a run (..., n) is better than another (..., m), by all pairs; equal
    ones count by half.
    """
    apart = runs[..., :, None] - others[..., None, :]
    return ((apart > 0) + 0.5 * (apart == 0)).mean((-1, -2))


def estimate(
    statistic: Callable[..., np.ndarray],
    *strata: ArrayLike,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Estimate:
    """statistic(*strata), of runs (..., n) each, and its interval by percentiles: runs are drawn
    anew within each stratum, (..., resamples, n). Of one run a stratum the interval is its value.
    """
    random, runs = np.random.default_rng(seed), [np.asarray(one, float) for one in strata]
    sizes = [one.shape[-1] for one in runs]
    drawn = [
        one[..., random.integers(0, n, (resamples, n))] for one, n in zip(runs, sizes, strict=True)
    ]
    ends = [(1 - LEVEL) / 2, (1 + LEVEL) / 2]
    return Estimate(statistic(*runs), *np.quantile(statistic(*drawn), ends, axis=-1))
