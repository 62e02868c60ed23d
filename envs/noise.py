"""Noise: random numbers as a function of (key, step), so that they depend on no neighbour and need
no loop over sub-envs.
"""

from __future__ import annotations

import torch
from torch import Tensor

# SplitMix64 (Steele, Lea and Flood 2014): increment and multipliers, as signed numbers
GOLDEN = 0x9E3779B97F4A7C15 - 2**64
FIRST, SECOND = 0xBF58476D1CE4E5B9 - 2**64, 0x94D049BB133111EB - 2**64


def uniform(key: Tensor, step: Tensor, size: int) -> Tensor:
    """(..., n, size) float64 numbers, uniform in (0, 1), of the episodes with the keys (n,) at
    their steps (..., n), both int64.

    Number j of a step is the hash of key + (size step + j) increments: the same key and step give
    the same numbers.
    """
    j = torch.arange(size, device=key.device)
    x = key[:, None] + (size * step[..., None] + j + 1) * GOLDEN
    x = (x ^ _shifted(x, 30)) * FIRST
    x = (x ^ _shifted(x, 27)) * SECOND
    return (_shifted(x ^ _shifted(x, 31), 11).to(torch.float64) + 0.5) / 2**53


def normal(key: Tensor, step: Tensor, size: int, dtype: torch.dtype) -> Tensor:
    """(..., n, size) standard normal numbers, of `uniform` ones (Box and Muller 1958)."""
    radius, angle = uniform(key, step, 2 * size).chunk(2, -1)
    return ((-2 * radius.log()).sqrt() * torch.cos(2 * torch.pi * angle)).to(dtype)


def _shifted(x: Tensor, bits: int) -> Tensor:
    """x >> bits without its sign: int64 as if it were unsigned."""
    return (x >> bits) & (2 ** (64 - bits) - 1)
