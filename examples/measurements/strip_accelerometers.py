"""A strip with two accelerometers that rings: its modulus and damping, and where the instruments
are, from a while of their record, and the while after that predicted.

The data are those of the repository `deepfe/dexpilab1`, folder `20220317_VD1`: a cantilever of
steel or aluminium, 0.3 or 0.4 m, with 50 to 200 g on it, struck, by two accelerometers at 2,048 Hz.
Its .mat files hold `Out` (or `Fe.Out`) with `Time` and `Acc` (2, samples), and `Data` with `L`,
`Section` (width, thickness), `Density` and `ElasticMod`. It has no licence: take a copy of your own
and write of a record, from the stroke on, in m/s^2,

    import numpy, scipy.io
    out = scipy.io.loadmat("VDeXpiLab1_2022413_2310.mat", squeeze_me=True)["Out"][()]
    rows = numpy.column_stack((out["Time"], out["Acc"].T))
    numpy.savetxt("strip.csv", rows, "%.7g", ",", header="t_s,acc1_m_s2,acc2_m_s2", comments="")

    python -m examples.measurements.strip_accelerometers --data strip.csv --length 0.4 --width 0.03
        --thickness 0.003 --density 7850 --modulus 2.1e11 --mass 0.1 --sensors 0.2 0.38
        [--held other.csv]

--mass is that at the tip, --sensors where the accelerometers are about (m from the clamp).
Published with it, of a strip without mass: 27.8, 167 and 415.6 Hz. Three modes of a beam with
damping of Kelvin and Voigt and of the air swing freely; their sizes and phases at the record's
begin are parameters, six of each record, as are the instruments' places. Half a second is fitted,
the next one predicted; of --held a tenth is fitted, for its own sizes and phases. The search begins
where the first mode has the frequency of the spectrum's largest line.

It ends with a line of JSON: parameters with 95 % intervals; the RMS over what was predicted by
accelerometer, as a displacement at the first frequency, a/omega^2, mm; the share of the readings
that 95 % bands hold.
"""

import argparse
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from torch.distributions import LogNormal, Normal

import torchbeam as tb

from .report import columns, line

ELEMENTS, MODES = 6, 3
FITTED, SETTLED, AHEAD = 0.5, 0.1, 0.5  # s
COMMON = ("E", "tau", "alpha", "place")
Theta = dict[str, torch.Tensor]


class Strip:
    """What the arguments say of it."""

    def __init__(self, given: argparse.Namespace) -> None:
        self.given = given
        self.length, self.places = given.length, torch.tensor(given.sensors, dtype=torch.float64)

    def modes(self, theta: Theta) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Of samples (n,): frequencies (n, MODES) rad/s, decay (n, MODES) 1/s, and displacement
        (n, MODES, 2) at the accelerometers over that of the tip.
        """
        given = self.given
        section = tb.Section.rectangle(given.width, given.thickness, theta["E"], 0.3, given.density)
        effects: list = [tb.Damping(theta["tau"]), tb.MassDamping(theta["alpha"])]
        if given.mass:
            effects.append(tb.PointMass(given.mass))
        beam = tb.Beam.straight(self.length, ELEMENTS, section, order=2)
        modes = tb.modes(tb.Scene(beam, effects, plane="xz"), count=MODES)
        shape = modes.shape / modes.shape[..., -1:, 2:3]  # the tip moves by 1
        w, slope = shape[..., 2].real, -shape[..., 4].real
        nodes = w.shape[-1] - 1
        h = self.length / nodes
        at = (theta["place"] / h)[:, None].expand(-1, MODES, -1)
        k = at.detach().floor().long().clamp(0, nodes - 1)
        u = at - k
        w0, w1, s0, s1 = (
            x.gather(-1, n) for x, n in ((w, k), (w, k + 1), (slope, k), (slope, k + 1))
        )
        moved = (
            (1 + 2 * u) * (1 - u) ** 2 * w0 + u**2 * (3 - 2 * u) * w1
            + h * u * (1 - u) * ((1 - u) * s0 - u * s1)
        )  # fmt: skip
        return modes.frequency, -modes.eigenvalue.real, moved

    def swings(self, theta: Theta, t: torch.Tensor) -> torch.Tensor:
        """(n, times, 2, 2 MODES): what each amplitude adds to the readings at t (times,) s."""
        omega, decay, moved = self.modes(theta)
        phase = omega[:, None] * t[:, None]
        fading = torch.exp(-decay[:, None] * t[:, None])
        waves = torch.stack((fading * phase.cos(), fading * phase.sin()), -1)
        return (moved.mT[:, None, :, :, None] * waves[:, :, None]).flatten(-2)

    def model(self, t: torch.Tensor) -> Callable[[Theta], torch.Tensor]:
        def readings(theta: Theta) -> torch.Tensor:
            return (self.swings(theta, t) @ theta["amplitude"][:, None, :, None])[..., 0]

        return readings


def read(path: Path) -> tuple[torch.Tensor, torch.Tensor]:
    """Times (times,) s from the first on, and accelerations (times, 2) m/s^2."""
    names, rows = columns(path)
    t = rows[:, names.index("t_s")]
    return t - t[0], rows[:, [names.index("acc1_m_s2"), names.index("acc2_m_s2")]]


def largest_line(t: torch.Tensor, a: torch.Tensor) -> float:
    """rad/s, of a record (times, 2), eight times as fine as its spectrum."""
    n = 8 * len(t)
    size = torch.fft.rfft((a - a.mean(0)) * torch.hann_window(len(t))[:, None], n, dim=0)
    return 2 * math.pi * int(size.abs().sum(-1).argmax()) / (n * (t[1] - t[0]).item())


def start(strip: Strip, t: torch.Tensor, a: torch.Tensor, several: bool) -> dict[str, tb.Parameter]:
    """Parameters, from the largest line of a record (times, 2) and least squares at that."""
    E = strip.given.modulus
    theta = {name: torch.tensor([x]).double() for name, x in (("tau", 1e-6), ("alpha", 0.5))}
    theta |= {"place": strip.places[None], "E": torch.tensor([E]).double()}
    theta["E"] = E * (largest_line(t, a) / strip.modes(theta)[0][:, 0]) ** 2
    basis = strip.swings(theta, t)[0].flatten(0, 1)
    amplitude = torch.linalg.lstsq(basis, a.flatten()[:, None]).solution[:, 0]
    size = amplitude.abs().max()
    return {
        "E": tb.Parameter(theta["E"].item(), "log", prior=LogNormal(math.log(E), 0.2)),
        "tau": tb.Parameter(1e-6, "log", prior=LogNormal(math.log(1e-6), 2.0)),
        "alpha": tb.Parameter(0.5, "log", prior=LogNormal(math.log(0.5), 2.0)),
        "place": tb.Parameter(strip.places, prior=Normal(strip.places, 5e-3)),
        "amplitude": tb.Parameter(
            amplitude, prior=Normal(0 * amplitude, 10 * size.expand_as(amplitude)), own=several
        ),
    }


def main(arguments: Sequence[str] | None = None) -> str:
    """Fit, predict, and the line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="a record")
    parser.add_argument("--held", type=Path, help="another one, of which 0.1 s are fitted")
    for name in ("length", "width", "thickness", "density", "modulus"):
        parser.add_argument(f"--{name}", type=float, required=True)
    parser.add_argument("--mass", type=float, default=0.0, help="kg, at the tip")
    parser.add_argument("--sensors", type=float, nargs=2, required=True, help="m from the clamp")
    given, begun = parser.parse_args(arguments), time.perf_counter()
    strip, until = Strip(given), {given.data: FITTED}
    if given.held is not None:
        until[given.held] = SETTLED
    records = {path.stem: (*read(path), end) for path, end in until.items()}
    first = {name: t < end for name, (t, _, end) in records.items()}
    fit = tb.identify(
        {name: strip.model(t[first[name]]) for name, (t, _, _) in records.items()},
        {
            name: tb.Measurement(a[first[name]], times=t[first[name]], name="strip")
            for name, (t, a, _) in records.items()
        },
        start(strip, *(x[first[given.data.stem]] for x in records[given.data.stem][:2]),
              len(records) > 1),
        noise="channel",
        derivatives="difference",
        tolerance=1e-3,
    )  # fmt: skip
    print(fit.summary())
    name, (t, a, end) = list(records.items())[-1]
    later = (t >= end) & (t < end + AHEAD)
    noise = torch.tensor(list(fit.noise.values())[:2]).double()  # the first record is the longer
    band = fit.predict(strip.model(t[later]), experiment=name, sigma=noise)
    seen = a[later]
    share = ((band.low <= seen) & (seen <= band.high)).double().mean().item()
    omega = strip.modes({n: fit[n].reshape(1, *fit[n].shape) for n in COMMON})[0][0, 0]
    rms = (band.y - seen).square().mean(0).sqrt() / omega**2
    return line(fit, COMMON, rms, share, time.perf_counter() - begun)


if __name__ == "__main__":
    print(main())
