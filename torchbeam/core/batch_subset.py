"""Batch subset: the same problem for some samples of a batch, so that the others stop costing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .functions_of_time import taken
from .leaves import map_leaves
from .validation import concrete

LEAST = 64  # samples in a batch from which on a smaller one is faster (measured: even at 32, N = 8, one core)
SHARE = 0.8  # of them: where more are left, nobody is left out


class NotSeparable(Exception):
    """Error: the batch cannot be split into samples; something holds a function of the motion, of unknown batch axes."""


@dataclass(frozen=True)
class BatchSubset:
    """Samples `index` (n,) of a batch with the one axis (count,)."""

    index: Tensor
    count: int

    @classmethod
    def worthwhile(cls, going: Tensor) -> BatchSubset | None:
        """Subset of the samples that are `going` (...), where solving these alone is faster; else None."""
        if going.ndim != 1 or len(going) < LEAST or going is not concrete(going):
            return None
        if not 0 < int(going.sum()) <= SHARE * len(going):
            return None
        return cls(going.nonzero()[:, 0], len(going))

    def gather(self, tree: Any) -> Any:
        """Tree (see `leaves`) of these samples alone. What has no batch axis, or one of size 1, stays; of a function the
        values are taken. Differentiable. Raises `NotSeparable`.
        """
        return map_leaves(self._taken, tree)

    def scatter(self, tree: Any, part: Any) -> Any:
        """The tree with these samples replaced by those of `part`. Out of place; gradients of both survive."""
        return map_leaves(self._replaced, tree, part)

    def take(self, x: Tensor, axes: int) -> Tensor:
        """`gather` of one tensor with `axes` axes of its own."""
        axis = x.ndim - axes - 1
        if axis < 0 or x.shape[axis] != self.count:
            return x
        return x.index_select(axis, self.index)

    def put(self, x: Tensor, part: Tensor, axes: int) -> Tensor:
        """`scatter` of one tensor with `axes` axes of its own."""
        own = x.shape[x.ndim - axes:]
        return x.expand(self.count, *own).index_copy(0, self.index, part.expand(len(self.index), *own))

    def _taken(self, value: Any, axes: int | None) -> Any:
        if isinstance(value, Tensor) and axes is not None:
            return self.take(value, axes)
        if isinstance(value, np.ndarray) and axes is not None:
            return self.take(torch.from_numpy(value), axes).numpy()
        if callable(value):
            return self._function(value, axes)
        return value

    def _function(self, function: Callable[..., Any], axes: int | None) -> Callable[..., Any]:
        if axes is None:
            raise NotSeparable
        return lambda t: self.take(taken("a function's value", function(t), t), axes)

    def _replaced(self, value: Any, axes: int | None, part: Any) -> Any:
        return self.put(value, part, axes) if isinstance(value, Tensor) else value
