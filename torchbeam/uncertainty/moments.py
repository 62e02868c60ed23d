"""Moments of a stream, in constant memory."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass
class Moments:
    """Number of samples, mean (...), sums of the second to fourth powers of the distance from it,
    least and largest.

    Parts are merged by Pebay's formulas (2008), which do not cancel where the mean is large.
    """

    n: int
    mean: Tensor
    second: Tensor
    third: Tensor
    fourth: Tensor
    least: Tensor
    largest: Tensor

    @classmethod
    def of(cls, y: Tensor) -> Moments:
        """Of samples y (n, ...), n > 0."""
        y = y.double()
        mean = y.mean(0)
        d = y - mean
        return cls(len(y), mean, *((d**k).sum(0) for k in (2, 3, 4)), y.amin(0), y.amax(0))

    def merged(self, other: Moments) -> Moments:
        """Moments of both."""
        a, b, n = self.n, other.n, self.n + other.n
        d = other.mean - self.mean
        second = self.second + other.second + d**2 * (a * b / n)
        third = (self.third + other.third + d**3 * (a * b * (a - b) / n**2)
                 + 3 * d * (a * other.second - b * self.second) / n)  # fmt: skip
        fourth = (self.fourth + other.fourth + d**4 * (a * b * (a * a - a * b + b * b) / n**3)
                  + 6 * d**2 * (a * a * other.second + b * b * self.second) / n**2
                  + 4 * d * (a * other.third - b * self.third) / n)  # fmt: skip
        mean = self.mean + d * (b / n)
        ends = torch.minimum(self.least, other.least), torch.maximum(self.largest, other.largest)
        return Moments(n, mean, second, third, fourth, *ends)

    @property
    def deviation(self) -> Tensor:
        """Of independent samples; NaN of one."""
        return (self.second / (self.n - 1)).sqrt()

    @property
    def skewness(self) -> Tensor:
        return self.third / self.n / (self.second / self.n) ** 1.5

    @property
    def kurtosis(self) -> Tensor:
        """Of a normal law: 3."""
        return self.fourth * self.n / self.second**2
