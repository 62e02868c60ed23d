"""A rope that is let down onto a floor and falls into coils, on the floor and on itself.

Its upper end comes down at a steady speed; the floor rubs, and the rope's turns lie on each other.
Once all of it lies, or hangs from the hand, the floor and the hand bear its weight. Run as a
script, it also draws a picture and a film.
The film: the rope meets the floor with its tip, bends over, and lays turn upon turn.
"""

import argparse
from pathlib import Path
from typing import Any

import torch

import torchbeam as tb

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument(
    "--picture", type=Path, default=Path("out/rope_pile.png"), help="the film is beside it"
)
options = parser.parse_args(None if __name__ == "__main__" else [])

LENGTH, RADIUS, MASS, GRAVITY = 0.5, 0.004, 0.08, 9.81  # m, m, kg/m, m/s^2
BEND = 0.012  # m: (EI/(MASS GRAVITY))^(1/3), what a rope bends over as it hangs
SPEED, UNTIL, END = 0.5, 0.9, 2.4  # m/s; s, when the hand stops; s

EI = MASS * GRAVITY * BEND**3
section = tb.Section.from_stiffness(
    EA=100.0, GA=100.0, GJ=EI, EI=EI, mass=MASS, inertia=MASS * RADIUS**2 / 4
)
hand = (0.0, 0, LENGTH + 0.014)
beam = tb.Beam.straight(LENGTH, 64, section, root=hand, direction=(0, 0, -1.0), up=(1.0, 0, 0))
let_down = tb.Support(0, displacement=lambda t: t.clamp(max=UNTIL) * t.new_tensor((0, 0, -SPEED)))
floor = tb.Contact(
    tb.Plane((0, 0, 0), (0, 0, 1.0)),
    radius=RADIUS, thickness=2e-3, force=20.0, friction=0.4, slip_speed=5e-3,
)  # fmt: skip
turns = tb.SelfContact(radius=RADIUS, thickness=1e-3, force=20.0)
effects = [
    tb.Gravity((0, 0, -GRAVITY)), floor, turns, tb.Damping(5e-3), tb.MassDamping(1.0),
]  # fmt: skip
scene = tb.Scene(beam, effects, supports=[let_down])

# a little out of the straight, as a rope that falls straight would not know where to
s = torch.linspace(0, LENGTH, beam.node_count, dtype=torch.float64)
bow = 0.004 * (1 - torch.exp(-s / 0.05))
bow = torch.stack((bow * torch.cos(20 * s), bow * torch.sin(20 * s), 0 * s), -1)
start = tb.State.from_nodes(scene, beam.nodes + bow)
t = torch.linspace(0, END, 121, dtype=torch.float64)
solution = tb.simulate(scene, t, start, "generalized_alpha", step=4e-3, rho_inf=0.5)

last = solution.state[-1]
borne = tb.sensors.ContactForce(scene)(last)[2] + last.root.force[2]  # N
CHECK, EXPECTED = (borne / (MASS * GRAVITY * LENGTH)).item(), 1.0
TOLERANCE = 0.01


def near(ax: Any) -> None:
    ax.set(xlim=(-0.055, 0.055), ylim=(-0.055, 0.055), zlim=(0, 0.11))
    ax.set_axis_off()


def main(path: Path = options.picture) -> None:
    print(f"floor and hand bear {CHECK:.4f} of its weight")
    fallen = tb.plot.grid(1, 3, three=(0, 1, 2))
    for ax, k in zip(fallen, (25, 40, 120), strict=True):
        near(ax)
        tb.plot.shape(solution.state[k], ax, scene=scene)
        ax.set_title(f"{t[k]:.1f} s")
    print("wrote", tb.plot.save(fallen[0], path))
    ax = tb.plot.axes((4.5, 4), three=True)
    near(ax)
    film: dict[str, Any] = dict(scene=scene, fps=16, speed=0.5, trail=False, dpi=80)
    print("wrote", tb.plot.animate(solution, path.with_suffix(".gif"), ax, **film))


if __name__ == "__main__":
    main()
