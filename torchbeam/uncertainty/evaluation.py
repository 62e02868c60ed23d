"""Evaluation of a function at the points of a design, chunk by chunk, here or by an executor.

Results go from one process to another as bytes, in which tensors are arrays: between processes of
one machine torch itself sends a file descriptor for each tensor, by a
connection of its own, and both ends keep it open as long as the tensor lives: a run of some hundred
chunks would have more open files than a process may have.
"""

from __future__ import annotations

import io
import os
import pickle
import platform
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import count
from ..core.arguments import function as checked_function
from ..core.files import NotWritten
from ..core.memory import check_memory
from ..core.repetition import one_of
from ..core.validation import precision, refusal, shown
from ..core.warning import warn
from .called import Function, evaluated
from .chunks import Chunk, ChunkFolder
from .designs import SOBOL_POINTS
from .joint_law import JointLaw
from .progress import Progress, Report


class _Pickler(pickle.Pickler):
    def reducer_override(self, obj: Any) -> Any:
        # which NumPy has not: torch's own, slower, bytes
        if isinstance(obj, Tensor) and obj.dtype is not torch.bfloat16:
            return torch.from_numpy, (obj.numpy(),)
        return NotImplemented


def packed(result: Any) -> bytes:
    """Bytes of what holds tensors on the CPU, without gradients."""
    file = io.BytesIO()
    _Pickler(file, pickle.HIGHEST_PROTOCOL).dump(result)
    return file.getvalue()


def unpacked(result: Any) -> Any:
    """What was packed, or the result itself where it was not: one of this process."""
    return pickle.loads(result) if isinstance(result, bytes) else result


AHEAD = 1024  # chunks that an executor is given before the first of them is back


@dataclass(frozen=True)
class Job:
    """One chunk of an evaluation: samples first to last - 1, of its design's part. Calling it gives
    theta, y and status; whether they are written: into the folder, where there is one and this
    machine sees it; and what is doubtful, see `called`. Another process computes on one thread,
    with the caller's default dtype, and gives its result packed.
    """

    work: Evaluation
    first: int
    last: int
    caller: tuple[str, int]
    default: torch.dtype

    def __call__(self) -> tuple[Any, bool, str | None]:
        work, elsewhere = self.work, _here() != self.caller
        if elsewhere:
            torch.set_num_threads(1)
            torch.set_default_dtype(self.default)
        theta = work.design.theta(work.joint, self.first, self.last).detach().to(work.dtype)
        with one_of(work.total / (self.last - self.first)):
            *answer, doubt = evaluated(
                work.function, work.joint, theta.clone(), work.by_name, self.first
            )
        chunk = theta, *answer
        written = work.folder is not None and work.folder.reachable
        if written:
            work.folder.put(self.first, chunk)
        result = chunk if work.reduce is None else work.reduce(chunk)
        return packed(result) if elsewhere else result, written, doubt


@dataclass(frozen=True)
class Evaluation:
    """A function, the laws and design of its parameters, and how it is evaluated.

    total   samples of the run, as far as that is known: what is worth compiling depends on them all
    points  of each replicate, where no chunk may be of two
    reduce  what becomes of a chunk where it was computed, without a folder: something with
            `failed`, the number of samples
    told    what was doubtful first, of which a warning told
    """

    function: Function
    joint: JointLaw
    design: Any
    dtype: torch.dtype
    chunk: int
    by_name: bool = False
    executor: Executor | None = None
    folder: ChunkFolder | None = None
    total: int = 1
    points: int | None = None
    reduce: Callable[[Chunk], Any] | None = None
    told: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Raises MemoryError where the parameters of a call are more than there is memory for."""
        count = min(self.chunk, self.total)
        size = 2 * 8 * count * len(self.joint.names)  # and the numbers that they are drawn from
        check_memory(f"the parameters of {count} samples", size, "a smaller chunk is wanted")

    def chunks(
        self, first: int, last: int, progress: Progress | None = None
    ) -> Generator[Any, None, None]:
        """Chunks of samples first to last - 1, in order, stored ones too; reduced if asked for.
        Warns of the first that is doubtful.
        """
        stored: dict[int, Chunk] = {}
        todo: Iterable[tuple[int, int]] = self._ends(first, last)
        if self.folder is not None:
            stored = {
                a: chunk
                for a, b in self._ends(first, last)
                if (chunk := self.folder.get(a, b - a)) is not None
            }
            todo = [end for end in todo if end[0] not in stored]
            if todo:
                self.folder.writable()
        here, default = _here(), torch.get_default_dtype()
        jobs = (
            Job(replace(self, design=self.design.part(a, b), executor=None), a, b, here, default)
            for a, b in todo
        )
        results = (
            (job() for job in jobs) if self.executor is None else _gathered(self.executor, jobs)
        )
        try:
            for a, b in self._ends(first, last):
                known = stored.pop(a, None)
                chunk, written, doubt = (
                    (tuple(part[: b - a] for part in known), True, None)
                    if known is not None
                    else next(results)
                )
                if doubt and not self.told:
                    self.told.append(doubt)
                    warn(doubt)
                if self.folder is not None and not written:
                    self.folder.put(a, chunk)
                if progress is not None:
                    failed = int((chunk[2] != 0).sum()) if self.reduce is None else chunk.failed
                    progress.add(b - a, failed, known is not None)
                yield chunk
        finally:
            results.close()
            if self.folder is not None and todo:
                with suppress(NotWritten):
                    self.folder.finish(self.function, self.joint.laws)

    def _ends(self, first: int, last: int) -> Iterator[tuple[int, int]]:
        """First samples of chunks, and of those after them."""
        while first < last:
            end = min(first + self.chunk, last)
            if self.points is not None:
                end = min(end, (first // self.points + 1) * self.points)
            yield first, end
            first = end


def one_kind(chunks: Iterable[tuple[int, Chunk]]) -> None:
    """ValueError where y changes shape or dtype between chunks, given with first samples."""
    kind = None
    for first, (_, y, _) in chunks:
        now = (y.dtype, tuple(y.shape[1:]))
        if kind not in (None, now):
            raise refusal(
                f"a function that gave y (N, ...) of {kind} and, from sample {first} on, of {now}",
                "one kind",
            )
        kind = now


def settings(
    function: Any, n: Any, seed: Any, chunk: Any, executor: Any, dtype: Any, version: Any
) -> tuple[int, int, int, torch.dtype]:
    """n, seed, chunk and dtype; ValueError where they, or the others, are not as they should be."""
    checked_function("function", function)
    if executor is not None and not hasattr(executor, "submit"):
        raise refusal(f"executor = {shown(executor)}", "a concurrent.futures.Executor")
    if isinstance(version, bool) or not isinstance(version, (str, int, type(None))):
        raise refusal(f"version = {shown(version)}", "a text or a whole number")
    if dtype is not None and not isinstance(dtype, torch.dtype):
        raise refusal(f"dtype = {shown(dtype)}", "torch.float32 or torch.float64")
    if (seed := count("seed", seed, 0)) >= 2**63:
        raise refusal(f"seed = {seed}", "one below 2^63")
    if (n := count("n", n)) > SOBOL_POINTS:
        raise ValueError(f"n = {n} was given; the sequence has 2^30 points")
    return n, seed, count("chunk", chunk), precision(dtype or torch.float64)


def points_of(n: int, replicates: Any, fewest: int = 1, least: int = 1) -> int:
    """Points of each replicate, at least `least`, of at least `fewest` that n samples are shared
    out to; ValueError where that leaves some.
    """
    points = n // count("replicates", replicates, fewest)
    if points * replicates != n or points < least:
        each = f", of at least {least} points each," if least > 1 else ""
        raise ValueError(
            f"n = {n} was given for {replicates} replicates; a multiple{each} is wanted"
        )
    return points


def _here() -> tuple[str, int]:
    """Machine and process."""
    return platform.node(), os.getpid()


def _gathered(executor: Executor, jobs: Iterable[Callable[[], Any]]) -> Generator[Any, None, None]:
    """What jobs give, in their order; AHEAD of them at most are under way."""
    waiting: deque = deque()
    try:
        for job in jobs:
            waiting.append(executor.submit(job))
            if len(waiting) >= AHEAD:
                yield _result(waiting.popleft())
        while waiting:
            yield _result(waiting.popleft())
    finally:
        for future in waiting:
            future.cancel()


def _result(future: Any) -> tuple[Any, bool, str | None]:
    """What a job gave, once it is there."""
    result, *rest = future.result()
    return unpacked(result), *rest


def progress_of(report: Report | bool | None, total: int) -> Progress | None:
    """Progress of a run of so many samples, told to a function or, with True, to the terminal;
    ValueError for anything else.
    """
    return None if report is None or report is False else Progress(total, time.monotonic(), report)
