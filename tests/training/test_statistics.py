"""training/statistics.py beside numbers by hand, and intervals beside how often they hold."""

import numpy as np
import pytest

from training.statistics import estimate, improvement, interquartile_mean


def test_interquartile_mean():
    """Of ten runs half of the third and of the eighth count; of four the inner two."""
    shuffled = np.random.default_rng(0).permutation(10.0 ** np.arange(10))
    middle = (0.5e2 + 1e3 + 1e4 + 1e5 + 1e6 + 0.5e7) / 5
    assert interquartile_mean(shuffled) == pytest.approx(middle)
    assert interquartile_mean(np.array([3.0])) == 3
    np.testing.assert_allclose(
        interquartile_mean(np.array([[9.0, 1, 2, 7], [0, 0, 4, 4]])), [4.5, 2]
    )


def test_improvement():
    assert improvement(np.array([1.0, 2, 3]), np.array([2.0])) == 0.5
    assert improvement(np.array([1.0, 4]), np.array([0.0, 2])) == 0.75
    assert improvement(np.array([1.0, 2]), np.array([1.0, 2])) == 0.5


def test_an_interval_holds_about_as_often_as_it_says():
    """200 sets of 20 normal runs: percentiles of 20 runs are a little too narrow (0.92 expected for
    a mean); one run has no interval.
    """
    runs = np.random.default_rng(1).normal(size=(200, 20))
    value, low, high = estimate(interquartile_mean, runs, resamples=500)
    held = ((low < 0) & (high > 0)).mean()
    assert 0.86 < held < 0.98 and (low < value).all() and (value < high).all()
    assert estimate(interquartile_mean, [4.0]) == (4, 4, 4)


def test_strata_are_drawn_apart():
    """Two tasks without spread in themselves have none together."""
    value, low, high = estimate(
        lambda a, b: (interquartile_mean(a) + interquartile_mean(b)) / 2, [1.0, 1, 1], [5.0, 5]
    )
    assert low == value == high == 3
