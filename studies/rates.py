"""CPU time of the mixed forms' rates: sweep, dense, the dense linear solve alone, minimal.

    python -m studies rates

One thread, float64, a soft cantilever with a changing tip load at random small states; median and
minimum of repeats.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Sequence
from statistics import median
from typing import NamedTuple

import torch

import torchbeam as tb
from torchbeam.core.measurement import progress, timed
from torchbeam.extend.commands import table
from torchbeam.mixed import minimal
from torchbeam.mixed.model import MixedModel
from torchbeam.mixed.rates import block_system, solve_scaled, sweep, terms
from torchbeam.mixed.state import unpack

from .harness import Report, Study

CASES = ((1, 4096), (4, 256), (8, 256), (16, 256), (32, 256), (64, 256))  # elements, batch
DENSE_UP_TO = 16  # elements: 396 x 396
ROUTES = ("sweep", "minimal", "linalg.solve alone", "dense")


class RateTime(NamedTuple):
    """Of a batch of beams, by one of `ROUTES`."""

    elements: int
    batch: int
    what: str
    median_ms: float
    minimum_ms: float


def tip_force(t: torch.Tensor) -> torch.Tensor:
    return torch.stack((0 * t, t, 3 * t))


def milliseconds(function: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Median and minimum."""
    (times,) = timed([function], repeats)
    return 1e3 * median(times.wall), 1e3 * min(times.wall)


def measure(N: int, batch: int) -> dict[str, tuple[float, float]]:
    """CPU time of the rates of a batch, by each route."""
    section = tb.Section.from_stiffness(1e3, 400.0, 0.8, (1.0, 2.0), 1.0, (0.01, 0.01))
    model = MixedModel(
        tb.Scene(tb.Beam.straight(1.0, N, section), (tb.TipLoad(force=tip_force),)), "block_rate"
    )
    t = model.nodes.new_tensor(0.1)
    generator = torch.Generator().manual_seed(0)
    x = unpack(
        0.1 * torch.randn(batch, 24 * N + 12, generator=generator, dtype=model.nodes.dtype), N
    )
    calls = {
        "sweep": milliseconds(lambda: sweep(model, x, terms(model, t, x)), 15),
        "minimal": milliseconds(lambda: minimal.rates(model, t, x.u, x.theta, x.V, x.Omega), 15),
    }
    if N <= DENSE_UP_TO:
        A, b = block_system(model, x, terms(model, t, x))
        calls["linalg.solve alone"] = milliseconds(lambda: torch.linalg.solve(A, b), 5)
        calls["dense"] = milliseconds(
            lambda: solve_scaled(*block_system(model, x, terms(model, t, x))), 5
        )
    return calls


def measured(cases: Iterable[tuple[int, int]]) -> Iterator[RateTime]:
    """Rows of the table, one of each case and route."""
    for N, batch in cases:
        progress(f"{N} elements, batch {batch}")
        for what, (middle, least) in measure(N, batch).items():
            yield RateTime(N, batch, what, round(middle, 3), round(least, 3))


def markdown(rows: Sequence[RateTime]) -> str:
    """One line a case: median ms of each route, and how many times as long as the sweep the dense
    matrix takes.
    """
    medians = {row[:3]: row.median_ms for row in rows}
    lines = []
    for case in dict.fromkeys(row[:2] for row in rows):
        times = [medians.get((*case, what)) for what in ROUTES]
        ratio = "" if times[-1] is None else f"{times[-1] / times[0]:.0f}"
        cells = ("" if t is None else f"{t:.1f}" for t in times)
        lines.append((*map(str, case), *cells, ratio))
    head = ("elements", "batch", *(f"{what}, ms" for what in ROUTES), "dense over sweep")
    return table(head, lines, words=0)


def study(options: Namespace) -> Report:
    rows = list(measured(((1, 16),) if options.quick else CASES))
    return Report([markdown(rows)], rows)


main = Study(
    "rates",
    "Time the rates of the mixed forms: O(N) sweep against the dense block rate matrix.",
    __doc__.partition("\n")[0],
    study,
    quick="one element, a batch of 16",
    double=True,
)
