"""Forces of constraints: multipliers, unknowns like the stress of elements, which stand in rows
behind it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from ..core.leaves import Tree, leaf
from ..math.shapes import stacked

ROUNDING = 1000.0  # eps: places that floating point does not tell apart
# what a gap over the size of the whole is measured against: 1e-8 of it is 1e-14 of that size
CLOSED = 1e-6


@dataclass(frozen=True)
class Multipliers(Tree):
    """Of J rows of w, of which those are there that `held` (J, w) has as 1; None = there are no
    rows. size (...) m of the whole.
    """

    held: Tensor | None = leaf(2, default=None)
    size: Tensor | None = leaf(0, default=None)

    @property
    def count(self) -> int:
        """Of rows."""
        return 0 if self.held is None else len(self.held)

    @property
    def held_count(self) -> int:
        """How many constraints there are."""
        return 0 if self.held is None else int(self.held.sum())

    def split(self, stress: Tensor) -> tuple[Tensor, Tensor | None]:
        """Stress or gaps: (of the elements (..., N, k), of the rows (..., J, w), None = none)."""
        if self.held is None:
            return stress, None
        N = stress.shape[-2] - self.count
        return stress.narrow(-2, 0, N), stress.narrow(-2, N, self.count)

    def with_forces(self, stress: Tensor, forces: Tensor | None) -> Tensor:
        """Stress of elements, and behind it forces (..., m) of constraints, None = 0."""
        if self.held is None:
            return stress
        rows = torch.zeros_like(self.held).flatten()
        if forces is not None:
            held = self.held.flatten().nonzero()[:, 0]
            rows = rows.expand(*forces.shape[:-1], -1).index_copy(-1, held, forces)
        return stacked(stress, rows.unflatten(-1, self.held.shape))

    def measure(self, size: Tensor, gap: Tensor | None) -> Tensor:
        """(...) a scaled residual, with the largest that is apart."""
        if self.held is None:
            return size
        p = (self.held.shape[-1] + 1) // 2  # of 6: 3, of 3: 2
        apart = torch.maximum(
            gap[..., :p].abs().amax((-1, -2)) / self.size, gap[..., p:].abs().amax((-1, -2))
        )
        return measured(size, apart)

    def span(self, lengths: Tensor) -> Tensor:
        """(..., 1, 1) m, the size of what has no elements, whose lengths (..., 0, 1) are none."""
        return lengths.new_ones(1, 1) if self.held is None else self.size[..., None, None]

    def asked(self, push: Tensor, gap: Tensor | None) -> Tensor:
        """Right-hand side of a system: loads on the nodes, and gaps that are to be closed."""
        return push if self.held is None else stacked(push, -gap)

    def answered(
        self, solution: Tensor, change: Callable[[Tensor], Tensor]
    ) -> tuple[Tensor, Tensor]:
        """(moves of the nodes, change of stress and of these) of its solution; change(moves): that
        of the stress.
        """
        moves, forces = self.split(solution)
        return moves, change(moves) if forces is None else stacked(change(moves), forces)


def measured(size: Tensor, apart: Tensor) -> Tensor:
    """(...) a scaled residual, with the largest that is apart, over the whole's size, or turned."""
    rounding = ROUNDING * torch.finfo(apart.dtype).eps
    return torch.maximum(size, (apart - rounding).clamp(min=0) / CLOSED)
