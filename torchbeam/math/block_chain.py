"""Block tridiagonal matrices of constants: products, sums and solutions, O(n)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from .block_tridiagonal import positive_definite


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
