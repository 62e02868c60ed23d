"""Cost of each effect and its influence on the answer: one scene, with and without it."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb
from cases.rows import ROWS, Row
from studies.operations import operations, repeated
from torchbeam.analysis.advise import change, seconds
from torchbeam.core.measurement import progress
from torchbeam.extend.commands import table as markdown_table

from .harness import Report, Study

STEP, STEPS = 0.005, 80  # s; of the answer
# operations and times are those of TIMED steps after the first MIDDLE; of fewer where `steps` are
# few
MIDDLE, TIMED = 20, 4
ABOUT = (
    "A cantilever of 1 m along x, EI = 1 N m^2, GJ = 0.8 N m^2, kGA = 4e3 N, EA = 1e4 N, 0.2 "
    "kg/m, rotary inertia 1e-4 kg m, a dead force of (0, 0.5, 1) N on its tip, suddenly; "
    "{elements} elements, {steps} steps of 5 ms, float64, one thread. Operations: tensor "
    "operations a step more than without the effect, in motion after 20 steps (without: "
    "{operations}, in {iterations:.1f} Newton iterations). Time: of the same steps, over that "
    "without the effect in the same run. Change: RMS of the tip's displacement from that without "
    "the effect, over the RMS of its motion."
)


@dataclass(frozen=True)
class EffectCost:
    """operations: a step, more than without the effect; iterations a step; time: by batch, over
    that without the effect; change of the answer; note: why it did not run.
    """

    effect: str
    given: str
    operations: float | None = None
    iterations: float | None = None
    time: dict[str, float] | None = None
    change: float | None = None
    note: str = ""


def scene(
    elements: int,
    *more: Any,
    section: tb.Section | None = None,
    force: tuple = (0.0, 0.5, 1.0),
    **options: Any,
) -> tb.Scene:
    """The stated scene with `more` effects."""
    number = torch.tensor(1.0, dtype=torch.float64)
    section = section or tb.Section.from_stiffness(
        EA=1e4 * number, GA=4e3 * number, GJ=0.8 * number, EI=number, mass=0.2 * number,
        inertia=1e-4 * number,
    )  # fmt: skip
    beam = tb.Beam.straight(number, elements, section)
    return tb.Scene(beam, (tb.TipLoad(force=force), *more), **options)


def table(elements: int) -> list[tuple[str, str, Any]]:
    """(effect, what of it, a function that makes the scene)."""

    def shaken(t: Tensor) -> Tensor:
        return torch.stack((0 * t, 0 * t, 0.01 * torch.sin(6.283 * t)))

    def without_inertia() -> tb.Section:
        return tb.Section.from_stiffness(
            *(torch.tensor(x, dtype=torch.float64) for x in (1e4, 4e3, 0.8, 1.0, 0.2))
        )

    def with_effect(row: Row) -> Any:
        return lambda: scene(elements, row.make(row.cost[2], elements))

    # fmt: off
    return [
        *((*row.cost[:2], with_effect(row)) for row in ROWS.values() if row.cost),
        ("Frame", "turns at 1 rad/s about z",
         lambda: scene(elements, frame=tb.Frame(angular_velocity=(0.0, 0, 1)))),
        ("RootMotion", "1 cm along z, 1 Hz",
         lambda: scene(elements, root=tb.RootMotion(displacement=shaken))),
        ("no rotary inertia", "", lambda: scene(elements, section=without_inertia())),
        ("small displacements", "", lambda: scene(elements, small=True)),
        ("plane", "against 3D, the force in it",
         lambda: scene(elements, force=IN_PLANE, plane="xz")),
    ]
    # fmt: on


IN_PLANE = (0.0, 0.0, 1.0)


class _Ran:
    """A scene in motion: the tip's path, and steps from the middle of it."""

    def __init__(self, scene: tb.Scene, steps: int) -> None:
        self.stepper = tb.Stepper(scene, STEP, engine="eager")
        self.timed = max(1, min(TIMED, steps // 10))
        state = self.stepper.rest()
        path = [state.tip.position]
        for k in range(steps):
            if k == min(MIDDLE, steps // 2):
                self.middle = state
            state = self.stepper(state)
            path.append(state.tip.position)
        if (state.status != 0).any():
            raise RuntimeError("the steps did not converge")
        self.path = torch.stack(path)
        self.run()  # what is remembered is, when operations are counted
        self.operations = operations(self.run) / self.timed

    def run(self, batch: int = 1) -> None:
        state, iterations = repeated(self.middle, batch), 0.0
        for _ in range(self.timed):
            state = self.stepper(state)
            iterations += self.stepper.iterations.double().mean().item()
        self.iterations = iterations / self.timed


def measure(quick: bool = False) -> tuple[_Ran, list[EffectCost]]:
    """The scene without any effect of the table, and the rows."""
    elements, steps, batches, repeats = (4, 4, (1,), 1) if quick else (16, STEPS, (1, 256), 3)
    base, flat = (
        _Ran(scene(elements, force=force), steps) for force in ((0.0, 0.5, 1.0), IN_PLANE)
    )
    rows = []
    for name, given, make in table(elements):
        progress(name)
        beside = flat if name == "plane" else base
        try:
            ran = _Ran(make(), steps)
        except (ValueError, RuntimeError) as refusal:
            rows.append(EffectCost(name, given, note=str(refusal).splitlines()[0]))
            continue
        times = {}
        for batch in batches:
            without, with_ = seconds(
                [lambda b=batch, r=r: r.run(b) for r in (beside, ran)], repeats
            )
            times[str(batch)] = with_ / without
        rows.append(
            EffectCost(
                name,
                given,
                ran.operations - beside.operations,
                ran.iterations,
                times,
                change(ran.path, beside.path),
            )
        )
    base.elements, base.steps = elements, steps
    return base, rows


@torch.no_grad()
def study(options: Namespace) -> Report:
    base, rows = measure(options.quick)
    values = dict(operations=round(base.operations), iterations=base.iterations)
    about = ABOUT.format(elements=base.elements, steps=base.steps, **values)
    batches = next(r.time for r in rows if r.time)
    times = [f"time, batch {b}" for b in batches]
    return Report(
        [about, markdown(rows)],
        rows,
        {"about": about, "operations without": base.operations},
        columns=("effect", "given", "operations", "iterations", *times, "change", "note"),
        cells=[
            (r.effect, r.given, r.operations, r.iterations,
             *((r.time or {}).get(b) for b in batches), r.change, r.note)
            for r in rows
        ],
    )  # fmt: skip


def markdown(rows: Sequence[EffectCost]) -> str:
    """The table."""
    batches = next(r.time for r in rows if r.time)
    times = [f"time, batch {b}" for b in batches]
    head = ("effect", "here", "operations a step", "iterations", *times, "changes the answer by")
    lines = []
    for r in rows:
        cells = [r.note, *[""] * (len(batches) + 2)]
        if not r.note:
            times = [f"{r.time[b]:.2f}" for b in batches]
            change = f"{100 * r.change:.2g} %"
            cells = [f"{r.operations:+.0f}", f"{r.iterations:.1f}", *times, change]
        lines.append((r.effect, r.given, *cells))
    return markdown_table(head, lines, words=2)


main = Study(
    "effects",
    "What each effect adds in operations and time, and changes in an answer.",
    "Steps one scene with and without each effect, side by side: tensor operations, time, and "
    "change of the answer.",
    study,
    quick="four elements, four steps, batch 1",
)
