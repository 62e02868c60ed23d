"""Static condensation of midside nodes: from the matrix of a chain of elements of three nodes to
that of their end nodes.

With m the midside node of an element, i and j its ends, D_m u_m = b_m - L_m u_i - U_m u_j leaves of
the rows of i and j

    (D_i - U_i D_m^-1 L_m) u_i + (K_ij - U_i D_m^-1 U_m) u_j = b_i - U_i D_m^-1 b_m,
    and those of j likewise:

block tridiagonal. Midside nodes are neighbours of none but their own element's ends: all are
eliminated at once.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..math.block_tridiagonal import broadcast_matrices
from ..math.dense import solve_in_order
from .chain_sums import at_i, at_j


class Midside(NamedTuple):
    """D (..., N, w, w) of the midside nodes; by_i, by_j: D^-1 L, D^-1 U; to_i, to_j: in the rows of
    the elements' ends.
    """

    D: Tensor
    by_i: Tensor
    by_j: Tensor
    to_i: Tensor
    to_j: Tensor

    def condense(self, b: Tensor) -> tuple[Tensor, Tensor]:
        """Right-hand sides (..., 2 N + 1, w) -> (..., N+1, w) of the end nodes; D^-1 b
        (..., N, w).
        """
        own = solve_in_order(*broadcast_matrices(self.D, b[..., 1::2, :, None]))
        return b[..., ::2, :] - at_i((self.to_i @ own)[..., 0]) - at_j(
            (self.to_j @ own)[..., 0]
        ), own[..., 0]

    def restore(self, x: Tensor, own: Tensor) -> Tensor:
        """(..., 2 N + 1, w) of all nodes from x (..., N+1, w) of the end nodes and D^-1 b."""
        middle = following(own, self.by_i, self.by_j, x[..., :-1, :], x[..., 1:, :])
        inner = torch.stack(torch.broadcast_tensors(x[..., :-1, :], middle), -2).flatten(-3, -2)
        return torch.cat((inner, x[..., -1:, :].expand(*inner.shape[:-2], 1, -1)), -2)

    def detach(self) -> Midside:
        return Midside(*(x.detach() for x in self))


def condensed(
    D: Tensor, L: Tensor, U: Tensor, far_U: Tensor, far_L: Tensor
) -> tuple[Tensor, Tensor, Tensor, Midside]:
    """D, L, U of the end nodes, and what leads back, from the parts of the matrix of all nodes, see
    `ChainMatrix`.
    """
    middle, *by = broadcast_matrices(D[..., 1::2, :, :], L[..., ::2, :, :], U[..., 1::2, :, :])
    by_i, by_j = solve_in_order(middle, torch.cat(by, -1)).chunk(2, -1)
    to_i, to_j = U[..., ::2, :, :], L[..., 1::2, :, :]
    D = D[..., ::2, :, :] - at_i(to_i @ by_i, 2) - at_j(to_j @ by_j, 2)
    return D, far_L - to_j @ by_i, far_U - to_i @ by_j, Midside(middle, by_i, by_j, to_i, to_j)


def following(own: Tensor, by_i: Tensor, by_j: Tensor, x_i: Tensor, x_j: Tensor) -> Tensor:
    """(..., w) of midside nodes from those of their elements' ends, see `Midside`, and D^-1 b."""
    return own - (by_i @ x_i[..., None] + by_j @ x_j[..., None])[..., 0]
