"""Least squares of numbers that are not negative."""

from __future__ import annotations

import torch
from torch import Tensor

ROUNDING = 1e-12  # of the largest slope, below which it is none


def nonnegative_least_squares(A: Tensor, b: Tensor) -> Tensor:
    """x (n) >= 0 with the least |A x - b|, A (m, n), b (m); by which x are zero a constant, by the
    others differentiable (Lawson and Hanson 1974, chapter 23).
    """
    with torch.no_grad():
        free, x = torch.zeros(A.shape[-1], dtype=torch.bool), torch.zeros_like(A[0])
        slope = A.mT @ b
        least = ROUNDING * slope.abs().amax()
        for _ in range(3 * A.shape[-1]):
            slope = (A.mT @ (b - A @ x)).masked_fill(free, -torch.inf)
            if not (slope > least).any():
                break
            free[slope.argmax()] = True
            while True:
                there = _solution(A, b, free)
                if (there >= 0).all():
                    break
                # as far as all stay, which then are zero
                off = there < 0
                share = (x[off] / (x[off] - there[off])).amin()
                x = torch.lerp(x, there, share)
                free = free & (x > ROUNDING * x.amax())
                x = torch.where(free, x, 0.0)
            x = there
    return _solution(A, b, free)


def _solution(A: Tensor, b: Tensor, free: Tensor) -> Tensor:
    """Of the unknowns that are free, the others being zero."""
    Q, R = torch.linalg.qr(A[:, free])
    x = torch.linalg.solve_triangular(R, (Q.mT @ b)[:, None], upper=True)[:, 0]
    return torch.zeros_like(A[0]).masked_scatter(free, x)
