"""Static condensation of the midside nodes of a framework of order 2; see `midside`, whose formulas
these are, by index.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..math.block_tridiagonal import broadcast_matrices
from ..math.dense import solve_in_order
from .midside import following


class FrameworkMidside(NamedTuple):
    """framework: of order 2. D (..., N, w, w) of the midside nodes; by_i, by_j: D^-1 times their
    couplings to the elements' ends; to_i, to_j: in the rows of these.
    """

    framework: Any
    D: Tensor
    by_i: Tensor
    by_j: Tensor
    to_i: Tensor
    to_j: Tensor

    def condense(self, b: Tensor) -> tuple[Tensor, Tensor]:
        """Right-hand sides (..., nodes, w) -> of the end nodes; D^-1 b (..., N, w) of the
        others.
        """
        ends, middle = self.framework.ends, self.framework.elements[1]
        own = solve_in_order(*broadcast_matrices(self.D, b[..., list(middle), :, None]))
        push = ((self.to_i @ own)[..., 0], (self.to_j @ own)[..., 0])
        return b[..., list(ends), :] - self.framework.of_ends.scatter(push), own[..., 0]

    def restore(self, x: Tensor, own: Tensor) -> Tensor:
        """(..., nodes, w) from the end nodes' and D^-1 b."""
        i, j = self.framework.of_ends.gather(x)
        middle = following(own, self.by_i, self.by_j, i, j)
        both = torch.cat((x, middle.expand(*x.shape[:-2], *middle.shape[-2:])), -2)
        order = sorted(
            range(both.shape[-2]),
            key=(*self.framework.ends, *self.framework.elements[1]).__getitem__,
        )
        return both[..., order, :]

    def detach(self) -> FrameworkMidside:
        return FrameworkMidside(self.framework, *(x.detach() for x in self[1:]))


def condensed(
    framework: Any,
    D: Tensor,
    im: Tensor,
    ij: Tensor,
    mi: Tensor,
    mj: Tensor,
    ji: Tensor,
    jm: Tensor,
) -> tuple[Tensor, Tensor, Tensor, FrameworkMidside]:
    """D of the end nodes, an element's coupling from its first end to its last and back, and what
    leads back.
    """
    middle, mi, mj = broadcast_matrices(D[..., list(framework.elements[1]), :, :], mi, mj)
    by_i, by_j = solve_in_order(middle, torch.cat((mi, mj), -1)).chunk(2, -1)
    D = D[..., list(framework.ends), :, :] - framework.of_ends.scatter((im @ by_i, jm @ by_j), 2)
    return (
        D,
        ij - im @ by_j,
        ji - jm @ by_i,
        FrameworkMidside(framework, middle, by_i, by_j, im, jm),
    )
