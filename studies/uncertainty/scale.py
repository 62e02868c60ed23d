"""Cost of Monte Carlo: planar static samples and planar rollouts of 1 s, by chunk size and by
processes.

python -m studies scale [--peers examples/peers --python PEERS/bin/python]
"""

from __future__ import annotations

import gc
import os
import shutil
import tempfile
import time
from argparse import Namespace
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.core.measurement import progress
from torchbeam.extend.commands import process_pool, table, threads

from .. import peers
from ..harness import Report, Study
from ..peak_memory import peak_memory

TOTALS = {"static": 1_000_000, "rollout": 100_000}  # samples
# one part in so many: of the samples, for the first rows; of all of them, with --quick
SHARE, QUICK = 16, 10
CHUNKS = {"static": (256, 1024, 4096, 16384), "rollout": (64, 256, 1024, 4096)}
ELEMENTS, STEP = 8, 0.01  # s
WARM = 4096  # samples that equilibria are compiled for, whatever the chunk
LAWS = {"EI": tb.laws.LogNormal(1.0, 0.2), "P": tb.laws.Normal(1.0, 0.15)}
COLUMNS = (
    "what | run | processes | chunk | samples | seconds | CPU us/sample | samples/s | failed | "
    "MB of memory | bytes/sample on disk"
).split(" | ")
ABOUT = (
    "A strip of 1 m in a plane, {elements} elements, EI lognormal (1 N m^2, 20 %), tip load "
    "normal (1 N, 15 %): equilibria, and rollouts of 1 s after the load is put on suddenly, with "
    "damping, in steps of 10 ms, of which y is the largest deflection. The engine is the one that "
    "`auto` takes. First rows: one process and thread, a chunk size each. Last rows: all samples, "
    "by one process and by one for each core, kept with a folder of chunks, and as a stream. "
    "Memory: what the process had at most more than before, of the rows of one process. A first "
    "call of each, which may compile, does not count."
)
OTHERS = (
    "Rows with another program's name: the same beam, laws, step and number of nodes, each sample "
    "a system of its own that Python builds; few samples, as each costs the same."
)


@dataclass(frozen=True)
class ScaleRun:
    """Seconds and CPU microseconds a sample of a run; peak memory, MB, of this process over what it
    had before, and bytes that a sample took in the folder (nan: not measured).
    """

    what: str
    run: str
    processes: int
    chunk: int
    samples: int
    seconds: float
    cpu: float
    failed: int
    memory: float
    disk: float

    def cells(self) -> list[str]:
        return [
            self.what, self.run, str(self.processes), f"{self.chunk:,}", f"{self.samples:,}",
            f"{self.seconds:.1f}", *("-" if x != x else f"{x:.3g}" for x in (self.cpu,)),
            f"{self.samples / self.seconds:,.0f}", str(self.failed),
            *("-" if x != x else f"{x:.3g}" for x in (self.memory, self.disk)),
        ]  # fmt: skip


def scene(EI: Tensor, P: Tensor, *effects: Any) -> tb.Scene:
    section = tb.Section.from_stiffness(EA=4e4, GA=1.5e4, GJ=0.8, EI=EI, mass=0.2)
    force = tb.TipLoad(force=torch.stack((0 * P, 0 * P, P), -1))
    return tb.Scene(tb.Beam.straight(1.0, ELEMENTS, section), [force, *effects], plane="xz")


def static(EI: Tensor, P: Tensor) -> tuple[Tensor, Tensor]:
    """Tip deflection (N,) m and status."""
    state = tb.equilibrium(scene(EI, P), throw=False)
    return state.tip.position[:, 2], state.status


def rollout(EI: Tensor, P: Tensor) -> tuple[Tensor, Tensor]:
    """Largest tip deflection (N,) m of 21 instants, and status."""
    solution = tb.simulate(
        scene(EI, P, tb.Damping(0.01)),
        torch.linspace(0, 1, 21, dtype=EI.dtype),
        step=STEP,
        throw=False,
    )
    return solution.tip.position[..., 2].amax(0), solution.status


FUNCTIONS: dict[str, Callable[..., Any]] = {"static": static, "rollout": rollout}


def run(what: str, kind: str, samples: int, chunk: int, processes: int) -> ScaleRun:
    """One row: kind is "kept" (in memory), "folder" or "stream"."""
    samples = samples // 16 * 16
    out = Path(tempfile.mkdtemp(prefix="torchbeam-scale-")) if kind == "folder" else None
    gc.collect()
    pool = process_pool(processes) if processes > 1 else None
    try:
        with threads(1), pool or nullcontext():
            options = dict(replicates=16, by_name=True, executor=pool, dtype=torch.float64)
            # processes begin, and compile
            first = max(chunk if pool is None else 2 * processes * chunk, min(samples, WARM))
            tb.monte_carlo(
                FUNCTIONS[what], LAWS, first, chunk=chunk, seed=1, **{**options, "replicates": None}
            )
            taken = peak_memory()
            begun, cpu = time.perf_counter(), time.process_time()
            if kind == "stream":
                result: Any = tb.monte_carlo_stream(
                    FUNCTIONS[what], LAWS, samples, chunk=chunk, **options
                )
            else:
                result = tb.monte_carlo(
                    FUNCTIONS[what], LAWS, samples, chunk=chunk, out=out and out / "run", **options
                )
            seconds, cpu = time.perf_counter() - begun, time.process_time() - cpu
        disk = (
            sum(path.stat().st_size for path in (out / "run").iterdir()) / samples
            if out
            else float("nan")
        )
    finally:
        if out is not None:
            shutil.rmtree(out)
    alone = (1e6 * cpu / samples, taken()) if pool is None else (float("nan"), float("nan"))
    return ScaleRun(
        what, kind, processes, chunk, samples, seconds, alone[0], result.failed, alone[1], disk
    )


def rows(quick: bool, cores: int) -> list[ScaleRun]:
    """All rows; the chunk of the last ones is the fastest of the first."""
    table_rows: list[ScaleRun] = []
    for what, total in TOTALS.items():
        total = total // QUICK if quick else total
        each = [
            run(what, "kept", max(total // SHARE, 2 * chunk), chunk, 1) for chunk in CHUNKS[what]
        ]
        best = max(each, key=lambda row: row.samples / row.seconds).chunk
        kinds = [(kind, n) for n in (1, cores) for kind in ("folder", "stream")]
        ends = [run(what, kind, total, best, processes) for kind, processes in kinds]
        table_rows += [*each, *ends]
        for row in (*each, *ends):
            progress(" ".join(row.cells()))
    return table_rows


def other(given: Mapping[str, Any]) -> tuple[ScaleRun, str]:
    """Row of what another program's script measured, and in words: all samples at that rate, and y
    at the means beside ours.
    """
    what, samples, one = given["what"], given["samples"], torch.ones(1, dtype=torch.float64)
    unknown = float("nan")
    off = abs(given["at_means"] / FUNCTIONS[what](one, one)[0].item() - 1)
    count, seconds = given["processes"], given["seconds"]
    row = ScaleRun(
        what, given["peer"], count, 1, samples, seconds, unknown, given["failed"], unknown, unknown
    )
    return row, (
        f"{row.run}, {what}: {TOTALS[what]:,} samples would take "
        f"{TOTALS[what] * row.seconds / samples:,.0f} s, extrapolated from {samples:,}; y at the "
        f"means of the laws differs by {100 * off:.1f} %."
    )


def study(options: Namespace) -> Report:
    quick = ["--quick"] * options.quick
    scripts = [] if options.peers is None else [options.peers, options.python, "--samples", *quick]
    others = list(map(other, peers.measured(*scripts))) if scripts else []
    cores = min(os.cpu_count() or 1, 64)
    every = [*rows(options.quick, max(cores, 2)), *(row for row, _ in others)]
    cells = [row.cells() for row in every]
    text = [ABOUT.format(elements=ELEMENTS), table(COLUMNS, cells, 2)]
    if others:
        text.append(" ".join((OTHERS, *(said for _, said in others))))
    return Report(text, every, columns=COLUMNS, cells=cells)


main = Study(
    "scale",
    "Cost of Monte Carlo samples: planar statics and rollouts, by chunk size and by processes.",
    "Measures {static:,} static samples and {rollout:,} rollouts of 1 s.".format(**TOTALS),
    study,
    quick="a tenth of the samples",
    options=peers.OPTIONS,
)
