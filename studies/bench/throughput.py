"""Throughput: the common dynamic case through the public API, eager beside compiled, with the error
of each setting.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import torch

import torchbeam as tb
from torchbeam.core.measurement import CPU, WALL, Measured, apart, progress, thread_counts, timed
from torchbeam.extend.commands import threads

from ..common_case import KINDS, SPACES, Case, motion

PART = "throughput"
BOUNDS = {"3D": 0.01, "plane": 0.007}  # errors that a setting may have
BATCHES = {"3D": (1, 256), "plane": (1, 256, 1024)}
SHARES = {"compiled": 1, "eager": 20}  # one part in so many of the case is timed
QUICK = {"compiled": 10, "eager": 100}
CEILING = "two processes at once, over one"  # the most that two threads could do, over one
READY, WINDOW = 6.0, 1.0  # s until a process has begun, and that it then counts in


class Setting(NamedTuple):
    """Elements, step (s), how many instants of the reference (every 10 ms) lie between two outputs,
    the element (`KINDS`).
    """

    elements: int
    step: float
    every: int = 1
    element: str = KINDS[0]


SETTINGS = {  # of the usual element, and the cheapest within the bound of every element
    "3D": (
        Setting(10, 0.005),
        Setting(9, 0.01),
        Setting(6, 0.02 / 3, 2, "linked"),
        Setting(3, 0.0075, 3, "order 2"),
    ),
    "plane": (
        Setting(12, 0.005),
        Setting(10, 0.02 / 3, 2),
        Setting(6, 0.005, element="linked"),
        Setting(3, 0.02 / 3, 2, "order 2"),
    ),
}


def rows(quick: bool) -> Iterator[Measured]:
    """Simulated seconds by CPU and by the clock on the wall, by one thread and two; the tip is read
    every 10 to 30 ms. Of elements other than the usual one eager steps are not timed.
    """
    case, repeats, shares = Case.load(), 3 if quick else 5, QUICK if quick else SHARES
    for space, settings in SETTINGS.items():
        for setting in settings[:3:2] if quick else settings:
            own = shares if setting.element == KINDS[0] else {"compiled": shares["compiled"]}
            error = {
                engine: case.error(motion(case, space, *setting, engine=engine))
                for engine in (("compiled",) if quick else own)
            }
            for batch in BATCHES[space][:2] if quick else BATCHES[space]:
                yield from _batch(
                    case, space, setting, batch, repeats if batch == 1 else 3, own, error
                )
            if setting is settings[0] and len(thread_counts()) > 1 and not quick:
                where = dict(space=space, elements=setting.elements, batch=batch)
                value = ceiling(space, setting, batch)
                progress(f"{space}, batch {batch}: {CEILING}: {value:.2f}")
                yield Measured.of(
                    PART, CEILING, value, "", engine="compiled", threads=2,
                    step_ms=1e3 * setting.step, element=setting.element, **where,
                )  # fmt: skip


def ceiling(space: str, setting: Setting, batch: int, ready: float = READY) -> float:
    """How much more two processes of one thread each do at once than one by itself: what cores,
    caches and memory of the machine leave to two threads.
    """
    rates = []
    for count in (1, 2):
        begin = time.time() + ready
        one = partial(apart, alone, space, *setting[:2], setting.element, batch, begin)
        with ThreadPoolExecutor(count) as pool:
            found = [task.result() for task in [pool.submit(one) for _ in range(count)]]
        if any(x["late"] for x in found):
            return ceiling(space, setting, batch, 2 * ready)
        rates.append(sum(x["rate"] for x in found))
    return rates[1] / rates[0]


def alone(
    space: str, elements: int, step: float, element: str, batch: int, begin: float
) -> dict[str, Any]:
    """Runs a second of one process in a window that begins at a time; late: it was not ready."""
    case, times = Case.load(), []
    scene = case.scene(elements, SPACES[space], element=element)
    instants, start = case.t[: len(case.t) // SHARES["eager"] + 1], tb.rest(scene, (batch,))

    def run() -> None:
        with torch.no_grad():
            _ = tb.simulate(scene, instants, start, step=step, engine="compiled").tip.position

    run()
    late = time.time() > begin
    while time.time() < begin:
        time.sleep(1e-3)
    while time.time() < begin + WINDOW or not times:
        now = time.perf_counter()
        run()
        times.append(time.perf_counter() - now)
    return {"rate": 1 / min(times), "late": late}


def _batch(
    case: Case,
    space: str,
    setting: Setting,
    batch: int,
    repeats: int,
    shares: dict[str, int],
    error: dict[str, float],
) -> Iterator[Measured]:
    scene = case.scene(setting.elements, SPACES[space], element=setting.element)
    start = tb.rest(scene, () if batch == 1 else (batch,))
    instants = case.t[:: setting.every]

    def run(engine: str, share: int) -> None:
        with torch.no_grad():
            _ = tb.simulate(
                scene,
                instants[: len(instants) // share + 1],
                start,
                step=setting.step,
                engine=engine,
            ).tip.position

    where = dict(
        space=space, elements=setting.elements, step_ms=1e3 * setting.step, batch=batch,
        element=setting.element,
    )  # fmt: skip
    for count in thread_counts():
        engines = tuple(shares) if count == 1 else ("compiled",)
        with threads(count):
            timings = timed([partial(run, engine, shares[engine]) for engine in engines], repeats)
        for engine, times in zip(engines, timings, strict=True):
            per = batch * (len(instants) // shares[engine]) * (instants[1] - instants[0]).item()
            given = dict(per=per, engine=engine, threads=count, error=error.get(engine), **where)
            if count == 1:
                yield (row := times.row(PART, "rate by CPU time", "cpu", CPU, **given))
                progress(
                    f"{space}, {setting.elements} elements, {setting.element}, batch {batch}, "
                    f"{engine}: {row.best:.4g} simulated s per CPU s"
                )
            if engine == "compiled":
                yield times.row(PART, "rate by the clock", "wall", WALL, **given)
