"""Portal frame: two clamped columns and a beam welded across them, pushed sideways and buckled.

The check is against closed forms of beams that only bend. A push P at the top: by slope-deflection
with the bar's turn psi = sway/H and k = H/L (the same EI everywhere) both corners turn by
3 psi/(2 + 3k), and each column carries P H/2 = (6 EI/H)(2 psi - turn) at its two ends together.
A weight at each corner: the frame sways out of the upright at the smallest u^2 EI/H^2 with
tan(u)/u = -1/(6k) (Timoshenko and Gere 1961, Theory of Elastic Stability, ch. 2). Run as a script,
it also draws how the frame with weights leans over under a hundredth of them sideways.
"""

import argparse
import math
from pathlib import Path

import torch
from scipy.optimize import brentq

import torchbeam as tb

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--picture", type=Path, default=Path("out/portal_frame.png"))
options = parser.parse_args(None if __name__ == "__main__" else [])

H, L, N = 1.0, 1.5, 4  # m, m, elements of order 2 in each of the three; EI = 1 N m^2
PUSH = 1e-4  # N: what the sway changes in the balance is 1e-6 of it

section = tb.Section.from_stiffness(EA=math.inf, GA=math.inf, GJ=1.0, EI=1.0, mass=1.0)
upright = dict(direction=(0, 1, 0), up=(0, 0, 1), order=2)
parts = {
    "left": tb.Beam.straight(H, N, section, **upright),
    "right": tb.Beam.straight(H, N, section, root=(L, 0, 0), **upright),
    "beam": tb.Beam.straight(L, N, section, root=(0, H, 0), order=2),
}
corners = tb.Input("left", 3), tb.Input("right", 3)
frame = tb.Scene(
    parts,
    [tb.PointLoad((load.name, -1), force=load) for load in corners],
    joints=[tb.Weld(("left", -1), ("beam", 0)), tb.Weld(("right", -1), ("beam", -1))],
    supports=[tb.Support(("left", 0)), tb.Support(("right", 0))],
    plane="xy",
)
CORNER = frame.beam.row(("left", -1))


def loads(left: list[float], right: list[float]) -> dict[str, torch.Tensor]:
    """Forces (N, x and y) on the corners."""
    return {"left": torch.tensor([*left, 0.0]), "right": torch.tensor([*right, 0.0])}


# the push, by slope-deflection: per newton
k = H / L
share = 3 / (2 + 3 * k)  # of the bar's turn that a corner makes
bar = H**2 / (12 * (2 - share))
closed = {
    "sway": H * bar,
    "foot": 2 / H * (share - 3) * bar,
    "corner": 2 / H * (2 * share - 3) * bar,
}
pushed = tb.equilibrium(frame, inputs=loads([PUSH, 0], [0, 0]))
found = {
    "sway": pushed["left"].tip.position[0] / PUSH,
    "foot": -pushed["left"].root.moment[2] / PUSH,
    "corner": pushed.joint[0].moment[2] / PUSH,
}

# the weights
u = brentq(lambda u: math.sin(u) + math.cos(u) * u / (6 * k), math.pi / 2, math.pi)
EULER = (u / H) ** 2
buckled = tb.critical_load(frame, 12.0, points=5, inputs=loads([0, -1], [0, -1]))

bending = max(abs(found[name].item() / value - 1) for name, value in closed.items())
buckling = abs(buckled.factor.item() / EULER - 1)
CHECK = max(bending / 1e-5, buckling / 1e-3)  # 8e-7, of the push; 4e-4, of the elements
EXPECTED, TOLERANCE = 0.0, 1.0

for (name, value), unit in zip(closed.items(), ("m/N", "N m/N", "N m/N"), strict=True):
    print(f"{name:<8}{found[name].item():>10.5f} {unit:<6}  by slope-deflection {value:.5f}")
print(f"buckles at {buckled.factor:.4f} EI/H^2, by tan(u)/u = -1/(6k) {EULER:.4f}")


def sway(state: tb.State) -> torch.Tensor:
    return state.position[..., CORNER, 0]


def draw(path: Path = options.picture) -> None:
    leaning = tb.path(
        frame,
        12.0,
        step=0.02,
        control=sway,
        target=torch.tensor(0.6 * H),
        inputs=loads([0.01, -1], [0.01, -1]),
    )
    x, shown = sway(leaning.state), slice(0, None, 16)
    curve, shapes = tb.plot.grid(1, 2, (10, 4))
    curve.plot(x, leaning.factor, lw=1.8)
    curve.plot(x[shown], leaning.factor[shown], "o", ms=5, color="C0", clip_on=False)
    curve.axhline(EULER, color="0.6", lw=0.8)
    label = dict(textcoords="offset points", ha="right", va="top")
    curve.annotate("buckling load, closed form", (0.6, EULER), (0, -4), **label)
    curve.set(xlabel="sway / H", ylabel="weight on each corner / (EI/H^2)")
    curve.set(xlim=(0, None), ylim=(0, None))
    tb.plot.shape(leaning.state[shown], shapes, plane="xy")
    print("wrote", tb.plot.save(curve, path))


if __name__ == "__main__":
    draw()
