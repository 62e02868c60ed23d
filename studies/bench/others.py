"""Measurements from elsewhere: of packages built on torchbeam, found by entry point, and of other
programs, by scripts that print rows.

A package adds a function of `quick` that gives rows:

    [project.entry-points."torchbeam.benchmarks"]
    environments = "torchbeam_envs.benchmark:rows"
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from torchbeam.core.measurement import CPU, Measured, progress

from ..peers import measured

GROUP, PEERS = "torchbeam.benchmarks", "peers"


def measurements(quick: bool) -> Iterator[Measured]:
    """Rows of every package that has some."""
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        yield from entry.load()(quick)


def peers(folder: Path, python: str, quick: bool) -> Iterator[Measured]:
    """Rows of the scripts of a folder, see `measured`."""
    for one in measured(folder, python, *["--quick"] * quick):
        whole = one["rate"] * one["best_cpu_s"]
        names = "space", "elements", "step_ms", "error", "element"
        where: dict[str, Any] = {name: one[name] for name in names}
        median, what = whole / one["median_cpu_s"], "rate by CPU time"
        yield Measured(PEERS, what, one["rate"], median, CPU, engine=one["peer"], batch=1, **where)
        progress(
            f"{one['peer']}: {one['rate']:.4g} simulated s per CPU s at {100 * one['error']:.2f} %"
        )
