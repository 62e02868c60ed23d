"""A cable between two robots, by motion capture: its stiffness, natural curvature, twist of the
grips, damping and air from some seconds of a record, and other motion predicted from the grips'.

The data are those of the repository `roahmlab/DEFORM` (Chen et al. 2024, arXiv 2406.05931), folders
`data_set/DLO1` to `DLO5`, `train` and `eval`: 12 or 13 markers on a cable at 100 Hz, of which the
first two are on one grip and the last two on the other; z is upwards. It has no licence: take a
copy of your own and write of a record (a pickle of arrays (3, markers), one an instant; a pickle
runs code, so that one of unknown origin is not opened)

    import numpy, pandas
    x = numpy.array(pandas.read_pickle("data_set/DLO2/train/1.pkl")).transpose(0, 2, 1)
    names = ["t_s"] + [f"marker{m + 1}_{c}_m" for m in range(x.shape[1]) for c in "xyz"]
    rows = numpy.column_stack((0.01 * numpy.arange(len(x)), x.reshape(len(x), -1)))
    numpy.savetxt("cable.csv", rows, "%.6f", ",", header=",".join(names), comments="")

    python -m examples.measurements.deform_cable --data cable.csv [--held other.csv] [--seconds 1.6]

The first --seconds of the record are fitted, from the equilibrium in which it begins; the rest of
it, or all of --held, is predicted from the motion of its grips alone. Published for 5 s of records
that were not fitted: a mean error of a coordinate of 26 to 34 mm before training, 10.3 mm after it,
of a network on top of a discrete rod; this model's on the set is not stored here.

The cable is a round rod. How it is turned in the grips is not measured: its axes at both ends are
carried along without twist, and a twist and a curvature at rest are parameters, constant along it.
A record tells forces by weight alone, so that stiffness is that over the mass per length (--mass,
kg/m, is a number that scales both). What the model cannot: grips that roll about the cable, slip in
the grips, friction within it, and the noise of the grips' own markers, which is taken as motion: of
a file that the model made with 0.2 mm of it, EI comes out 3 % too large. It ends with a line of
JSON: parameters with 95 % intervals, the RMS by free marker over what was predicted, the share of
its readings that 95 % bands hold; and mean_error_mm, that of a coordinate, as it was published.
"""

import argparse
import math
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import torch
from torch.distributions import LogNormal, Normal

import torchbeam as tb

from .report import columns, line, rms

ELEMENTS, STEP, G = 12, 0.01, 9.81
SIGMA = 3e-3  # m: what the model misses, of a first fit
AIR, DIAMETER = 1.2, 0.01  # kg/m^3; m, of the drag's coefficient
PARAMETERS = ("EI", "GJ", "curvature", "tau", "drag", "length")
Theta = dict[str, torch.Tensor]


class Record:
    """Times t (times,) s and markers (times, markers, 3) m of a file; frames of the grips (times,
    3, 3), x along the cable, which turn about it no more than it does itself.
    """

    def __init__(self, path: Path, mass: float) -> None:
        names, rows = columns(path)
        self.mass = mass
        self.t = rows[:, names.index("t_s")] - rows[0, names.index("t_s")]
        count = sum(name.endswith("_x_m") for name in names)
        seen = [names.index(f"marker{m + 1}_{c}_m") for m in range(count) for c in "xyz"]
        self.markers = rows[:, seen].unflatten(-1, (count, 3))
        along = torch.nn.functional.normalize(self.markers.diff(dim=1), dim=-1)
        side = torch.eye(3).double()[along[0, 0].abs().argmin()]
        first = carried(framed(along[0, 0], side), along[0])  # along the cable, as it begins
        self.frames = carried(first[0], along[:, 0]), carried(first[-1], along[:, -1])
        cable = self.markers[:, 1:-1]
        # a chord is longest where the cable is straight, and where noise makes it so
        parts = cable.diff(dim=1).norm(dim=-1).quantile(0.9, dim=0)
        self.chord = parts.sum().item()
        self.shares = parts.cumsum(0)[:-1] / self.chord
        self.place, self.other = cable[:, 0], cable[:, -1]

    def scene(self, theta: Theta) -> tb.Scene:
        """With samples (n,)."""
        length = theta["length"]
        section = tb.Section.from_stiffness(
            EA=1e4 * self.mass, GA=5e3 * self.mass, GJ=theta["GJ"] * self.mass,
            EI=theta["EI"] * self.mass, mass=self.mass, inertia=1e-5 * self.mass,
        )  # fmt: skip
        axes = self.frames[0][0]
        beam = tb.Beam.straight(
            length, ELEMENTS, section, direction=axes[:, 0], up=axes[:, 2], root=self.place[0]
        )
        drawn = self.place[0] + length[:, None] * axes[:, 0]
        start, end = (tb.SmoothHistory(self.t, x) for x in (self.place, self.other))
        turns = [tb.SmoothRotation(self.t, frames, reference=axes) for frames in self.frames]
        begin = self.place[0]
        supports = [
            tb.Support(0, displacement=lambda t: start(t) - begin, turn=turns[0]),
            tb.Support(-1, displacement=lambda t: end(t) - drawn, turn=turns[1]),
        ]
        drag = tb.Drag(density=AIR, diameter=DIAMETER, normal=theta["drag"], tangential=0.0)
        effects = [
            tb.Gravity((0, 0, -G)), tb.Damping(theta["tau"]), drag,
            tb.Actuation(curvature=theta["curvature"]),
        ]  # fmt: skip
        return tb.Scene(beam, effects, supports=supports)

    def model(self, some: torch.Tensor) -> Callable[[Theta], tuple[torch.Tensor, torch.Tensor]]:
        """Of the instants some (times,) bool: parameters (n,) -> readings (n, some, markers, 3)."""
        grid = self.t[: int(some.nonzero()[-1]) + 1]
        where = some[: len(grid)]

        def readings(theta: Theta) -> tuple[torch.Tensor, torch.Tensor]:
            scene = self.scene(theta)
            start = tb.equilibrium(scene, initial=self.begin(scene), throw=False)
            motion = tb.simulate(scene, grid, step=STEP, initial=start, throw=False)
            stations = self.shares * theta["length"][:, None]
            places = [
                tb.sensors.Position(station, scene.beam)(motion.state[where])
                for station in stations.unbind(-1)
            ]
            return torch.stack(places, -2).transpose(0, 1), motion.status

        return readings

    def begin(self, scene: tb.Scene) -> tb.State:
        """The cable through the markers of the first instant."""
        cable = self.markers[0, 1:-1]
        at = torch.cat((torch.zeros(1).double(), self.shares, torch.ones(1).double()))
        s = torch.linspace(0, 1, ELEMENTS + 1).double()
        k = torch.searchsorted(at, s).clamp(1, len(at) - 1)
        u = ((s - at[k - 1]) / (at[k] - at[k - 1]))[:, None]
        nodes = cable[k - 1] + u * (cable[k] - cable[k - 1])
        return tb.State.from_nodes(scene, nodes)

    def free(self, some: torch.Tensor) -> torch.Tensor:
        """(some, markers, 3) m of those that no grip holds."""
        return self.markers[some, 2:-2]


def framed(along: torch.Tensor, side: torch.Tensor) -> torch.Tensor:
    """(3, 3) axes with the first along (3,) a direction."""
    z = torch.nn.functional.normalize(torch.linalg.cross(along, side), dim=-1)
    return torch.stack((along, torch.linalg.cross(z, along), z), -1)


def carried(first: torch.Tensor, along: torch.Tensor) -> torch.Tensor:
    """(m, 3, 3): axes (3, 3) carried along directions (m, 3) without a turn about these."""
    frames = [first]
    for a, b in pairwise(along):
        v, c = torch.linalg.cross(a, b), a @ b
        K = torch.zeros(3, 3).double()
        K[[2, 0, 1], [1, 2, 0]], K[[1, 2, 0], [2, 0, 1]] = v, -v
        frames.append((torch.eye(3).double() + K + K @ K / (1 + c)) @ frames[-1])
    return torch.stack(frames)


def start(record: Record) -> dict[str, tb.Parameter]:
    """Parameters, with what is known of them before; stiffness over mass per length m^4/s^2."""
    zero = torch.zeros(3)
    return {
        "EI": tb.Parameter(0.05, "log", prior=LogNormal(math.log(0.05), 1.5)),
        "GJ": tb.Parameter(0.04, "log", prior=LogNormal(math.log(0.04), 1.5)),
        "curvature": tb.Parameter(zero, prior=Normal(zero, 2.0)),  # twist and bending, 1/m
        "tau": tb.Parameter(0.01, "log", prior=LogNormal(math.log(0.01), 1.5)),
        "drag": tb.Parameter(1.0, "log", prior=LogNormal(0.0, 1.0)),
        "length": tb.Parameter(
            record.chord, prior=Normal(record.chord, 0.01 * record.chord), scale=0.01
        ),
    }


def main(arguments: Sequence[str] | None = None) -> str:
    """Fit, predict, and the line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="a record")
    parser.add_argument("--held", type=Path, help="another one, to be predicted")
    parser.add_argument("--seconds", type=float, default=1.6, help="that are fitted")
    parser.add_argument("--mass", type=float, default=0.1, help="kg/m")
    given, begun = parser.parse_args(arguments), time.perf_counter()
    record = Record(given.data, given.mass)
    first = record.t < given.seconds + 1e-6
    cable = tb.Measurement(record.free(first), SIGMA, times=record.t[first], noise="blocks")
    fit = tb.identify(
        record.model(first), cable, start(record), derivatives="difference", tolerance=1e-3
    )
    print(fit.summary())
    other = record if given.held is None else Record(given.held, given.mass)
    some = ~first if given.held is None else torch.ones_like(other.t, dtype=torch.bool)
    (fitted,) = fit.readings
    noise = (fitted.data - fitted.y).square().mean(0).sqrt()
    band, seen = fit.predict(other.model(some), sigma=noise), other.free(some)
    errors, inside = band.y - seen, (band.low <= seen) & (seen <= band.high)
    share, mean = inside.double().mean().item(), round(1e3 * errors.abs().mean().item(), 2)
    seconds = time.perf_counter() - begun
    return line(fit, PARAMETERS, rms(errors), share, seconds, mean_error_mm=mean)


if __name__ == "__main__":
    print(main())
