"""Growth: time of the compiled case against elements, batch and horizon, with the exponent that
fits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch

import torchbeam as tb
from torchbeam.core.measurement import Measured, exponent, progress, timed

from ..common_case import SPACES, Case

PART, STEP = "growth", 0.005
LADDERS = {
    "elements": (16, 32, 64, 128, 256),
    "batch": (256, 512, 1024, 2048, 4096),
    "steps": (64, 128, 256, 512, 1024),
}
USUAL = {"elements": 10, "batch": 256, "steps": 64}


def rows(quick: bool) -> Iterator[Measured]:
    """Seconds of each size, others as usual, and the exponent."""
    case, repeats = Case.load(), 2 if quick else 3
    for space in ("plane",) if quick else SPACES:
        for what, sizes in LADDERS.items():
            sizes, seconds = sizes[:2] if quick else sizes, []
            runs = [_run(case, space, **USUAL | {what: size}) for size in sizes]
            for size, times in zip(sizes, timed(runs, repeats), strict=True):
                now = USUAL | {what: size}
                where = dict(elements=now["elements"], step_ms=1e3 * STEP, batch=now["batch"])
                of = f"{now['steps']} steps, by {what}"
                row = times.row(PART, of, "cpu", engine="compiled", space=space, **where)
                seconds.append(row.best)
                yield row
            power = exponent(sizes, seconds)
            yield Measured.of(
                PART, f"exponent of {what}", power, "", engine="compiled", space=space
            )
            progress(f"{space}: time grows with {what} to the power {power:.2f}")


def _run(case: Case, space: str, elements: int, batch: int, steps: int) -> Callable[[], None]:
    scene = case.scene(elements, SPACES[space])
    start, t = tb.rest(scene, (batch,)), case.t.new_tensor((0.0, steps * STEP))

    def run() -> None:
        with torch.no_grad():
            tb.simulate(scene, t, start, step=STEP, engine="compiled")

    return run
