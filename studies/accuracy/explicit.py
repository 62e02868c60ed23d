"""Explicit methods over the same motions, in each form of the beam: what they cost, where that can
be paid for.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb

from .measurement import AccuracyRun, timed
from .motions import INTERVALS, Motion
from .references import LOSS, Reference, apart, difference, differentiated
from .settings import EXPLICIT, FORMS, OUTPUTS

RTOL = 1e-5
MESHES = 4, 8, 16
GENEROUS = 2.0  # times its equal share of the time that is left, which a run may take
# of a motion, by which it is seen what the whole would take; ten times as much until it takes a
# while
PIECE = 1e-4
WHILE, EVALUATIONS, LONG = 0.15, 100, 2.0  # s of CPU time, and evaluations; but no longer than that
# steps of rk4 over those of dopri5; of the ones that are stable the least
FRACTIONS = 0.3, 0.42, 0.6, 0.85, 1.2, 1.7, 2.4, 3.4
NEAR = 0.1  # of what the tip has moved: less than what is not stable is off by


def rows(
    motions: Sequence[Motion],
    known: Mapping[str, Reference],
    seconds: float,
    say: Callable[[str], None],
) -> Iterator[AccuracyRun]:
    """Methods and forms over motions, each with finer meshes as long as the whole motion is
    expected to take no more than its share of the CPU seconds (what others leave of theirs is
    shared out); of one that has no such mesh the first part of the motion, scaled up, without an
    error.
    """
    runs = list(product(motions, FORMS, EXPLICIT))
    end = time.process_time() + seconds
    for k, (motion, form, method) in enumerate(runs):
        say(f"{motion.name}: {form}, {method}")
        allowed = GENEROUS * (end - time.process_time()) / (len(runs) - k)
        yield from _meshes(motion, form, method, known[motion.reference], allowed)


def _meshes(
    motion: Motion, form: str, method: str, reference: Reference, seconds: float
) -> Iterator[AccuracyRun]:
    end = time.process_time() + seconds
    for elements in MESHES:
        row = AccuracyRun(motion.name, form, method, elements, RTOL)
        try:
            row = _piece(motion, row)
        except (ValueError, RuntimeError) as error:
            # what the form does not take, and a method that fails
            yield replace(row, note=str(error))
            return
        if row.seconds > end - time.process_time() or row.note:
            if elements == MESHES[0]:
                yield row
            return
        try:
            sol, spent = _run(motion, row, motion.instants(OUTPUTS))
            why = next(iter(sol.stats.reason.values()), "failed") if sol.status.any() else ""
        except RuntimeError as error:
            why = str(error)
        if why:
            yield replace(row, note=why)
            return
        error = difference(sol.tip.position, reference.tip[:: INTERVALS // OUTPUTS])
        row = replace(row, steps=sol.stats.evaluations, error=error, **_once(spent))
        if 6 * spent < end - time.process_time():
            row = _gradient(motion, row, reference)
        yield row


def _piece(motion: Motion, row: AccuracyRun) -> AccuracyRun:
    """What the whole motion would take, by the first part of it; fineness of rk4: steps that are
    stable.
    """
    share = PIECE
    while True:
        t = share * motion.instants(1)
        first = replace(row, method="dopri5") if row.method == "rk4" else row
        sol, spent = _run(motion, first, t)
        if (spent > WHILE and sol.stats.evaluations > EVALUATIONS) or spent > LONG or share >= 1:
            break
        share *= 10
    if row.method == "rk4":
        for fraction in FRACTIONS:
            steps = max(1, round(fraction * sol.stats.evaluations / 6 / share))
            row, compared = replace(row, fineness=steps), sol.tip.position
            try:
                tried, spent = _run(motion, row, t)
            except RuntimeError:  # it grew beyond all bounds
                continue
            if not tried.status.any() and difference(tried.tip.position, compared) < NEAR:
                sol = tried
                break
        else:
            row = replace(row, note="no stable step was found")
    evaluations = round(sol.stats.evaluations / share)
    return replace(row, steps=evaluations, **_once(spent / share, 1 / share))


def _once(seconds: float, scaled: float = 1.0) -> dict[str, Any]:
    return dict(seconds=seconds, seconds_median=seconds, repeats=1, scaled=scaled)


def _gradient(motion: Motion, row: AccuracyRun, reference: Reference) -> AccuracyRun:
    spent, (_, gradient) = timed(
        lambda: differentiated(
            motion, lambda by: _run(motion, row, motion.instants(LOSS), by)[0].tip.position
        )
    )
    error = apart(gradient, reference.gradient)
    return replace(row, gradient=spent, gradient_median=spent, gradient_error=error)


def _run(
    motion: Motion, row: AccuracyRun, t: Tensor, by: Tensor | None = None
) -> tuple[tb.Solution, float]:
    """The motion at the instants t, and CPU seconds."""
    options: dict[str, Any] = dict(
        method=row.method, form="nodal" if row.element == FORMS[0] else row.element
    )
    if row.method == "rk4":
        options["options"] = dict(step_size=motion.duration / row.fineness)
    else:
        options |= dict(rtol=row.fineness, atol=row.fineness * motion.length)
    scene = motion.scene("linked" if row.element == FORMS[0] else "linear", row.elements, by)
    with torch.set_grad_enabled(by is not None):
        seconds, sol = timed(lambda: tb.simulate(scene, t, **options))
    return sol, seconds
