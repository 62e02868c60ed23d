"""Quadrature along the beam by values at its nodes: how much of its length, or mass, belongs to
each of them.

The trapezoidal rule gives each node half of its elements. With rho a density along the beam,
constant in each element, its error is that of the slopes at the ends of the elements
(Euler and Maclaurin):

    integral of rho f = sum over elements of rho (h/2 (f_i + f_j) - h^2/12 (f'_j - f'_i)) + O(h^4)

Gregory's rule takes these slopes from the parabola through a node and its neighbours (at an end
through the last three nodes). Equal elements have the weights 3/8, 7/6, 23/24, 1, ..., times h;
three nodes those of Simpson's rule.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad

LEAST = 0.5  # of a trapezoidal weight


def trapezoidal(length: Tensor, density: Tensor | float = 1.0) -> Tensor:
    """Weights (..., N+1) of elements of length (..., N) m and density (..., N or 1) per metre."""
    half = density * length / 2
    return pad(half, (0, 1)) + pad(half, (1, 0))


def gregory(
    length: Tensor, density: Tensor | float = 1.0, smooth: Tensor | float | None = None
) -> Tensor:
    """The same by Gregory's rule: linear functions exactly, as by the trapezoidal one, which stays
    where there is one element, and where `too_uneven`; smooth: the density with 0 in elements that
    are to stay trapezoidal.
    """
    plain = trapezoidal(length, density)
    if length.shape[-1] == 1:
        return plain
    weights = _corrected(length, density if smooth is None else smooth, plain)
    return torch.where(_positive(weights, plain), weights, plain)


def too_uneven(length: Tensor, density: Tensor | float = 1.0) -> Tensor:
    """(..., 1) bool: whether lengths or densities jump by so much that one of Gregory's weights
    would fall below half of the trapezoidal one: from twice the length at an end, or back and
    forth, on, and from about 2.5 times at one place between.
    """
    plain = trapezoidal(length, density)
    return ~_positive(plain if length.shape[-1] == 1 else _corrected(length, density, plain), plain)


def _positive(weights: Tensor, plain: Tensor) -> Tensor:
    return (weights >= LEAST * plain).all(-1, keepdim=True)


def _corrected(length: Tensor, density: Tensor | float, plain: Tensor) -> Tensor:
    N = length.shape[-1]
    slope = density * length**2 / 12
    slope = pad(slope, (0, 1)) - pad(slope, (1, 0))  # what f' of each node counts for
    # three nodes at -a, 0, b: slopes are wanted at 0, and at the ends of the beam
    a, b = length[..., :-1], length[..., 1:]
    first, last = pad(slope[..., :1], (0, N - 2)), pad(slope[..., -1:], (N - 2, 0))
    S, X = slope[..., 1:-1] + first + last, 2 * (b * last - a * first)
    before, here = (X - b * S) / (a * (a + b)), ((b - a) * S - X) / (a * b)
    after = (X + a * S) / (b * (a + b))
    return plain + pad(before, (0, 2)) + pad(here, (1, 1)) + pad(after, (2, 0))
