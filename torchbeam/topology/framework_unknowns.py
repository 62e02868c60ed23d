"""Unknowns of a framework: what supports leave free."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class FrameworkUnknowns:
    """See `protocols.Unknowns`. moving (nodes, w) bool; free: the same as numbers, None = all
    is.
    """

    moving: Tensor
    free: Tensor | None

    @property
    def grouped(self) -> Tensor:
        """Which of the numbers of a vector of `FrameworkMatrix.grouped` are free moves, a mask."""
        return self.moving.flatten()

    def select(self, x: Tensor) -> Tensor:
        return x if self.free is None else x * self.free
