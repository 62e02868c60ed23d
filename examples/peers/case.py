"""The common dynamic case for other programs: reference, error, and a measured row. Wants NumPy alone, so that a peer may
live in an environment of its own.
"""

import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from statistics import median

import numpy as np

DATA = json.loads((Path(__file__).parents[2] / "torchbeam/data/accuracy_references.json").read_text())
TIP = np.array(DATA["references"]["sudden"]["tip"])[::DATA["intervals"] // 200]  # m, every 10 ms
T = np.linspace(0, 2, 201)  # s
EA, GA, GJ, EI, MASS, INERTIA = 4e4, 1.4835e4, 0.769, 1.0, 0.2, 5e-6  # of a cantilever of 1 m along x
COLUMNS = ("peer", "space", "elements", "element", "step_ms", "error", "best_cpu_s", "median_cpu_s", "rate")


def error(tip: np.ndarray) -> float:
    """RMS |tip - reference| / RMS |reference - its start| of a tip (time, 3)."""
    return float(np.sqrt(((tip - TIP) ** 2).sum() / ((TIP - TIP[0]) ** 2).sum()))


def measure(package: str, space: str, element: str, settings: Sequence[tuple[int, float]],
            run: Callable[[int, float], tuple[np.ndarray, float]]) -> Iterator[dict]:
    """A row by `COLUMNS` of each setting (elements, step s), of the first alone without --ladder: of run(*setting), which gives
    the tip every 10 ms for 2 s and the CPU seconds that this took; rate in simulated s per CPU s. After one run to warm up.
    """
    repeats = 3 if "--quick" in sys.argv or "--ladder" in sys.argv else 15
    for elements, step in settings if "--ladder" in sys.argv else settings[:1]:
        (tip, _), *runs = [run(elements, step) for _ in range(repeats + 1)]
        seconds = [cpu for _, cpu in runs]
        yield dict(zip(COLUMNS, (f"{package} {version(package)}", space, elements, element, 1e3 * step, error(tip),
                                 min(seconds), median(seconds), T[-1] / min(seconds)), strict=True))


def show(rows: Iterable[dict]) -> None:
    """Print rows as a table; with --json, one JSON object a line."""
    if "--json" in sys.argv:
        for row in rows:
            print(json.dumps(row), flush=True)
        return
    print("".join(f"{name:>15s}" for name in COLUMNS))
    for row in rows:
        print("".join(f"{value:15.4g}" if isinstance(value, float) else f"{value!s:>15s}" for value in row.values()))


def clock() -> float:
    return time.process_time()
