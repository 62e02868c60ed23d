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
        yield Measured(
            PEERS,
            "rate by CPU time",
            one["rate"],
            whole / one["median_cpu_s"],
            CPU,
            engine=one["peer"],
            space=one["space"],
            elements=one["elements"],
            step_ms=one["step_ms"],
            batch=1,
            error=one["error"],
            element=one["element"],
        )
        progress(
            f"{one['peer']}: {one['rate']:.4g} simulated s per CPU s at {100 * one['error']:.2f} %"
        )
