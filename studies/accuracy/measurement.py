"""Measurements of a setting: its error, and what the motion and a gradient cost, alone and in a
batch.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from statistics import median
from typing import Any

import torch

import torchbeam as tb
from studies.operations import repeated

from .motions import Motion
from .references import LOSS, Reference, apart, difference, differentiated
from .settings import OUTPUTS, Setting

BATCH = 256  # samples, of stiffness 0.95 to 1.05 times that of the motion
REPEATS = 5
ENOUGH = 0.08  # s that a part of a motion is to take by a batch


@dataclass(frozen=True)
class AccuracyRun:
    """What was found of a setting. Times are CPU s of one thread, least and median of the repeats;
    those of a batch are a sample's share of the whole motion, of which a part was made. None: not
    measured.

    fineness  number of steps, or rtol;  error: RMS distance of the tip from the reference, over RMS
              displacement
    gradient  s: forward and backward;  gradient_error: of the gradient, relative
    scaled    how many times as long the motion is as what of it was made (an explicit method that
              would take too long)
    """

    motion: str
    element: str
    method: str
    elements: int
    fineness: float
    steps: int | None = None
    error: float | None = None
    seconds: float | None = None
    seconds_median: float | None = None
    gradient: float | None = None
    gradient_median: float | None = None
    gradient_error: float | None = None
    batch: int | None = None
    batch_seconds: float | None = None
    batch_seconds_median: float | None = None
    batch_gradient: float | None = None
    batch_gradient_median: float | None = None
    repeats: int = 0
    scaled: float = 1.0
    note: str = ""


COLUMNS = tuple(f.name for f in fields(AccuracyRun))


def warm(motion: Motion, element: str, method: str, many: int) -> None:
    """Make the native code that measurements of an element and a method will use, alone and in a
    batch of so many (1 = none), forward and gradient. Raises ValueError where the method does not
    take the motion.
    """
    options = (
        dict(rtol=0.3) if method == "adaptive" else dict(method=method, step=1e-3 * motion.duration)
    )
    for plane, batch in ((True, ()), (False, ()), (False, (many,))):
        for gradient in (False, True) if not plane else (False,):
            if (plane and not motion.flat) or (batch and (method == "adaptive" or many == 1)):
                continue
            by = torch.ones(*batch, 3, dtype=torch.float64, requires_grad=gradient)
            with torch.set_grad_enabled(gradient), warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)
                sol = tb.simulate(
                    motion.scene(element, 4, by, flat=plane), 2e-3 * motion.instants(1), **options
                )
                if gradient:
                    sol.tip.position.square().sum().backward()


def forward(
    motion: Motion, setting: Setting, reference: Reference
) -> tuple[AccuracyRun, tb.Solution | None, list[float]]:
    """Error and the first time of a setting; no solution where it failed."""
    row = AccuracyRun(
        motion.name, setting.element, setting.method, setting.elements, setting.fineness
    )
    with torch.no_grad():
        seconds, sol = timed(lambda: setting.run(motion))
    steps = int(sol.stats.steps)
    if sol.status.any():
        why = next(iter(sol.stats.reason.values()), "failed")
        return replace(row, steps=steps, seconds=seconds, note=why), None, []
    every = (len(reference.tip) - 1) // setting.instants()
    error = difference(sol.tip.position, reference.tip[::every])
    return replace(row, steps=steps, error=error), sol, [seconds]


def costs(
    motion: Motion,
    setting: Setting,
    reference: Reference,
    row: AccuracyRun,
    sol: tb.Solution,
    seconds: list[float],
    allowed: float,
    batch: bool = True,
) -> AccuracyRun:
    """The row with all that a setting costs, within about as many CPU seconds as are allowed."""
    end = time.process_time() + allowed

    def left() -> float:
        return end - time.process_time()

    def run() -> None:
        with torch.no_grad():
            _ = setting.run(motion).tip.position

    seconds = seconds[:] if 2 * seconds[0] > left() else again(run, 0.3 * left())
    row = replace(row, seconds=min(seconds), seconds_median=median(seconds), repeats=len(seconds))
    if 6 * row.seconds < left():
        row = _gradient(motion, setting, reference, row, 0.5 * left())
    if batch and left() > 0:
        row = _batch(motion, setting, row, sol, left())
    return row


def timed(run: Callable[[], Any]) -> tuple[float, Any]:
    """CPU seconds and answer."""
    begun = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of samples that failed: the row says so
        answer = run()
    return time.process_time() - begun, answer


def again(run: Callable[[], Any], allowed: float) -> list[float]:
    """CPU seconds of repeats, within about as many seconds as are allowed; one at least."""
    times_taken = [timed(run)[0]]
    while len(times_taken) < REPEATS and sum(times_taken) + times_taken[-1] < allowed:
        times_taken.append(timed(run)[0])
    return times_taken


def _gradient(
    motion: Motion, setting: Setting, reference: Reference, row: AccuracyRun, allowed: float
) -> AccuracyRun:
    """With the gradient of the loss by the parameters."""
    gradients = []

    def run() -> None:
        gradients.append(
            differentiated(motion, lambda by: setting.run(motion, LOSS, by).tip.position)[1]
        )

    seconds = again(run, allowed)
    error, middle = apart(gradients[-1], reference.gradient), median(seconds)
    return replace(row, gradient=min(seconds), gradient_median=middle, gradient_error=error)


def _batch(
    motion: Motion, setting: Setting, row: AccuracyRun, sol: tb.Solution, allowed: float
) -> AccuracyRun:
    """With times of a batch: of a part of the motion from its middle, or of adaptive steps the
    whole.
    """
    whole, step = setting.method == "adaptive", motion.duration / setting.fineness
    many = int(min(BATCH, max(1.0, 2 * allowed / row.seconds) // 8 * 8)) if whole else BATCH
    if many < 8:
        return row
    spread = torch.ones(many, 3, dtype=torch.float64)
    spread[:, 0] = torch.linspace(0.95, 1.05, many, dtype=torch.float64)
    middle = setting.instants() // 2
    begin, start = sol.t[middle].item(), None if whole else repeated(sol.state[middle], many)
    most = 1 if whole else max(1, round((motion.duration - begin) / step))

    def run(steps: int, gradient: bool) -> None:
        by = spread.clone().requires_grad_(gradient)
        t = (
            motion.instants(OUTPUTS if not gradient else LOSS)
            if whole
            else begin + step * torch.tensor([0.0, steps], dtype=torch.float64)
        )
        with torch.set_grad_enabled(gradient):
            scene = motion.scene(setting.element, setting.elements, by)
            tip = tb.simulate(scene, t, start, **setting.options(motion)).tip.position
            if gradient:
                tip.square().sum().backward()

    measured: dict[str, Any] = dict(batch=many)
    for gradient, name in ((False, "batch_seconds"), (True, "batch_gradient")):
        steps = min(most, 10)
        end = time.process_time() + 0.4 * allowed
        if gradient and whole and 10 * measured["batch_seconds"] * many > allowed:
            break
        timed(partial(run, steps, gradient))
        pilot, _ = timed(partial(run, steps, gradient))
        steps = max(1, min(most, int(steps * ENOUGH / pilot)))
        times = again(partial(run, steps, gradient), end - time.process_time())
        share = (1.0 if whole else setting.fineness / steps) / many
        measured |= {name: share * min(times), f"{name}_median": share * median(times)}
    return replace(row, **measured)
