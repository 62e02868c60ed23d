"""Block tridiagonal linear systems, batched, differentiable in the right-hand side."""

from __future__ import annotations

import torch
from torch import Tensor

from .dense import solve_in_order
from .first_derivative import first_only
from .shapes import broadcast_shapes


def block_tridiagonal(D: Tensor, L: Tensor, U: Tensor, b: Tensor) -> Tensor:
    """x of D_i x_i + L_{i-1} x_{i-1} + U_i x_{i+1} = b_i by block elimination: O(n), pivoting
    inside the blocks.

    D (..., n, k, k), L and U (..., n-1, k, k), b (..., n, k); leading axes broadcast. A singular
    pivot block gives infinities or NaN in that sample alone.
    """
    return torch.cat(_rows(D, L, U, b[..., None]), -1).mT


def block_tridiagonal_columns(D: Tensor, L: Tensor, U: Tensor, b: Tensor) -> Tensor:
    """The same for many right-hand sides: b and x (..., n, k, m)."""
    return torch.stack(_rows(D, L, U, b), -3)


def _rows(D: Tensor, L: Tensor, U: Tensor, b: Tensor) -> tuple[Tensor, ...]:
    """The n rows of x (..., k, m)."""
    n = b.shape[-3]
    ahead, y = [], []
    for i in range(n):
        above = U[..., i, :, :] if i < n - 1 else None
        before = () if i == 0 else (L[..., i - 1, :, :], ahead[-1], y[-1])
        *solved, right = eliminated(D[..., i, :, :], above, b[..., i, :, :], *before)
        ahead.extend(solved)
        y.append(right)
    x = [y[-1]]
    for i in range(n - 2, -1, -1):
        x.append(y[i] - ahead[i] @ x[-1])
    return torch.broadcast_tensors(*x[::-1])


def eliminated(
    diagonal: Tensor,
    above: Tensor | None,
    right: Tensor,
    below: Tensor | None = None,
    ahead: Tensor | None = None,
    y: Tensor | None = None,
) -> tuple[Tensor, ...]:
    """D'^-1 U and D'^-1 b' (..., k, m) of a row D, U, b, from L of the row (below) and both of the
    row before; of the last row, where above is None, D'^-1 b' alone.
    """
    if below is not None:
        diagonal = diagonal - below @ ahead
        right = right - below @ y
    if above is None:
        return (_solve(diagonal, right),)
    solved, k = _solve(diagonal, above, right), diagonal.shape[-1]
    return solved[..., :k], solved[..., k:]


def _solve(A: Tensor, *right: Tensor) -> Tensor:
    """A^-1 [right ...]"""
    A, *right = broadcast_matrices(A, *right)
    return solve_in_order(A, torch.cat(right, -1) if len(right) > 1 else right[0])


def broadcast_matrices(*blocks: Tensor) -> tuple[Tensor, ...]:
    """Matrices with the same leading axes."""
    # asked for first: broadcasting is slow beside a small solve
    if len({b.shape[:-2] for b in blocks}) == 1:
        return blocks
    shape = broadcast_shapes(*(b.shape[:-2] for b in blocks))
    return tuple(b.expand(*shape, *b.shape[-2:]) for b in blocks)


def pivots(D: Tensor, L: Tensor, U: Tensor) -> Tensor:
    """(..., n, k, k) pivot blocks of the elimination from the first to the last; shapes as in
    `block_tridiagonal`; O(n).
    """
    blocks = [D[..., 0, :, :]]
    for i in range(1, D.shape[-3]):
        blocks.append(
            D[..., i, :, :] - L[..., i - 1, :, :] @ _solve(blocks[-1], U[..., i - 1, :, :])
        )
    return torch.stack(torch.broadcast_tensors(*blocks), -3)


def finite_pivots(D: Tensor, L: Tensor, U: Tensor) -> tuple[Tensor, Tensor]:
    """`pivots`, with zeros after a singular one, and (...) bool: whether all are finite."""
    blocks = pivots(D, L, U)
    sound = torch.isfinite(blocks)
    return torch.where(sound, blocks, 0.0), sound.all(-1).all(-1).all(-1)


def in_unit(blocks: Tensor, unit: Tensor | None) -> Tensor:
    """Blocks (..., n, k, k) of a quadratic form, by unknowns measured in `unit` (..., k), None = as
    they are.
    """
    return blocks if unit is None else unit[..., None, :, None] * blocks * unit[..., None, None, :]


def positive_definite(D: Tensor, L: Tensor, U: Tensor) -> Tensor:
    """(...) bool: whether a symmetric block tridiagonal matrix is positive definite: whether all of
    its pivot blocks are (Haynsworth 1968).
    """
    blocks = pivots(D, L, U)
    return (torch.linalg.cholesky_ex(blocks + blocks.mT).info == 0).all(-1)


def recorded() -> bool:
    """Whether derivatives are being recorded at all, backward or forward."""
    return torch.is_grad_enabled() or torch._C._is_fwd_grad_enabled()


class ChainSolve(torch.autograd.Function):
    """`block_tridiagonal` with a matrix that is a constant: forward mode and backward
    (the transposed system) in b.

    The matrix carries no gradient: this is the linear solve of the implicit function theorem, where
    the residual in b carries it all. Second derivatives through it would be wrong and are refused.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(D: Tensor, L: Tensor, U: Tensor, b: Tensor) -> Tensor:
        return block_tridiagonal(D, L, U, b)

    @staticmethod
    def setup_context(ctx, inputs, output) -> None:
        D, L, U, b = inputs
        ctx.save_for_backward(D, L, U, b)
        ctx.save_for_forward(D, L, U, b)

    @staticmethod
    def backward(ctx, grad: Tensor):
        D, L, U, b = ctx.saved_tensors
        # backward may be called where autocast is on
        with torch.no_grad(), torch.autocast(grad.device.type, enabled=False):
            g = block_tridiagonal(D.mT, U.mT, L.mT, grad).sum_to_size(b.shape)
        return None, None, None, first_only(g, grad, b)

    @staticmethod
    def jvp(ctx, _D, _L, _U, b_t: Tensor) -> Tensor:
        D, L, U, b = ctx.saved_tensors
        return first_only(block_tridiagonal(D, L, U, b_t), b_t, b)
