"""Measurements of the benchmark: rows, runs timed in turns, functions in a process of their own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from statistics import median
from typing import Any, NamedTuple

import torch

CPU, WALL = "simulated s per CPU s", "simulated s per s"  # rates by the clock


class Measured(NamedTuple):
    """One number. part: of the benchmark; best and median: of the repeats, both the number itself
    where it is not a time; engine: "eager", "compiled", or another program's name; error: of the
    tip, relative RMS; element: which one.
    """

    part: str
    what: str
    best: float
    median: float
    unit: str
    engine: str = ""
    space: str = ""
    elements: int | None = None
    step_ms: float | None = None
    batch: int | None = None
    threads: int = 1
    error: float | None = None
    element: str = ""

    @classmethod
    def of(cls, part: str, what: str, value: float, unit: str, **where: Any) -> Measured:
        """Of what is not repeated."""
        return cls(part, what, value, value, unit, **where)


class Times(NamedTuple):
    """Seconds of each repeat, by both clocks."""

    cpu: list[float]
    wall: list[float]

    def row(
        self,
        part: str,
        what: str,
        clock: str = "wall",
        unit: str = "s",
        per: float | None = None,
        **where: Any,
    ) -> Measured:
        """The time, or how much of `per` is done in a second."""
        values = (
            [per / s for s in getattr(self, clock)] if per is not None else getattr(self, clock)
        )
        return Measured(
            part, what, (min if per is None else max)(values), median(values), unit, **where
        )


def timed(runs: Sequence[Callable[[], Any]], repeats: int) -> list[Times]:
    """Times of each run, after one to warm up, in turns: the machine is the same to all."""
    measured = [Times([], []) for _ in runs]
    for k in range(repeats + 1):
        for run, times in zip(runs, measured, strict=True):
            cpu, wall = time.process_time(), time.perf_counter()
            run()
            cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
            if k:
                times.cpu.append(cpu)
                times.wall.append(wall)
    return measured


def thread_counts() -> tuple[int, ...]:
    """One, and two where the machine has them."""
    return (1, 2) if (os.cpu_count() or 1) > 1 else (1,)


def apart(
    function: Callable[..., dict[str, Any]],
    *args: Any,
    limit: float | None = None,
    **environment: str,
) -> dict[str, Any]:
    """What a function of this package finds in a new process, with one thread and more environment
    variables. Raises RuntimeError where it fails, subprocess.TimeoutExpired after `limit` s.
    """
    code = (
        f"import json, sys; from {function.__module__} import {function.__name__} as run; "
        "print(json.dumps(run(*json.loads(sys.argv[1]))))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, json.dumps(args)],
        capture_output=True,
        text=True,
        timeout=limit,
        env={**os.environ, "OMP_NUM_THREADS": "1", **environment},
    )
    if done.returncode:
        raise RuntimeError(f"{function.__name__} failed in a process of its own:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def progress(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def exponent(sizes: Sequence[float], seconds: Sequence[float]) -> float:
    """p of seconds = c size^p, by least squares of the logarithms."""
    x, y = (torch.tensor(v, dtype=torch.float64).log() for v in (sizes, seconds))
    x = x - x.mean()
    return (x @ y / (x @ x)).item()
