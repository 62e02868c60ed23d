"""Rotation vectors of relative rotations D (..., 3, 3), by what of them is linear in D:

    c = (tr D - 1)/2 = cos |phi|      y = the axial vector of (D - D^T)/2 = sin |phi| n
    phi = f(c) y                      f = |phi|/sin |phi| = arccos(c)/sqrt(1 - c^2)

f is analytic but for c = -1, half a turn. Its derivatives are those of (1 - c^2) f' = c f - 1, and
near c = 1 those of its series in z = (1 - c)/2, sum of (2/3)(4/5)...(2n/(2n+1)) z^n.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

SMALL = 0.1  # of 1 - c: where f is a series
TERMS = 14
LEAST = 1e-14  # of 1 - c^2, next to half a turn
APART = 0.01  # of two c, of 1 + c: where the difference of f is well told by its values
# Gauss-Legendre points of [0, 1] and their weights
POINTS = ((0.5 - 0.15**0.5, 5 / 18), (0.5, 8 / 18), (0.5 + 0.15**0.5, 5 / 18))
SERIES = [math.prod(2 * k / (2 * k + 1) for k in range(1, n + 1)) for n in range(TERMS)]


class Turn(NamedTuple):
    """y (..., 3) and c (...) of a rotation."""

    y: Tensor
    c: Tensor

    @classmethod
    def of(cls, D: Tensor) -> Turn:
        """Of what is linear in D: of a difference, or a derivative, theirs."""
        return cls(axial(D) / 2, (_trace(D) - 1) / 2)

    @property
    def vector(self) -> Tensor:
        """phi (..., 3) rad."""
        return arc(self.c)[0][..., None] * self.y


def axial(X: Tensor) -> Tensor:
    """(..., 3) a of ~a = X - X^T."""
    return torch.stack(
        (X[..., 2, 1] - X[..., 1, 2], X[..., 0, 2] - X[..., 2, 0], X[..., 1, 0] - X[..., 0, 1]), -1
    )


def changes(dD: Tensor) -> tuple[Tensor, Tensor]:
    """dy (..., 3) and dc (...) of a change dD (..., 3, 3)."""
    return axial(dD) / 2, _trace(dD) / 2


def _trace(D: Tensor) -> Tensor:
    return D[..., 0, 0] + D[..., 1, 1] + D[..., 2, 2]


def arc(c: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """f, f' and f'' (...) at c."""
    small = c > 1 - SMALL
    z = torch.where(small, (1 - c) / 2, 0.0)
    series, first, second = (_series(z, k) for k in range(3))
    cosine = torch.where(small, 0.0, c)
    square = (1 - cosine**2).clamp(min=LEAST)
    sine = torch.sqrt(square)
    f = torch.atan2(sine, cosine) / sine
    by = (cosine * f - 1) / square
    by_by = (3 * cosine * by + f) / square
    return (
        torch.where(small, series, f),
        torch.where(small, -first / 2, by),
        torch.where(small, second / 4, by_by),
    )


def _series(z: Tensor, derivative: int) -> Tensor:
    total = torch.zeros_like(z)
    for n in range(TERMS - 1, derivative - 1, -1):
        weight = SERIES[n]
        for k in range(derivative):
            weight *= n - k
        total = total * z + weight
    return total


def arc_slope(c: Tensor, before: Tensor) -> tuple[Tensor, Tensor]:
    """(f(c) - f(before))/(c - before), where they are one its limit f', and the derivative by c."""
    change = c - before
    far = change.abs() > APART * (1 + c)
    mean = mean_by = 0.0
    for share, weight in POINTS:
        _, by, by_by = arc(before + share * change)
        mean, mean_by = mean + weight * by, mean_by + weight * share * by_by
    safe = torch.where(far, change, 1.0)
    f, by, _ = arc(c)
    slope = (f - arc(before)[0]) / safe
    return torch.where(far, slope, mean), torch.where(far, (by - slope) / safe, mean_by)
