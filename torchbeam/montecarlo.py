"""monte_carlo: a function of scattered parameters, in chunks that can run anywhere and be taken up again."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from .checks import count

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
                executor: Executor | None = None, out: str | Path | None = None, dtype: torch.dtype | None = None) -> Samples:
    """A function of n samples of parameters, in chunks.

    function  theta (N, p) -> y (N, ...), batched; or (y, status (N,)), with a status other than 0 for samples that failed
    laws      by name, in the order of theta's columns: (least, largest) for a uniform law; anything with `icdf`, such as
              torch.distributions.Normal(1.0, 0.1); or a function of u (N,), uniform in (0, 1), that gives (N,)
    n         samples: those of one scrambled Sobol sequence (Owen 1998), best a power of two. The first n of a longer run
              with the same seed are the same
    chunk     samples a call. Chunk i is a function of (seed, i) alone: who computes it, when, or how often does not matter
    executor  any concurrent.futures.Executor, such as ProcessPoolExecutor, or a Dask cluster's Client.get_executor(); None =
              here, one after the other. Function and laws must then pickle; other processes compute on one thread
    out       a folder: each chunk is a file there, written under another name and then renamed, and what is there already is
              not computed again; a run that was killed, or a larger n, continues. The function is known by its name alone:
              another folder, where it changes

    A sample with a y that is not finite has the status 1 and keeps its place. Raises ValueError for laws that are none, and a
    folder of another run.
    """
    names, chunk, n = tuple(laws), count("chunk", chunk), count("n", n)
    if not names:
        raise ValueError("no laws were given; one for each parameter is wanted")
    for name, law in laws.items():
        _checked(name, law)
    dtype = dtype or torch.get_default_dtype()
    folder = None if out is None else _folder(Path(out), function, laws, seed, chunk)
    jobs = [(function, tuple(laws.values()), seed, first, min(first + chunk, n), dtype, folder, os.getpid())
            for first in range(0, n, chunk)]
    done = map(_run, *zip(*jobs, strict=True)) if executor is None else _gathered(executor, jobs)
    theta, y, status = (torch.cat(part)[:n] for part in zip(*done, strict=True))
    return Samples(names, theta, y, status)


def sample(laws: tuple[Law, ...], seed: int, first: int, last: int, dtype: torch.dtype) -> Tensor:
    """Samples first to last - 1 of the sequence, (last - first, p)."""
    engine = torch.quasirandom.SobolEngine(len(laws), scramble=True, seed=seed)
    if first:
        engine.fast_forward(first)
    start = engine.quasi.double() / 2**engine.MAXBIT  # the engine itself keeps its first point in the default dtype
    u = engine.draw(last - first, dtype=torch.float64)
    u = (torch.cat((start[None], u[1:])) if first == 0 else u) + 2.0**-31  # multiples of 2^-30: now never 0, and never 1
    columns = []
    for law, v in zip(laws, u.unbind(-1), strict=True):
        if isinstance(law, (tuple, list)):
            columns.append(law[0] + (law[1] - law[0]) * v)
        else:
            columns.append(law.icdf(v) if hasattr(law, "icdf") else law(v))
    return torch.stack([torch.as_tensor(c, dtype=dtype) for c in columns], -1)


def _run(function: Function, laws: tuple[Law, ...], seed: int, first: int, last: int, dtype: torch.dtype, folder: Path | None,
         caller: int) -> tuple[Tensor, Tensor, Tensor]:
    """One chunk: theta, y, status; from its file, where there is one."""
    path = None if folder is None else folder / f"chunk-{first:09d}.pt"
    if path is not None and path.exists():
        stored = torch.load(path, weights_only=True)
        if len(stored["status"]) >= last - first:  # the last chunk of a smaller n is shorter
            return stored["theta"], stored["y"], stored["status"]
    if os.getpid() != caller:
        torch.set_num_threads(1)
    theta = sample(laws, seed, first, last, dtype)
    y = function(theta)
    y, status = y if isinstance(y, tuple) else (y, torch.zeros(len(theta), dtype=torch.long))
    if y.shape[:1] != theta.shape[:1]:
        raise ValueError(f"a function that gave y {tuple(y.shape)} was given; ({len(theta)}, ...) is wanted")
    y, status = y.detach(), status.detach()
    finite = torch.isfinite(y).reshape(len(y), -1).all(-1)
    status = torch.where((status == 0) & ~finite, FAILED, status)
    if path is not None:
        part = path.with_suffix(f".{os.getpid()}.part")
        torch.save(dict(theta=theta, y=y, status=status), part)
        os.replace(part, path)
    return theta, y, status


def _gathered(executor: Executor, jobs: list[tuple]) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    waiting = [executor.submit(_run, *job) for job in jobs]
    try:
        yield from (future.result() for future in waiting)
    finally:
        for future in waiting:
            future.cancel()


def _checked(name: str, law: Law) -> None:
    if isinstance(law, (tuple, list)):
        if len(law) != 2 or not all(isinstance(v, (int, float)) for v in law) or not law[0] < law[1]:
            raise ValueError(f"the law {law!r} was given for {name!r}; (least, largest) is wanted")
    elif not hasattr(law, "icdf") and not callable(law):
        raise ValueError(f"the law {law!r} was given for {name!r}; a pair, a distribution with icdf or a function is wanted")


def _folder(folder: Path, function: Function, laws: Mapping[str, Law], seed: int, chunk: int) -> Path:
    """The folder, made and labelled; ValueError where its label is another run's."""
    def known(law: Law) -> str:
        return repr(law) if isinstance(law, (tuple, list)) or hasattr(law, "icdf") else getattr(law, "__qualname__", "function")

    label = dict(function=getattr(function, "__qualname__", type(function).__name__), seed=seed, chunk=chunk,
                 laws={name: known(law) for name, law in laws.items()})
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "run.json"
    if path.exists():
        there = json.loads(path.read_text())
        if there != label:
            what = next(key for key in label if there.get(key) != label[key])
            raise ValueError(f"the folder {str(folder)!r} of a run with another {what} was given; another folder is wanted")
    else:
        part = path.with_suffix(f".{os.getpid()}.part")
        part.write_text(json.dumps(label, indent=1) + "\n")
        os.replace(part, path)
    return folder
