"""Dense linear systems: torch.linalg, but that matrices of many rows are factored one sample at a
time.

After a call of torch.set_num_threads with 2 or more, torch 2.13 with MKL 2024.2 factors a batch of
matrices of more than 144 rows wrongly, or never comes to an end; each by itself it factors rightly,
on as many threads.
"""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar

import torch
from torch import Tensor

from .shapes import broadcast_shapes

LARGE = 128  # rows: below, a batch is right and quicker
BALANCING = 6  # sweeps over the scales
IN_ORDER = ContextVar("IN_ORDER", default=False)  # while `solve_in_order` solves


def solve(A: Tensor, B: Tensor) -> Tensor:
    """A^-1 B for (..., n, n) and (..., n, m). Raises torch.linalg.LinAlgError if singular."""
    return _by_sample(torch.linalg.solve, A, B)


def solve_unchecked(A: Tensor, B: Tensor) -> Tensor:
    """The same; a singular sample yields values that are not finite, or whatever elimination
    leaves, and harms no neighbour.
    """
    return _by_sample(lambda A, B: torch.linalg.solve_ex(A, B)[0], A, B)


def inverse_unchecked(A: Tensor) -> Tensor:
    """A^-1 (..., n, n), likewise."""
    return _by_sample(lambda A: torch.linalg.inv_ex(A)[0], A)


def cholesky_unchecked(A: Tensor) -> Tensor:
    """Lower factors (..., n, n) of symmetric positive definite matrices, likewise."""
    return _by_sample(lambda A: torch.linalg.cholesky_ex(A)[0], A)


def positive_inverse(A: Tensor) -> tuple[Tensor, Tensor]:
    """A^-1 (..., n, n) and ln det A (...) of symmetric matrices without negative eigenvalues, by
    eigenvalues with the diagonal scaled to one; of one that is singular to rounding, the largest
    meaningful inverse.
    """
    size = A.diagonal(dim1=-2, dim2=-1).clamp(min=torch.finfo(A.dtype).tiny).rsqrt()
    values, vectors = torch.linalg.eigh(size[..., :, None] * A * size[..., None, :])
    values = values.clamp(min=torch.finfo(A.dtype).eps * values.amax(-1, keepdim=True))
    inverse = (
        size[..., :, None] * (vectors / values[..., None, :] @ vectors.mT) * size[..., None, :]
    )
    return inverse, values.log().sum(-1) - 2 * size.log().sum(-1)


def solve_in_order(A: Tensor, B: Tensor) -> Tensor:
    """A^-1 B of small matrices (..., n, n) whose leading minors are all regular, as of what is
    symmetric and positive definite, or nearly so: native code eliminates them row by row, and
    exchanges rows of all others (`engine.compiler.arrays`). Singular ones as in `solve_unchecked`.
    """
    token = IN_ORDER.set(True)
    try:
        return torch.linalg.solve_ex(A, B)[0]
    finally:
        IN_ORDER.reset(token)


def balancing(A: Tensor) -> Tensor:
    """Scales d (..., n) that balance rows and columns of diag(1/d) A diag(d) (Osborne 1960)."""
    size = A.detach().abs()
    size = size - torch.diag_embed(size.diagonal(dim1=-2, dim2=-1))
    scale = torch.ones_like(size[..., 0])
    for _ in range(BALANCING):
        now = size * scale[..., None, :] / scale[..., :, None]
        ratio = now.sum(-1) / now.sum(-2)
        scale = scale * torch.where(torch.isfinite(ratio) & (ratio > 0), ratio, 1.0) ** 0.25
    return scale


def _by_sample(function: Callable[..., Tensor], *matrices: Tensor) -> Tensor:
    batch = broadcast_shapes(*(x.shape[:-2] for x in matrices))
    if matrices[0].shape[-1] < LARGE or batch.numel() < 2 or matrices[0].device.type != "cpu":
        return function(*matrices)
    samples = zip(*(x.expand(*batch, *x.shape[-2:]).flatten(0, -3) for x in matrices), strict=True)
    return torch.stack([function(*sample) for sample in samples]).unflatten(0, batch)
