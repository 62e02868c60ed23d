"""Tensor operations of a call, counted."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torch.utils._python_dispatch import TorchDispatchMode


class Counter(TorchDispatchMode):
    """Counts tensor operations."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def __torch_dispatch__(
        self, function: Any, types: Any, args: tuple = (), kwargs: dict | None = None
    ) -> Any:
        self.count += 1
        return function(*args, **(kwargs or {}))


def operations(run: Callable[[], Any]) -> int:
    """Tensor operations of one call."""
    with Counter() as counter:
        run()
    return counter.count


def repeated(state: Any, batch: int) -> Any:
    """A state without batch axes as a batch (batch,) of itself; as it is for one."""
    return state if batch == 1 else state.map(lambda x: x.expand(batch, *x.shape))
