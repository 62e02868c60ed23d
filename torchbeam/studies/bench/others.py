"""Measurements from elsewhere: of packages built on torchbeam, found by entry point, and of other programs, by scripts that
print rows.

A package adds a function of `quick` that gives rows:

    [project.entry-points."torchbeam.benchmarks"]
    environments = "torchbeam_envs.benchmark:rows"
"""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path

from .measurement import CPU, Row, progress

GROUP, PEERS = "torchbeam.benchmarks", "peers"


def found(quick: bool) -> Iterator[Row]:
    """Rows of every package that has some."""
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        yield from entry.load()(quick)


def peers(folder: Path, python: str, quick: bool) -> Iterator[Row]:
    """Rows of the scripts of a folder that print them as JSON, each by `python` and on one thread; those of packages that are
    not installed are left out, and named. Raises ValueError for a folder without scripts.
    """
    scripts = [path for path in sorted(folder.glob("*.py")) if "__main__" in path.read_text()]
    if not scripts:
        raise ValueError(f"the folder {str(folder)!r} was given; one with scripts, as examples/peers is, is wanted")
    for path in scripts:
        done = subprocess.run([python, str(path), "--json", *["--quick"] * quick], capture_output=True, text=True,
                              env={**os.environ, "OMP_NUM_THREADS": "1"})
        if done.returncode:
            why = done.stderr.strip().splitlines()
            progress(f"{path.name} is left out: {why[-1] if why else f'exit status {done.returncode}'}")
            continue
        for one in map(json.loads, filter(lambda line: line.startswith("{"), done.stdout.splitlines())):
            whole = one["rate"] * one["best_cpu_s"]
            yield Row(PEERS, "rate by CPU time", one["rate"], whole / one["median_cpu_s"], CPU, engine=one["peer"],
                      space=one["space"], elements=one["elements"], step_ms=one["step_ms"], batch=1, error=one["error"],
                      element=one["element"])
            progress(f"{one['peer']}: {one['rate']:.4g} simulated s per CPU s at {100 * one['error']:.2f} %")
