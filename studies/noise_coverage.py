"""python -m studies noise: how often intervals hold the truth where noise is not white, or not
normal.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.core.measurement import progress
from torchbeam.extend.commands import table

from .harness import Report, Study

REPEATS, LEVEL = 200, 0.95
READINGS, SIGMA = 100, 0.05
RHO = 0.8  # correlation of neighbours
SHARE, SIZE = 0.05, 10.0  # of readings that are outliers, and how many deviations these have
RUNS, SCATTER = 6, 0.1  # repeats of one experiment, and the deviation of the slope among them
TRUE = torch.tensor([1.0, 2.0], dtype=torch.float64)
T = torch.linspace(0, 1, READINGS, dtype=torch.float64)
ABOUT = (
    f"A line a + b t through {READINGS} readings is fitted {REPEATS} times, and it is counted "
    f"how often the stated {100 * LEVEL:g} % interval (`laplace`) holds the truth: so many repeats "
    "know that to 1.5 % (one deviation). Noise: independent; an autoregression of the first order "
    f"whose neighbours have a correlation of {RHO:g}; independent, and {100 * SHARE:g} % of the "
    f"readings with {SIZE:g} times its deviation; {RUNS} repeats of the experiment, among which b "
    f"has a deviation of {SCATTER:g}. The size of the noise is never given. Ratio: RMS of the "
    "error over that which the most exact of the rows with the same noise has."
)


@dataclass(frozen=True)
class Row:
    """Noise of the data, how it is said to be, coverage of a and b (share), RMS of their errors."""

    noise: str
    said: str
    a: float
    b: float
    rms_a: float
    rms_b: float
    repeats: int


def normal(seed: int, rho: float = 0.0) -> Tensor:
    random = torch.Generator().manual_seed(seed)
    e = torch.randn(READINGS, generator=random, dtype=torch.float64)
    for k in range(1, READINGS):
        e[k] = rho * e[k - 1] + (1 - rho * rho) ** 0.5 * e[k]
    return SIGMA * e


def outliers(seed: int) -> Tensor:
    random = torch.Generator().manual_seed(10_000 + seed)
    return normal(seed) * torch.where(torch.rand(READINGS, generator=random) < SHARE, SIZE, 1.0)


def scattered(seed: int) -> Tensor:
    random = torch.Generator().manual_seed(20_000 + seed)
    slopes = SCATTER * torch.randn(RUNS, 1, generator=random, dtype=torch.float64)
    return torch.stack([normal(RUNS * seed + k) for k in range(RUNS)]) + slopes * T


CASES: tuple[tuple[str, Callable[[int], Tensor], tuple[tuple[str, dict[str, str]], ...]], ...] = (
    ("independent", normal, (("white", {}), ("ar1", {"noise": "ar1"}), ("huber", {"loss": "huber"}),
                             ("student", {"loss": "student"}))),
    ("autoregression", lambda seed: normal(seed, RHO),
     (("white", {}), ("blocks", {"noise": "blocks"}), ("ar1", {"noise": "ar1"}))),
    ("outliers", outliers, (("white", {}), ("huber", {"loss": "huber"}),
                            ("student", {"loss": "student"}))),
    ("repeats", scattered, (("white", {}), ("repeats", {"noise": "repeats"}))),
)  # fmt: skip


def fitted(values: Tensor, said: dict[str, str]) -> tb.Fit:
    """Of readings (times,), or of repeats (runs, times), each with an offset of its own."""

    def line(theta: dict[str, Tensor]) -> Tensor:
        return theta["a"][:, None] + theta["b"][:, None] * T

    if values.ndim == 1:
        return tb.identify(line, tb.Measurement(values, times=T, **said), {"a": 0.5, "b": 1.0})
    data = {f"run {k}": tb.Measurement(v, times=T, **said) for k, v in enumerate(values)}
    return tb.identify(line, data, {"b": 1.0, "a": tb.Parameter(0.5, own=True)})


def measured(noise: str, draw: Callable[[int], Tensor], label: str, said: dict, n: int) -> Row:
    inside, errors = [], []
    for seed in range(n):
        fit = fitted(TRUE[0] + TRUE[1] * T + draw(seed), said)
        if fit.status:
            raise RuntimeError(f"{noise}, {label}, seed {seed}: {fit.message}")
        which = [next(k for k, x in enumerate(fit.names) if x.endswith(p)) for p in "ab"]
        low, high = fit.interval_without_warning(LEVEL)[which].unbind(-1)
        inside.append((low <= TRUE) & (high >= TRUE))
        errors.append(fit.theta[which] - TRUE)
    progress(f"{noise}, {label}: {n} fits")
    held = torch.stack(inside).double().mean(0).tolist()
    return Row(noise, label, *held, *torch.stack(errors).square().mean(0).sqrt().tolist(), n)


def markdown(rows: list[Row]) -> str:
    lines = []
    for row in rows:
        best = min(r.rms_b for r in rows if r.noise == row.noise)
        shares = (f"{100 * row.a:.1f}", f"{100 * row.b:.1f}", f"{row.rms_b / best:.2f}")
        lines.append((row.noise, row.said, *shares))
    return table("noise of the data | said to be | a: % | b: % | error of b, ratio", lines, words=2)


def study(options: Namespace) -> Iterator[Report]:
    rows: list[Row] = []
    for noise, draw, kinds in CASES:
        for label, said in kinds:
            rows.append(measured(noise, draw, label, said, 3 if options.quick else REPEATS))
    yield Report([ABOUT, markdown(rows)], rows, {"about": ABOUT})


main = Study(
    "noise",
    "How often stated intervals hold the truth where noise remembers, has outliers, or repeats "
    "scatter.",
    "Repeated identification of a line in synthetic noise of four kinds.",
    study,
    quick="three repeats of each",
)
