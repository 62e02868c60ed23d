"""Chunk size of a run: by the number of samples, or from measured throughput and memory."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from typing import Any

from ..core.memory import available, most_held

LEAST, MOST, STEP = 32, 2**17, 4
LONGEST = 20.0  # seconds of a chunk: what a killed worker loses, and a progress line waits for
GAIN = 1.1  # throughput over that of a smaller chunk, below which it is not worth more memory
SHARE = 0.5  # of the free memory, for all workers together
USUAL = 256, 1024  # least and most of a chunk that nobody chose
CHUNKS = 64  # of a run, at least, before its chunks grow: so many workers have something to do


def usual_chunk(n: int) -> int:
    """Samples a call of a run of n samples: the same wherever it is computed, and little memory, as
    what y takes on its way is not known.
    """
    least, most = USUAL
    return min(max(2 ** max((n // CHUNKS).bit_length() - 1, 0), least), most)


def chunk_size(work: Any) -> int:
    """Samples a call for an `Evaluation`: of 32, 128, 512 ... the least whose throughput is within
    a tenth of the best, as long as a chunk takes less than LONGEST seconds, and all cores together
    less than half of the free memory.

    It is measured in this process, at the first samples of the design, an eighth of all at most:
    larger chunks may be worth native code, which smaller ones are not. The first call of each size,
    which may compile, does not count where it is short. With an executor there are at least four
    chunks a core.
    """
    n = work.total
    workers = (
        1 if work.executor is None else getattr(work.executor, "_max_workers", os.cpu_count() or 1)
    )
    most = max(min(MOST, n // 8 if work.executor is None else n // (8 * workers)), LEAST)
    free, size, rates = available(), LEAST, {}
    while True:
        size, before = min(size, n), most_held()
        seconds = _seconds(work, size)
        if seconds < LONGEST:
            seconds = min(seconds, _seconds(work, size))
        rates[size] = size / seconds
        # what so many more take; the next size takes STEP times as much, or more
        taken = max(most_held() - before, 0)
        crowded = free is not None and 2 * STEP * taken * workers > SHARE * free
        if crowded or STEP * seconds > LONGEST or STEP * size > most:
            best = max(rates.values())
            return min(size for size, rate in rates.items() if GAIN * rate >= best)
        size *= STEP


def _seconds(work: Any, size: int) -> float:
    begun = time.perf_counter()
    for _ in replace(work, chunk=size, executor=None, folder=None).chunks(0, size):
        pass
    return max(time.perf_counter() - begun, 1e-9)
