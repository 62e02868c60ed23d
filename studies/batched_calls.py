"""Repeats as one batch: threads, each with a repeat of its own, whose calls of a batched function
are evaluated together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Condition
from typing import TypeVar

import torch
from torch import Tensor

T = TypeVar("T")
S = TypeVar("S")
AT_ONCE = 50  # repeats
LARGEST = 4096  # samples of a call


@dataclass
class _Call:
    function: Callable[[Tensor], Tensor]
    x: Tensor
    y: Tensor | None = None
    error: Exception | None = None


class BatchedCalls:
    """Calls function(x (n, ...)) -> y (n, ...) of so many workers. Each waits until all that are
    still at work do; what they ask for is then one batch for each function, in parts of LARGEST
    samples.
    """

    def __init__(self, workers: int) -> None:
        self._workers, self._waiting, self._turn = workers, list[_Call](), Condition()

    def __call__(self, function: Callable[[Tensor], Tensor], x: Tensor) -> Tensor:
        call = _Call(function, x)
        with self._turn:
            self._waiting.append(call)
            self._evaluate_if_all_wait()
            while call.y is None and call.error is None:
                self._turn.wait()
        if call.y is None:
            raise call.error  # type: ignore[misc]
        return call.y

    def leave(self) -> None:
        """A worker is done."""
        with self._turn:
            self._workers -= 1
            self._evaluate_if_all_wait()

    def _evaluate_if_all_wait(self) -> None:
        if not self._waiting or len(self._waiting) < self._workers:
            return
        calls, self._waiting = self._waiting, []
        for function in dict.fromkeys(call.function for call in calls):
            some = [call for call in calls if call.function is function]
            try:
                y = torch.cat(
                    [function(x) for x in torch.cat([call.x for call in some]).split(LARGEST)]
                )
                for call, part in zip(some, y.split([len(call.x) for call in some]), strict=True):
                    call.y = part
            except Exception as error:
                for call in some:
                    call.error = error
        self._turn.notify_all()


def as_one_batch(work: Callable[[T, BatchedCalls], S], items: Sequence[T]) -> Iterator[S]:
    """work(item, calls) of each item, AT_ONCE at a time. Raises what one of them raises."""
    for first in range(0, len(items), AT_ONCE):
        some = items[first : first + AT_ONCE]
        calls = BatchedCalls(len(some))

        def run(item: T, calls: BatchedCalls = calls) -> S:
            torch.set_num_threads(1)
            try:
                return work(item, calls)
            finally:
                calls.leave()

        with ThreadPoolExecutor(len(some)) as pool:
            yield from pool.map(run, some)
