"""Throughput: the common dynamic case through the public API, eager beside compiled, with the error
of each setting.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import torch

from ...cli import threads
from ...dynamics.simulate import simulate
from ...state.state import rest
from ..common_case import KINDS, SPACES, Case, motion
from .measurement import CPU, WALL, Measured, progress, thread_counts, timed

PART = "throughput"
BOUNDS = {"3D": 0.01, "plane": 0.007}  # errors that a setting may have
BATCHES = {"3D": (1, 256), "plane": (1, 256, 1024)}
SHARES = {"compiled": 1, "eager": 20}  # one part in so many of the case is timed
QUICK = {"compiled": 10, "eager": 100}


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
    start = rest(scene, () if batch == 1 else (batch,))
    instants = case.t[:: setting.every]

    def run(engine: str, share: int) -> None:
        with torch.no_grad():
            _ = simulate(
                scene,
                instants[: len(instants) // share + 1],
                start,
                step=setting.step,
                engine=engine,
            ).tip.position

    where = dict(
        space=space,
        elements=setting.elements,
        step_ms=1e3 * setting.step,
        batch=batch,
        element=setting.element,
    )
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
