"""The smallest gap on a straight way of a point past an obstacle."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

AtPoints = Callable[[Tensor], Tensor]  # what is asked of points
MEETINGS = 4  # of tangents


def leads_through(gap: AtPoints, directions: AtPoints, start: Tensor, end: Tensor) -> Tensor:
    """(..., n) bool: whether straight ways from points to points (..., n, 3) lead through what has
    the gap (..., n, 1) m and its gradient `directions`: inside in between, and outside at both
    ends, or out on another side than in.
    """
    inside = least_along(gap, directions, start, end - start) < 0
    out = torch.minimum(gap(start), gap(end)) > 0
    turned = (directions(start) * directions(end)).sum(-1, keepdim=True) < 0
    return (inside & (out | turned))[..., 0]


def least_along(gap: AtPoints, directions: AtPoints, start: Tensor, way: Tensor) -> Tensor:
    """(..., n, 1) m: about the smallest gap on straight ways (..., n, 3) from points on, with its
    gradient `directions`. It is convex along a line, as what can be passed through is: least near
    where the tangents at both ends meet, nearer yet between there and the end towards which it
    falls, and so on. Above a face it is straight, so that a few meetings find a thin box.
    """

    def at(share: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        x = start + share * way
        return share, gap(x), (directions(x) * way).sum(-1, keepdim=True)

    none = torch.zeros_like(way[..., :1])
    first, last = at(none), at(none + 1)
    least = torch.minimum(first[1], last[1])
    for _ in range(MEETINGS):
        middle = at(_meeting(first, last))
        least, falls = torch.minimum(least, middle[1]), middle[2] < 0
        first, last = (
            tuple(torch.where(taken, m, x) for m, x in zip(middle, end, strict=True))
            for taken, end in ((falls, first), (~falls, last))
        )
    return least


def _meeting(first: tuple[Tensor, ...], last: tuple[Tensor, ...]) -> Tensor:
    """Where the tangents of a convex function meet, by places, values and slopes at two ends; the
    lower end where it does not fall first and rise then.
    """
    (a, f, fall), (b, g, rise) = first, last
    bent = (fall < 0) & (rise > 0)
    share = (g - f - rise * (b - a)) / torch.where(bent, fall - rise, 1.0)
    return torch.where(bent, a + share, torch.where(fall < 0, b, a))
