"""Two weights on a cable over a pulley that turns on a hinge: Atwood's machine.

The cable sticks to the pulley by friction and turns it without slip but for the creep of what
sticks. Weights, cable and the pulley's rim have one way x, that of a rope without bending stiffness
whose mass q per length goes over from one side to the other:

    (m + M + I/R^2 + the cable's mass) x'' = (m - M) g + 2 q g x

with R to the cable's axis; from rest, x' = a/c sinh(c t) with a = x''(0) and c^2 = 2 q g/(m + M +
...). The cable is straight by nature (one that is bent to the pulley by nature would lose its
energy EI/(2 R^2) per length as it leaves, and take as much where it comes on: a force of EI/R^2),
and starts in the tension of the mean weight, so that it neither falls nor rings. What is left is
friction where the cable comes on and leaves: it is pressed there before it turns as the pulley
does, so that its surface slips by its radius times the spin that it lacks. It takes the less, the
thinner contact and cable are, and the less friction and bending stiffness there is (0.6 % with a
friction of 0.8 and a contact of 0.5 mm, whatever the number of elements). The rim creeps, too. Run
as a script, it also draws a picture and a film.
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

RADIUS, CABLE, THICKNESS, G = 0.05, 0.003, 1.25e-4, 9.81  # m, m/s^2
HEAVY, LIGHT, MASS, INERTIA = 0.2, 0.15, 1e-3, 4e-4  # kg; kg/m of the cable; kg m^2
TURNS, HANGS, END = 24, 18, 0.3  # elements over the pulley, on each side; s
AXIS = RADIUS + CABLE + THICKNESS / 2  # m: under a quarter of the contact's force
TENSION, EA, EI = (HEAVY + LIGHT) / 2 * G, 2e3, 1e-5  # N, N, N m^2


def course() -> torch.Tensor:
    """Nodes (N+1, 3) m: up, over the pulley, and down. The centreline is (arc of an element)^2/(8
    R) within them.
    """
    angle = torch.linspace(0, math.pi, TURNS + 1, dtype=torch.float64)
    out = AXIS * (1 + (math.pi / TURNS) ** 2 / 8)
    over = out * torch.stack((-torch.cos(angle), 0 * angle, torch.sin(angle)), -1)
    down = out * math.pi / TURNS * torch.arange(HANGS, 0, -1, dtype=torch.float64)
    left, right = (torch.stack((0 * down + x, 0 * down, -down), -1) for x in (-out, out))
    return torch.cat((left, over, right.flip(0)))


def straight_and_taut(nodes: torch.Tensor) -> tb.Actuation:
    """What makes a cable that is drawn through nodes straight by nature, and taut as drawn."""
    chord = nodes.diff(dim=0)
    turned = torch.atan2(chord[:, 0], chord[:, 2])
    at_nodes = torch.cat((turned[:1], (turned[1:] + turned[:-1]) / 2, turned[-1:]))
    bent = at_nodes.diff() / torch.linalg.vector_norm(chord, dim=-1)
    curvature = torch.stack((0 * bent, -bent, 0 * bent), -1)
    strain = (-TENSION / EA, 0.0, 0.0)
    return tb.Actuation(curvature=tb.PerElement(curvature), strain=strain, on="cable")


def machine() -> tb.Scene:
    nodes = course()
    section = tb.Section.from_stiffness(EA=EA, GA=EA, GJ=1e-4, EI=EI, mass=MASS, inertia=1e-9)
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
    contact = tb.Contact(
        "cable", "pulley", radius=CABLE, thickness=THICKNESS, friction=0.2, slip_speed=5e-3,
        force=4 * TENSION / RADIUS, damping=1e-3,
    )  # fmt: skip
    joints = [
        tb.Hinge(None, "pulley", axis=(0, 1, 0)),
        tb.Ball(("cable", 0), "heavy"),
        tb.Ball(("cable", -1), "light"),
    ]
    gravity, damping = tb.Gravity((0, 0, -G)), tb.Damping(1e-3)
    effects = [contact, gravity, damping, straight_and_taut(nodes)]
    return tb.Scene(parts, effects, joints=joints, plane="xz")


t = torch.linspace(0, END, 31, dtype=torch.float64)
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
start, rate = (HEAVY - LIGHT) * G / whole, math.sqrt(2 * MASS * G / whole)  # m/s^2, 1/s
wanted = start * math.sinh(rate * END) / (rate * END)  # the mean
CHECK = max(abs(a / wanted - 1) for a in (heavy, light, rim))
EXPECTED, TOLERANCE = 0.0, 5e-3  # of friction at both ends of the arc, and of creep


def falls(ax: Any) -> None:
    height = run["heavy"].position[:, 2]
    ax.plot(t, 1e3 * (height[0] - height), ".", label="the heavier weight")
    way = start * ((rate * t).cosh() - 1) / rate**2
    ax.plot(t, 1e3 * way, lw=1, label="a rope without stiffness")
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
