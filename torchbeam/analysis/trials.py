"""Comparison of two variants of a scene: change of an answer, tensor operations, CPU time."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor
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


def seconds(runs: Sequence[Callable[[], Any]], repeats: int) -> list[float]:
    """CPU seconds of each run, the least of `repeats`, in turns: what else the machine does falls
    on all alike.
    """
    best = [float("inf")] * len(runs)
    for _ in range(repeats):
        for k, run in enumerate(runs):
            begun = time.process_time()
            run()
            best[k] = min(best[k], time.process_time() - begun)
    return best


def repeated(state: Any, batch: int) -> Any:
    """A state without batch axes as a batch (batch,) of itself; as it is for one."""
    return state if batch == 1 else state.map(lambda x: x.expand(batch, *x.shape))


def change(answer: Tensor, reference: Tensor) -> float:
    """RMS of the difference over the RMS of what the reference has moved from its first instant (or
    of itself, where it did not move); time is the first axis.
    """
    moved = (reference - reference[:1]).square().mean()
    size = torch.where(moved > 0, moved, reference.square().mean())
    return ((answer - reference).square().mean() / size).sqrt().item()
