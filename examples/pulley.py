"""Two weights on a cable over a pulley that turns on a hinge: Atwood's machine.

The cable sticks to the pulley by friction and turns it without slip but for the creep of what
sticks; both weights, and the pulley's rim, get

    a = (m - M) g/(m + M + I/R^2 + the cable's mass)

with R to the cable's axis, and the tensions differ by I a/R^2. Run as a script, it also draws a
picture and a film.
The film: the heavier weight goes down, the cable runs over, and the line on the pulley turns with
it.
"""

import argparse
import math
from pathlib import Path
from typing import Any

import torch

import torchbeam as tb

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument(
    "--picture", type=Path, default=Path("out/pulley.png"), help="the film beside it"
)
options = parser.parse_args(None if __name__ == "__main__" else [])

torch.set_default_dtype(torch.float64)
RADIUS, CABLE, THICKNESS, G = 0.05, 0.003, 5e-4, 9.81  # m, m/s^2
HEAVY, LIGHT, MASS, INERTIA = 0.2, 0.15, 1e-3, 4e-4  # kg; kg/m of the cable; kg m^2
TURNS, HANGS, END = 24, 18, 0.3  # elements over the pulley, on each side; s
AXIS = RADIUS + CABLE + THICKNESS / 2  # m: under a quarter of the contact's force


def machine() -> tb.Scene:
    angle = torch.linspace(0, math.pi, TURNS + 1)
    over = AXIS * torch.stack((-torch.cos(angle), 0 * angle, torch.sin(angle)), -1)
    down = AXIS * math.pi / TURNS * torch.arange(HANGS, 0, -1)
    left, right = (torch.stack((0 * down + x, 0 * down, -down), -1) for x in (-AXIS, AXIS))
    nodes = torch.cat((left, over, right.flip(0)))
    section = tb.Section.from_stiffness(EA=2e3, GA=2e3, GJ=1e-4, EI=1e-5, mass=MASS, inertia=1e-9)
    parts = {
        "cable": tb.Beam.from_nodes(nodes, section, up=(-1.0, 0, 0)),
        "pulley": tb.Body(0.3, INERTIA, surface=tb.Capsule((0, -0.01, 0), (0, 0.01, 0), RADIUS)),
        "heavy": tb.Body(
            HEAVY,
            1e-5,
            position=nodes[0],
            surface=tb.Box((0, 0, -0.012), (0.03, 0.03, 0.024), 0.003),
        ),
        "light": tb.Body(
            LIGHT,
            1e-5,
            position=nodes[-1],
            surface=tb.Box((0, 0, -0.009), (0.03, 0.03, 0.018), 0.003),
        ),
    }
    turns = tb.Contact(
        "cable", "pulley", radius=CABLE, thickness=THICKNESS, friction=0.8, slip_speed=5e-3,
        force=4 * (HEAVY + LIGHT) / 2 * G / RADIUS, damping=1e-3,
    )  # fmt: skip
    joints = [
        tb.Hinge(None, "pulley", axis=(0, 1, 0)),
        tb.Ball(("cable", 0), "heavy"),
        tb.Ball(("cable", -1), "light"),
    ]
    effects = [turns, tb.Gravity((0, 0, -G)), tb.Damping(1e-3)]
    return tb.Scene(parts, effects, joints=joints, plane="xz")


t = torch.linspace(0, END, 31)
scene = machine()
run = tb.simulate(scene, t, step=5e-4)
assert (run.status == 0).all()
heavy, light, rim = (
    x / END  # the mean, from rest
    for x in (
        -run["heavy"].velocity[-1, 2].item(),
        run["light"].velocity[-1, 2].item(),
        -AXIS * run["pulley"].spin[-1, 1].item(),
    )
)
whole = HEAVY + LIGHT + MASS * float(scene.beam.length.sum()) + INERTIA / AXIS**2
wanted = (HEAVY - LIGHT) * G / whole
CHECK = max(abs(a / wanted - 1) for a in (heavy, light, rim))
# of a polygon over half a turn, creep, and what bending there takes
EXPECTED, TOLERANCE = 0.0, 0.02


def falls(ax: Any) -> None:
    height = run["heavy"].position[:, 2]
    ax.plot(t, 1e3 * (height[0] - height), ".", label="the heavier weight")
    ax.plot(t, 1e3 * wanted * t**2 / 2, lw=1, label="a t²/2")
    ax.set(xlabel="time (s)", ylabel="fallen (mm)")
    ax.legend(frameon=False, fontsize=8)


def main(path: Path = options.picture) -> None:
    print(f"weights {heavy:.4f} and {light:.4f}, rim {rim:.4f} m/s^2; by the formula {wanted:.4f}")
    left, right = tb.plot.grid(1, 2, (8, 4))
    falls(right)
    tb.plot.shape(run.state[-1], left, scene=scene)
    print("wrote", tb.plot.save(left, path))
    left, right = tb.plot.grid(1, 2, (7, 3.6))
    falls(right)
    height = run["heavy"].position[:, 2]
    (now,) = right.plot([], [], "ko", ms=7, mfc="none")
    film: dict[str, Any] = dict(scene=scene, speed=0.2, fps=16, trail=False, dpi=70)
    film["beside"] = lambda k: now.set_data([t[k]], [1e3 * (height[0] - height[k])])
    print("wrote", tb.plot.animate(run, path.with_suffix(".gif"), left, **film))


if __name__ == "__main__":
    main()
