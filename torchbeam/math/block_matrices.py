"""Matrices of blocks."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad


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
