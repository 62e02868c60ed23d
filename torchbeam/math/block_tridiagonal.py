"""Block tridiagonal linear systems, batched: elimination in O(n), pivoting inside the blocks; and
block tridiagonal matrices of constants: products, sums and solutions, O(n).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from .dense import solve_in_order
from .shapes import broadcast_shapes


def forward(D: Tensor, L: Tensor, U: Tensor, b: Tensor) -> tuple[list[Tensor], list[Tensor]]:
    """D'^-1 U and D'^-1 b' of each row, in order: what the next row's unknowns, and the right-hand
    side, add to its own, see `eliminated`. U with n blocks: the last row has a next one too.
    """
    n, links = D.shape[-3], U.shape[-3]
    ahead, y = [], []
    for i in range(n):
        above = U[..., i, :, :] if i < links else None
        before = () if i == 0 else (L[..., i - 1, :, :], ahead[-1], y[-1])
        *solved, right = eliminated(D[..., i, :, :], above, b[..., i, :, :], *before)
        ahead.extend(solved)
        y.append(right)
    return ahead, y


def backward(ahead: list[Tensor], y: list[Tensor], after: Tensor | None = None) -> list[Tensor]:
    """The rows of x (..., k, m) from what `forward` gives, and the unknowns after the last one."""
    x = [y[-1] if after is None else y[-1] - ahead[-1] @ after]
    for i in range(len(y) - 2, -1, -1):
        x.append(y[i] - ahead[i] @ x[-1])
    return x[::-1]


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
    """(..., n, k, k) pivot blocks of the elimination, first to last, O(n)."""
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
    """Blocks (..., n, k, k) of a quadratic form, unknowns in `unit` (..., k) or as they are."""
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


class BlockChain(NamedTuple):
    """diagonal (..., n, k, k) blocks; upper, lower (..., n-1, k, k), to the right and below."""

    diagonal: Tensor
    upper: Tensor
    lower: Tensor

    @property
    def entries(self) -> Tensor:
        """(..., size) on the diagonal."""
        return self.diagonal.diagonal(dim1=-2, dim2=-1).flatten(-2)

    @property
    def mT(self) -> BlockChain:
        """Transposed."""
        return BlockChain(self.diagonal.mT, self.lower.mT, self.upper.mT)

    @property
    def size(self) -> int:
        """Of a vector."""
        return self.diagonal.shape[-3] * self.diagonal.shape[-1]

    def nodes(self, x: Tensor) -> Tensor:
        """A vector (..., size) -> (..., n, k, 1), for `times` and `FactoredChain.solve`."""
        return x.unflatten(-1, self.diagonal.shape[-3:-1])[..., None]

    def flat(self, x: Tensor) -> Tensor:
        """Back."""
        return x[..., 0].flatten(-2)

    def abs(self) -> BlockChain:
        return BlockChain(*map(torch.abs, self))

    def to(self, dtype: torch.dtype) -> BlockChain:
        return BlockChain(*(x.to(dtype) for x in self))

    def dense(self) -> Tensor:
        """(..., size, size)."""
        nodes, k = self.diagonal.shape[-3:-1]
        eye = torch.eye(self.size, dtype=self.diagonal.dtype, device=self.diagonal.device)
        return self.times(eye.unflatten(0, (nodes, k))).flatten(-3, -2)

    def symmetrised(self) -> BlockChain:
        """Of one that is symmetric up to rounding."""
        return BlockChain((self.diagonal + self.diagonal.mT) / 2, self.upper, self.upper.mT)

    def plus(self, factor: Tensor, other: BlockChain) -> BlockChain:
        """The sum with factor (...) times another one."""
        factor = factor[..., None, None, None]
        return BlockChain(*(a + factor * b for a, b in zip(self, other, strict=True)))

    def positive_definite(self) -> Tensor:
        """(...) bool, of a symmetric one."""
        return positive_definite(self.diagonal, self.lower, self.upper)

    def times(self, X: Tensor) -> Tensor:
        """The product with X (..., n, k, m)."""
        above, below = self.upper @ X[..., 1:, :, :], self.lower @ X[..., :-1, :, :]
        return self.diagonal @ X + pad(above, (0, 0, 0, 0, 0, 1)) + pad(below, (0, 0, 0, 0, 1, 0))

    def factored(self) -> FactoredChain:
        """For `FactoredChain.solve`."""
        lu, order, ahead = [], [], []
        for i in range(self.diagonal.shape[-3]):
            pivot = self.diagonal[..., i, :, :]
            if i > 0:
                pivot = pivot - self.lower[..., i - 1, :, :] @ ahead[-1]
            factors = torch.linalg.lu_factor_ex(pivot)
            lu.append(factors[0])
            order.append(factors[1])
            if i < self.upper.shape[-3]:
                ahead.append(torch.linalg.lu_solve(lu[-1], order[-1], self.upper[..., i, :, :]))
        return FactoredChain(self, lu, order, ahead)


class FactoredChain(NamedTuple):
    """Of each pivot block in order: LU, its pivoting, its inverse times the block to its right."""

    matrix: BlockChain
    lu: list[Tensor]
    order: list[Tensor]
    ahead: list[Tensor]

    def solve(self, load: Tensor) -> Tensor:
        """K^-1 load for load (..., n, k, m), refined once, as pivots may be ill conditioned."""
        x = self._swept(load)
        return x + self._swept(load - self.matrix.times(x))

    def _swept(self, load: Tensor) -> Tensor:
        loads, L = load.unbind(-3), self.matrix.lower.unbind(-3)
        down = []
        for i, (lu, order) in enumerate(zip(self.lu, self.order, strict=True)):
            right = loads[i] if i == 0 else loads[i] - L[i - 1] @ down[-1]
            down.append(torch.linalg.lu_solve(lu, order, right))
        x = [down[-1]]
        for i in range(len(down) - 2, -1, -1):
            x.append(down[i] - self.ahead[i] @ x[-1])
        return torch.stack(x[::-1], -3)
