"""Symmetric block tridiagonal matrices, of constants: products, sums, and solutions of many
right-hand sides, O(n).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from .block_tridiagonal import positive_definite


class SymmetricChain(NamedTuple):
    """diagonal (..., n, k, k) blocks; upper (..., n-1, k, k) those to their right."""

    diagonal: Tensor
    upper: Tensor

    @property
    def largest(self) -> Tensor:
        """(...) on the diagonal, of whatever sign."""
        return self.diagonal.diagonal(dim1=-2, dim2=-1).abs().amax((-1, -2))

    def plus(self, factor: Tensor, other: SymmetricChain) -> SymmetricChain:
        """The sum with factor (...) times another one."""
        factor = factor[..., None, None, None]
        return SymmetricChain(
            self.diagonal + factor * other.diagonal, self.upper + factor * other.upper
        )

    def positive_definite(self) -> Tensor:
        """(...) bool."""
        return positive_definite(self.diagonal, self.upper.mT, self.upper)

    def times(self, X: Tensor) -> Tensor:
        """The product with X (..., n, k, m)."""
        above, below = self.upper @ X[..., 1:, :, :], self.upper.mT @ X[..., :-1, :, :]
        return self.diagonal @ X + pad(above, (0, 0, 0, 0, 0, 1)) + pad(below, (0, 0, 0, 0, 1, 0))

    def factored(self) -> FactoredChain:
        """For `FactoredChain.solve`."""
        lu, order, ahead = [], [], []
        for i in range(self.diagonal.shape[-3]):
            pivot = self.diagonal[..., i, :, :]
            if i > 0:
                pivot = pivot - self.upper[..., i - 1, :, :].mT @ ahead[-1]
            factors = torch.linalg.lu_factor_ex(pivot)
            lu.append(factors[0])
            order.append(factors[1])
            if i < self.upper.shape[-3]:
                ahead.append(torch.linalg.lu_solve(lu[-1], order[-1], self.upper[..., i, :, :]))
        return FactoredChain(self, lu, order, ahead)


class FactoredChain(NamedTuple):
    """Of each pivot block from the first to the last: LU, its pivoting, and its inverse times the
    block to its right.
    """

    matrix: SymmetricChain
    lu: list[Tensor]
    order: list[Tensor]
    ahead: list[Tensor]

    def solve(self, load: Tensor) -> Tensor:
        """K^-1 load for load (..., n, k, m), refined once: pivots next to impossible strains are
        ill conditioned.
        """
        x = self._swept(load)
        return x + self._swept(load - self.matrix.times(x))

    def _swept(self, load: Tensor) -> Tensor:
        loads, U = load.unbind(-3), self.matrix.upper.unbind(-3)
        down = []
        for i, (lu, order) in enumerate(zip(self.lu, self.order, strict=True)):
            right = loads[i] if i == 0 else loads[i] - U[i - 1].mT @ down[-1]
            down.append(torch.linalg.lu_solve(lu, order, right))
        x = [down[-1]]
        for i in range(len(down) - 2, -1, -1):
            x.append(down[i] - self.ahead[i] @ x[-1])
        return torch.stack(x[::-1], -3)
