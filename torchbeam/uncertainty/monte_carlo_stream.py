"""Monte Carlo without keeping samples, in constant memory."""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import Executor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import torch

from ..core.arguments import boolean, choice
from ..core.files import NotWritten, path_of, save
from .chunks import ChunkFolder, loaded
from .evaluation import Evaluation, Function, points_of, progress_of, settings
from .joint_law import Correlation, JointLaw
from .laws import Law
from .moments import Moments
from .monte_carlo import DESIGNS, folder_of
from .progress import Report
from .samples import checked_sentences
from .sketch import Sketch
from .stream import Stream, summarised

EVERY = 10.0  # seconds from one writing of the summary to the next
FILE = "stream.pt"


def monte_carlo_stream(
    function: Function,
    laws: Mapping[str, Law],
    n: int,
    *,
    replicates: int = 16,
    correlation: Correlation | None = None,
    design: str = "sobol",
    seed: int = 0,
    chunk: int = 4096,
    executor: Executor | None = None,
    out: str | Path | None = None,
    dtype: torch.dtype | None = None,
    version: str | int | None = None,
    by_name: bool = False,
    sentences: Mapping[int, str] | None = None,
    progress: Report | bool | None = None,
) -> Stream:
    """Evaluate a function at n samples, as `monte_carlo`, and keep a summary of y in place of the
    samples.

    Args:
        n: a multiple of `replicates`, independent Sobol sequences whose scatter gives intervals.
            Memory does not grow with n: 70 kB for each number of y in each replicate
        out: a folder for the summary and the place in the sequence, written every ten seconds and
            at the end. The same call continues from it, and ends with the same numbers
        function, laws, correlation, design, seed, chunk, executor, dtype, version, by_name: as in
            `monte_carlo`
        sentences, progress: as in `monte_carlo`

    Raises:
        ValueError: as `monte_carlo`.

    Examples:
        >>> stream = tb.monte_carlo_stream(deflection, laws, 1024, by_name=True)
        >>> stream.quantile(0.95)
        tensor(0.4181)
    """
    joint = JointLaw.of(laws, correlation)
    choice("design", design, DESIGNS)
    out = None if out is None else path_of("out", out)
    boolean("by_name", by_name)
    n, seed, chunk, dtype = settings(function, n, seed, chunk, executor, dtype, version)
    points = points_of(n, replicates)
    plan = DESIGNS[design](joint.dimension, seed, points)
    label = dict(seed=seed, chunk=chunk, dtype=str(dtype), **plan.label)
    label |= dict(kept="summary", points=points)
    folder = folder_of(out, function, joint, version, **label)
    stream, done = Stream(joint.names, plan.independent), 0
    if folder is not None:
        stream, done = _taken_up(folder, stream)
    if done > n:
        raise ValueError(
            f"n = {n} was given for a folder with the summary of {done} samples; at least as "
            "many are wanted"
        )
    reduce = partial(summarised, checked_sentences(sentences))
    work = Evaluation(
        function, joint, plan, dtype, chunk, by_name, executor, None, n, points, reduce
    )
    at, written = progress_of(progress, n), time.monotonic()
    if at is not None and done:
        at.add(done, stream.failed, True)
    for part in work.chunks(done, n, at):  # summarised where it was computed
        stream.merge(done // points, part)
        done += part.samples
        if folder is not None and (done == n or time.monotonic() - written > EVERY):
            _write(folder, stream, done)
            written = time.monotonic()
    if folder is not None:
        with suppress(NotWritten):
            folder.finish(function, joint.laws)
    return stream


def _write(folder: ChunkFolder, stream: Stream, done: int) -> None:
    content = vars(stream), done
    path = folder.path / FILE
    save(path, {"stream": stream, "done": done, "checksum": folder.checksum(*content)})


def _taken_up(folder: ChunkFolder, empty: Stream) -> tuple[Stream, int]:
    """Summary in the folder, and of how many samples; `empty` where it is damaged or not there."""

    def content(stored: dict[str, Any]) -> tuple[Stream, int]:
        stream, done = stored["stream"], stored["done"]
        if stored["checksum"] != folder.checksum(vars(stream), done):
            raise ValueError("it is another run's, or its checksum is wrong")
        return stream, done

    known = loaded(folder.path / FILE, content)
    if known is None:
        folder.writable()
    return known or (empty, 0)


torch.serialization.add_safe_globals([Stream, Moments, Sketch])
