"""The common dynamic case for other programs: reference, error, and a measured row. Wants NumPy
alone, so that a peer may live in an environment of its own.
"""

import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from statistics import median

import numpy as np

DATA = json.loads((Path(__file__).parents[2] / "studies/data/accuracy_references.json").read_text())
TIP = np.array(DATA["references"]["sudden"]["tip"])[:: DATA["intervals"] // 200]  # m, every 10 ms
T = np.linspace(0, 2, 201)  # s
# of a cantilever of 1 m along x
EA, GA, GJ, EI, MASS, INERTIA = 4e4, 1.4835e4, 0.769, 1.0, 0.2, 5e-6
COLUMNS = (
    "peer",
    "space",
    "elements",
    "element",
    "step_ms",
    "error",
    "best_cpu_s",
    "median_cpu_s",
    "rate",
    "batch",
)


def error(tip: np.ndarray) -> float:
    """RMS |tip - reference| / RMS |reference - its start| of a tip (time, 3)."""
    return float(np.sqrt(((tip - TIP) ** 2).sum() / ((TIP - TIP[0]) ** 2).sum()))


def measure(
    package: str,
    space: str,
    element: str,
    settings: Sequence[tuple[int, float]],
    run: Callable[[int, float], tuple[np.ndarray, float]],
    batch: int = 1,
) -> Iterator[dict]:
    """A row by `COLUMNS` of each setting (elements, step s), of the first alone without --ladder:
    of run(*setting), which gives the tip every 10 ms for 2 s and the CPU seconds that this took;
    rate in simulated s of all beams of a batch per CPU s. After one run to warm up. Batches
    are for --beside alone; with --samples, which is about something else, there are no rows.
    """
    beside = "--beside" in sys.argv
    if "--samples" in sys.argv or (batch > 1 and not beside):
        return
    repeats = 3 if beside or "--quick" in sys.argv or "--ladder" in sys.argv else 15
    for elements, step in settings if "--ladder" in sys.argv else settings[:1]:
        (tip, _), *runs = [run(elements, step) for _ in range(repeats + 1)]
        seconds = [cpu for _, cpu in runs]
        yield dict(
            zip(
                COLUMNS,
                (
                    f"{package} {version(package)}",
                    space,
                    elements,
                    element,
                    1e3 * step,
                    error(tip),
                    min(seconds),
                    median(seconds),
                    batch * T[-1] / min(seconds),
                    batch,
                ),
                strict=True,
            )
        )


def sampled(
    package: str, functions: Mapping[Callable[[float, float], float], int]
) -> Iterator[dict]:
    """A row of each function of a bending stiffness, N m^2, and a tip load, N, by its name: seconds
    that so many random samples take processes that have begun, one a core and two at least; how
    many failed; `at_means`, its value at 1 and 1. The laws are those of
    `python -m studies scale`.
    """
    processes = min(max(os.cpu_count() or 1, 2), 64)
    draw, sigma = np.random.default_rng(1), np.sqrt(np.log1p(0.2**2))
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        for function, n in functions.items():
            n = n // 10 if "--quick" in sys.argv else n
            EI_ = np.exp(-(sigma**2) / 2 + sigma * draw.standard_normal(n))
            P = 1 + 0.15 * draw.standard_normal(n)
            at_means, *_ = pool.map(function, [1.0] * 4 * processes, [1.0] * 4 * processes)
            start = time.perf_counter()
            y = np.array(
                list(
                    pool.map(
                        function, EI_.tolist(), P.tolist(), chunksize=max(n // (8 * processes), 1)
                    )
                )
            )
            yield dict(
                peer=f"{package} {version(package)}",
                what=function.__name__,
                processes=processes,
                samples=n,
                seconds=time.perf_counter() - start,
                failed=int((~np.isfinite(y)).sum()),
                at_means=float(at_means),
            )


def show(rows: Iterable[dict]) -> None:
    """Print rows as a table; with --json, one JSON object a line."""
    if "--json" in sys.argv:
        for row in rows:
            print(json.dumps(row), flush=True)
        return
    for k, row in enumerate(rows):
        if k == 0:
            print("".join(f"{name:>15s}" for name in row))
        print(
            "".join(
                f"{value:15.4g}" if isinstance(value, float) else f"{value!s:>15s}"
                for value in row.values()
            )
        )


def clock() -> float:
    return time.process_time()
