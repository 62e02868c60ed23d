"""How fast the rates are: sweep against dense, dense against its own linear solve, minimal beside them.

    python -m torchbeam rates

One thread, float64, a soft cantilever with a changing tip load at random small states; median and minimum of repeats.
"""

from __future__ import annotations

import argparse
import csv
import platform
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import torch

from ..beam import Beam
from ..cli import threads
from ..effects import TipLoad
from ..scene import Scene
from ..section import Section
from . import minimal
from .chain import Chain
from .rates import block_system, solve_scaled, sweep, terms
from .state import unpack

CASES = ((1, 4096), (4, 256), (8, 256), (16, 256), (32, 256), (64, 256))  # elements, batch
DENSE_UP_TO = 16  # elements: 396 x 396
COLUMNS = ("elements", "batch", "what", "median_ms", "minimum_ms", "torch", "dtype", "threads", "machine")


def tip_force(t: torch.Tensor) -> torch.Tensor:
    return torch.stack((0 * t, t, 3 * t))


def timed(function: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Median and minimum, ms, after one call to warm up."""
    function()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(1e3 * (time.perf_counter() - start))
    return sorted(times)[len(times) // 2], min(times)


def measure(N: int, batch: int) -> dict[str, tuple[float, float]]:
    """What it takes to get the rates of a batch, by each route."""
    section = Section.from_stiffness(1e3, 400.0, 0.8, (1.0, 2.0), 1.0, (0.01, 0.01))
    chain = Chain(Scene(Beam.straight(1.0, N, section), (TipLoad(force=tip_force),)), "block_rate")
    t = chain.nodes.new_tensor(0.1)
    generator = torch.Generator().manual_seed(0)
    x = unpack(0.1 * torch.randn(batch, 24 * N + 12, generator=generator, dtype=chain.nodes.dtype), N)
    found = {
        "sweep": timed(lambda: sweep(chain, x, terms(chain, t, x)), 15),
        "minimal": timed(lambda: minimal.rates(chain, t, x.u, x.theta, x.V, x.Omega), 15),
    }
    if N <= DENSE_UP_TO:
        A, b = block_system(chain, x, terms(chain, t, x))
        found["linalg.solve alone"] = timed(lambda: torch.linalg.solve(A, b), 5)
        found["dense"] = timed(lambda: solve_scaled(*block_system(chain, x, terms(chain, t, x))), 5)
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Time the rates of the mixed forms: O(N) sweep against the dense block rate matrix."""
    parser = argparse.ArgumentParser(prog="python -m torchbeam rates", description=__doc__.split("\n\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/rates"), help="folder for rates.csv (default: %(default)s)")
    out = parser.parse_args(argv).out
    out.mkdir(parents=True, exist_ok=True)
    dtype = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        with threads(1), (out / "rates.csv").open("w", newline="") as file:
            write(csv.writer(file))
    finally:
        torch.set_default_dtype(dtype)
    print("written to", out / "rates.csv")
    return 0


def write(table) -> None:
    """Measure every case into a csv writer, and say what was found."""
    table.writerow(COLUMNS)
    for N, batch in CASES:
        found = measure(N, batch)
        for what, (median, least) in found.items():
            table.writerow((N, batch, what, f"{median:.3f}", f"{least:.3f}", torch.__version__, "float64", 1,
                            platform.processor() or platform.machine()))
        print(f"N = {N}, batch {batch}:", ", ".join(f"{what} {m:.1f} ms" for what, (m, _) in found.items()), flush=True)
        if "dense" in found:
            dense = found["dense"][0]
            print(f"    dense / sweep = {dense / found['sweep'][0]:.1f},"
                  f" dense / its linear solve = {dense / found['linalg.solve alone'][0]:.2f}")
