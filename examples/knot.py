"""An overhand knot in a long rod: the pull that holds its loop open, against the law of Audoly,
Clauvelin and Neukirch (Phys. Rev. Lett. 99, 164301, 2007).

A loop of radius R hangs by a short braid, in which two strands wind about each other. A pull F at
the ends of a rod of radius h and bending stiffness B, with friction mu, holds it open by

    F h^2/B = eps^4/2 + 0.492 mu eps^3,    eps = (h/R)^(1/2)

where eps is small: the first term is the loop's bending, in the second 0.492 eps^3 B/h^2 is what
strands press on each other with. Knots of one loop and three thicknesses start a little loose and
come to rest without friction; both numbers are read, and go to the law's with eps. R is that of the
loop whose length is missing between the ends. Run as a script, it also draws out/knot.png.
"""

import math
from pathlib import Path

import torch

import torchbeam as tb

torch.set_default_dtype(torch.float64)
TAIL, REACH = 3.0, 0.85  # in radii of the loop: straight ends; half of the braid, at most
LAYER = 0.1  # thickness of the contact, over h
RADII = (0.04, 0.01, 0.0025)  # h/R


def smooth(x: torch.Tensor) -> torch.Tensor:
    """From 0 to 1, with two continuous derivatives."""
    x = x.clamp(0, 1)
    return x**3 * (10 - 15 * x + 6 * x * x)


def loose(h: float) -> tuple[torch.Tensor, torch.Tensor]:
    """A fine polyline (M, 3) along a knot whose loop is a circle of radius 1, and how far its
    points (M) are from the middle of the braid, along the rod.

    Over the x axis the loop is z = 1 - (1 - x^2)^(1/2) away from the tail. Both turn about their
    middle by 3 pi, with no less than some 2 h between them, which makes three crossings.
    """
    x = torch.linspace(-REACH, REACH, 4001)
    z = 1 - (1 - x * x).sqrt()
    apart = torch.hypot(z, 2.4 * h * (1 - smooth((x.abs() - 0.3) / (REACH - 0.3))))
    turn = 3 * math.pi * smooth((x / min(3 * math.sqrt(h), 0.8) + 1) / 2) - math.pi / 2
    half = torch.stack((0 * x, torch.cos(turn), torch.sin(turn)), -1) * apart[:, None] / 2
    middle = torch.stack((x, 0 * x, z / 2), -1)
    angle = torch.linspace(math.asin(REACH), 2 * math.pi - math.asin(REACH), 4001)[1:-1]
    loop = torch.stack((torch.sin(angle), 0 * angle, 1 - torch.cos(angle)), -1)
    tail = torch.linspace(-TAIL - REACH, -REACH, 2001)[:-1]
    tail = torch.stack((tail, 0 * tail, 0 * tail), -1)
    ends = tail, -tail.flip(0)
    curve = torch.cat((ends[0], middle + half, loop, middle - half, ends[1]))
    s = arclength(curve)
    first = s[len(tail) + len(x) // 2]
    return curve, torch.minimum((s - first).abs(), (s - s[-1] + first).abs())


def arclength(curve: torch.Tensor) -> torch.Tensor:
    """(M) along points (M, 3)."""
    return torch.nn.functional.pad(curve.diff(dim=0).norm(dim=-1).cumsum(0), (1, 0))


def knot(h: float) -> tuple[tb.Scene, tb.State]:
    """A rod of B = 1 that was straight, tied; with five elements in (h R)^(1/2) within the braid,
    and longer ones the further from it.
    """
    curve, away = loose(h)
    braid = math.sqrt(h)
    size = (braid / 5 + (away - 4 * braid).clamp(min=0) / 5).clamp(max=0.2)
    share = (arclength(curve).diff() * (1 / size[1:] + 1 / size[:-1]) / 2).cumsum(0)
    count = 2 * math.ceil(float(share[-1]) / 2)
    at = torch.searchsorted(share, torch.linspace(0, float(share[-1]), count + 1)[1:-1])
    nodes = torch.cat((curve[:1], curve[at + 1], curve[-1:]))
    s = arclength(nodes)
    straight = nodes[0] + s[:, None] * torch.tensor([1.0, 0, 0])
    EA = 4 / h**2
    section = tb.Section.from_stiffness(
        EA=EA, GA=EA / 3, GJ=0.75, EI=1.0, mass=1.0, inertia=h * h / 4
    )
    thickness = LAYER * h
    touching = tb.SelfContact(radius=h - thickness / 2, thickness=thickness, force=5 / h, points=2)
    ends = [
        tb.Support(0, "xyz", ""),
        tb.Support(-1, "xyz", "", displacement=nodes[-1] - straight[-1]),
    ]
    effects = [touching, tb.Damping(0.1), tb.MassDamping(0.7)]
    scene = tb.Scene(tb.Beam.from_nodes(straight, section), effects, supports=ends)
    return scene, tb.State.from_nodes(scene, nodes)


def measure(h: float) -> tuple[tb.State, list[float]]:
    """The knot at rest, and eps, F h^2/B, and h^2/B times what the strands press with."""
    scene, start = knot(h)
    state = start
    for until, step in ((1.0, 0.02), (30.0, 0.1)):  # strands that are thin and fast first
        t = [float(state.t), until]
        run = tb.simulate(scene, t, state, "generalized_alpha", step=step, rho_inf=0.5)
        assert (run.status == 0).all()
        state = run.state[-1]
    length = float(arclength(scene.beam.nodes)[-1])
    R = (length - float(state.position[-1, 0] - state.position[0, 0])) / (2 * math.pi)
    press, gap = tb.sensors.ContactPressure(scene)(state).tolist()
    own = h - LAYER * h / 2 + gap / 2  # half of the distance of the axes
    pull = float(state.stress[1, 0])
    return state, [math.sqrt(own / R), own**2 * pull, own**2 * press]


rows = [measure(h) for h in RADII]
eps, pull, press = torch.tensor([numbers for _, numbers in rows]).unbind(-1)
shares = torch.stack((2 * pull / eps**4, press / (0.492 * eps**3)))  # of the law's, each
powers = eps[:, None] ** torch.arange(len(eps))
limits = torch.linalg.solve(powers, shares.mT)[0]  # of polynomials through all, at eps = 0
CHECK, EXPECTED = float((limits - 1).abs().max()), 0.0
TOLERANCE = 0.05

if __name__ == "__main__":
    pictures = tb.plot.grid(1, 2)
    e = torch.logspace(-1.4, -0.6, 50)
    for k, (values, law, name) in enumerate(
        ((pull, e**4 / 2, "pull"), (press, 0.492 * e**3, "force between strands"))
    ):
        pictures[0].loglog(eps, values, "o", ms=4, color=f"C{k}", label=f"{name}, h²/B")
        pictures[0].loglog(e, law, color=f"C{k}", lw=1, label=("ε⁴/2", "0.492 ε³")[k])
    pictures[0].set(xlabel="ε = (h/R)$^{1/2}$")
    pictures[0].legend(frameon=False)
    for (state, _), h in zip(rows, RADII, strict=True):
        x, z = state.position[:, (0, 2)].unbind(-1)
        pictures[1].plot(x, z, lw=0.5 + 20 * h, label=f"h = {h} R")
    pictures[1].set(aspect="equal", xlabel="x/R", ylabel="z/R", xlim=(-1.5, 1.5))
    pictures[1].legend(frameon=False, loc="center")
    print(f"eps {eps.tolist()}: of the law {shares.tolist()}; where eps = 0 {limits.tolist()}")
    print(tb.plot.save(pictures[0], Path("out") / "knot.png"))
