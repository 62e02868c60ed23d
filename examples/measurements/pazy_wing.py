"""The Pazy wing under weights: its stiffness in bending and torsion and how far its root gives way,
from small weights; larger ones predicted.

The data are those of Avin, Raveh, Drachinsky, Ben-Shmuel and Tur (AIAA Journal 60(3), 2022,
doi:10.2514/1.J060621), as the Large Deflection Working Group of the aeroelastic prediction workshop
publishes them, github.com/UM-A2SRL/AePW3-LDWG, folder 03_2023_JA_Riso_Cesnik/03_Static_Structural,
05_Experimental_Bending and 06_Experimental_Torsion. Two files of one wing, lines "mass kg, number",
make one CSV with a row a weight and an empty field where nothing was read:

    mass_kg,behind_m,displacement_percent,twist_deg
    0.2,,-4.274,                      weight at half of the tip's chord
    0.2,0.04,-4.547,1.206             so far behind the trailing edge

    python -m examples.measurements.pazy_wing --data wing.csv [--held other.csv]

displacement of half of the tip's chord, % of the span, upwards, and twist, as the tip's edges are
at different heights, from where the wing hangs by itself. Without --held the weights above 1.4 kg
are left out of the fit and predicted. The wing is a cantilever of one EI and one GJ under its own
weight, in a root that may turn under a moment; the readings may begin from another zero. Published
numbers: without skin 38.83 % under 2.0 kg, twist 6.03 degrees under 2.0 kg at 0.04 m; with skin
37.73 % under 2.0 kg, 50.09 % under 3.0 kg, and 9.22 degrees under 2.8 kg at 0.08 m. A beam model
that was condensed from finite elements (Riso and Cesnik 2022) has EI = 4.42 and GJ = 6.45 N m^2 in
the middle of the span; under 2 kg its tip is 2.4 % of the span higher than the wing's.

What the data cannot: EI and the root's compliance are nearly one number (see
`examples/identify_wing.py`); the twist without skin was read in steps of 0.6 degrees. It ends with
a line of JSON: parameters with 95 % intervals, RMS of the height and of the difference of the
edges' heights over what was predicted, the share of its readings that 95 % bands hold.
"""

import argparse
import csv
import math
import time
from collections.abc import Sequence
from pathlib import Path

import torch
from torch.distributions import HalfNormal, LogNormal, Normal

import torchbeam as tb

from .report import line

SPAN, CHORD, AXIS, G = 0.55, 0.0989, 0.44096, 9.81  # m, m, of the chord, m/s^2
MASS = 0.346 / SPAN  # kg/m, as if it were uniform
EA, EI_EDGE = 9.65e6, 3.28e3  # N, N m^2 within the wing's plane
ELEMENTS, LARGEST = 12, 1.4  # kg, of the weights that are fitted
WEIGHTLESS = 1e-9  # kg
HALF = CHORD * (AXIS - 0.5)  # m, y of half of the chord


def read(path: Path) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Weights (rows,) kg, their places y (rows,) m before the axis, and (rows, 2) m: displacement
    of half of the tip's chord, and how much higher the leading edge has come than the trailing one.
    """
    with path.open() as file:
        rows = list(csv.DictReader(file))

    def column(name: str) -> torch.Tensor:
        return torch.tensor([float(row[name] or "nan") for row in rows], dtype=torch.float64)

    behind = CHORD * (AXIS - 1) - column("behind_m")
    height = column("displacement_percent") / 100 * SPAN
    edges = CHORD * column("twist_deg").deg2rad().sin()
    return column("mass_kg"), behind.nan_to_num(nan=HALF), torch.stack((height, edges), -1)


class Wing:
    """The model of weights (rows,) kg at y (rows,) m: parameters (n,) -> readings (n, rows, 2) m
    from where the wing hangs by itself.
    """

    def __init__(self, mass: torch.Tensor, y: torch.Tensor) -> None:
        itself = torch.tensor([WEIGHTLESS], dtype=mass.dtype)
        self.mass = torch.cat((itself, mass))
        at = torch.cat((0 * itself, y))
        self.offset = torch.stack((0 * at, at, 0 * at), -1)

    def __call__(self, theta: dict[str, torch.Tensor]) -> torch.Tensor:
        EI, GJ, soft = (theta[name][:, None] for name in ("EI", "GJ", "root"))
        section = tb.Section.from_stiffness(
            EA=EA, GA=EA / 3, GJ=GJ, EI=(EI, EI_EDGE), mass=MASS, inertia=1e-5
        )
        effects = [
            tb.Gravity((0, 0, -G)),
            tb.PointMass(self.mass, offset=self.offset, node=-1),
            tb.RootSpring((0.0, 1 / soft.clamp(min=1e-6)[..., None])),
        ]
        foot = tb.Support(0, rotation="xz")
        scene = tb.Scene(tb.Beam.straight(SPAN, ELEMENTS, section), effects, supports=foot)
        tip = tb.equilibrium(scene, throw=False, engine="compiled").tip
        edge = tip.rotation[..., 2, 1]
        height = tip.position[..., 2] + HALF * edge
        readings = torch.stack((height, CHORD * edge), -1)
        return readings[:, 1:] - readings[:, :1] + theta["zero"][:, None]


def start() -> dict[str, tb.Parameter]:
    """Parameters, with what is known of them before: the root gives way by little."""
    return {
        "EI": tb.Parameter(4.4, "log", prior=LogNormal(math.log(4.4), 0.2)),
        "GJ": tb.Parameter(6.5, "log", prior=LogNormal(math.log(6.5), 0.5)),
        "root": tb.Parameter(0.002, prior=HalfNormal(0.01), bounds=(0.0, 0.1)),  # rad/(N m)
        "zero": tb.Parameter(torch.zeros(2), prior=Normal(torch.zeros(2), 3e-3)),  # m
    }


def main(arguments: Sequence[str] | None = None) -> str:
    """Fit, predict, and the line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="a CSV of weights")
    parser.add_argument("--held", type=Path, help="another one, to be predicted")
    given, begun = parser.parse_args(arguments), time.perf_counter()
    mass, y, seen = read(given.data)
    fitted = torch.ones_like(mass, dtype=torch.bool)
    if given.held is None:
        fitted = mass < LARGEST + 1e-6
        held = mass[~fitted], y[~fitted], seen[~fitted]
    else:
        held = read(given.held)
    fit = tb.identify(
        Wing(mass[fitted], y[fitted]),
        tb.Measurement(seen[fitted], name="tip"),
        start(),
        noise="channel",
        derivatives="difference",
        tolerance=1e-3,
    )
    print(fit.summary())
    noise = torch.tensor(list(fit.noise.values()), dtype=seen.dtype)
    band = fit.predict(Wing(*held[:2]), sigma=noise)
    there = held[2].isfinite()
    inside = (band.low <= held[2]) & (held[2] <= band.high)
    off = torch.where(there, band.y - held[2], 0)
    rms = (off.square().sum(0) / there.sum(0).clamp(min=1)).sqrt()
    share = inside[there].double().mean().item()
    return line(fit, start(), rms, share, time.perf_counter() - begun)


if __name__ == "__main__":
    print(main())
