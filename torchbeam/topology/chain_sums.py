"""Sums at the nodes of a chain, of what its elements (..., N, *) give them."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad


def at_i(x: Tensor, axes: int = 1) -> Tensor:
    """Of order 1, what each gives its first node, as nodes (..., N+1, *)."""
    return pad(x, (0, 0) * axes + (0, 1))


def at_j(x: Tensor, axes: int = 1) -> Tensor:
    """Of order 1, what each gives its second node, as nodes (..., N+1, *)."""
    return pad(x, (0, 0) * axes + (1, 0))


def interleaved(a: Tensor, b: Tensor, axes: int = 1) -> Tensor:
    """a_0, b_0, a_1, b_1 ... along the axis before `axes` others."""
    return torch.stack((a, b), -axes - 1).flatten(-axes - 2, -axes - 1)


def spread(first: Tensor, middle: Tensor, third: Tensor, axes: int = 1) -> Tensor:
    """Of order 2, what each gives its three nodes, summed (..., 2 N + 1, *)."""
    own = (0, 0) * axes
    inner = interleaved(first, middle, axes)
    return pad(inner, (*own, 0, 1)) + pad(
        interleaved(torch.zeros_like(third), third, axes), (*own, 1, 0)
    )
