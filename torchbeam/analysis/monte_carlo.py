"""Monte Carlo evaluation of a function of random parameters, in chunks that run anywhere and can be resumed."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import count
from ..core.files import NotWritten
from ..core.validation import precision
from .chunks import Chunk, ChunkFolder

Function = Callable[[Tensor], Any]  # theta (N, p) -> y (N, ...), or (y, status (N,))
Law = Any  # (least, largest): uniform between; an object with icdf(u), as torch.distributions have; or a function of u
FAILED = 1  # status of a sample whose y is not finite


@dataclass(frozen=True)
class Samples:
    """theta (n, p), its columns by `names`; y (n, ...); status (n,): 0 = good. Statistics are of the good ones."""

    names: tuple[str, ...]
    theta: Tensor
    y: Tensor
    status: Tensor

    @property
    def good(self) -> Tensor:
        """y of the good samples."""
        return self.y[self.status == 0]

    @property
    def mean(self) -> Tensor:
        return self.good.mean(0)

    @property
    def deviation(self) -> Tensor:
        return self.good.std(0)

    def quantile(self, levels: Any) -> Tensor:
        """(levels, ...)"""
        return self.good.quantile(torch.as_tensor(levels, dtype=self.y.dtype), dim=0)

    def __repr__(self) -> str:
        failed = int((self.status != 0).sum())
        return f"Samples({len(self.y)} of {', '.join(self.names)}; {failed} failed; y {tuple(self.y.shape[1:])})"


def monte_carlo(function: Function, laws: Mapping[str, Law], n: int, *, seed: int = 0, chunk: int = 256,
                executor: Executor | None = None, out: str | Path | None = None, dtype: torch.dtype | None = None,
                version: str | int | None = None) -> Samples:
    """Evaluate a function at n samples of parameters, in chunks.

    function  theta (N, p) -> y (N, ...), batched; or (y, status (N,)), with a status other than 0 for samples that failed
    laws      by name, in the order of theta's columns: (least, largest) for a uniform law; anything with `icdf`, such as
              torch.distributions.Normal(1.0, 0.1); or a function of u (N,), uniform in (0, 1), that gives (N,)
    n         samples: those of one scrambled Sobol sequence (Owen 1998), best a power of two. The first n of a longer run
              with the same seed are the same
    chunk     samples a call. Chunk i is a function of (seed, i) alone: who computes it, when, or how often does not matter
    executor  any concurrent.futures.Executor, such as ProcessPoolExecutor, or a Dask cluster's Client.get_executor(); None =
              here, one after the other. Function and laws must then pickle; other processes compute on one thread
    out       a folder: each chunk is a file there, and what is there already is not computed again; a run that was killed, or a
              larger n, continues. A chunk that is damaged is computed again, with a warning. A folder of another run is
              refused: of other laws or another order of them, seed, chunk, dtype, release of this library, or function
    dtype     of theta; None = the default dtype
    version   of the function, a text or number of your own that changes with it. None: the function is known by its code,
              by what it closes over and by the globals and functions that it uses, and by the versions of packages. What
              it changes itself while it runs does not count

    A sample with a y that is not finite has the status 1 and keeps its place. y and status are detached and on the CPU.

    Raises ValueError for laws that are none, a function whose y does not fit, a folder of another run or one that cannot be
    written; files.NotWritten (an OSError) where the disk is full: what was written stays, and the same call continues.
    """
    chunk, n, seed, dtype = _settings(laws, n, seed, chunk, executor, dtype, version)
    names = tuple(laws)
    ends = [(first, min(first + chunk, n)) for first in range(0, n, chunk)]
    folder = None if out is None else ChunkFolder.of(
        out, function, dict(laws), None if version is None else str(version), seed=seed, chunk=chunk, dtype=str(dtype),
        sobol=_points(len(names), seed, 0, 4).tolist())
    found = {} if folder is None else {first: folder.get(first, last - first) for first, last in ends}
    jobs = [(function, dict(laws), seed, first, last, dtype, folder, os.getpid())
            for first, last in ends if found.get(first) is None]
    if folder is not None and jobs:
        folder.writable()
    made = (_run(*job) for job in jobs) if executor is None else _gathered(executor, jobs)
    try:
        chunks = [found.get(first) or next(made) for first, _ in ends]
    finally:
        made.close()
        if folder is not None and jobs:
            with suppress(NotWritten):
                folder.finish(function, dict(laws))
    kinds = [(y.dtype, tuple(y.shape[1:])) for _, y, _ in chunks]
    for (first, _), kind in zip(ends, kinds, strict=True):
        if kind != kinds[0]:
            raise ValueError(f"a function that gave y (N, ...) of {kinds[0]} and, from sample {first} on, of {kind} was given; "
                             "one kind is wanted")
    theta, y, status = (torch.cat(part)[:n] for part in zip(*chunks, strict=True))
    return Samples(names, theta, y, status)


def sample(laws: Mapping[str, Law], seed: int, first: int, last: int, dtype: torch.dtype) -> Tensor:
    """Samples first to last - 1 of the sequence, (last - first, p)."""
    columns = []
    for (name, law), v in zip(laws.items(), _points(len(laws), seed, first, last).unbind(-1), strict=True):
        if isinstance(law, (tuple, list)):
            column = law[0] + (law[1] - law[0]) * v
        else:
            column = law.icdf(v) if hasattr(law, "icdf") else law(v)
        wrong = (f"a {type(column).__name__}" if not isinstance(column, Tensor) else
                 f"{tuple(column.shape)}" if column.shape != v.shape else
                 "numbers that are not finite" if not torch.isfinite(column).all() else None)
        if wrong:
            raise ValueError(f"a law of {name!r} that gave {wrong} for u ({len(v)},) was given; finite numbers ({len(v)},) are "
                             "wanted")
        columns.append(column.to("cpu", dtype))
    return torch.stack(columns, -1)


def _points(p: int, seed: int, first: int, last: int) -> Tensor:
    """Points first to last - 1 of the scrambled Sobol sequence in (0, 1)^p, (last - first, p) float64."""
    engine = torch.quasirandom.SobolEngine(p, scramble=True, seed=seed)
    if first:
        engine.fast_forward(first)
    start = engine.quasi.double() / 2**engine.MAXBIT  # the engine itself keeps its first point in the default dtype
    u = engine.draw(last - first, dtype=torch.float64)
    return (torch.cat((start[None], u[1:])) if first == 0 else u) + 2.0**-31  # multiples of 2^-30: now never 0, and never 1


def _run(function: Function, laws: Mapping[str, Law], seed: int, first: int, last: int, dtype: torch.dtype,
         folder: ChunkFolder | None, caller: int) -> Chunk:
    """One chunk: theta, y, status; into its file, where there is a folder."""
    if os.getpid() != caller:
        torch.set_num_threads(1)
    theta = sample(laws, seed, first, last, dtype)
    given = function(theta.clone())
    y, status = given if isinstance(given, tuple) and len(given) == 2 else (given, torch.zeros(len(theta), dtype=torch.long))
    for name, value, wanted in (("y", y, f"({len(theta)}, ...)"), ("a status", status, f"({len(theta)},)")):
        if not isinstance(value, Tensor):
            raise ValueError(f"a function that gave {name} as a {type(value).__name__} was given; a tensor {wanted} is wanted")
        if value.shape[:1] != theta.shape[:1] or (value is status and value.ndim != 1):
            raise ValueError(f"a function that gave {name} {tuple(value.shape)} was given; {wanted} is wanted")
    y, status = y.detach().cpu(), status.detach().cpu().long()
    finite = torch.isfinite(y).reshape(len(y), -1).all(-1)
    chunk = theta, y, torch.where((status == 0) & ~finite, FAILED, status)
    if folder is not None:
        folder.put(first, chunk)
    return chunk


def _gathered(executor: Executor, jobs: list[tuple]) -> Generator[Chunk, None, None]:
    waiting = [executor.submit(_run, *job) for job in jobs]
    try:
        yield from (future.result() for future in waiting)
    finally:
        for future in waiting:
            future.cancel()


def _settings(laws: Any, n: Any, seed: Any, chunk: Any, executor: Any, dtype: Any, version: Any) -> tuple:
    """chunk, n, seed and dtype, if these are what they should be; ValueError otherwise."""
    if not isinstance(laws, Mapping):
        raise ValueError(f"laws = {laws!r} was given; a dict, name -> law, is wanted")
    if not laws:
        raise ValueError("no laws were given; one for each parameter is wanted")
    for name, law in laws.items():
        _checked(name, law)
    if executor is not None and not hasattr(executor, "submit"):
        raise ValueError(f"executor = {executor!r} was given; a concurrent.futures.Executor is wanted")
    if isinstance(version, bool) or not isinstance(version, (str, int, type(None))):
        raise ValueError(f"version = {version!r} was given; a text or a whole number is wanted")
    if dtype is not None and not isinstance(dtype, torch.dtype):
        raise ValueError(f"dtype = {dtype!r} was given; torch.float32 or torch.float64 is wanted")
    if count("seed", seed, 0) >= 2**63:
        raise ValueError(f"seed = {seed} was given; one below 2^63 is wanted")
    if count("n", n) > 2**30:
        raise ValueError(f"n = {n} was given; the sequence has 2^30 points")
    return count("chunk", chunk), n, seed, precision(dtype or torch.get_default_dtype())


def _checked(name: Any, law: Law) -> None:
    if not isinstance(name, str):
        raise ValueError(f"a law was given for {name!r}; a name is wanted")
    if isinstance(law, (tuple, list)):
        numbers = len(law) == 2 and all(isinstance(v, Real) and abs(v) < float("inf") for v in law)
        if not numbers or not law[0] < law[1]:
            raise ValueError(f"the law {law!r} was given for {name!r}; (least, largest) is wanted")
    elif not hasattr(law, "icdf") and not callable(law):
        raise ValueError(f"the law {law!r} was given for {name!r}; a pair, a distribution with icdf or a function is wanted")
