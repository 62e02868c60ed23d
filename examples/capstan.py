"""A capstan: a rope, held at one end, lies over half a turn of a drum that turns beneath it, with a
weight at the other end.

Where all of it slips, friction makes the tension rise by exp(mu a) over the angle a (Euler,
Eytelwein): the end that is held bears exp(0.3 pi) = 2.57 weights where the drum drags the rope
towards the weight, and 0.39 where it lifts it. The rope is a beam of next to no bending stiffness.
Run as a script, it also draws a picture and a film.
The film: the drum drags at the rope that was laid over it, and within 0.1 s the tensions along it
come to the exponential, or to its inverse where the drum turns the other way.
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
    "--picture", type=Path, default=Path("out/capstan.png"), help="the film is beside it"
)
options = parser.parse_args(None if __name__ == "__main__" else [])

FRICTION, WEIGHT = 0.3, 1.0  # N
RADIUS, STRAIGHT = 0.1, 0.1  # m
SPEED = torch.tensor([20.0, -20.0])  # rad/s of the drum: a batch of two
THICKNESS, FORCE = 2e-4, 200.0  # m; N/m where surfaces meet, of which weight/radius are 10

s = torch.linspace(0, math.pi * RADIUS + 2 * STRAIGHT, 61)
turn = ((s - STRAIGHT) / RADIUS).clamp(0, math.pi)
down = (STRAIGHT - s).clamp(min=0) + (s - STRAIGHT - math.pi * RADIUS).clamp(min=0)
outer = RADIUS + 0.7 * THICKNESS
nodes = torch.stack((-outer * torch.cos(turn), 0 * s, outer * torch.sin(turn) - down), -1)
section = tb.Section.from_stiffness(EA=2e3, GA=2e3, GJ=1e-3, EI=1e-6, mass=0.05, inertia=1e-7)
drum = tb.Cylinder((0.0, 0, 0), (0, 1.0, 0), RADIUS, spin=SPEED)
contact = tb.Contact(
    drum, thickness=THICKNESS, force=FORCE, friction=FRICTION, slip_speed=1e-3, damping=1e-3
)
scene = tb.Scene(
    tb.Beam.from_nodes(nodes, section),
    [tb.TipLoad(force=(0, 0, -WEIGHT)), tb.MassDamping(60.0), tb.Damping(2e-4), contact],
    supports=[tb.Support(0, "xyz", "")],
    plane="xz",
)


def run(*times: float) -> tb.Solution:
    """The rope at times after it was put there."""
    return tb.simulate(scene, torch.tensor([0.0, *times]), step=2e-3)


state = run(0.6).state[-1]  # at rest
held = -state.root.force[..., 2] / WEIGHT  # (2,): weights that the held end bears
wanted = torch.exp(FRICTION * math.pi * SPEED.sign())
CHECK, EXPECTED = held[0].item(), wanted[0].item()
TOLERANCE = 2e-3  # of the rope's polygon, twice over


def tensions(ax: Any, state: tb.State) -> list[Any]:
    """Along the drum, of both ways, with the law's lines: what moves in the film."""
    middle, dots = (turn[1:] + turn[:-1]) / 2, []
    for k, word in enumerate(("towards the weight", "away from it")):
        style = dict(ms=3, color=f"C{k}", label=f"drum turns {word}")
        dots += ax.plot(middle, state.stress[k, :, 0] / WEIGHT, "o", **style)
        law = torch.exp(FRICTION * SPEED.sign()[k] * (math.pi - middle))
        ax.plot(middle, law, color=f"C{k}", lw=1)
    ax.set(xlabel="angle (rad)", ylabel="tension (weights)", ylim=(0.2, 2.8))
    ax.legend(frameon=False, fontsize=8)
    return dots


def main(path: Path = options.picture) -> None:
    print(f"held end: {held.tolist()} weights, by exp(mu a): {wanted.tolist()}")
    left, right = tb.plot.grid(1, 2)
    tensions(left, state)
    tb.plot.shape(state[0], right, scene=scene)
    print("wrote", tb.plot.save(left, path))
    start = run(*torch.arange(2e-3, 0.1, 2e-3).tolist())
    left, right = tb.plot.grid(1, 2, (7.5, 3.6))
    dots = tensions(right, start.state[1])

    def beside(k: int) -> None:
        for each, dot in enumerate(dots):
            dot.set_ydata(start.state[k + 1].stress[each, :, 0] / WEIGHT)
        left.set_title(f"{1e3 * start.t[k + 1]:.0f} ms", fontsize=9)

    film: dict[str, Any] = dict(plane="xz", scene=scene, fps=12, trail=False, beside=beside, dpi=70)
    print("wrote", tb.plot.animate(start.state[1:, 0], path.with_suffix(".gif"), left, **film))


if __name__ == "__main__":
    main()
