"""Batch subset: the same problem for some samples of a batch, so that the others stop costing."""

from __future__ import annotations

from dataclasses import dataclass
from types import CellType, FunctionType, MethodType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .functions_of_time import taken
from .leaves import map_leaves
from .validation import concrete

# samples in a batch from which on a smaller one is faster (measured: even at 32, N = 8, one core)
LEAST = 64
SHARE = 0.8  # of them: where more are left, nobody is left out
PLAIN = (bool, int, float, complex, str)  # what is compared by its value


class NotSeparable(Exception):
    """Error: something holds a function of the motion, of unknown batch axes: no samples alone."""


@dataclass(frozen=True)
class BatchSubset:
    """Samples `index` (n,) of a batch with a single axis (count,).

    Examples:
        >>> few = extend.BatchSubset(torch.tensor([0, 2]), 3)
        >>> few.gather(tb.PointLoad(-1, force=torch.eye(3))).force  # of samples 0 and 2
        tensor([[1., 0., 0.],
                [0., 0., 1.]])
    """

    index: Tensor
    count: int

    @classmethod
    def worthwhile(cls, going: Tensor) -> BatchSubset | None:
        """Subset of the samples `going` (...), where solving these alone is faster; else None."""
        if going.ndim != 1 or len(going) < LEAST or going is not concrete(going):
            return None
        if not 0 < int(going.sum()) <= SHARE * len(going):
            return None
        return cls(going.nonzero()[:, 0], len(going))

    def gather(self, tree: Any) -> Any:
        """Tree (see `leaves`) of these samples alone. Values without batch axis, or with size 1,
        stay; samples of a function's values are selected. Differentiable. Raises `NotSeparable`.
        """
        return map_leaves(self._taken, tree)

    def scatter(self, tree: Any, part: Any) -> Any:
        """The tree with these samples replaced by the samples of `part`. Out of place,
        differentiable.
        """
        return map_leaves(self._replaced, tree, part)

    def merge(self, tree: Any, part: Any) -> Any:
        """`scatter`, where `part` was made for these samples by itself: what has no batch axis in
        either is everybody's and stays the tree's. Raises ValueError for a function that is not the
        same in both, for its values are unknown.
        """
        return map_leaves(self._merged, tree, part)

    def take(self, x: Tensor, axes: int) -> Tensor:
        """`gather` of one tensor with `axes` axes of its own."""
        axis = x.ndim - axes - 1
        if axis < 0 or x.shape[axis] != self.count:
            return x
        return x.index_select(axis, self.index)

    def put(self, x: Tensor, part: Tensor, axes: int) -> Tensor:
        """`scatter` of one tensor with `axes` axes of its own."""
        rest = x.shape[x.ndim - axes :]
        whole, own = (self.count, *rest), (len(self.index), *rest)
        x = x if x.shape == whole else x.expand(whole)
        return x.index_copy(0, self.index, part if part.shape == own else part.expand(own))

    def _taken(self, value: Any, axes: int | None) -> Any:
        if isinstance(value, Tensor) and axes is not None:
            return self.take(value, axes)
        if isinstance(value, np.ndarray) and axes is not None:
            return self.take(torch.from_numpy(value), axes).numpy()
        if not callable(value):
            return value
        if axes is None:
            raise NotSeparable
        return lambda t: self.take(taken("a function's value", value(t), t), axes)

    def _replaced(self, value: Any, axes: int | None, part: Any) -> Any:
        return self.put(value, part, axes) if isinstance(value, Tensor) else value

    def _merged(self, value: Any, axes: int | None, part: Any) -> Any:
        if isinstance(value, Tensor):
            return value if max(value.ndim, part.ndim) <= axes else self.put(value, part, axes)
        if callable(value) and not _same(value, part):
            raise ValueError(
                "a function that holds other things for some samples than for the rest of a batch "
                "was given; declared values are wanted (a load's `values`, a history)"
            )
        return value


def _same(a: Any, b: Any, met: frozenset[tuple[int, int]] = frozenset()) -> bool:
    """Whether two functions, or what they hold, are one or made alike; pairs `met` are."""
    if a is b or type(a) is not type(b):
        return a is b
    if isinstance(a, Tensor):
        return a.shape == b.shape and bool((a == b).all())
    if isinstance(a, FunctionType):
        one, other = map(_held, (a, b))
        if a.__code__ is not b.__code__ or one.keys() != other.keys():
            return False
        pair = id(a), id(b)
        return pair in met or all(_same(one[name], other[name], met | {pair}) for name in one)
    return isinstance(a, (MethodType, *PLAIN)) and a == b


def _held(function: FunctionType) -> dict[Any, Any]:
    """Defaults of a function by place and by name, and the variables that it closes over."""
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    held = dict(enumerate(function.__defaults__ or ())) | (function.__kwdefaults__ or {})
    filled = [(name, cell) for name, cell in cells if cell != CellType()]
    return held | {f"closed over {name}": cell.cell_contents for name, cell in filled}
