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


@pytest.mark.parametrize("n", [4, 8, 12])
def test_interquartile_mean_is_that_of_rliable(n):
    """trim_mean(x, 0.25) leaves out int(n/4) runs at each side: a quarter where four divides n."""
    runs = np.random.default_rng(n).normal(size=(3, n))
    kept = np.sort(runs, -1)[:, n // 4 : n - n // 4]
    np.testing.assert_allclose(interquartile_mean(runs), kept.mean(-1), rtol=1e-12)


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


@pytest.mark.parametrize("n", [5, 7, 10])
def test_the_fewest_runs_that_have_an_interval(n):
    """1000 sets of as many normal runs: 0.92 to 0.93 hold the truth, by 0.008 (one deviation)."""
    runs = np.random.default_rng(1).normal(size=(1000, n))
    _, low, high = estimate(interquartile_mean, runs, resamples=500)
    assert ((low < 0) & (high > 0)).mean() > 0.89


def test_few_runs_have_no_interval():
    """Of three it would hold in 75 of 100 cases. A controller has one value, beside five seeds."""
    value, low, high = estimate(interquartile_mean, [1.0, 2, 4])
    assert value == pytest.approx((0.25 + 2 + 1) / 1.5) and np.isnan([low, high]).all()
    both = estimate(improvement, [1.0, 2, 3, 4, 9], [2.5])
    assert both.low < both.value == 0.6 < both.high
    assert np.isnan(estimate(improvement, [1.0, 2, 3, 4, 9], [2.5, 3]).low)


def test_strata_are_drawn_apart():
    """Two tasks without spread in themselves have none together."""
    value, low, high = estimate(
        lambda a, b: (interquartile_mean(a) + interquartile_mean(b)) / 2, [1.0] * 6, [5.0] * 5
    )
    assert low == value == high == 3
