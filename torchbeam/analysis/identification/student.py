"""Student's t distribution: quantiles, and the levels that are asked of it."""

from __future__ import annotations

import math

import torch

from ...core.arguments import number

POINTS = 401


def tail(level: float) -> float:
    """Share beyond each of the two ends of an interval of a level of confidence. Raises ValueError for one not in (0, 1)."""
    level = number("level", level)
    if not 0 < level < 1:
        raise ValueError(f"level = {level:g} was given; one between 0 and 1 is wanted")
    return (1 - level) / 2


def quantile(probability: float, freedom: float) -> float:
    """t below which a share `probability` of Student's t with so many degrees of freedom lies; inf degrees: the normal law.

    With t = sqrt(n) tan(a) the share between 0 and t is c times the integral of cos(a)^(n-1), which Simpson's rule gives; the
    root by bisection (Abramowitz and Stegun 1964, 26.7).
    """
    if probability < 0.5:
        return -quantile(1 - probability, freedom)
    normal = math.sqrt(2) * torch.erfinv(torch.tensor(2 * probability - 1, dtype=torch.float64)).item()
    if freedom > 1e6 or normal == 0:
        return normal
    c = math.exp(math.lgamma((freedom + 1) / 2) - math.lgamma(freedom / 2)) / math.sqrt(math.pi)
    weights = torch.ones(POINTS, dtype=torch.float64)
    weights[1:-1:2], weights[2:-1:2] = 4, 2

    def share(t: float) -> float:
        end = math.atan(t / math.sqrt(freedom))
        values = torch.cos(torch.linspace(0, end, POINTS, dtype=torch.float64)) ** (freedom - 1)
        return 0.5 + c * (weights @ values).item() * end / (POINTS - 1) / 3

    low, high = 0.0, max(normal, 1.0)
    while share(high) < probability:
        low, high = high, 2 * high
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if share(middle) < probability else (low, middle)
    return (low + high) / 2
