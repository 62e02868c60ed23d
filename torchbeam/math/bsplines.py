"""B-splines between evenly or unevenly spaced breaks, whose knots at the ends are repeated."""

from __future__ import annotations

import torch
from torch import Tensor


def basis(breaks: Tensor, x: Tensor, degree: int, order: int = 0) -> Tensor:
    """(n, K) derivatives of an order of the K = len(breaks) - 1 + degree B-splines at x (n,), by
    the recursion of Cox and de Boor.
    """
    knots = torch.cat((breaks[:1].expand(degree), breaks, breaks[-1:].expand(degree)))
    k = (torch.searchsorted(breaks, x.contiguous(), right=True) - 1).clamp(0, len(breaks) - 2)
    values = torch.nn.functional.one_hot(k + degree, len(knots) - 1).to(x)
    for d in range(1, degree + 1):
        width = knots[d:] - knots[:-d]
        share = torch.where(width > 0, values / torch.where(width > 0, width, 1), 0)
        if d > degree - order:
            values = d * (share[:, :-1] - share[:, 1:])
        else:
            left, right = x[:, None] - knots[: -d - 1], knots[d + 1 :] - x[:, None]
            values = left * share[:, :-1] + right * share[:, 1:]
    return values


def penalty(breaks: Tensor, degree: int, order: int) -> Tensor:
    """(K, K) integrals of products of the derivatives of an order, from end to end, by three Gauss
    points an interval: exact for pieces of degree 2 and less.
    """
    points = breaks.new_tensor((-(0.6**0.5), 0.0, 0.6**0.5))
    weights = breaks.new_tensor((5 / 9, 8 / 9, 5 / 9))
    half = breaks.diff()[:, None] / 2
    at = (breaks[:-1, None] + half * (1 + points)).flatten()
    rows = basis(breaks, at, degree, order)
    return rows.mT @ ((half * weights).flatten()[:, None] * rows)
