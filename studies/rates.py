"""CPU time of the mixed forms' rates: sweep, dense, the dense linear solve alone, minimal.

    python -m studies rates

One thread, float64, a soft cantilever with a changing tip load at random small states; median and
minimum of repeats.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence

import torch

from torchbeam.core.command_line import threads
from torchbeam.core.results import measured_on, sentence, table, write
from torchbeam.mixed import minimal
from torchbeam.mixed.model import MixedModel
from torchbeam.mixed.rates import block_system, solve_scaled, sweep, terms
from torchbeam.mixed.state import unpack
from torchbeam.scene.beam import Beam
from torchbeam.scene.effects import TipLoad
from torchbeam.scene.scene import Scene
from torchbeam.scene.section import Section

from .command import double_precision, study

CASES = ((1, 4096), (4, 256), (8, 256), (16, 256), (32, 256), (64, 256))  # elements, batch
DENSE_UP_TO = 16  # elements: 396 x 396
ROUTES = ("sweep", "minimal", "linalg.solve alone", "dense")
COLUMNS = ("elements", "batch", "what", "median_ms", "minimum_ms")


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
    """CPU time of the rates of a batch, by each route."""
    section = Section.from_stiffness(1e3, 400.0, 0.8, (1.0, 2.0), 1.0, (0.01, 0.01))
    model = MixedModel(
        Scene(Beam.straight(1.0, N, section), (TipLoad(force=tip_force),)), "block_rate"
    )
    t = model.nodes.new_tensor(0.1)
    generator = torch.Generator().manual_seed(0)
    x = unpack(
        0.1 * torch.randn(batch, 24 * N + 12, generator=generator, dtype=model.nodes.dtype), N
    )
    calls = {
        "sweep": timed(lambda: sweep(model, x, terms(model, t, x)), 15),
        "minimal": timed(lambda: minimal.rates(model, t, x.u, x.theta, x.V, x.Omega), 15),
    }
    if N <= DENSE_UP_TO:
        A, b = block_system(model, x, terms(model, t, x))
        calls["linalg.solve alone"] = timed(lambda: torch.linalg.solve(A, b), 5)
        calls["dense"] = timed(lambda: solve_scaled(*block_system(model, x, terms(model, t, x))), 5)
    return calls


def main(argv: Sequence[str] | None = None) -> int:
    """Time the rates of the mixed forms: O(N) sweep against the dense block rate matrix."""
    given, out = study(
        argv, "rates", __doc__.partition("\n")[0], quick="one element, a batch of 16"
    )
    with double_precision(), threads(1):
        rows, heading = list(measured(((1, 16),) if given.quick else CASES)), measured_on()
    text = f"{markdown(rows)}\n\n{sentence(heading)}"
    print(text)
    write(
        out,
        "rates",
        text,
        {**heading, "rows": [dict(zip(COLUMNS, row, strict=True)) for row in rows]},
        COLUMNS,
        rows,
    )
    return 0


def measured(cases: Iterable[tuple[int, int]]) -> Iterator[tuple]:
    """Rows of the table, one of each case and route; progress on stderr."""
    for N, batch in cases:
        print(f"{N} elements, batch {batch}", file=sys.stderr)
        for what, (median, least) in measure(N, batch).items():
            yield N, batch, what, round(median, 3), round(least, 3)


def markdown(rows: Sequence[tuple]) -> str:
    """One line a case: median ms of each route, and how many times as long as the sweep the dense
    matrix takes.
    """
    medians = {(N, batch, what): median for N, batch, what, median, _ in rows}
    lines = []
    for N, batch in dict.fromkeys((N, batch) for N, batch, *_ in rows):
        times = [medians.get((N, batch, what)) for what in ROUTES]
        cells = ["" if t is None else f"{t:.1f}" for t in times]
        ratio = "" if times[-1] is None else f"{times[-1] / times[0]:.0f}"
        lines.append((str(N), str(batch), *cells, ratio))
    return table(
        ("elements", "batch", *(f"{what}, ms" for what in ROUTES), "dense over sweep"),
        lines,
        words=0,
    )
