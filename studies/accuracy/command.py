"""python -m studies accuracy: which setting is cheapest for an error."""

from __future__ import annotations

import sys
import time
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from .. import peers
from ..common_case import KINDS
from ..harness import Report, Study
from . import errors, explicit, measurement, references
from .measurement import AccuracyRun
from .motions import MOTIONS, Motion
from .pictures import pictures
from .report import markdown
from .settings import BASE, METHODS, TARGETS

SECONDS = 660.0  # of the whole, but for native code and other programs
EXPLICIT = 0.18  # of it, for explicit methods
ERRORS = 0.25  # of a motion's, for errors of meshes and of steps
BASE_WEIGHT = 3.0  # what all others are compared with may take so many times as long
QUICK, QUICK_SECONDS = ("follower",), 4.0
QUICK_PAIRS = BASE, ("linear", "midpoint4")
QUICK_ABOUT = (
    "one motion by two methods with linear elements, errors of 5 and 1 %%, no batch: some seconds"
)
TRIES = 3  # of a setting whose error is more than the sum of what its mesh and its step are off by
PAYS = 3.0  # a setting is tried where so many times what it is expected to take is there
ABOUT = (
    "Work and precision: five motions by every element, method and form, at errors from 5 % to "
    "1e-6; what is cheapest, alone and in a batch of 256, forward and with a gradient, beside the "
    "second-order setting (linear elements, midpoint steps) of equal error. One thread, float64, "
    "about 13 minutes; with matplotlib also pictures, accuracy.png and orders.png."
)


@dataclass
class Progress:
    """A bar of the CPU time that was set aside, and what is being measured, on stderr."""

    seconds: float

    def __post_init__(self) -> None:
        self.begun = time.process_time()

    def say(self, what: str) -> None:
        done = min(1.0, (time.process_time() - self.begun) / self.seconds)
        bar = ("#" * round(20 * done)).ljust(20, ".")
        line = f"[{bar}] {100 * done:3.0f} %  {what}"
        shown = sys.stderr.isatty()
        print(
            f"\r{line:<100}" if shown else line,
            end="" if shown else "\n",
            file=sys.stderr,
            flush=True,
        )


def _place(options: Namespace) -> tuple[Path | None, str]:
    if options.references is not None:
        return options.references.parent, "--references"
    return options.out, "--out"


def study(options: Namespace) -> Report | int:
    if options.references is not None:
        for line in references.write(options.references):
            print(line, flush=True)
        return 0
    rows, curves, known, others = _measured(options)
    data = {
        "quick": options.quick,
        "peers": others,
        "agreement": {name: (one.agreement, one.gradient_agreement) for name, one in known.items()},
        "errors": {name: curve._asdict() for name, curve in curves.items()},
    }
    return Report(
        [markdown(rows, known, others)],
        rows,
        data,
        picture=lambda folder: pictures(rows, curves, known, others, folder),
    )


def _measured(
    given: Namespace,
) -> tuple[
    list[AccuracyRun],
    dict[str, errors.Errors],
    dict[str, references.Reference],
    list[dict[str, Any]],
]:
    """Rows, errors of space and time by motion, references, and what other programs have
    measured.
    """
    known = references.load()
    wanted = given.motions or (QUICK if given.quick else [motion.name for motion in MOTIONS])
    motions = [motion for motion in MOTIONS if motion.name in wanted]
    seconds = QUICK_SECONDS if given.quick and given.seconds == SECONDS else given.seconds
    progress, rows, curves = Progress(seconds), [], {}
    for motion in motions:
        measured = _motion(
            motion, known[motion.reference],
            (1.0 if given.quick else 1 - EXPLICIT) * seconds / len(motions), given.quick, progress,
        )  # fmt: skip
        curves[motion.name] = next(measured)
        rows += measured
    if not given.quick:
        rows += explicit.rows(motions, known, EXPLICIT * seconds, progress.say)
    others = []
    if given.peers is not None:
        progress.say("other programs")
        others = list(
            peers.measured(given.peers, given.python, "--quick" if given.quick else "--ladder")
        )
    progress.say("done\n" if sys.stderr.isatty() else "done")
    return (
        rows,
        curves,
        {name: known[name] for name in {motion.reference for motion in motions}},
        others,
    )


def _motion(
    motion: Motion, reference: references.Reference, seconds: float, quick: bool, progress: Progress
) -> Iterator[Any]:
    """The errors of space and time, then rows."""
    pairs = [pair for pair in product(KINDS, METHODS) if not quick or pair in QUICK_PAIRS]
    refused = {}
    for pair in pairs:
        progress.say(f"{motion.name}: native code, {', '.join(pair)}")
        try:
            measurement.warm(motion, *pair, 1 if quick else measurement.BATCH)
        except ValueError as error:
            refused[pair] = str(error)
    taken = [pair for pair in pairs if pair not in refused]
    progress.say(f"{motion.name}: errors of meshes and of steps")
    curves = errors.measure(
        motion,
        ERRORS * seconds,
        *(list(dict.fromkeys(names)) for names in zip(*taken, strict=True)),
    )
    yield curves
    end = time.process_time() + (1 - ERRORS) * seconds
    for (element, method), why in refused.items():
        yield AccuracyRun(motion.name, element, method, 0, 0.0, note=why)
    weights = [BASE_WEIGHT if pair == BASE else 1.0 for pair in taken]
    for k, (element, method) in enumerate(taken):
        progress.say(f"{motion.name}: {element}, {method}")
        allowed = (end - time.process_time()) * weights[k] / sum(weights[k:])
        yield from _pair(motion, curves, element, method, reference, allowed, quick)


def _pair(
    motion: Motion,
    curves: errors.Errors,
    element: str,
    method: str,
    reference: references.Reference,
    seconds: float,
    quick: bool,
) -> Iterator[AccuracyRun]:
    """Rows of an element and a method: the cheapest setting of each error, while there is time for
    it.
    """
    end, pair_made, targets = time.process_time() + seconds, {}, TARGETS[:2] if quick else TARGETS
    for k, target in enumerate(targets):
        if target < 2 * reference.agreement:
            return
        wanted = target
        for _ in range(TRIES):
            pair = curves.pair(element, method, 0.95 * wanted)
            left = end - time.process_time()
            if pair is None or PAYS * pair[1] > left:
                return
            setting = pair[0]
            if setting not in pair_made:
                pair_made[setting] = row, sol, _ = measurement.forward(motion, setting, reference)
                if sol is None:  # it failed
                    yield row
            error = pair_made[setting][0].error
            if error is not None and error <= target:
                break
            wanted *= 0.5
        else:
            continue
        if pair_made[setting][1] is not None:
            row, sol, first = pair_made[setting]
            yield measurement.costs(
                motion, setting, reference, row, sol, first, left / (len(targets) - k), not quick
            )
            pair_made[setting] = row, None, first  # it is measured


main = Study(
    "accuracy",
    "Which setting is cheapest for an error: elements, methods and forms over five motions, beside "
    "other programs.",
    ABOUT,
    study,
    quick=QUICK_ABOUT,
    options={
        "--motions": dict(
            nargs="+",
            metavar="MOTION",
            choices=[motion.name for motion in MOTIONS],
            help=f"of {', '.join(repr(motion.name) for motion in MOTIONS)} (default: all)",
        ),
        "--seconds": dict(type=float, default=SECONDS, help="CPU time, about (%(default)g)"),
        **peers.OPTIONS,
        "--references": dict(
            type=Path,
            metavar="FILE",
            help="only make the references anew, by runs finer than any setting here: some minutes",
        ),
    },
    place=_place,
    packages=("llvmlite",),
)
