"""Sparse symmetric systems that are a sum over elements, with derivatives by the same factors.

SuperLU by scipy, sample by sample: sections differ in their numbers, not in their pattern. A dense
solution in torch costs n^3; a mesh of 1,000 nodes has n = 3,000.
"""

from __future__ import annotations

from copy import copy
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..core.validation import refusal
from .elements import plain


class Factors:
    """The unknowns of elements, and factors of the matrices that were assembled with them.

    dofs: (e, d) numbers of each element's unknowns. held: those that stay 0.
    """

    def __init__(self, dofs: Tensor, size: int, held: list[int]) -> None:
        self.numbers, self.device, self.size = plain(dofs), dofs.device, size
        free = np.ones(size, dtype=bool)
        free[held] = False
        self.free = np.flatnonzero(free)
        number = np.full(size, -1)
        number[self.free] = np.arange(len(self.free))
        local = number[self.numbers]
        rows = np.broadcast_to(local[:, :, None], (*local.shape, local.shape[1])).reshape(-1)
        columns = np.broadcast_to(local[:, None, :], (*local.shape, local.shape[1])).reshape(-1)
        self.use = np.flatnonzero((rows >= 0) & (columns >= 0))
        self.rows, self.columns = rows[self.use], columns[self.use]
        self.factors: list[Any] = []

    @property
    def dofs(self) -> Tensor:
        """Made where it is used: torch.func keeps tensors to the level at which they came."""
        return torch.from_numpy(self.numbers).to(self.device)

    def solve(self, elements: Tensor, right: Tensor) -> Tensor:
        """x (b, n, m) of the system of elements (b, e, d, d) and right (b, n, m)."""
        from scipy.sparse import coo_matrix
        from scipy.sparse.linalg import splu

        n = len(self.free)
        if len(self.factors) != len(elements):
            entries = elements.detach().cpu().numpy().reshape(len(elements), -1)[:, self.use]
            self.factors = []
            for row in entries:
                matrix = coo_matrix((row, (self.rows, self.columns)), shape=(n, n)).tocsc()
                matrix.eliminate_zeros()  # where warping across the plane and in it go apart
                try:
                    factor = splu(
                        matrix,
                        permc_spec="MMD_AT_PLUS_A",
                        diag_pivot_thresh=0.0,
                        options=dict(SymmetricMode=True),
                    )
                except RuntimeError:  # exactly singular
                    raise refusal(
                        "a cross-section in parts that do not hold together", "a connected one"
                    ) from None
                self.factors.append(factor)
        known = right.detach().cpu().numpy()[:, self.free]
        x = np.zeros(right.shape)
        for k, factor in enumerate(self.factors):
            x[k, self.free] = factor.solve(np.ascontiguousarray(known[k]))
        return torch.from_numpy(x).to(right)

    def product(self, elements: Tensor, x: Tensor) -> Tensor:
        """The matrix of elements (b, e, d, d) times x (b, n, m)."""
        parts = elements @ x[:, self.dofs]
        return torch.zeros_like(x).index_add(1, self.dofs.reshape(-1), parts.flatten(1, 2))


class Solve(torch.autograd.Function):
    """x of A x = b, A symmetric: dA and db by the adjoint A lambda = dx, backward and forward."""

    @staticmethod
    def forward(elements: Tensor, right: Tensor, factors: Factors) -> Tensor:
        return factors.solve(elements, right)

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        elements, _, ctx.factors = inputs
        ctx.save_for_backward(elements, output)
        ctx.save_for_forward(elements, output)

    @staticmethod
    def backward(ctx: Any, dx: Tensor) -> Any:
        elements, x = ctx.saved_tensors
        adjoint = Solve.apply(elements, dx, ctx.factors)
        dofs = ctx.factors.dofs
        return -adjoint[:, dofs] @ x[:, dofs].mT, adjoint, None

    @staticmethod
    def jvp(ctx: Any, d_elements: Tensor, d_right: Tensor, _: Any) -> Tensor:
        elements, x = ctx.saved_tensors
        right = torch.zeros_like(x) if d_right is None else d_right
        if d_elements is not None:
            right = right - ctx.factors.product(d_elements, x)
        return Solve.apply(elements, right, ctx.factors)

    @staticmethod
    def vmap(info: Any, in_dims: Any, elements: Tensor, right: Tensor, factors: Factors) -> Any:
        count = info.batch_size
        if in_dims[0] is None:  # more right sides of the same matrices
            right = right.movedim(in_dims[1], -1)
            x = Solve.apply(elements, right.flatten(-2), factors)
            return x.unflatten(-1, (-1, count)), 3
        elements, right = (
            x.expand(count, *x.shape) if axis is None else x.movedim(axis, 0)
            for x, axis in ((elements, in_dims[0]), (right, in_dims[1]))
        )
        several = copy(factors)
        several.factors = []
        x = Solve.apply(elements.flatten(0, 1), right.flatten(0, 1), several)
        return x.unflatten(0, (count, -1)), 0


def solve(elements: Tensor, right: Tensor, factors: Factors) -> Tensor:
    """x (..., n, m) of elements (..., e, d, d) and right (..., n, m), of the same leading axes."""
    lead = elements.shape[:-3]
    x = Solve.apply(
        elements.reshape(-1, *elements.shape[-3:]), right.reshape(-1, *right.shape[-2:]), factors
    )
    return x.reshape(*lead, *x.shape[-2:])
