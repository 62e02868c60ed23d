"""Null vectors of singular matrices, dense or of a chain, on either side."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from .block_tridiagonal import BlockChain
from .dense import solve_unchecked


def null_vectors(Q: Tensor | BlockChain) -> tuple[Tensor, Tensor]:
    """Right and left null vectors (..., n), by inverse iteration; the left one starts from the
    right one, so that of several (equal bending in two planes) the two belong together.
    """
    n, like = (Q.shape[-1], Q) if isinstance(Q, Tensor) else (Q.size, Q.diagonal)
    v = torch.cos(1.7 * torch.arange(n, dtype=like.real.dtype, device=like.device) + 0.3)
    v, vectors = v.to(like.dtype), []
    for matrix in (Q, Q.mT):
        solve = _solver(matrix)
        for _ in range(3):
            v = solve(v)
            v = v / v.gather(-1, v.abs().argmax(-1, keepdim=True))
        vectors.append(v)
    return vectors[0], vectors[1]


def _solver(Q: Tensor | BlockChain) -> Callable[[Tensor], Tensor]:
    """Vectors (..., n) -> Q^-1 times these."""
    if isinstance(Q, Tensor):
        return lambda v: solve_unchecked(Q, v[..., None])[..., 0]
    factors = Q.factored()
    return lambda v: Q.flat(factors.solve(Q.nodes(v)))


def bilinear(w: Tensor, Q: Tensor | BlockChain, v: Tensor) -> Tensor:
    """w^T Q v (...)."""
    if isinstance(Q, Tensor):
        return (w[..., None, :] @ Q.to(v.dtype) @ v[..., None])[..., 0, 0]
    return (w * Q.flat(Q.to(v.dtype).times(Q.nodes(v)))).sum(-1)
