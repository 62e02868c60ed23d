"""Chain: elements one after the other. Of order 1, element e lies between the nodes e and e + 1; of
order 2 it has the nodes 2 e, 2 e + 1 (midside) and 2 e + 2.
"""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor
from torch.nn.functional import pad

from ..math.quadratic import X, threes
from .chain_matrix import ChainMatrix
from .chain_sums import at_i, at_j, interleaved, spread
from .chain_unknowns import ChainUnknowns
from .protocols import Blocks


@dataclass(frozen=True)
class Chain:
    """See `protocols.Topology`."""

    order: int
    element_count: int

    @property
    def node_count(self) -> int:
        return self.order * self.element_count + 1

    def gather(self, x: Tensor, axes: int = 1) -> tuple[Tensor, ...]:
        if self.order == 1:
            N = self.element_count
            return x.narrow(-1 - axes, 0, N), x.narrow(-1 - axes, 1, N)
        return threes(x, axes)

    def scatter(self, parts: tuple[Tensor, ...], axes: int = 1) -> Tensor:
        if self.order == 1:
            return at_i(parts[0], axes) + at_j(parts[1], axes)
        return spread(*parts, axes)

    def arclength(self, length: Tensor) -> Tensor:
        if self.order == 1:
            return pad(length.cumsum(-1), (1, 0))
        return pad(within_elements(length, (0.0, 1.0)).flatten(-2), (1, 0))

    def unknowns(self, moving: Tensor, like: Tensor) -> ChainUnknowns:
        return ChainUnknowns.of(self, moving, like)

    def diagonal(self, blocks: Tensor) -> ChainMatrix:
        return ChainMatrix(self.order, blocks)

    def matrix(self, blocks: Blocks) -> ChainMatrix:
        if self.order == 1:
            (ii, ij), (ji, jj) = blocks
            return ChainMatrix(1, self.scatter((ii, jj), 2), (ij, ji))
        (ii, im, ij), (mi, mm, mj), (ji, jm, jj) = blocks
        return ChainMatrix(
            2,
            self.scatter((ii, mm, jj), 2),
            (interleaved(im, mj, 2), interleaved(mi, jm, 2), ij, ji),
        )


def within_elements(length: Tensor, x: tuple[float, ...]) -> Tensor:
    """Arc length (..., N, len(x)) m at places x in [-1, 1] of elements of order 2, of the lengths
    (..., 2 N) m that their stations stand for. With ds/dx = J + J' x, which is that length,
    s = s_0 + J (1 + x) + J' (x^2 - 1)/2: a midside node need not be in the middle.
    """
    first, second = length.unflatten(-1, (-1, 2))[..., None].unbind(-2)
    mean, slope, x = (first + second) / 2, (second - first) / (2 * X), length.new_tensor(x)
    whole = first + second
    return whole.cumsum(-2) - whole + mean * (1 + x) + slope * (x * x - 1) / 2
