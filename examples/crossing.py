"""Two cantilevers that cross: the upper one is lowered at its clamp and presses on the lower one,
whose tip gives way as its own does.

Each bends by F a^3/(3 EI) at the crossing, a from its clamp, and the gap between the two is that at
which the law of contact, along the patch of two round bars that cross, gives F: one equation for F,
solved by halves. Run as a script, it also draws out/crossing.png.
"""

from pathlib import Path
from typing import Any

import torch

import torchbeam as tb

torch.set_default_dtype(torch.float64)
RADIUS, EI, GA, ARM = 0.004, 0.5, 1e6, 0.2  # m, N m^2, N, m from the clamps to the crossing
LAW: dict[str, Any] = dict(radius=RADIUS, thickness=1e-3, force=800.0)
lowered = torch.linspace(1e-3, 8e-3, 5)  # m: a batch of five

section = tb.Section.from_stiffness(EA=1e6, GA=GA, GJ=0.4, EI=EI, mass=0.1, inertia=1e-6)
touch = 2 * RADIUS + LAW["thickness"]  # between the axes
scene = tb.Scene(
    {
        "lower": tb.Beam.straight(1.25 * ARM, 15, section, root=(0, -ARM, 0), direction=(0, 1, 0)),
        "upper": tb.Beam.straight(1.25 * ARM, 15, section, root=(-ARM, 0, touch)),
    },
    [tb.Contact("lower", "upper", **LAW)],
    supports=[
        tb.Support(("lower", 0)),
        tb.Support(("upper", 0), displacement=lowered[:, None] * torch.tensor([0.0, 0, -1])),
    ],
)


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


state = tb.equilibrium(scene, engine="eager")
force = -tb.sensors.ContactForce(scene)(state)[:, 2]  # of "upper" on "lower"
wanted = closed_form()
CHECK, EXPECTED = force[-1].item(), wanted[-1].item()
TOLERANCE = 5e-3  # of 15 elements of first order, 1/(4 N^2) in the deflection, and of large ones

if __name__ == "__main__":
    pictures = tb.plot.grid(1, 2)
    pictures[0].plot(1e3 * lowered, force, "o", ms=4, label="equilibrium")
    pictures[0].plot(1e3 * lowered, wanted, lw=1, label="F a³/(3 EI), law of contact")
    pictures[0].set(xlabel="clamp lowered by (mm)", ylabel="force (N)")
    pictures[0].legend(frameon=False)
    last = state.map(lambda x: x[-1])
    for name in ("lower", "upper"):
        nodes = 1e3 * last[name].position
        pictures[1].plot(nodes[:, 0] - nodes[:, 1], nodes[:, 2], marker=".", label=name)
    pictures[1].set(xlabel="x - y (mm)", ylabel="z (mm)")
    pictures[1].legend(frameon=False)
    print(f"force: {force.tolist()} N, by the closed form: {wanted.tolist()}")
    print(tb.plot.save(pictures[0], Path("out") / "crossing.png"))
