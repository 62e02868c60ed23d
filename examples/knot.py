"""An overhand knot in a long rod, pulled tight: the pull that it wants, against the law of Audoly,
Clauvelin and Neukirch (Phys. Rev. Lett. 99, 164301, 2007).

A loop of radius R hangs by a short braid, in which two strands wind about each other. A pull F at
the ends of a rod of radius h and bending stiffness B, with friction mu, holds it open by

    F h^2/B = eps^4/2 + 0.492 mu eps^3,    eps = (h/R)^(1/2)

where eps is small: the first term is the loop's bending, in the second 0.492 eps^3 B/h^2 is what
strands press on each other with. Knots of one loop and three thicknesses start a little loose and
come to rest without friction; both numbers are read, and go to the law's with eps. R is that of the
loop whose length is missing between the ends.

Run as a script, it also pulls the thickest one tight without friction, by its ends, with a rest
after each tug (the force curve), and two with friction, slowly. These are printed as shares of the
law, which holds where eps goes to 0: at 0.1 and 0.2 the pull with friction is 1.4 and 1.6 of it. It
draws a picture and a film.
The film: tug by tug the loop runs into its braid, and the pull at rest leaves the law's line as the
loop comes to be no more than a few thicknesses wide.
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
parser.add_argument("--picture", type=Path, default=Path("out/knot.png"), help="the film beside it")
options = parser.parse_args(None if __name__ == "__main__" else [])

TAIL, REACH = 3.0, 0.85  # in radii of the loop: straight ends; half of the braid, at most
LAYER = 0.1  # thickness of the contact, over h
RADII = (0.04, 0.01, 0.0025)  # h/R
TUGS, TUG, WAIT, TIGHT = 8, 15.0, 15.0, 0.2  # their number, times of each; radius of the last loop
MU, SPEED, SLOWLY = 0.1, 0.02, 12.0  # friction; of the end that is pulled, for how long


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
    x = torch.linspace(-REACH, REACH, 4001, dtype=torch.float64)
    z = 1 - (1 - x * x).sqrt()
    apart = torch.hypot(z, 2.4 * h * (1 - smooth((x.abs() - 0.3) / (REACH - 0.3))))
    turn = 3 * math.pi * smooth((x / min(3 * math.sqrt(h), 0.8) + 1) / 2) - math.pi / 2
    half = torch.stack((0 * x, torch.cos(turn), torch.sin(turn)), -1) * apart[:, None] / 2
    middle = torch.stack((x, 0 * x, z / 2), -1)
    angle = torch.linspace(
        math.asin(REACH), 2 * math.pi - math.asin(REACH), 4001, dtype=torch.float64
    )[1:-1]
    loop = torch.stack((torch.sin(angle), 0 * angle, 1 - torch.cos(angle)), -1)
    tail = torch.linspace(-TAIL - REACH, -REACH, 2001, dtype=torch.float64)[:-1]
    tail = torch.stack((tail, 0 * tail, 0 * tail), -1)
    ends = tail, -tail.flip(0)
    curve = torch.cat((ends[0], middle + half, loop, middle - half, ends[1]))
    s = arclength(curve)
    first = s[len(tail) + len(x) // 2]
    return curve, torch.minimum((s - first).abs(), (s - s[-1] + first).abs())


def arclength(curve: torch.Tensor) -> torch.Tensor:
    """(M) along points (M, 3)."""
    return torch.nn.functional.pad(curve.diff(dim=0).norm(dim=-1).cumsum(0), (1, 0))


def knot(h: float, tugs: bool = False, friction: float | None = None) -> tuple[tb.Scene, tb.State]:
    """A rod of B = 1 that was straight, tied, with its ends held; with five elements in
    (h R)^(1/2) within the braid, and longer ones the further from it; or, to be pulled by `tugs` at
    both ends, ones all over the loop that are fine enough for where the braid will be.
    """
    curve, away = loose(h)
    braid, s = math.sqrt(h), arclength(curve)
    size = braid / 5 + (away - 4 * braid).clamp(min=0) / 5
    if tugs:
        size = math.sqrt(0.3 * h) / 4 + ((s - s[-1] / 2).abs() - 3.75 - 2 * braid).clamp(min=0) / 5
    size = size.clamp(max=0.2)
    share = (s.diff() * (1 / size[1:] + 1 / size[:-1]) / 2).cumsum(0)
    count = 2 * math.ceil(float(share[-1]) / 2)
    at = torch.searchsorted(
        share, torch.linspace(0, float(share[-1]), count + 1, dtype=torch.float64)[1:-1]
    )
    nodes = torch.cat((curve[:1], curve[at + 1], curve[-1:]))
    along = torch.tensor([1.0, 0, 0], dtype=torch.float64)
    straight = nodes[0] + arclength(nodes)[:, None] * along
    EA = 4 / h**2
    section = tb.Section.from_stiffness(
        EA=EA, GA=EA / 3, GJ=0.75, EI=1.0, mass=1.0, inertia=h * h / 4
    )
    thickness = LAYER * h
    rub: dict[str, Any] = {} if friction is None else dict(friction=friction, slip_speed=SPEED / 20)
    touching = tb.SelfContact(
        radius=h - thickness / 2, thickness=thickness, force=5 / h, points=2, **rub
    )

    def apart(t: torch.Tensor) -> torch.Tensor:
        """By how much more the ends are than at the start."""
        if tugs:
            each = 2 * math.pi * (1 - TIGHT) / TUGS
            starts = REST + (TUG + WAIT) * torch.arange(TUGS)
            return each * smooth((t[..., None] - starts) / TUG).sum(-1)
        t = (t - REST).clamp(min=0) if friction is not None else 0 * t
        return SPEED * (t - 2 * (1 - torch.exp(-t / 2)))

    end = nodes[-1] - straight[-1]
    ends = [
        tb.Support(0, "xyz", "", displacement=lambda t: -apart(t)[..., None] * along / 2),
        tb.Support(-1, "xyz", "", displacement=lambda t: end + apart(t)[..., None] * along / 2),
    ]
    effects = [touching, tb.Damping(0.1), tb.MassDamping(0.7 if friction is None else 0.1)]
    scene = tb.Scene(tb.Beam.from_nodes(straight, section), effects, supports=ends)
    return scene, tb.State.from_nodes(scene, nodes)


def rested(scene: tb.Scene, start: tb.State, *times: float) -> tb.Solution:
    """From its start to REST, and on to further times."""
    thin = tb.simulate(scene, [0.0, 1.0], start, "generalized_alpha", step=0.02, rho_inf=0.5)
    t = [1.0, REST, *times]  # strands that are thin and fast came first
    run = tb.simulate(scene, t, thin.state[-1], "generalized_alpha", step=0.1, rho_inf=0.5)
    assert (run.status == 0).all()
    return run


def numbers(scene: tb.Scene, state: tb.State, h: float) -> list[float]:
    """eps, F h^2/B, and h^2/B times what the strands press with."""
    length = float(arclength(scene.beam.nodes)[-1])
    R = (length - float(state.position[-1, 0] - state.position[0, 0])) / (2 * math.pi)
    press, gap = tb.sensors.ContactPressure(scene)(state).tolist()
    own = h - LAYER * h / 2 + gap / 2  # half of the distance of the axes
    pull = float(state.stress[1, 0] + state.stress[-2, 0]) / 2
    return [math.sqrt(own / R), own**2 * pull, own**2 * press]


REST = 30.0
scenes = [knot(h) for h in RADII]
states = [rested(*each).state[-1] for each in scenes]
rows = [numbers(scene, x, h) for (scene, _), x, h in zip(scenes, states, RADII, strict=True)]
eps, pull, press = torch.tensor(rows, dtype=torch.float64).unbind(-1)
shares = torch.stack((2 * pull / eps**4, press / (0.492 * eps**3)))  # of the law's, each
powers = eps[:, None] ** torch.arange(len(eps))
limits = torch.linalg.solve(powers, shares.mT)[0]  # of polynomials through all, at eps = 0
CHECK, EXPECTED = float((limits - 1).abs().max()), 0.0
TOLERANCE = 0.05


def tightened() -> tuple[tb.Scene, tb.State, torch.Tensor]:
    """The thickest, tugged: its scene, states, and numbers (rests, 3)."""
    h = RADII[0]
    scene, start = knot(h, tugs=True)
    t = torch.arange(REST + 1, REST + TUGS * (TUG + WAIT) + 1).tolist()
    states = rested(scene, start, *t).state[1:]
    rests = [round(k * (TUG + WAIT)) for k in range(TUGS + 1)]
    return (
        scene,
        states,
        torch.tensor([numbers(scene, states[k], h) for k in rests], dtype=torch.float64),
    )


def rubbed(h: float, rest: tb.State) -> tuple[float, float]:
    """eps, and F h^2/B of a knot that is pulled slowly, with friction."""
    scene, _ = knot(h, friction=MU)
    t = torch.linspace(REST, REST + SLOWLY, 13, dtype=torch.float64)
    run = tb.simulate(scene, t, rest, step=0.1)
    assert (run.status == 0).all()
    last = torch.tensor([numbers(scene, state, h) for state in run.state[-6:]], dtype=torch.float64)
    return float(last[:, 0].mean()), float(last[:, 1].mean())


def curves(ax: Any, tight: torch.Tensor, slow: torch.Tensor) -> None:
    """Force curves, and the law's lines."""
    e = torch.logspace(-1.4, -0.38, 50, dtype=torch.float64)
    ax.loglog(e, e**4 / 2, color="C0", lw=1, label="ε⁴/2")
    ax.loglog(e, e**4 / 2 + 0.492 * MU * e**3, "--", color="C3", lw=1, label="... + 0.492 µ ε³")
    ax.loglog(eps, pull, "o", ms=5, color="C0", label="three rods at rest")
    ax.loglog(*tight[:, :2].T, "s-", ms=3, lw=0.8, color="C2", label="pulled tight, at rest")
    ax.loglog(*slow.T, "^", ms=5, color="C3", label=f"pulled slowly, µ = {MU}")
    ax.set(xlabel="ε = (h/R)$^{1/2}$", ylabel="pull, F h²/B")
    ax.set_xticks((0.05, 0.1, 0.2, 0.4), labels=("0.05", "0.1", "0.2", "0.4"))
    ax.set_xticks((), minor=True)
    ax.legend(frameon=False, fontsize=8)


def knot_axes(ax: Any) -> None:
    """Seen from the front, as far as the loop is."""
    ax.set(xlim=(-1.3, 1.3), ylim=(-0.2, 0.2), zlim=(-0.5, 1.5))
    ax.view_init(elev=12, azim=-75)
    ax.set_axis_off()


def main(path: Path = options.picture) -> None:
    scene, states_, tight = tightened()
    slow = torch.tensor(
        [rubbed(h, x) for h, x in zip(RADII[:2], states[:2], strict=True)], dtype=torch.float64
    )
    print(f"eps {eps.tolist()}: of the law {shares.tolist()}; where eps = 0 {limits.tolist()}")
    print("tightened, eps and share of the law:")
    print("  ", *(f"{e:.3f} {2 * F / e**4:.3f}" for e, F, _ in tight.tolist()), sep="  ")
    for e, F in slow.tolist():
        law = e**4 / 2 + 0.492 * MU * e**3
        print(f"with friction {MU}, eps {e:.3f}: {F / law:.3f} of the law with friction")
    last = len(states_.t) - 1
    views = tb.plot.grid(1, 3, (12, 4), three=(1, 2))
    curves(views[0], tight, slow)
    for view, k in zip(views[1:], (0, last), strict=True):
        knot_axes(view)
        tb.plot.shape(states_[k], view, scene=scene)
    print(tb.plot.save(views[0], path))
    left, right = tb.plot.grid(1, 2, (8, 3.6), three=(0,))
    curves(right, tight, slow)
    knot_axes(left)
    (now,) = right.plot([], [], "ko", ms=7, mfc="none")
    shown = torch.arange(0, last + 1, 4)

    def beside(k: int) -> None:
        state = states_[int(shown[k])]
        e, F, _ = numbers(scene, state, RADII[0])
        now.set_data([e], [F])
        left.set_title(f"R = {RADII[0] / e**2:.2f}, h = {RADII[0]}", fontsize=9)

    film = path.with_suffix(".gif")
    look: dict[str, Any] = dict(scene=scene, fps=12, trail=False, beside=beside, dpi=70)
    print(tb.plot.animate(states_[shown], film, left, **look))


if __name__ == "__main__":
    main()
