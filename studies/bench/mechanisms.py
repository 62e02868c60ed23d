"""Two mechanisms, a linkage and a hand: CPU time against error, of settings from coarse to fine, of
a model that is made; and of other programs, by their scripts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.core.measurement import CPU, Measured, progress, timed

from .. import mechanisms
from ..peers import measured

PART = "mechanisms"
BOUNDS = 0.01, 0.003, 0.001, 0.0003, 0.0001  # errors that are asked for in the table
# elements a beam, order of the elements, steps in the whole
SETTINGS = {
    "four-bar": ((3, 1, 50), (1, 2, 50), (1, 2, 100), (2, 2, 100), (3, 2, 200), (4, 2, 400),
                 (6, 2, 1000)),
    "hand": ((2, 1, 50), (1, 2, 50), (1, 2, 100), (2, 2, 100), (2, 2, 200), (3, 2, 400),
             (3, 2, 1000), (4, 2, 2000)),
}  # fmt: skip


def rows(quick: bool) -> Iterator[Measured]:
    """Simulated s by CPU time, with the error of each setting."""
    known = mechanisms.load()
    for name, settings in SETTINGS.items():
        for elements, order, steps in settings[:1] if quick else settings:
            run = _stepping(name, elements, order, steps)
            every = max(mechanisms.INTERVALS // steps, 1)
            error = mechanisms.error(run(), known[name].places[::every])
            (times,) = timed([run], 2 if quick else 5)
            where = dict(
                engine="torchbeam", space=mechanisms.SPACES[name], elements=elements,
                step_ms=1e3 * mechanisms.DURATION / steps, batch=1, error=error,
                element=f"order {order}",
            )  # fmt: skip
            yield _row(times.row(PART, name, "cpu", CPU, per=mechanisms.DURATION, **where))


def peers(folder: Path, python: str, quick: bool) -> Iterator[Measured]:
    """Of the scripts in `mechanisms` of a folder, if there is one."""
    if not (own := folder / PART).is_dir():
        return
    for one in measured(own, python, *["--quick"] * quick):
        names = "space", "elements", "element", "step_ms", "error"
        where: dict[str, Any] = {name: one[name] for name in names}
        median = mechanisms.DURATION / one["median_cpu_s"]
        yield _row(
            Measured(
                PART, one["what"], one["rate"], median, CPU, engine=one["peer"], batch=1, **where
            )
        )


def _row(row: Measured) -> Measured:
    progress(
        f"{row.what}, {row.engine}, {row.elements} elements, {row.element}, {row.step_ms:g} ms: "
        f"{1e3 * mechanisms.DURATION / row.best:.3g} ms at {100 * row.error:.2g} %"
    )
    return row


def _stepping(name: str, elements: int, order: int, steps: int) -> Callable[[], Tensor]:
    """Places at all instants, or at each step if these are longer; the model is made before."""
    stepper = tb.Stepper(
        mechanisms.scene(name, elements, order), mechanisms.DURATION / steps, engine="compiled"
    )
    start, every = stepper.rest(), max(steps // mechanisms.INTERVALS, 1)

    def run() -> Tensor:
        with torch.no_grad():
            states = start, tb.rollout(stepper, start, steps)
            first, after = (mechanisms.places(name, state) for state in states)
            return torch.cat((first[None], after))[::every]

    return run


def table(rows: Sequence[Measured]) -> tuple[Sequence[str], list[Sequence[str]]]:
    """Heads and lines: the least CPU ms of each program for an error, and its setting."""
    rows = [row for row in rows if row.part == PART]
    lines = []
    pairs = dict.fromkeys((row.what, row.engine) for row in rows)
    for what, engine in sorted(pairs, key=lambda pair: pair[0]):
        own = [row for row in rows if (row.what, row.engine) == (what, engine)]
        lines.append((what, engine, *(_cheapest(own, bound) for bound in BOUNDS)))
    return ("", "", *(f"{100 * bound:g} %" for bound in BOUNDS)), lines


def _cheapest(rows: Sequence[Measured], bound: float) -> str:
    """ms, (elements a beam, step)."""
    good = [row for row in rows if row.error <= bound]
    if not good:
        return ""
    row = max(good, key=lambda row: row.best)
    return f"{1e3 * mechanisms.DURATION / row.best:.3g} ({row.elements}, {row.step_ms:g} ms)"
