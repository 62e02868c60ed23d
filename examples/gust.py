"""A long flexible wing flies through a gust: how far it bends, with lags of the wake and without.

The wing of Patil, Hodges and Cesnik (2001): span 16 m, chord 1 m, at 20 km and 25 m/s, trimmed at 4
degrees. A "1 - cosine" gust of 3 m/s and gradients of 4 to 64 chords (CS 25.341) travels toward it
at the airspeed. Gradients are one batch. The root's bending moment over that of steady flight says
what the gust asks for. Quasi-steady air asks for more in short gusts: it has the lift at once,
which the wake lets grow over some chords. Run as a script, it also draws out/gust.png.
"""

from pathlib import Path

import torch

import torchbeam as tb

SPAN, SPEED, DENSITY, N = 16.0, 25.0, 0.0889, 4
ANGLE, GUST = torch.tensor(4.0).deg2rad(), 3.0  # m/s
GRADIENTS = torch.tensor([4.0, 8.0, 16.0, 32.0, 64.0])  # m, as many chords

section = tb.Section.from_stiffness(
    EA=1e7, GA=1e7, GJ=1e4, EI=(2e4, 4e6), mass=0.75, inertia=(5e-4, 0.0995)
)
wing = tb.Beam.straight(SPAN, N, section)
mean = tb.Wind(SPEED * torch.stack((0 * ANGLE, -ANGLE.cos(), ANGLE.sin())))
gust = tb.Gust((0, 0, GUST), GRADIENTS, speed=SPEED, direction=(0, -1.0, 0), start=0.2)
t = torch.linspace(0, 4.0, 81)


def bending(lags):
    """Root bending moments (times, gradients) N m in the gust."""
    air = tb.StripAir(1.0, axis=0.5, density=DENSITY, lags=lags, wind=mean + gust)
    calm = tb.StripAir(1.0, axis=0.5, density=DENSITY, lags=lags, wind=mean)
    steady = tb.equilibrium(tb.Scene(wing, [calm]))
    flight = tb.simulate(tb.Scene(wing, [air]), t, step=0.025, initial=steady)
    return flight.root.moment[..., 1], steady.root.moment[1]


moments, steady = bending("wagner")
quasi, _ = bending(None)
factor, quasi_factor = ((x / steady).amax(0) for x in (moments, quasi))
CHECK = factor[2].item()
EXPECTED, TOLERANCE = 1.347, 5e-3  # twice the elements and half the step give the same

print(f"steady flight at {SPEED:.0f} m/s: root moment {steady:.0f} N m")
print("gradient m   largest moment over steady, with lags   quasi-steady")
for H, a, b in zip(GRADIENTS.tolist(), factor.tolist(), quasi_factor.tolist(), strict=True):
    print(f"{H:8.0f} {a:26.3f} {b:26.3f}")


def draw(path: Path = Path("out/gust.png")) -> None:
    import matplotlib.pyplot as plt

    _, axis = plt.subplots(figsize=(6.5, 4), layout="constrained")
    for k in (0, 2, 4):
        (line,) = axis.plot(t, moments[:, k] / steady, label=f"H = {GRADIENTS[k]:.0f} m")
        axis.plot(t, quasi[:, k] / steady, ":", color=line.get_color(), lw=1)
    axis.set(xlabel="t, s", ylabel="root moment over steady flight's", xlim=(0, 4))
    axis.set_title("gusts of 3 m/s at 25 m/s; dotted: quasi-steady")
    axis.legend()
    print("wrote", tb.plot.save(axis, path))


if __name__ == "__main__":
    draw()
