"""Contact beside the same scene without: beams that may touch and are far from each other, a rod
that may touch itself and does not, two beams of which one falls on the other and lies there, two
that are pressed on each other at twenty places and sway, one that is drawn along another; each a
ratio of CPU times that are taken in turns. Warmed up: the programs of lists of near pairs that came
before are kept, the lists themselves are looked for again; but of the beam that is drawn along each
run has a stepper, a speed, and lists of its own.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from itertools import count
from statistics import median
from typing import NamedTuple

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.core.measurement import Measured, progress, timed

PART = "contact"
ANGLE = math.radians(3.1)
RADIUS, ELEMENTS, STEP, STEPS = 5e-3, 25, 1e-3, 200
LAW = dict(radius=RADIUS, thickness=1e-3, force=100.0)
BATCHES = 1, 64, 256


def section() -> tb.Section:
    return tb.Section.circle(RADIUS, E=1e7, nu=0.35, rho=1200.0)


def over(height: float, touches: bool) -> tb.Scene:
    """A clamped beam above one that is clamped at both ends, surfaces so high above each other."""
    root = (0.0, 0.0, 2 * RADIUS + height)
    parts = {
        "lower": tb.Beam.straight(0.5, ELEMENTS, section()),
        "upper": tb.Beam.straight(0.5, ELEMENTS, section(), root=root),
    }
    effects = [tb.Gravity((0.0, 0.0, -9.81))]
    if touches:
        effects.append(tb.Contact("lower", "upper", **LAW, points=1))
    ends = [("lower", 0), ("lower", -1), ("upper", 0)]
    return tb.Scene(parts, effects, supports=[tb.Support(end) for end in ends])


def alone(touches: bool) -> tb.Scene:
    """A clamped rod."""
    beam = tb.Beam.straight(1.0, 2 * ELEMENTS, section())
    return tb.Scene(beam, [tb.Gravity((0.0, 0.0, -9.81)), *[tb.SelfContact(**LAW)] * touches])


def crossed(touches: bool) -> tb.Scene:
    """Two beams, clamped at both ends, that cross at so small an angle that they touch along a
    third of their length, where line loads press them on each other.
    """
    along = math.cos(ANGLE), math.sin(ANGLE)
    root = (0.25 * (1 - along[0]), -0.25 * along[1], 2 * RADIUS + 9e-4)
    parts = {
        "lower": tb.Beam.straight(0.5, ELEMENTS, section()),
        "upper": tb.Beam.straight(0.5, ELEMENTS, section(), root=root, direction=(*along, 0.0)),
    }
    loads = [tb.LineLoad(force=(0.0, 0.0, p), on=on) for on, p in (("lower", 2.0), ("upper", -2.0))]
    law = [tb.Contact("lower", "upper", **LAW, points=1)] * touches
    supports = [tb.Support((name, end)) for name in parts for end in (0, -1)]
    return tb.Scene(parts, [*loads, *law], supports=supports)


def drawn(touches: bool, run: int) -> tb.Scene:
    """A beam across one that is clamped at both ends, drawn along it by its root, over half of its
    length or a little more; steps begin anew, as a user's do.
    """
    speed = 0.8 + 0.013 * run
    root = (0.15, -0.25, 2 * RADIUS + 5e-4)
    parts = {
        "lower": tb.Beam.straight(0.5, ELEMENTS, section()),
        "upper": tb.Beam.straight(0.5, ELEMENTS, section(), root=root, direction=(0.0, 1.0, 0.0)),
    }
    effects = [tb.Gravity((0.0, 0.0, -9.81))]
    if touches:
        effects.append(tb.Contact("lower", "upper", **LAW, points=1))

    def along(t: Tensor) -> Tensor:
        return torch.stack((speed * t, 0 * t, 0 * t), -1)

    ends = [tb.Support(("lower", 0)), tb.Support(("lower", -1))]
    return tb.Scene(parts, effects, supports=[*ends, tb.Support(("upper", 0), displacement=along)])


@cache
def pressed() -> tb.State:
    """The equilibrium of `crossed` beams, swaying across both. They would slide from each other,
    in many times the run.
    """
    scene = crossed(True)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*unstable equilibrium", RuntimeWarning)
        at_rest = tb.equilibrium(scene)
    mode = torch.sin(math.pi * torch.linspace(0.0, 1.0, ELEMENTS + 1)).repeat(2)[:, None]
    fields = {name: getattr(at_rest, name) for name in ("position", "rotation", "stress")}
    return replace(tb.rest(scene), **fields, velocity=mode * torch.tensor([0.0, 0.1, 0.0]))


class Case(NamedTuple):
    """A scene, with contact or without, and what it starts from; None = from rest. anew: whether it
    is one of its own, by number, in each run.
    """

    scene: Callable[..., tb.Scene]
    start: Callable[[], tb.State] | None = None
    anew: bool = False


CASES = {
    "two beams far from each other": Case(lambda touches: over(0.3, touches)),
    "a rod that does not touch itself": Case(alone),
    "a beam that lies on another, 25 elements": Case(lambda touches: over(5e-4, touches)),
    "two beams of 25 elements pressed at 20 places": Case(crossed, pressed),
    "a beam drawn along another, lists that change": Case(drawn, anew=True),
}


def rows(quick: bool) -> Iterator[Measured]:
    """Ratios by scene and batch."""
    steps, repeats = (20, 2) if quick else (STEPS, 4)
    for name, case in CASES.items():
        for batch in BATCHES[: 1 if quick else None]:
            pair = [stepping(case, touches, batch, steps) for touches in (True, False)]
            a, b = timed(pair, repeats)
            ratios = [x / y for x, y in zip(a.cpu, b.cpu, strict=True)]
            what, best = f"contact / without, {name}", min(a.cpu) / min(b.cpu)
            where = dict(engine="compiled", space="3D", batch=batch, step_ms=1e3 * STEP)
            yield Measured(PART, what, best, median(ratios), "", **where)
            progress(f"{what}, batch {batch}: {best:.2f}")


def stepping(case: Case, touches: bool, batch: int, steps: int) -> Callable[[], None]:
    """A rollout, of samples that a small velocity sets apart."""

    def ready(*run: int) -> tuple[tb.Stepper, tb.State]:
        stepper = tb.Stepper(case.scene(touches, *run), STEP, engine="compiled")
        start = stepper.rest() if case.start is None else case.start()
        if batch > 1:
            start = start.map(lambda x: x.expand(batch, *x.shape).clone())
            apart = torch.linspace(0.0, 0.01, batch, dtype=torch.float64)[:, None, None]
            free = start.velocity.new_tensor((0.0, 1.0, 0.0))
            start = replace(start, velocity=start.velocity + apart * free)
        return stepper, start

    runs = count()
    always = None if case.anew else ready()
    return lambda: tb.rollout(*(always or ready(next(runs))), steps) and None
