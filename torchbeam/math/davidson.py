"""Eigenvalues next to zero of (I + mu A) v = 0, with a real A that is known by its products.

Projected onto a subspace, which grows by the residuals of the pairs that are looked for, side by
side (Davidson 1975).
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from .concrete import concrete

KRYLOV = 2  # blocks by A, before the first pairs are looked at
GROWTH = 12  # blocks by residuals, at most
SLACK = 32  # of rounding, relative to the largest 1 / mu, that a residual may be
STUCK = 0.7  # a small one that is not less than this much of the one before is rounding of products


def nearest(
    product: Callable[[Tensor], Tensor], start: Tensor, wanted: Callable[[Tensor], Tensor]
) -> tuple[Tensor, Tensor] | None:
    """Eigenvalues (..., m) and vectors (..., n, m), complex, among them those next to zero; None
    where these do not converge.

    product  A by vectors (..., n, p)
    start    (..., n, p): the subspace begins with what A makes of it
    wanted   eigenvalues (..., m) -> places (..., count) of those that are to converge
    """
    block = product(start)
    basis = image = block[..., :0]
    eps, done, last = torch.finfo(start.dtype).eps, torch.tensor(False), torch.inf
    for step in range(1 + KRYLOV + GROWTH):
        if basis.shape[-1] + block.shape[-1] > block.shape[-2] or not _finite(block):
            return None
        block = _beside(basis, block)
        basis = torch.cat((basis, block), -1)
        image = torch.cat((image, product(block)), -1)
        if step < KRYLOV:
            block = image[..., -block.shape[-1] :]
            continue
        values, vectors = torch.linalg.eig(-basis.mT @ image)
        mu = 1 / values
        chosen = wanted(mu)
        near = vectors.gather(-1, chosen[..., None, :].expand(*vectors.shape[:-1], -1))
        residual = _times(image, near) + (
            values.gather(-1, chosen)[..., None, :] * _times(basis, near)
        )
        size = residual.norm(dim=-2).amax(-1) / values.abs().amax(-1)
        done = done | (size <= SLACK * eps) | ((size > STUCK * last) & (size <= eps**0.5))
        if concrete(done).all():
            return mu, _times(basis, vectors)
        # most pairs are real; of one that is not its two directions come in two steps
        last, block = size, residual.real + residual.imag
        block = block / block.norm(dim=-2, keepdim=True).clamp(min=torch.finfo(block.dtype).tiny)
    return None


def _finite(x: Tensor) -> bool:
    return bool(concrete(torch.isfinite(x)).all())


def _beside(V: Tensor, W: Tensor) -> Tensor:
    """W made orthonormal and orthogonal to V, even of rounding alone: projected twice."""
    for _ in range(2):
        W = torch.linalg.qr(W - V @ (V.mT @ W)).Q
    return W


def _times(A: Tensor, v: Tensor) -> Tensor:
    """A v, A real, v complex."""
    return torch.complex(A @ v.real, A @ v.imag)
