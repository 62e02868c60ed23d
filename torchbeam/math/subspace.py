"""Subspace iteration for block tridiagonal matrices: the largest eigenvalues of K^-1 M, both symmetric, K positive definite."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from .shapes import broadcast_shapes

EXTRA = 8  # vectors beyond those asked for
SWEEPS, LATE = 40, 8
CONVERGED = {torch.float64: 1e-11, torch.float32: 1e-5}  # change of an eigenvalue in a sweep, relative
STUCK = 0.7  # a change that is not less than this much of the one before, late on, is rounding


class Chained(NamedTuple):
    """A block tridiagonal matrix: diagonal blocks (..., n, k, k), those to the right of each, upper, and those to the left of
    the next, lower (..., n-1, k, k).
    """

    diagonal_blocks: Tensor
    upper: Tensor
    lower: Tensor


def subspace(M: Chained, K: Chained, count: int) -> tuple[Tensor, Tensor]:
    """The `count` largest eigenvalues (..., count), falling, and vectors (..., n, count) of K^-1 M.

    Block inverse iteration with the Rayleigh-Ritz projection (Bathe 1971), O(N) a sweep. A sample's result depends on its
    neighbours by what is left to converge alone: 1e-11.
    """
    diagonal = K.diagonal_blocks
    nodes, k = diagonal.shape[-3], diagonal.shape[-1]
    size = min(2 * count, count + EXTRA)
    batch = broadcast_shapes(diagonal.shape[:-3], M[0].shape[:-3])
    factors = _Factors.of(K)
    start = torch.cos(torch.arange(nodes * k, dtype=diagonal.dtype, device=diagonal.device)[:, None]
                      * (1 + torch.arange(size, dtype=diagonal.dtype, device=diagonal.device)) * 0.7 + 0.3)
    load = _product(M, start.unflatten(0, (nodes, k)).expand(*batch, nodes, k, size))
    value = last = None
    for sweep in range(SWEEPS):
        X = _solve(factors, K, load)
        MX = _product(M, X)
        flat, flat_load, flat_mass = (x.flatten(-3, -2) for x in (X, load, MX))
        stiff, mass = flat.mT @ flat_load, flat.mT @ flat_mass
        scale = stiff.diagonal(dim1=-2, dim2=-1).rsqrt()
        stiff, mass = (scale[..., :, None] * (A + A.mT) / 2 * scale[..., None, :] for A in (stiff, mass))
        axis, turn = torch.linalg.eigh(stiff)
        axis = axis.clamp(min=torch.finfo(axis.dtype).eps * size)  # directions that coincide count for nothing
        whiten = turn / axis.sqrt()[..., None, :]
        new, turn = torch.linalg.eigh(whiten.mT @ mass @ whiten)
        mix = scale[..., :, None] * (whiten @ turn).flip(-1)
        new, before = new.flip(-1), value
        value, load, vectors = new, MX @ mix[..., None, :, :], flat @ mix
        if before is not None:
            change = ((value - before)[..., :count].abs() / value[..., :count]).amax()
            if change <= CONVERGED[value.dtype] or (sweep >= LATE and change > STUCK * last):
                break
            last = change
    return value[..., :count], vectors[..., :count]


class _Factors(NamedTuple):
    """Of each pivot block from the first to the last: LU, its pivoting, and its inverse times the block to its right."""

    lu: list[Tensor]
    order: list[Tensor]
    ahead: list[Tensor]

    @classmethod
    def of(cls, K: Chained) -> _Factors:
        diagonal, upper, lower = K
        lu, order, ahead = [], [], []
        for i in range(diagonal.shape[-3]):
            pivot = diagonal[..., i, :, :]
            if i > 0:
                pivot = pivot - lower[..., i - 1, :, :] @ ahead[-1]
            factors = torch.linalg.lu_factor_ex(pivot)
            lu.append(factors[0])
            order.append(factors[1])
            if i < upper.shape[-3]:
                ahead.append(torch.linalg.lu_solve(lu[-1], order[-1], upper[..., i, :, :]))
        return cls(lu, order, ahead)


def _solve(factors: _Factors, K: Chained, load: Tensor) -> Tensor:
    """K^-1 load for load (..., N, k, m), refined once: pivots next to impossible strains are ill conditioned."""
    x = _swept(factors, K.lower, load)
    return x + _swept(factors, K.lower, load - _product(K, x))


def _swept(factors: _Factors, lower: Tensor, load: Tensor) -> Tensor:
    loads, L = load.unbind(-3), lower.unbind(-3)
    down = []
    for i, (lu, order) in enumerate(zip(factors.lu, factors.order, strict=True)):
        right = loads[i] if i == 0 else loads[i] - L[i - 1] @ down[-1]
        down.append(torch.linalg.lu_solve(lu, order, right))
    x = [down[-1]]
    for i in range(len(down) - 2, -1, -1):
        x.append(down[i] - factors.ahead[i] @ x[-1])
    return torch.stack(x[::-1], -3)


def _product(A: Chained, X: Tensor) -> Tensor:
    """A X for X (..., N, k, m)."""
    diagonal, upper, lower = A
    pad = torch.nn.functional.pad
    above, below = upper @ X[..., 1:, :, :], lower @ X[..., :-1, :, :]
    return diagonal @ X + pad(above, (0, 0, 0, 0, 0, 1)) + pad(below, (0, 0, 0, 0, 1, 0))
