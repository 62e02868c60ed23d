"""Options of evaluations: who makes them, in which chunks, and where they are kept."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import TypedDict

import torch

from .progress import Report


class EvaluationOptions(TypedDict, total=False):
    """Of a function at samples of its parameters, chunk by chunk.

    Args:
        chunk: samples a call. Chunk i is a function of (seed, i) alone: who computes it, when, or
            how often does not matter. None: 256; 512 from 32,768 samples on, 1,024 from 65,536 on.
            "auto": measured, from throughput and memory. With either a folder keeps its own
        executor: any concurrent.futures.Executor, such as ProcessPoolExecutor, or a Dask cluster's
            Client.get_executor(); None = here, one after the other. Function and laws must then
            pickle; other processes compute on one thread
        out: a folder: each chunk is a file there, and what is there already is not computed again;
            a run that was killed continues, and so does one with a larger n (with `replicates`,
            more of them of the same size; with `theta` of one's own, none). A chunk that is damaged
            is computed again, with a warning. A folder of another run is refused: of other laws or
            another order of them, correlation, design, seed, chunk, dtype, release of this library,
            or function
        dtype: of theta; None = torch.float64
        version: of the function, a text or number of your own that changes with it; asked for with
            `out`. None: the function is known by its code and by what it finds around it, with a
            FutureWarning where some of that cannot be seen. What it changes itself while it runs
            does not count
        by_name: the function takes its parameters by name: f(EI=(N,), mass=(N,)), a field as (N,
            places)
        sentences: what a status of the function means, {3: "buckled"}: reasons of samples that
            failed
        progress: a function that is given the `Progress` after each chunk, or True: a line on the
            terminal
    """

    chunk: int | str | None
    executor: Executor | None
    out: str | Path | None
    dtype: torch.dtype | None
    version: str | int | None
    by_name: bool
    sentences: Mapping[int, str] | None
    progress: Report | bool | None
