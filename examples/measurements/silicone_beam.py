"""A silicone cantilever that is let go under its weight and hung masses: its material from its
motion, and the motion after that predicted.

The data are those of the repository `srl-ethz/diffPD_sim2real` (MIT licence), folder
`python/realbeam_experiments/Measurement_data`: motion capture at 100 Hz, as a CSV of t_s and
marker1_X_mm to marker6_Z_mm. Block of 30 x 30 x 100 mm of Dragon Skin 10, clamped at one end, 1,070
kg/m^3; markers 1 to 3 on the free end; the mass (`load52`: 52 g, by the name of the file) on its
upper edge. It is held by hand, about straight, and let go.

    python -m examples.measurements.silicone_beam --data silicone_beam_load52_a.csv
        [--held silicone_beam_load52_b.csv] [--noise ar1] [--begin 0.6]

The material is one whose stress relaxes by a power of time, as rubbers' does nearly: stiffness
grows as omega^power, the loss factor is tan(pi/2 power) at all frequencies, and strain goes on
creeping by the logarithm of time. A record swings at one frequency, so that Young's modulus and the
retardation time of Kelvin and Voigt's damping at that do for it,

    E(omega) = E (omega/OMEGA)^power      tau = tan(pi/2 power)/omega

with omega of the first mode of the block with its mass; what creeps is a share `creep` of the sag
under the mass and the block, times ln(1 + t/LETTING_GO). Found are E, power and creep, a tilt of
the cameras' axes, and of each record with what force and moment the hand held, when it let go, and
where the cameras' origin is (an offset of each channel). Fitted are the markers as they were held
and from 0.4 to 1 s after the release; the next second is predicted, with 95 % bands. With --held,
of the other record what was held and 0.4 to 0.6 s tell its own hand and origin, and the second
after these is predicted. Several files are fitted together, with one material.

The authors' finite elements found E = 263.8 kPa for motion and sag; the search begins 20 % above
it, as one from below may count a period too few (and says so then, `fit.doubts`). What the model
cannot: the first swings, of 20 mm and more, which are damped more than those after them (they are
left out; fitted too, they make the prediction twice as bad). Residuals are alike for a while, so
that deviations count blocks of times; bands have as noise what the model missed in the last 0.2 s
that were fitted, as it misses less where less moves. The fit by steps of 5 ms is refined by steps
of a quarter, which move E by more than its deviation. It ends with a line of JSON: parameters with
95 % intervals, the RMS by marker over what was predicted, the share of its readings that 95 % bands
hold.
"""

import argparse
import math
import re
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from torch.distributions import LogNormal, Normal

import torchbeam as tb

from .report import columns, line, rms

SIDE, LENGTH, RHO, NU, G = 0.03, 0.1, 1070.0, 0.49, 9.81  # m, kg/m^3, m/s^2
AXES = ((0, 0, 1), (0, -1, 0), (1, 0, 0))  # of the cameras: their Z along the beam, X upwards
FACE = (0.072, -0.031, 0.0533)  # m, model axes, of the middle of the free end where it was held
ELEMENTS, RELEASE = 4, 0.05  # of order 2; s, when the model's hand begins to let go
STEP, FINE = 5e-3, 1.25e-3  # s, of the fit and of its refinement
LETTING_GO = 0.015  # s
OMEGA, NOMINAL = 30.0, 3e5  # rad/s at which E is told; Pa, of the records' frequencies
AUTHORS = 2.638e5  # Pa
SWING, FITTED, SETTLED, AHEAD = 0.4, 1.0, 0.6, 1.0  # s after the release
LAST = 0.2  # s, of what was fitted, that tell how much is missed after it
SIGMA = 3e-4  # m: what the model misses, of a first fit
COMMON = ("E", "power", "creep", "tilt")
SECTION = tb.Section.rectangle(SIDE, SIDE, NOMINAL, NU, RHO)
BLOCK = tb.Beam.straight(LENGTH, ELEMENTS, SECTION, order=2)


class Record:
    """Times t (times,) s and markers 1 to 3 (times, 3, 3) m of a file in the cameras' axes, from
    RELEASE before the release on; the mass (kg) by the file's name, and where the markers were on
    the block when it was held.
    """

    def __init__(self, path: Path, noise: str = "blocks", begin: float = SWING) -> None:
        self.noise, self.begin = noise, begin
        names, rows = columns(path)
        seen = [names.index(f"marker{m}_{c}_mm") for m in (1, 2, 3) for c in "XYZ"]
        markers = 1e-3 * rows[:, seen].unflatten(-1, (3, 3))
        load = re.search(r"load(\d+)", path.stem)
        self.name, self.mass = path.stem, 1e-3 * int(load[1]) if load else 0.0
        moved = torch.linalg.vector_norm(markers - markers[:3].mean(0), dim=-1).amax(-1) > 2.5e-3
        begin = max(int(moved.nonzero()[0]) - 6, 0)
        self.t, self.markers = rows[begin:, 0] - rows[begin, 0], markers[begin:]
        held = markers[:3].mean(0) @ torch.tensor(AXES, dtype=markers.dtype).mT
        self.points = held - torch.tensor(FACE)
        self.omega = tb.modes(tb.Scene(BLOCK, self.hung()), count=1).frequency[0].item()

    def hung(self) -> list[tb.PointMass]:
        return [tb.PointMass(self.mass, offset=(0, 0, SIDE / 2))] if self.mass else []

    def during(self, first: float, last: float) -> torch.Tensor:
        """(times,) bool: of a while after the release, s."""
        return (self.t > RELEASE + first - 1e-6) & (self.t < RELEASE + last - 1e-6)

    def measurements(self, until: float) -> list[tb.Measurement]:
        """Of the three markers, as they were held, and from `begin` until so long after the
        release.
        """
        some = self.during(-1.0, 0.0) | self.during(self.begin, until)
        return [
            tb.Measurement(
                self.markers[some, k],
                SIGMA,
                times=self.t[some],
                sensor=tb.sensors.Position(LENGTH, BLOCK, point=self.points[k]),
                frame=tb.SensorFrame(rotation=AXES, tilt="tilt"),
                delay="delay",
                offset=True,
                noise=self.noise,
                name=f"marker{k + 1}",
            )
            for k in range(3)
        ]

    def model(
        self, until: float, step: float = STEP
    ) -> Callable[[dict[str, torch.Tensor]], tb.Solution]:
        """Parameters (n, ...) -> motions until so long after the release."""
        grid = torch.arange(0.0, until + 2 * RELEASE + 1e-9, 0.01)

        def motion(theta: dict[str, torch.Tensor]) -> tb.Solution:
            power = theta["power"]
            E, tau = theta["E"] * (self.omega / OMEGA) ** power, tangent(power) / self.omega
            section = tb.Section.rectangle(SIDE, SIDE, E, NU, RHO)
            beam = tb.Beam.straight(LENGTH, ELEMENTS, section, order=2)
            effects = [tb.Gravity((0, 0, -G)), tb.Damping(tau), *self.hung()]
            bears = torch.tensor([0, 0, G * (self.mass + 3 / 8 * RHO * SIDE**2 * LENGTH)])
            force, moment = bears + theta["hand"][..., :3], theta["hand"][..., 3:]
            held = tb.Scene(beam, [*effects, tb.TipLoad(force=force, moment=moment)])
            hand, creeps = letting_go(force), theta["creep"][..., None] * bears
            ends = tb.TipLoad(
                force=lambda t: hand(t) - creeps * since_release(t), moment=letting_go(moment)
            )
            start = tb.equilibrium(held, throw=False)
            return tb.simulate(tb.Scene(beam, [*effects, ends]), grid, step=step, initial=start)

        return motion


def tangent(power: torch.Tensor) -> torch.Tensor:
    """Loss factor of stress that relaxes by a power of time."""
    return torch.tan(math.pi / 2 * power)


def since_release(t: torch.Tensor) -> torch.Tensor:
    """ln(1 + t/LETTING_GO), t s after the release."""
    return torch.log1p((t - RELEASE).clamp(min=0) / LETTING_GO)


def letting_go(value: torch.Tensor) -> Callable[[torch.Tensor], torch.Tensor]:
    def of_time(t: torch.Tensor) -> torch.Tensor:
        share = ((t - RELEASE) / LETTING_GO).clamp(0, 1)
        return value * (1 - share * share * (3 - 2 * share))

    return of_time


def start(several: bool) -> dict[str, tb.Parameter]:
    """Parameters, with what is known of them before. The hand, 0.1 N and 5 N mm (one deviation) off
    what bears the mass and the block, and the release are each record's own.
    """
    spread = torch.tensor([0.1, 0.1, 0.1, 5e-3, 5e-3, 5e-3])
    zero = torch.zeros(3)
    return {
        "E": tb.Parameter(1.2 * AUTHORS, "log", prior=LogNormal(math.log(AUTHORS), 0.3)),
        "power": tb.Parameter(0.1, "log"),
        "creep": tb.Parameter(0.03, prior=Normal(0.0, 0.05)),
        "tilt": tb.Parameter(zero, prior=Normal(zero, 0.1)),
        "hand": tb.Parameter(torch.zeros(6), prior=Normal(torch.zeros(6), spread), own=several),
        "delay": tb.Parameter(0.0, prior=Normal(0.0, 0.01), own=several),
    }


def main(arguments: Sequence[str] | None = None) -> str:
    """Fit, predict, and the line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, nargs="+", required=True, help="records")
    parser.add_argument("--held", type=Path, help="a record of which 0.6 s are fitted")
    parser.add_argument("--noise", default="blocks", choices=("white", "ar1", "repeats", "blocks"))
    parser.add_argument("--begin", type=float, default=SWING, help="s, when the fit begins")
    given, begun = parser.parse_args(arguments), time.perf_counter()
    later, settings = given.begin - SWING, (given.noise, given.begin)
    until = {Record(path, *settings): FITTED + later for path in given.data}
    if given.held is not None:
        until[Record(given.held, *settings)] = SETTLED + later
    fit = tb.identify(
        {r.name: r.model(end) for r, end in until.items()},
        {r.name: r.measurements(end) for r, end in until.items()},
        start(len(until) > 1),
        derivatives="difference",
        tolerance=1e-3,
    )
    fit = fit.refined({r.name: r.model(end, FINE) for r, end in until.items()})
    print(fit)
    off, inside = [], []
    for record, end in list(until.items())[-1:] if given.held else until.items():
        errors, within, motion = predicted(fit, record, end)
        print(record.name, "RMS over the motion, %:", 100 * rms(errors) / motion)
        off.append(errors)
        inside.append(within)
    share = torch.cat(inside).double().mean().item()
    return line(fit, COMMON, rms(torch.cat(off)), share, time.perf_counter() - begun)


def predicted(
    fit: tb.Fit, record: Record, begin: float
) -> tuple[torch.Tensor, torch.Tensor, float]:
    """Of the second after what was fitted of a record: errors (times, markers, 3) m, which readings
    the 95 % bands hold, and how far the markers moved in the record, m.
    """
    some = record.during(begin, begin + AHEAD)
    seen = record.markers[some]
    errors, within = [], []
    for k in range(3):
        name = f"marker{k + 1}"
        (fitted,) = (
            r for r in fit.readings if r.experiment == record.name and r.labels[0].startswith(name)
        )
        last = fitted.times > fitted.times.max() - LAST
        noise = (fitted.data - fitted.y)[last].square().mean(0).sqrt()
        band = fit.predict(
            record.model(begin + AHEAD, FINE),
            times=record.t[some],
            experiment=record.name,
            measurement=name,
            sigma=noise,
        )
        errors.append(band.y - seen[:, k])
        within.append((band.low <= seen[:, k]) & (seen[:, k] <= band.high))
    spread = record.markers.amax(0) - record.markers.amin(0)
    return torch.stack(errors, 1), torch.stack(within, 1), spread.norm(dim=-1).max().item()


if __name__ == "__main__":
    print(main())
