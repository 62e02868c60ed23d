"""Quantiles and intervals of statistics: against tables and sums."""

import math

import pytest
import torch

from torchbeam.math.distributions import (
    beta_probability,
    beta_quantile,
    binomial_interval,
    binomial_ranks,
    log_normal_probability,
    normal_probability,
    probability_between,
    score_of_tails,
    student_quantile,
)


def binomial(k, n, p):
    return math.comb(n, k) * p**k * (1 - p) ** (n - k)


@pytest.mark.parametrize("n, k, p", [(5, 2, 0.4), (20, 3, 0.05), (60, 55, 0.9), (12, 11, 1e-4)])
def test_beta_is_a_sum_of_binomials(n, k, p):
    """P(B >= k) = I_p(k, n - k + 1) (DLMF 8.17.5)."""
    assert beta_probability(p, k, n - k + 1) == pytest.approx(
        sum(binomial(j, n, p) for j in range(k, n + 1)), rel=1e-11
    )


@pytest.mark.parametrize("p", [1e-9, 0.025, 0.5, 0.975, 1 - 1e-9])
@pytest.mark.parametrize("a, b", [(0.5, 0.5), (3, 5), (1001, 1), (2, 1e5)])
def test_beta_quantile(p, a, b):
    """It undoes the probability, on the small side."""
    x = beta_quantile(p, a, b)
    assert beta_probability(x, a, b) == pytest.approx(p, rel=1e-7) and 0 <= x <= 1


def test_student():
    """Tables of the 97.5 % point, to their last digit; far out, t = (2p - 1) sqrt(2 / (4 p
    (1 - p))) of two degrees; where the normal law's expansion takes over both agree; symmetric;
    with one degree of freedom tan(pi (p - 1/2)).
    """
    for freedom, wanted in (
        (1, 12.7062047),
        (5, 2.57058184),
        (30, 2.04227246),
        (math.inf, 1.95996398),
    ):
        assert student_quantile(0.975, freedom) == pytest.approx(wanted, rel=1e-8)
    p = 0.99995
    assert student_quantile(p, 2) == pytest.approx(
        (2 * p - 1) * math.sqrt(2 / (4 * p * (1 - p))), rel=1e-11
    )
    below, above = (student_quantile(p, 1e6 * (1 + side)) for side in (-1e-9, 1e-9))
    assert above == pytest.approx(below, rel=1e-9)
    assert student_quantile(0.1, 4) == pytest.approx(-student_quantile(0.9, 4))
    assert (
        student_quantile(0.8, 1) == pytest.approx(math.tan(0.3 * math.pi))
        and student_quantile(0.5, 3) == 0
    )


def test_clopper_and_pearson():
    """The tails of the limits are 2.5 % each; none of n: 1 - 0.025^(1/n)."""
    low, high = binomial_interval(3, 20, 0.95)
    assert sum(binomial(j, 20, low) for j in range(3, 21)) == pytest.approx(0.025)
    assert sum(binomial(j, 20, high) for j in range(4)) == pytest.approx(0.025)
    assert binomial_interval(0, 50, 0.95) == (0.0, pytest.approx(1 - 0.025 ** (1 / 50)))
    assert binomial_interval(50, 50, 0.95) == (pytest.approx(0.025 ** (1 / 50)), 1.0)


@pytest.mark.parametrize("q, n", [(0.5, 10), (0.95, 100), (0.01, 300), (0.999, 100)])
def test_ranks(q, n):
    """The coverage, a sum of binomials, is what was asked for on each side, and would not be with
    one rank less.
    """
    low, high = binomial_ranks(q, n, 0.9)

    def below(k):  # P(B < k)
        return sum(binomial(j, n, q) for j in range(k))

    assert below(low) <= 0.05 < below(low + 1)
    assert high == n + 1 or below(high) >= 0.95
    assert below(min(high, n + 1) - 1) < 0.95


def test_normal_in_the_far_tail():
    """Phi(-30) = erfc(30/sqrt 2)/2, by Python's own erfc; its logarithm; the range from 9 to 10;
    the score it leads back to.
    """

    def tail(z):
        return math.erfc(z / 2**0.5) / 2

    z = torch.tensor([-30.0, -9.0, -1.0, 2.0], dtype=torch.float64)
    assert normal_probability(z).tolist() == pytest.approx(
        [tail(30), tail(9), tail(1), 1 - tail(2)], rel=1e-13
    )
    assert log_normal_probability(z).exp().tolist() == pytest.approx(
        [tail(30), tail(9), tail(1), 1 - tail(2)], rel=1e-12
    )
    nine, ten = z.new_tensor(9.0), z.new_tensor(10.0)
    assert probability_between(nine, ten).item() == pytest.approx(tail(9) - tail(10), rel=1e-13)
    assert probability_between(-ten, nine).item() == pytest.approx(1.0, rel=1e-15)
    assert score_of_tails(normal_probability(-z), normal_probability(z)).tolist() == pytest.approx(
        (-z).tolist(), rel=1e-12
    )
