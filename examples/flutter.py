"""Flutter of Goland's wing: how the damping of its bending and torsion changes with the speed.

A uniform cantilever wing of 6.1 m (Goland 1945): strip theory with Wagner's lags, its axis at 33 %
and its centre of mass at 43 % of the chord. Sixteen speeds are one batch of `tb.modes`;
`tb.critical_load` finds the speed at which a motion begins to grow. Published: 137.2 m/s and 70.7
rad/s (Goland and Luke 1948). The same equations with Theodorsen's own function in the place of
Jones's two lags give 137.0 m/s and 70.0 rad/s. Run as a script, it also draws out/flutter.png.
"""

from pathlib import Path

import torch

import torchbeam as tb

SPAN, CHORD, AXIS, CENTRE = 6.096, 1.8288, 0.33, 0.43  # m, m, of the chord, of the chord
EI, GJ, MASS, INERTIA = 9.77e6, 0.987e6, 35.72, 8.64  # N m^2, kg/m, kg m about the axis
N, PUBLISHED = 6, 137.2

behind = MASS * (CENTRE - AXIS) * CHORD  # kg, static moment: the centre of mass is at -y
mass = torch.diag(torch.tensor([MASS, MASS, MASS, INERTIA, 0.01 * INERTIA, INERTIA]))
mass[2, 3] = mass[3, 2] = -behind
mass[0, 5] = mass[5, 0] = behind
compliance = torch.diag(torch.tensor([0.0, 0.0, 0.0, 1 / GJ, 1 / EI, 0.0]))
wing = tb.Beam.straight(SPAN, N, tb.Section(compliance, mass))
air = tb.StripAir(CHORD, axis=AXIS, density=1.225, wind=tb.Input("wind", 3))
scene = tb.Scene(wing, [air])

speeds = torch.linspace(10.0, 160.0, 16)
wind = torch.stack((0 * speeds, -speeds, 0 * speeds), -1)  # toward the leading edge, which is at +y
found = tb.modes(scene, count=2, inputs={"wind": wind}).eigenvalue

critical = tb.critical_load(
    scene, 160.0, lowest=120.0, points=3, count=4, tolerance=1e-4, inputs={"wind": (0, -1.0, 0)}
)
CHECK = critical.factor.item() / PUBLISHED - 1
EXPECTED, TOLERANCE = 0.0, 1e-3  # measured 1e-4 below; 6 elements take off 1.1e-3

print("speed m/s   growth 1/s       frequency rad/s")
for speed, pair in zip(speeds.tolist()[::3], found[::3], strict=True):
    print(
        f"{speed:7.0f} ", *(f"{x:8.2f}" for x in (*pair.real.tolist(), *pair.imag.abs().tolist()))
    )
print(
    f"flutter at {critical.factor:.2f} m/s, {critical.frequency:.2f} rad/s: "
    f"{100 * CHECK:+.2f} % of the published speed"
)


def draw(path: Path = Path("out/flutter.png")) -> None:
    import matplotlib.pyplot as plt

    _, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(6, 5), layout="constrained")
    for axis, values in ((above, found.imag.abs()), (below, found.real)):
        axis.plot(speeds, values, ".", ms=5)
        axis.axvline(critical.factor.item(), color="k", lw=0.8, ls="--")
    below.axhline(0, color="k", lw=0.8)
    above.set(ylabel="frequency, rad/s", title=f"flutter at {critical.factor:.1f} m/s")
    below.set(xlabel="speed, m/s", ylabel="growth, 1/s")
    print("wrote", tb.plot.save(above, path))


if __name__ == "__main__":
    draw()
