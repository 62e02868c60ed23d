"""Least value of a function of one number, between two places."""

from __future__ import annotations

from collections.abc import Callable

GOLDEN = (5**0.5 - 1) / 2


def golden_section(f: Callable[[float], float], low: float, high: float, times: int = 30) -> float:
    """Where f is least between `low` and `high`, an interval that is shortened by the golden ratio
    so many times (Kiefer 1953).
    """
    inner = [high - GOLDEN * (high - low), low + GOLDEN * (high - low)]
    value = [f(x) for x in inner]
    for _ in range(times):
        if value[0] < value[1]:
            high = inner[1]
            inner = [high - GOLDEN * (high - low), inner[0]]
            value = [f(inner[0]), value[0]]
        else:
            low = inner[0]
            inner = [inner[1], low + GOLDEN * (high - low)]
            value = [value[1], f(inner[1])]
    return inner[int(value[1] < value[0])]
