"""Distribution functions and quantiles of statistics: normal, beta, Student's t."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

TINY = 1e-300
MANY = 1e6  # degrees of freedom, from which on Student's law is nearly the normal one


def normal_score(u: Tensor) -> Tensor:
    """Standard normal quantile of u in (0, 1), any shape."""
    return torch.special.ndtri(u)


def normal_probability(z: Tensor) -> Tensor:
    """Standard normal distribution function, any shape, exact in the lower tail (torch.special.ndtr
    has no digits below -8).
    """
    return torch.erfc(-z / math.sqrt(2)) / 2


def log_normal_probability(z: Tensor) -> Tensor:
    """Logarithm of the normal distribution function, any shape, exact in both tails."""
    return torch.special.log_ndtr(z)


def score_of_tails(below: Tensor, above: Tensor) -> Tensor:
    """Standard normal quantile of a probability and its complement, by the smaller one."""
    size = -normal_score(torch.minimum(below, above))
    return torch.where(below < above, -size, size)


def probability_between(low: Tensor, high: Tensor) -> Tensor:
    """Standard normal probability from low to high, of any shapes; exact in both tails."""
    right = low > 0
    a, b = torch.where(right, -high, low), torch.where(right, -low, high)
    return normal_probability(b) - normal_probability(a)


def beta_probability(x: float, a: float, b: float) -> float:
    """Regularised incomplete beta function I_x(a, b), the distribution function of the beta law:
    its continued fraction (DLMF 8.17.22), by Lentz's method, on the side of the mean where it
    converges fast. Good to 1e-13 for a + b of thousands, to 1e-8 for millions.
    """
    if x <= 0 or x >= 1:
        return float(x >= 1)
    if x > (a + 1) / (a + b + 2):
        return 1 - beta_probability(1 - x, b, a)
    front = math.exp(
        math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x) + b * math.log1p(-x)
    ) / a  # fmt: skip
    c, d = 1.0, 1 / _away(1 - (a + b) * x / (a + 1))
    value = d
    for m in range(1, 100_000):
        for term in (
            m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)),
            -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1)),
        ):
            c, d = _away(1 + term / c), 1 / _away(1 + term * d)
            value *= c * d
        if abs(c * d - 1) < 1e-15:
            break
    return front * value


def beta_quantile(p: float, a: float, b: float) -> float:
    """x with I_x(a, b) = p, by bisection: good to 1e-15 of itself, or of 1 - x."""
    if a > b and p > 0.5:  # the small side is the exact one
        return 1 - _bisected(lambda x: 1 - p - beta_probability(x, b, a))
    return _bisected(lambda x: p - beta_probability(x, a, b))


def student_quantile(p: float, freedom: float) -> float:
    """Quantile of Student's t law: with x = nu/(nu + t^2), P(T > t) = I_x(nu/2, 1/2)/2; of very
    many degrees, to the normal law's, which it is of infinitely many, by its expansion (Abramowitz
    and Stegun 1964, 26.7.5).
    """
    if p == 0.5:
        return 0.0
    if freedom > MANY:
        z = normal_score(torch.tensor(p, dtype=torch.float64)).item()
        return z + (z**3 + z) / (4 * freedom) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)
    tail = min(p, 1 - p)
    x = beta_quantile(2 * tail, freedom / 2, 0.5)
    return math.copysign(math.sqrt(freedom * (1 - x) / x), p - 0.5)


def binomial_interval(hits: float, n: float, level: float) -> tuple[float, float]:
    """Interval (low, high) of a probability from `hits` in n independent trials, that covers it at
    least as often as `level` says. (Clopper and Pearson 1934.)
    """
    tail = (1 - level) / 2
    low = beta_quantile(tail, hits, n - hits + 1) if hits > 0 else 0.0
    return low, beta_quantile(1 - tail, hits + 1, n - hits) if hits < n else 1.0


def binomial_ranks(q: float, n: int, level: float) -> tuple[int, int]:
    """Ranks (low, high) of 0 to n + 1 between whose order statistics the q-quantile of n
    independent samples lies at least as often as `level` says; 0 and n + 1 stand for no bound.
    (Conover 1999, section 3.2.)
    """
    tail = (1 - level) / 2

    def at_most(k: int) -> float:  # P(B <= k), B of n trials with probability q
        return 1.0 if k >= n else 0.0 if k < 0 else beta_probability(1 - q, n - k, k + 1)

    # the last rank with P(B < rank) <= tail
    low = _first(lambda k: at_most(k - 1) > tail, 0, n + 1) - 1
    high = _first(lambda k: at_most(k - 1) >= 1 - tail, 0, n + 1)
    return max(low, 0), high


def _first(true: Callable[[int], bool], low: int, high: int) -> int:
    """Least whole number from low to high for which a lasting condition is true; else `high`."""
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if true(middle) else (middle + 1, high)
    return low


def _bisected(falling: Callable[[float], float]) -> float:
    """Zero in (0, 1) of a falling function, by bisection in the logarithm of x where x is small."""
    low, high = TINY, 1.0
    for _ in range(2000):
        middle = math.sqrt(low * high) if high < 1e-3 or low < 1e-6 * high else (low + high) / 2
        if middle in (low, high) or high - low < 1e-16 * high:
            break
        low, high = (middle, high) if falling(middle) > 0 else (low, middle)
    return (low + high) / 2


def _away(x: float) -> float:
    return x if abs(x) > TINY else TINY
