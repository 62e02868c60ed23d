"""Static condensation of midside nodes: from the matrix of elements of three nodes to that of their
end nodes.

With m the midside node of an element, i and j its ends, D_m u_m = b_m - L_m u_i - U_m u_j leaves of
the rows of i and j

    (D_i - U_i D_m^-1 L_m) u_i + (K_ij - U_i D_m^-1 U_m) u_j = b_i - U_i D_m^-1 b_m,
    and those of j likewise.

Midside nodes are neighbours of none but their own element's ends: all are eliminated at once.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..math.block_tridiagonal import broadcast_matrices
from ..math.dense import solve_in_order
from .places import take


class Midside(NamedTuple):
    """framework: of order 2. D (..., N, w, w) of the midside nodes; by_i, by_j: D^-1 L, D^-1 U;
    to_i, to_j: in the rows of the elements' ends.
    """

    framework: Any
    D: Tensor
    by_i: Tensor
    by_j: Tensor
    to_i: Tensor
    to_j: Tensor

    def condense(self, b: Tensor) -> tuple[Tensor, Tensor]:
        """Right-hand sides (..., nodes, w) -> of the end nodes; D^-1 b (..., N, w) of others."""
        of = self.framework
        alone = solve_in_order(*broadcast_matrices(self.D, take(b, of.elements[1])[..., None]))
        push = (self.to_i @ alone)[..., 0], (self.to_j @ alone)[..., 0]
        return of.of_ends.without(take(b, of.ends), push), alone[..., 0]

    def restore(self, x: Tensor, alone: Tensor) -> Tensor:
        """(..., nodes, w) from the end nodes' and D^-1 b."""
        of = self.framework
        middle = following(alone, self.by_i, self.by_j, *of.of_ends.gather(x))
        both = torch.cat((x, middle.expand(*x.shape[:-2], *middle.shape[-2:])), -2)
        return take(both, of.ends_first)

    def detach(self) -> Midside:
        return Midside(self.framework, *(x.detach() for x in self[1:]))


def condensed(
    framework: Any, D: Tensor, U: Tensor, L: Tensor, far_U: Tensor, far_L: Tensor
) -> tuple[Tensor, Tensor, Tensor, Midside]:
    """D, U, L of the end nodes, and what leads back, from the parts of the matrix of all nodes, see
    `FrameworkMatrix`.
    """
    middle, by_i, by_j = broadcast_matrices(
        take(D, framework.elements[1], 2), L[..., ::2, :, :], U[..., 1::2, :, :]
    )
    by_i, by_j = solve_in_order(middle, torch.cat((by_i, by_j), -1)).chunk(2, -1)
    to_i, to_j = U[..., ::2, :, :], L[..., 1::2, :, :]
    D = framework.of_ends.without(take(D, framework.ends, 2), (to_i @ by_i, to_j @ by_j), 2)
    midside = Midside(framework, middle, by_i, by_j, to_i, to_j)
    return D, far_U - to_i @ by_j, far_L - to_j @ by_i, midside


def following(alone: Tensor, by_i: Tensor, by_j: Tensor, x_i: Tensor, x_j: Tensor) -> Tensor:
    """(..., w) of midside nodes from those of their elements' ends, see `Midside`, and D^-1 b."""
    return alone - (by_i @ x_i[..., None] + by_j @ x_j[..., None])[..., 0]
