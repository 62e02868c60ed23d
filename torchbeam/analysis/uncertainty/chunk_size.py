"""Chunk size of a run: from measured throughput and memory."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from typing import Any

from ...core.memory import available

LEAST, MOST = 32, 2**17
LONGEST = 20.0  # seconds of a chunk: what a killed worker loses, and a progress line waits for
GAIN = 1.1  # throughput over that of half the chunk, below which it is not worth more memory
SHARE = 0.5  # of the free memory, for all workers together


def chunk_size(work: Any, n: int) -> int:
    """Samples a call for an `Evaluation`: a power of two, doubled from 32 while the throughput rises by a tenth, a chunk takes
    less than LONGEST seconds, and all cores together take less than half of the free memory.

    It is measured in this process, at the first samples of the design; the first call of all, which may compile, does not
    count. With an executor there are at least four chunks a core.
    """
    workers = 1 if work.executor is None else getattr(work.executor, "_max_workers", os.cpu_count() or 1)
    most = min(MOST, n if work.executor is None else max(n // (4 * workers), LEAST))
    free = available()
    size, best = LEAST, 0.0
    _seconds(work, min(size, n))
    while True:
        before, size = _peak(), min(size, n)
        rate = size / _seconds(work, size)
        taken = max(_peak() - before, 0)  # what twice as many will take again, and more
        crowded = free is not None and 4 * taken * workers > SHARE * free
        slow = 2 * size / max(rate, 1e-9) > LONGEST
        if rate < GAIN * best and size > LEAST:
            return size // 2
        if crowded or slow or 2 * size > most:
            return size
        size, best = 2 * size, max(rate, best)


def _seconds(work: Any, size: int) -> float:
    begun = time.perf_counter()
    for _ in replace(work, chunk=size, executor=None, folder=None).chunks(0, size):
        pass
    return max(time.perf_counter() - begun, 1e-9)


def _peak() -> int:
    """Most bytes that this process has held so far; 0 = not known."""
    try:
        import resource
    except ImportError:  # Windows
        return 0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
