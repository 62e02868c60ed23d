"""How often the regions of a filter hold the truth: random plants that move, read with noise.

    python -m studies estimation --out docs/results/estimation
    python -m studies estimation --horizon --plants 64 --readings 100

Each plant has stiffness, mass, offset and forces of its own, drawn from what the filter takes for
granted. Shares are of the second half of the readings.
"""

from __future__ import annotations

import math
import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.core.measurement import progress
from torchbeam.extend.commands import table

from .harness import Report, Study

DT = 0.01  # s
REACH = 1.96  # deviations: 95 %


class Case(NamedTuple):
    """A plant: parameters -> its scene; what reads it; what the filter is told beside these."""

    scene: Callable[[dict[str, Tensor]], tb.Scene]
    sensors: list[tb.sensors.Sensor]
    noise: Sequence[float]
    parameters: dict[str, tb.Parameter]
    options: dict[str, Any]
    drive: Callable[[int], list[float]]  # of the k-th interval: the scene's inputs
    modes: int | None  # z; None = all


class Share(NamedTuple):
    """How often the 95 % interval of one unknown held it; of a case."""

    case: str
    unknown: str
    share_percent: float


class Whole(NamedTuple):
    """Of a case: squares of the unknowns' errors by their covariance, and of the readings' by
    theirs, each over their number (1 is right); CPU ms a reading and plant.
    """

    case: str
    errors: float
    readings: float
    milliseconds: float


def near_one(deviation: float) -> tb.Parameter:
    law = torch.distributions.LogNormal(torch.tensor(0.0), torch.tensor(deviation))
    return tb.Parameter(torch.tensor(1.0), transform="log", prior=law.expand(()))


def strip(p: dict[str, Tensor]) -> tb.Scene:
    """A steel strip, 1 m: stiffness and a force at its tip unknown."""
    section = tb.Section.rectangle(0.03, 0.002, E=69e9 * p["E"], nu=0.33, rho=2700.0)
    beam = tb.Beam.straight(1.0, 4, section)
    return tb.Scene(beam, [tb.TipLoad(force=tb.Input("push", 3)), tb.Damping(1e-3)], plane="xz")


def payload(p: dict[str, Tensor]) -> tb.Scene:
    """The same with an unknown mass at its tip, in a wind along it that is unknown, too."""
    section = tb.Section.rectangle(0.03, 0.002, E=69e9, nu=0.33, rho=2700.0)
    beam = tb.Beam.straight(1.0, 4, section)
    loads = [
        tb.PointMass(0.05 * p["mass"]), tb.LineLoad(force=tb.Input("wind", 3)), tb.Damping(1e-3),
    ]  # fmt: skip
    return tb.Scene(beam, loads, plane="xz")


def arm_beam() -> tb.Beam:
    section = tb.Section.rectangle(0.03, 0.002, E=69e9, nu=0.33, rho=2700.0)
    return tb.Beam.straight(0.6, 3, section)


def arm(p: dict[str, Tensor]) -> tb.Scene:
    """A flexible arm on a motor, with an unknown payload."""
    parts = {"arm": arm_beam()}
    motor = tb.Hinge(
        None, ("arm", 0), axis=(0, 1, 0), torque=tb.Input("motor", 1), damping=0.01, stiffness=0.2
    )
    loads = [tb.PointMass(0.1 * p["payload"], node=("arm", -1)), tb.Damping(1e-3)]
    return tb.Scene(parts, loads, joints=[motor], plane="xz")


CASES = {
    "strip, its tip read": Case(
        strip,
        [tb.sensors.TipPosition()["z"]],
        (1e-3,),
        {"E": near_one(0.1)},
        {"process": {"push": ((0.0, 0.0, 0.05), 0.2)}, "bias": 2e-3},
        lambda k: [0.0] * 3,
        modes=4,
    ),
    "payload, two accelerometers": Case(
        payload,
        [tb.sensors.NodeVelocity(k)["z"] for k in (2, -1)],
        (0.1, 0.1),
        {"mass": near_one(0.1)},
        {"process": {"wind": ((0.0, 0.0, 0.05), 0.1)}, "bias": 0.05, "rate": True},
        lambda k: [0.0] * 3,
        modes=4,
    ),
    "arm on a motor, angle and gauge": Case(
        arm,
        [
            tb.sensors.JointCoordinate(0), tb.sensors.Gauge(0.1, arm_beam(), z=0.001, on="arm"),
        ],
        (2e-3, 5e-6),
        {"payload": near_one(0.2)},
        {"process": {"motor": 0.02}, "bias": (0.0, 1e-5), "shaking": 3e-4},
        lambda k: [0.1 * math.sin(6.0 * k * DT)],
        modes=6,  # those that the motor's white torque shakes
    ),
}  # fmt: skip


def measure(
    name: str,
    plants: int,
    readings: int,
    seed: int = 0,
    estimator: type[tb.KalmanFilter] = tb.KalmanFilter,
) -> tuple[list[Share], Whole]:
    """Shares of z and of each unknown, and the whole."""
    case = CASES[name]
    means = {key: one.start for key, one in case.parameters.items()}
    scene = case.scene(means)
    still = {key: torch.zeros(size) for key, size in scene.inputs.items()}
    model = tb.linearize(scene, inputs=still)
    f = estimator(
        case.scene,
        case.sensors,
        dt=DT,
        noise=case.noise,
        parameters=case.parameters,
        model=model if case.modes is None else model.reduced(case.modes),
        **case.options,
    )
    own, n, generator = f.unknowns, f.moves, torch.Generator().manual_seed(seed)
    z = f.start(plants, amplitude=0.02, modes=2)
    like = z.x

    def drawn(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=like.dtype)

    draw = (drawn(plants, 1, f.size) @ z.factor)[:, 0]
    state, beside = f.interval.changed(z.state, draw[:, :n]), own.start + draw[:, n:]
    plant_scene = case.scene(own.given(beside[:, : own.of_model]))
    sizes = plant_scene.inputs
    plant = tb.Stepper(plant_scene, DT)
    inside, errors, squares, spent = [], [], [], 0.0
    for k in range(readings):
        inputs = own.acting(beside, like.new_tensor(case.drive(k)).expand(plants, -1))
        inputs = inputs + own.white * drawn(plants, len(own.white))
        parts = inputs.split(tuple(sizes.values()), -1)
        given = dict(zip(sizes, parts, strict=True))
        shaken = (drawn(plants, 1, len(f.shaken)) @ f.shaken)[:, 0, :n]
        before = f.interval.changed(state, shaken)
        state = plant(before, inputs=given)
        y = f.interval.instruments.after(plant_scene, before, state, given, plant.dt)
        y = own.with_offsets(y, beside) + f.interval.instruments.noise * drawn(plants, f.read)
        beside = beside * own.stays + own.added * drawn(*beside.shape)
        begin = time.process_time()
        z = f(z, y, case.drive(k))
        spent += time.process_time() - begin
        error = torch.cat((f.interval.model.departure(state), beside), -1) - z.x
        inside.append(error.abs() < REACH * z.factor.norm(dim=-2))
        unit = torch.linalg.lstsq(z.covariance, error[..., None]).solution[..., 0]
        errors.append((error * unit).sum(-1) / f.size)
        squares.append(z.nis / z.readings)
    half = slice(readings // 2, None)
    shares = torch.stack(inside)[half].to(like.dtype).mean((0, 1)) * 100
    names = [f"z[{i}]" for i in range(n)] + [*own.names]
    rows = [Share(name, u, round(x, 1)) for u, x in zip(names, shares.tolist(), strict=True)]
    return rows, Whole(
        name,
        round(torch.stack(errors)[half].mean().item(), 3),
        round(torch.stack(squares)[half].mean().item(), 3),
        round(1e3 * spent / readings / plants, 3),
    )


def markdown(shares: Sequence[Share], cases: Sequence[Whole]) -> list[str]:
    """Shares of each unknown, and a line a case."""
    return [
        table(
            ("case", "unknown", "95 % intervals that hold, %"),
            [(r.case, r.unknown, f"{r.share_percent:.1f}") for r in shares],
            words=2,
        ),
        table(
            ("case", "squared errors over expected", "readings' over expected", "CPU ms"),
            [
                (r.case, f"{r.errors:.2f}", f"{r.readings:.2f}", f"{r.milliseconds:.2f}")
                for r in cases
            ],
            words=1,
        ),
    ]


def study(options: Namespace) -> Report:
    plants, readings = (16, 20) if options.quick else (options.plants, options.readings)
    estimator = tb.MovingHorizon if options.horizon else tb.KalmanFilter
    shares: list[Share] = []
    cases: list[Whole] = []
    for name in CASES:
        progress(name)
        more, whole = measure(name, plants, readings, estimator=estimator)
        shares += more
        cases.append(whole)
    return Report(markdown(shares, cases), shares, {"cases": [c._asdict() for c in cases]})


main = Study(
    "estimation",
    "Count how often the Kalman filter's regions hold the truth.",
    __doc__.partition("\n")[0],
    study,
    quick="16 plants, 20 readings",
    options={
        "--horizon": dict(action="store_true", help="of tb.MovingHorizon"),
        "--plants": dict(type=int, default=400, metavar="N", help="a case (default: %(default)s)"),
        "--readings": dict(type=int, default=200, metavar="K", help="default: %(default)s"),
    },
    double=True,
)
