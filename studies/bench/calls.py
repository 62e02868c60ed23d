"""What a call costs: `simulate` beside `rollout` of the same steps, which has its scene's model and
native code at hand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.core.measurement import Measured, progress, timed

from ..common_case import SPACES, Case

PART = "calls"
ELEMENTS, STEP, STEPS = 4, 0.01, 50


def rows(quick: bool) -> Iterator[Measured]:
    """CPU milliseconds of each call, and its ratio to that of `rollout`; without a gradient, and
    with one and its backward.
    """
    case, repeats = Case.load(), 5 if quick else 60
    for space in ("plane",) if quick else SPACES:
        for gradient in (False, True):
            runs = _runs(case, space, gradient, repeats + 1)
            where = dict(engine="compiled", space=space, elements=ELEMENTS, step_ms=1e3 * STEP)
            best, kind = None, "gradient: " if gradient else ""
            for what, times in zip(runs, timed([*runs.values()], repeats), strict=True):
                row = times.row(PART, f"{kind}{what}, s", "cpu", **where)
                best = row.best if best is None else best
                yield row
                if what != "rollout":
                    yield Measured.of(PART, f"{kind}{what} / rollout", row.best / best, "", **where)
                    progress(f"{space}, {kind}{what}: {row.best / best:.2f} times rollout")


def _runs(case: Case, space: str, gradient: bool, count: int) -> dict[str, Callable[[], None]]:
    """Calls by name; those of other values have a scene of its own for each of so many times."""
    t = STEP * torch.arange(STEPS + 1, dtype=case.t.dtype)
    EI = case.t.new_ones((), requires_grad=gradient)
    values = iter(1 + 1e-3 * k for k in range(1000 * count))

    def scene() -> tb.Scene:
        return case.scene(ELEMENTS, SPACES[space], EI * next(values), (0.0, next(values), 0.0))

    same, others = scene(), [scene() for _ in range(count)]
    stepper = tb.Stepper(same, STEP)
    start = stepper.rest()

    def finished(tip: Tensor) -> None:
        if gradient:
            tip[-1].sum().backward(retain_graph=True)

    return {
        "rollout": lambda: finished(tb.rollout(stepper, start, STEPS).tip.position),
        "simulate, the same scene": lambda: finished(tb.simulate(same, t, step=STEP).tip.position),
        "simulate, other values": lambda: finished(
            tb.simulate(others.pop(), t, step=STEP).tip.position
        ),
        "a new scene and simulate": lambda: finished(
            tb.simulate(scene(), t, step=STEP).tip.position
        ),
    }
