"""A tendon-driven arm: a soft rod that hangs, with three tendons beside its axis.

Inverse kinematics: Newton's method on the tensions, whose mean is kept, through `tb.equilibrium`,
for places of the tip across the axis, three in one batch. The first check is how well
the targets are reached. The second is one tendon alone without weight, which bends the rod to an
arc: between two nodes it runs parallel to the chord, which gives each element the moment
T a cos(h kappa/2). Run as a script, it also draws the arm with its tendons, and a film.
The film: the tip goes round a circle across the axis, and the three tensions beside it follow, a
third of a turn apart.
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
    "--picture", type=Path, default=Path("out/tendon_arm.png"), help="the film is beside it"
)
options = parser.parse_args(None if __name__ == "__main__" else [])

torch.set_default_dtype(torch.float64)
LENGTH, RADIUS, OFFSET, N = 0.25, 0.006, 0.012, 6  # m
YOUNG = 2e6  # Pa, silicone
EI = YOUNG * math.pi * RADIUS**4 / 4

section = tb.Section.circle(RADIUS, E=YOUNG, nu=0.45, rho=1100)
arm = tb.Beam.straight(LENGTH, N, section, direction=(0, 0, -1), up=(0, 1, 0))
ANGLES = 2 * math.pi / 3 * torch.arange(3)
WANTED = torch.tensor([[0.05, 0.0], [-0.04, 0.06], [0.02, -0.08]])  # m, across
MEAN = 0.6  # N
PLACES = OFFSET * torch.stack((0 * ANGLES, ANGLES.cos(), ANGLES.sin()), -1)


def scene(tensions: torch.Tensor, weight: bool = True) -> tb.Scene:
    """With tensions (..., 3) N."""
    tendons = [
        tb.Tendon.along(arm, place, tension=tensions[..., k]) for k, place in enumerate(PLACES)
    ]
    return tb.Scene(arm, [*tendons, *[tb.Gravity((0, 0, -9.81))] * weight])


def pulls(x: torch.Tensor) -> torch.Tensor:
    """Tensions (..., 3) N of the mean MEAN that bend towards x (..., 2) N."""
    return MEAN + x @ torch.stack((ANGLES.cos(), ANGLES.sin()))


def tip(x: torch.Tensor) -> torch.Tensor:
    """Its place across (..., 2) m."""
    state = tb.equilibrium(scene(pulls(x)), engine="eager", tolerance=1e-11)
    return state.tip.position[..., :2]


def inverse(places: torch.Tensor) -> tuple[torch.Tensor, list[float]]:
    """x (..., 2) N for places (..., 2) m, and the largest distance before each step of Newton's
    method.
    """
    x, distances = torch.zeros_like(places), list[float]()
    while not distances or (distances[-1] > 1e-9 and len(distances) < 12):
        x = x.detach().requires_grad_()
        place = tip(x)
        gap = places - place.detach()
        rows = [torch.autograd.grad(y.sum(), x, retain_graph=True)[0] for y in place.unbind(-1)]
        distances.append(gap.abs().max().item())
        x = x + torch.linalg.solve(torch.stack(rows, -2), gap)
    return x.detach(), distances


x, distances = inverse(WANTED)
tensions = pulls(x)
state = tb.equilibrium(scene(tensions), engine="eager")

PULL = 0.5  # N
turn = 0.0
for _ in range(50):
    turn = LENGTH / N * PULL * OFFSET * math.cos(turn / 2) / EI
alone = tb.equilibrium(scene(torch.tensor([PULL, 0, 0]), weight=False), engine="eager")
bent = alone.stress[:, 3:].norm(dim=-1) / EI
apart = (bent * LENGTH / N / turn - 1).abs().max().item()

CHECK = max(distances[-1] / 1e-9, apart / 1e-9)
EXPECTED, TOLERANCE = 0.0, 1.0

print("tensions, N:")
for row in tensions.tolist():
    print("  ", *(f"{x:7.4f}" for x in row))
print("largest distance from the targets, m:", *(f"{x:.1e}" for x in distances))
print(f"one tendon alone: curvature {bent[0].item():.3f} 1/m, {apart:.1e} from that of its arc")


def draw(path: Path = options.picture) -> None:
    views = tb.plot.grid(1, 3, (9, 4), three=range(3))
    for k, view in enumerate(views):
        room(view)
        tb.plot.shape(state[k], view, scene=scene(tensions[k]), color="C0")
        view.plot(*WANTED[k], state[k].tip.position[2], "k+", ms=14)
        view.set_title(", ".join(f"{x:.2f}" for x in tensions[k]) + " N", fontsize=10)
    views[0].figure.suptitle("Three tendons bring the tip of a soft rod to the cross", fontsize=11)
    print("wrote", tb.plot.save(views[0], path))


def room(ax: Any) -> None:
    ax.set(xlim=(-0.09, 0.09), ylim=(-0.09, 0.09), zlim=(-0.26, 0.01))
    ax.view_init(elev=15)
    ax.set_axis_off()


def film(path: Path = options.picture) -> None:
    """Once round: of every place the equilibrium, in one batch."""
    angle = 2 * math.pi * torch.arange(49) / 48
    places = 0.07 * torch.stack((angle.cos(), angle.sin()), -1)
    pull = pulls(inverse(places)[0])
    round_ = scene(pull)
    states = tb.equilibrium(round_, engine="eager")
    left, right = tb.plot.grid(1, 2, (7.5, 3.8), three=(0,))
    room(left)
    left.plot(*places.T, float(states.tip.position[:, 2].mean()), color="0.6", lw=0.8)
    for k, own in enumerate(pull.T):
        right.plot(angle.rad2deg(), own, label=f"tendon {k + 1}")
    right.set(xlabel="place on the circle (degrees)", ylabel="tension (N)")
    right.set(xlim=(0, 360), ylim=(0, 1.35))
    right.legend(frameon=False, fontsize=8, ncols=3, loc="upper center")
    now = right.axvline(0, color="k", lw=0.8)
    look: dict[str, Any] = dict(scene=round_, fps=12, trail=False, dpi=70)
    look["beside"] = lambda k: now.set_xdata([angle[k].rad2deg()] * 2)
    print("wrote", tb.plot.animate(states, path.with_suffix(".gif"), left, **look))


if __name__ == "__main__":
    draw()
    film()
