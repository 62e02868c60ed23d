"""What elements are, by their order: how many nodes one has, how it interpolates between them, and
where its stations are. What depends on the order asks this table.

Order 2 interpolates between three equally spaced places, x = -1, 0, 1, with two Gauss points
x = -+1/sqrt(3).

    N_1 = x (x - 1)/2      N_2 = 1 - x^2      N_3 = x (x + 1)/2

The rule integrates cubics exactly, each point counting for half of the length; the derivative of a
quadratic interpolant is of third order there, one better than elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

X = 3**-0.5
VALUES = torch.tensor((
    (X * (X + 1) / 2, 1 - X * X, X * (X - 1) / 2),
    (X * (X - 1) / 2, 1 - X * X, X * (X + 1) / 2),
), dtype=torch.float64)  # fmt: skip
SLOPES = torch.tensor((
    (-X - 0.5, 2 * X, -X + 0.5),
    (X - 0.5, -2 * X, X + 0.5),
), dtype=torch.float64)  # fmt: skip


def at_points(like: Tensor) -> tuple[Tensor, Tensor]:
    """N_i and dN_i/dx (2, 3): Gauss points by places."""
    return VALUES.to(like), SLOPES.to(like)


@cache
def gauss_points(count: int) -> tuple[Tensor, Tensor]:
    """Places (count,) in [-1, 1] and weights, of sum 2, of the rule of so many points."""
    return tuple(map(torch.from_numpy, np.polynomial.legendre.leggauss(count)))


def threes(x: Tensor, axes: int = 1) -> tuple[Tensor, ...]:
    """Values (..., 2 n + 1, *) at a chain of places, with `axes` axes of their own -> (..., n, *)
    at the three of each part.
    """
    n, at = x.shape[-1 - axes] - 1, x.ndim - 1 - axes
    index = (slice(None),) * at
    return tuple(x[(*index, slice(k, n + k, 2))] for k in range(3))


class ElementShape(NamedTuple):
    """nodes of an element; midside: whether one of these is inside it; stations: places x in
    [-1, 1] at which stress is told; values(x (points,)): N_i (points, nodes).
    """

    nodes: int
    midside: bool
    stations: tuple[float, ...]
    values: Callable[[Tensor], Tensor]


def _linear(x: Tensor) -> Tensor:
    return torch.stack(((1 - x) / 2, (1 + x) / 2), -1)


def _quadratic(x: Tensor) -> Tensor:
    return torch.stack((x * (x - 1) / 2, 1 - x * x, x * (x + 1) / 2), -1)


SHAPES = {1: ElementShape(2, False, (0.0,), _linear), 2: ElementShape(3, True, (-X, X), _quadratic)}


def point_weights(order: int, length: Tensor, count: int) -> Tensor:
    """(..., N, count) m: what the Gauss points of elements count for in an integral over them;
    length (..., stations) m: what their stations stand for, between which ds/dx is linear.
    """
    x, weights = (part.to(length) for part in gauss_points(count))
    length = length[..., None]
    if not SHAPES[order].midside:
        return weights * (length / 2)
    first, second = length.unflatten(-2, (-1, 2)).unbind(-2)
    return weights * ((first + second) / 2 + (second - first) / (2 * X) * x)
