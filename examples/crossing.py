"""Two cantilevers that cross: the upper one is lowered at its clamp and presses on the lower one,
whose tip gives way as its own does.

Each bends by F a^3/(3 EI) at the crossing, a from its clamp, and the gap between the two is that at
which the law of contact, along the patch of two round bars that cross, gives F: one equation for F,
solved by halves. Run as a script, it also draws a picture and a film.
The film: the upper bar comes down at its clamp, and both bend away from where they cross.
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
    "--picture", type=Path, default=Path("out/crossing.png"), help="the film is beside it"
)
options = parser.parse_args(None if __name__ == "__main__" else [])

RADIUS, EI, GA, ARM = 0.004, 0.5, 1e6, 0.2  # m, N m^2, N, m from the clamps to the crossing
LAW: dict[str, Any] = dict(radius=RADIUS, thickness=1e-3, force=800.0)
lowered = torch.linspace(1e-3, 8e-3, 5)  # m: a batch of five

section = tb.Section.from_stiffness(EA=1e6, GA=GA, GJ=0.4, EI=EI, mass=0.1, inertia=1e-6)
touch = 2 * RADIUS + LAW["thickness"]  # between the axes


def crossed(lowered: torch.Tensor) -> tb.Scene:
    """With the upper clamp lowered by (batch,) m."""
    parts = {
        "lower": tb.Beam.straight(1.25 * ARM, 15, section, root=(0, -ARM, 0), direction=(0, 1, 0)),
        "upper": tb.Beam.straight(1.25 * ARM, 15, section, root=(-ARM, 0, touch)),
    }
    down = lowered[:, None] * torch.tensor([0.0, 0, -1])
    supports = [tb.Support(("lower", 0)), tb.Support(("upper", 0), displacement=down)]
    return tb.Scene(parts, [tb.Contact("lower", "upper", **LAW)], supports=supports)


def law(distance: torch.Tensor) -> torch.Tensor:
    """N of two bars that cross at a right angle, of which the axes are so near (...)."""
    x = torch.linspace(-5, 5, 4001) * RADIUS
    gap = (x * x + distance[..., None] ** 2).sqrt() - 2 * RADIUS
    y = 1 - gap / LAW["thickness"]
    pressure = y.clamp(min=0) ** 2 - (y - 1).clamp(min=0) ** 2
    return LAW["force"] * torch.trapezoid(pressure, x)


def closed_form() -> torch.Tensor:
    """F at each of the distances."""
    low, high = torch.zeros_like(lowered), torch.full_like(lowered, 10.0)
    for _ in range(60):
        F = (low + high) / 2
        gives = 2 * F * (ARM**3 / (3 * EI) + ARM / GA)
        more = law(touch - lowered + gives) > F
        low, high = torch.where(more, F, low), torch.where(more, high, F)
    return F


scene = crossed(lowered)
state = tb.equilibrium(scene, engine="eager")
force = -tb.sensors.ContactForce(scene)(state)[:, 2]  # of "upper" on "lower"
wanted = closed_form()
CHECK, EXPECTED = force[-1].item(), wanted[-1].item()
TOLERANCE = 5e-3  # of 15 elements of first order, 1/(4 N^2) in the deflection, and of large ones


def forces(ax: Any) -> None:
    ax.plot(1e3 * lowered, force, "o", ms=4, label="equilibrium")
    ax.plot(1e3 * lowered, wanted, lw=1, label="F a³/(3 EI), law of contact")
    ax.set(xlabel="clamp lowered by (mm)", ylabel="force (N)")
    ax.legend(frameon=False, fontsize=8)


def near(ax: Any) -> None:
    """Seen from the tips."""
    ax.set(xlim=(-0.2, 0.06), ylim=(-0.2, 0.06), zlim=(-0.06, 0.06))
    ax.view_init(elev=12, azim=45)
    ax.set_axis_off()


def main(path: Path = options.picture) -> None:
    print(f"force: {force.tolist()} N, by the closed form: {wanted.tolist()}")
    left, right = tb.plot.grid(1, 2, three=(1,))
    forces(left)
    near(right)
    tb.plot.shape(state[-1], right, scene=scene)
    print("wrote", tb.plot.save(left, path))
    down = torch.linspace(0, lowered[-1], 33)
    lowering = crossed(down)
    states = tb.equilibrium(lowering, engine="eager")
    pressed = -tb.sensors.ContactForce(lowering)(states)[:, 2]
    left, right = tb.plot.grid(1, 2, (7.5, 3.6), three=(0,))
    forces(right)
    near(left)
    (now,) = right.plot([], [], "ko", ms=7, mfc="none")
    film: dict[str, Any] = dict(scene=lowering, fps=12, trail=False, dpi=70)
    film["beside"] = lambda k: now.set_data([1e3 * down[k]], [pressed[k]])
    print("wrote", tb.plot.animate(states, path.with_suffix(".gif"), left, **film))


if __name__ == "__main__":
    main()
