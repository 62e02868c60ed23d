"""Ground resonance: a helicopter whose rotor shakes it on its landing gear, and why blades have lag
dampers.

Four rigid blades on lag hinges; the hub stands on springs, softer masses along y than along x. With
four equal dampers the coefficients are constant in multiblade coordinates, and every speed is
stable. With one damper inoperative they change with the azimuth; Floquet's exponents show where a
lag mode grows: where its regressing frequency meets those of the hub. `tb.campbell` takes either.
Data: Hammond (1974), J. Am. Helicopter Soc. 19(4), 14. The check is the growth and the onset of
that range against Coleman and Feingold's equations, integrated over a turn by a program of their
own (tests/verification/test_rotors.py). Run as a script, it also draws the diagram.
"""

import argparse
import math
from pathlib import Path

import torch

import torchbeam as tb

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--picture", type=Path, default=Path("out/ground_resonance.png"))
options = parser.parse_args(None if __name__ == "__main__" else [])

MASS, S, INERTIA = 94.9, 289.1, 1084.7  # of a blade, about its hinge: kg, kg m, kg m^2
OFFSET, DAMPER = 0.3048, 4067.5  # m of the hinge from the axis, N m s
HUB = (8026.6, 3283.6)  # kg along x and y
SPRING, HUB_DAMPER = 1240481.8, (51078.7, 25539.35)  # N/m, N s/m
ALONG = ((1, 0, 0), (0, 1, 0))


def helicopter(dampers: tuple[float, ...]) -> tb.Scene:
    """In the plane of the rotor, drawn at the azimuth 0; the bearing is joint 0."""
    lever = S / MASS
    parts = {
        "carriage": tb.Body(mass=HUB[0] - HUB[1], inertia=1.0),
        "mast": tb.Body(mass=HUB[1], inertia=1.0),
        "hub": tb.Body(mass=1e-6, inertia=1e-6),
    }
    joints: list[tb.Hinge | tb.Slider] = [tb.Hinge("mast", "hub", axis=(0, 0, 1))]
    for a, b, k in ((None, "carriage", 0), ("carriage", "mast", 1)):
        gear = tb.Slider(a, b, axis=ALONG[k], stiffness=SPRING, damping=HUB_DAMPER[k])
        joints.append(gear)
    for k, damper in enumerate(dampers):
        angle = 2 * math.pi * k / len(dampers)
        out = torch.tensor([math.cos(angle), math.sin(angle), 0.0], dtype=torch.float64)
        parts[f"blade {k}"] = tb.Body(
            mass=MASS, inertia=INERTIA - MASS * lever**2, position=(OFFSET + lever) * out
        )
        lag = tb.Hinge("hub", f"blade {k}", at=OFFSET * out, axis=(0, 0, 1), damping=damper)
        joints.append(lag)
    return tb.Scene(parts, joints=joints, plane="xy")


SPEED = torch.linspace(10.0, 40.0, 31, dtype=torch.float64)  # rad/s
whole = tb.campbell(helicopter((DAMPER,) * 4), SPEED, bearing=0)
less = tb.campbell(helicopter((0.0, DAMPER, DAMPER, DAMPER)), SPEED, bearing=0)
((low, high),) = less.unstable_ranges
growth = less.eigenvalue.real[SPEED == 26.0].max().item()

CHECK = growth
EXPECTED, TOLERANCE = 0.318621, 2e-6  # 1/s at 26 rad/s; measured 3e-8

print(f"four dampers: {whole.method}, unstable nowhere: {not whole.unstable.any()}")
print(f"one inoperative: {less.method}, unstable from {low:.2f} to {high:.2f} rad/s")
print(f"most growth {less.eigenvalue.real.max().item():.3f} 1/s, at 26 rad/s {growth:.6f} 1/s")
for at in whole.critical(orders=1):
    print(f"{at.mode}: 1/rev at {at.speed:.1f} rad/s")


def draw(path: Path = options.picture) -> None:
    left, right = tb.plot.grid(1, 2, (11, 4.2))
    less.plot(left, orders=(1, 2))
    left.set_ylabel("frequency, one damper inoperative / (rad/s)")
    for diagram, text in ((whole, "four dampers"), (less, "one inoperative")):
        right.plot(SPEED, diagram.eigenvalue.real.amax(-1), label=text)
    right.axhline(0.0, color="0.6", lw=0.8)
    right.axvspan(low, high, color="C3", alpha=0.15, lw=0)
    right.set(xlabel="speed / (rad/s)", ylabel="growth of the least damped mode / (1/s)")
    right.legend(frameon=False, fontsize=8)
    print("wrote", tb.plot.save(left, path))


if __name__ == "__main__":
    draw()
