"""Matrices of blocks."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad

from .dense import inverse_unchecked

SWEEPS = 6  # of balancing, over all scales


def of_blocks(a: Tensor, b: Tensor, c: Tensor, d: Tensor) -> Tensor:
    """[[a, b], [c, d]], of the same batch axes."""
    return torch.cat((torch.cat((a, b), -1), torch.cat((c, d), -1)), -2)


def block_diagonal(A: Tensor, B: Tensor) -> Tensor:
    """[[A, 0], [0, B]] of (..., m, n) and (..., k, l)."""
    (m, n), (k, l) = A.shape[-2:], B.shape[-2:]
    return pad(A, (0, l, 0, k)) + pad(B, (n, 0, m, 0))


def with_identity(A: Tensor, n: int) -> Tensor:
    """[[A, 0], [0, I]], with n rows of I."""
    return block_diagonal(A, torch.eye(n, dtype=A.dtype, device=A.device)) if n else A


def balance(A: Tensor) -> Tensor:
    """Scales d (..., n) that balance rows and columns of diag(1/d) A diag(d) (Osborne 1960)."""
    size = A.detach().abs()
    size = size - torch.diag_embed(size.diagonal(dim1=-2, dim2=-1))
    scale = torch.ones_like(size[..., 0])
    for _ in range(SWEEPS):
        now = size * scale[..., None, :] / scale[..., :, None]
        ratio = now.sum(-1) / now.sum(-2)
        scale = scale * torch.where(torch.isfinite(ratio) & (ratio > 0), ratio, 1.0) ** 0.25
    return scale


def eigenvalues(A: Tensor) -> Tensor:
    """(..., n) of (..., n, n), the smallest first, each to the precision of its own size.

    Rounding moves eigenvalues of A by about eps |A|, and those of (A - shift)^-1 by so much of its
    own: large ones are taken of the first, small ones of the second (Saad 2011, 4.1.2).
    """
    scale = balance(A)
    A = A * scale[..., None, :] / scale[..., :, None]
    fast = _by_size(torch.linalg.eigvals(A))
    largest = fast.detach().abs().amax(-1, keepdim=True)
    shift = torch.finfo(A.dtype).eps ** 0.5 * torch.where(largest > 0, largest, 1.0)
    inverse = inverse_unchecked(A - shift[..., None] * torch.eye(A.shape[-1]).to(A))
    # a shift that is an eigenvalue has no inverse
    slow = _by_size(1 / torch.linalg.eigvals(torch.nan_to_num(inverse, 0.0, 0.0, 0.0)) + shift)
    either = [x.detach().abs() < (largest * shift).sqrt() for x in (slow, fast)]
    as_many = torch.eq(*(x.sum(-1, keepdim=True) for x in either))
    return torch.where(either[0] & as_many & (fast != 0), slow, fast)


def _by_size(values: Tensor) -> Tensor:
    return values.gather(-1, values.detach().abs().argsort(dim=-1, stable=True))
