"""Local functions of a step that is a mean of two: of one midpoint step, and of several in a row
that start where it does.

Each solve takes a node's state X to an end E; beside X a node remembers another end Y. After it,
with the numbers a, e, y, k of the solve (`mixtures`), in all of X that has a mean,

    X <- a X + e E + y Y        Y <- k E + (1 - k) Y

so that the first solve keeps the whole step's end and goes back to the start, those in between go
on, and the last leaves the weighted mean, a unit quaternion made such again, and its own end, by
which the adjoint knows how it moved.
"""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from .local_functions import LocalFunctions
from .local_problem import Fields
from .row_kinds import NodeKind

OTHER = "other_"  # before the name of a node's field


def mixtures(parts: int, weights: tuple[float, float]) -> list[tuple[float, ...]]:
    """a, e, y, k of the solves of a step: of the whole, whose weight comes first, and of so many
    parts in a row.
    """
    of_whole, of_parts = weights
    between, last = (0.0, 1.0, 0.0, 0.0), (0.0, of_parts, of_whole, 1.0)
    return [(1.0, 0.0, 0.0, 1.0), *[between] * (parts - 1), last]


@dataclass(frozen=True)
class ExtrapolatedFunctions(LocalFunctions):
    """Functions of nodes, of elements and of what acts between nodes; those of the adjoint."""

    @property
    def state(self) -> tuple[str, ...]:
        fields = super().state
        return (*fields, *(f"{OTHER}{name}" for name in fields))

    def finish_node(self, kind: NodeKind, **fields: Tensor) -> Fields:
        """See `LocalFunctions.finish_node`, with the means above."""
        ends = super().finish_node(kind, **fields)
        a, e, y, k = self.common_of(fields).mixture.unbind(-1)
        after = dict(ends)
        for name in super().state:
            start, end, other = fields[name], ends[name], fields[f"{OTHER}{name}"]
            after[name] = a * start + e * end + y * other
            after[f"{OTHER}{name}"] = k * end + (1 - k) * other
        after["rotation"] = self.model.space.normalize(after["rotation"])
        return after

    def end(self, fields: Fields) -> tuple[Tensor, Tensor]:
        """Where the end is remembered, by it."""
        k = self.common_of(fields).mixture[3]
        position, rotation = (
            k * fields[f"after_{OTHER}{name}"] + (1 - k) * fields[f"after_{name}"]
            for name in ("position", "rotation")
        )
        return position, rotation
