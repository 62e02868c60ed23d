"""Functions of users that bring a batch of their own."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ...core.leaves import own_leaves, with_values
from ..compiler.trace import NotTraceable


class OwnBatch(NotTraceable):
    """A function that closes over a batch, of this shape."""

    def __init__(self, batch: torch.Size) -> None:
        super().__init__(
            f"a function has a batch {tuple(batch)} of its own; values= of a tb.Load take one"
        )
        self.batch = batch


def unbatched(value: Tensor, axes: int) -> Tensor:
    """What loads give one node, which has so many axes. Raises OwnBatch for more."""
    if value.ndim > axes:
        raise OwnBatch(value.shape[:-axes])
    return value


def of_one_sample(load: Any) -> Any:
    """A load whose functions read tensors by sample, each a batch of one: without that batch's axes
    in what they return.
    """
    axes = 2 if vars(load).get("node") is None else 1

    def one(x: Any) -> Any:
        if isinstance(x, (tuple, list)):
            return tuple(map(one, x))
        while isinstance(x, Tensor) and x.ndim > axes and len(x) == 1:
            x = x[0]
        return x

    return with_values(
        load,
        **{
            leaf.name: lambda *args, f=leaf.value, **named: one(f(*args, **named))
            for leaf in own_leaves(load)
            if leaf.axes is None and callable(leaf.value)
        },
    )
