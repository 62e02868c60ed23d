"""A capstan: a rope, held at one end, lies over half a turn of a drum that turns beneath it, with a
weight at the other end.

Where all of it slips, friction makes the tension rise by exp(mu a) over the angle a (Euler,
Eytelwein): the end that is held bears exp(0.3 pi) = 2.57 weights where the drum drags the rope
towards the weight, and 0.39 where it lifts it. The rope is a beam of next to no bending stiffness.
Run as a script, it also draws out/capstan.png.
"""

import math
from pathlib import Path

import torch

import torchbeam as tb

torch.set_default_dtype(torch.float64)
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


def settled() -> tb.State:
    """The rope at rest, 0.6 s after it was put there."""
    return tb.simulate(scene, torch.tensor([0.0, 0.6]), step=2e-3).state[-1]


state = settled()
held = -state.root.force[..., 2] / WEIGHT  # (2,): weights that the held end bears
wanted = torch.exp(FRICTION * math.pi * SPEED.sign())
CHECK, EXPECTED = held[0].item(), wanted[0].item()
TOLERANCE = 2e-3  # of the rope's polygon, twice over

if __name__ == "__main__":
    pictures = tb.plot.grid(1, 2)
    tension = state.stress[..., 0]
    middle = (turn[1:] + turn[:-1]) / 2
    for k, word in enumerate(("towards the weight", "away from it")):
        pictures[0].plot(middle, tension[k], "o", ms=3, color=f"C{k}", label=f"drum turns {word}")
        law = torch.exp(FRICTION * SPEED.sign()[k] * (math.pi - middle))
        pictures[0].plot(middle, law, color=f"C{k}", lw=1)
    pictures[0].set(xlabel="angle (rad)", ylabel="tension (weights)")
    pictures[0].legend(frameon=False)
    tb.plot.shape(state.map(lambda x: x[0]), pictures[1], plane="xz")
    tb.plot.obstacles(scene, pictures[1], plane="xz")
    print(f"held end: {held.tolist()} weights, by exp(mu a): {wanted.tolist()}")
    print(tb.plot.save(pictures[0], Path("out") / "capstan.png"))
