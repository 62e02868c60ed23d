"""Shapes of tensors."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor


def broadcast_shapes(*shapes: Sequence[int]) -> torch.Size:
    """Common broadcast shape. Raises RuntimeError where there is none. As `torch.broadcast_shapes`,
    whose first call imports a computer algebra system, for most of a second.

    Examples:
        >>> extend.broadcast_shapes((5, 1), (3,))
        torch.Size([5, 3])
    """
    sizes = [1] * max(map(len, shapes), default=0)
    for shape in shapes:
        for k, size in enumerate(reversed(shape), 1):
            if size != 1 and sizes[-k] not in (1, size):
                raise RuntimeError(
                    f"{', '.join(str(tuple(x)) for x in shapes)} were given; shapes that "
                    "broadcast are wanted"
                )
            sizes[-k] = sizes[-k] if size == 1 else size
    return torch.Size(sizes)


def stacked(*parts: Tensor, axis: int = -2) -> Tensor:
    """One after the other, of batch axes, before this one, that broadcast."""
    shape = broadcast_shapes(*(x.shape[:axis] for x in parts))
    return torch.cat([x.expand(*shape, *x.shape[axis:]) for x in parts], axis)


def largest(x: Tensor) -> int:
    """The largest of whole numbers that are not negative; 0 of none."""
    return int(x.max()) if x.numel() else 0
