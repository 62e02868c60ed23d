"""Cost of each effect and its influence on the answer: one scene, with and without it."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb
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
        EA=1e4 * number,
        GA=4e3 * number,
        GJ=0.8 * number,
        EI=number,
        mass=0.2 * number,
        inertia=1e-4 * number,
    )
    beam = tb.Beam.straight(number, elements, section)
    return tb.Scene(beam, (tb.TipLoad(force=force), *more), **options)


def _wind(position: Tensor, t: Tensor) -> Tensor:
    return torch.stack(
        (
            torch.zeros_like(position[..., 0]),
            5 * position[..., 0],
            torch.zeros_like(position[..., 0]),
        ),
        -1,
    )


def _user(x: None, R: None, v: Tensor, w: None, t: Tensor) -> tuple[Tensor, None]:
    return -0.05 * v, None


def _along(elements: int, **given: float) -> tb.Tendon:
    return tb.Tendon([(k, (0.0, 0, 0.02)) for k in range(elements + 1)], **given)


def _floor(height: float) -> tb.Contact:
    plane = tb.Plane((0.0, 0, height), (0.0, 0, 1))
    return tb.Contact(plane, thickness=3e-3, force=20.0, friction=0.3, slip_speed=0.1)


def _lagged(x: Tensor, R: None, v: None, w: None, t: Tensor, z: Tensor) -> tuple[Tensor, None]:
    return z, None


def _lag(z: Tensor, x: Tensor, R: None, v: None, w: None, t: Tensor) -> Tensor:
    return (-x * x.new_tensor([0.0, 1, 1]) - z) / 0.02


def table(elements: int) -> list[tuple[str, str, Any]]:
    """(effect, what of it, a function that makes the scene)."""

    def has(effect: Any) -> Any:
        return lambda: scene(elements, effect())

    def along(s: Tensor, t: Tensor) -> Tensor:
        return torch.stack((0 * s, 0.1 * torch.sin(s - t), 0 * s), -1)

    def shaken(t: Tensor) -> Tensor:
        return torch.stack((0 * t, 0 * t, 0.01 * torch.sin(6.283 * t)))

    def without_inertia() -> tb.Section:
        return tb.Section.from_stiffness(
            *(torch.tensor(x, dtype=torch.float64) for x in (1e4, 4e3, 0.8, 1.0, 0.2))
        )

    y, spin = (0, 0.1, 0), (0.0, 0, 1)
    rubbing = dict(stiffness=50.0, length=0.99, friction=0.1, slip_speed=0.1)
    lag = dict(internal=3, rate=_lag, of=("position",))
    # fmt: off
    return [
        ("TipLoad, dead", "force 0.1 N along y", has(lambda: tb.TipLoad(force=y))),
        ("TipLoad, follower", "force 0.1 N along its y",
         has(lambda: tb.TipLoad(force=y, follower=True))),
        ("LineLoad, dead", "0.1 N/m along y", has(lambda: tb.LineLoad(force=y))),
        ("LineLoad of s and t", "0.1 sin(s - t) N/m along y",
         has(lambda: tb.LineLoad(force=tb.Along(along)))),
        ("Gravity", "9.81 m/s^2 along -z", has(lambda: tb.Gravity((0, 0, -9.81)))),
        ("Damping, one tau", "0.2 ms", has(lambda: tb.Damping(2e-4))),
        ("Damping, six", "0.2 ms each", has(lambda: tb.Damping((2e-4,) * 6))),
        ("MassDamping", "1 1/s", has(lambda: tb.MassDamping(1.0))),
        ("Drag", "air, 1.2 kg/m^3, d = 1 cm", has(lambda: tb.Drag(1.2, 0.01))),
        ("Drag in a flow", "air, a wind 5 x along y", has(lambda: tb.Drag(1.2, 0.01, flow=_wind))),
        ("Drag, added mass", "water, d = 1 cm", has(lambda: tb.Drag(1000.0, 0.01, added_mass=1.0))),
        ("PointMass", "20 g on the tip", has(lambda: tb.PointMass(0.02))),
        ("PointMass with offset", "20 g, 5 cm off the tip",
         has(lambda: tb.PointMass(0.02, offset=(0.0, 0, 0.05)))),
        ("Spring", "1 N/m on the tip", has(lambda: tb.Spring(-1, 1.0, to=(1.0, 0, 0)))),
        ("RootSpring", "100 N m/rad, 1e4 N/m", has(lambda: tb.RootSpring((1e4, 100.0)))),
        ("Tendon", "0.5 N, 2 cm above the axis", has(lambda: _along(elements, tension=0.5))),
        ("Tendon, elastic, friction", "the same with 50 N/m, mu = 0.1",
         has(lambda: _along(elements, **rubbing))),
        ("Contact, near", "floor 1 mm below, friction", has(lambda: _floor(-2e-3))),
        ("Contact, far", "floor 1 m below", has(lambda: _floor(-1.0))),
        ("Actuation", "curvature 0.1 1/m", has(lambda: tb.Actuation(curvature=(0, 0, 0.1)))),
        ("Load, on the tip", "-0.05 v", has(lambda: tb.Load(_user, node=-1, of=("velocity",)))),
        ("Load, along the beam", "-0.05 v",
         has(lambda: tb.Load(_user, node=None, of=("velocity",)))),
        ("Load with a lag", "-x after 20 ms", has(lambda: tb.Load(_lagged, node=-1, **lag))),
        ("Frame", "turns at 1 rad/s about z",
         lambda: scene(elements, frame=tb.Frame(angular_velocity=spin))),
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
