"""An overhand knot pulled tight: loop of radius R, rod of radius h and bending stiffness B, which
a pull F holds open by F h^2/B = eps^4/2 + 0.492 mu eps^3, eps = (h/R)^(1/2) small.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

import torchbeam as tb

from .case import Case

TAIL, REACH = 3.0, 0.85  # in radii of the loop: straight ends; half of the braid, at most
LAYER = 0.1  # thickness of the contact, over h


def smooth(x: Tensor) -> Tensor:
    """From 0 to 1, with two continuous derivatives."""
    x = x.clamp(0, 1)
    return x**3 * (10 - 15 * x + 6 * x * x)


def loose(h: float) -> tuple[Tensor, Tensor]:
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


def arclength(curve: Tensor) -> Tensor:
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


def limits() -> tuple[Tensor, Tensor]:
    """Of knots of three thicknesses that come to rest without friction: the pull, and what strands
    press on each other with, which friction is mu times: 2 F h^2/(B eps^4) and P h^2/(B eps^3), by
    polynomials through all three at eps = 0.
    """
    rows = []
    for h in (0.04, 0.01, 0.0025):
        scene, start = knot(h)
        state = start
        for until, step in ((1.0, 0.02), (30.0, 0.1)):  # strands that are thin and fast first
            t = [float(state.t), until]
            run = tb.simulate(scene, t, state, "generalized_alpha", step=step, rho_inf=0.5)
            assert (run.status == 0).all()
            state = run.state[-1]
        missing = arclength(scene.beam.nodes)[-1] - state.position[-1, 0] + state.position[0, 0]
        press, gap = tb.sensors.ContactPressure(scene)(state)
        own = h - LAYER * h / 2 + gap / 2  # half of the distance of the axes
        eps = (own * 2 * math.pi / missing).sqrt()
        pull = state.stress[1, 0]
        rows.append(torch.stack((eps, 2 * pull * own**2 / eps**4, press * own**2 / eps**3)))
    eps, *shares = torch.stack(rows).unbind(-1)
    powers = eps[:, None] ** torch.arange(len(eps))
    return torch.linalg.solve(powers, torch.stack(shares, -1))[0], torch.tensor([1.0, 0.492])


CASES = [
    Case("overhand knot", "Audoly, Clauvelin and Neukirch, PRL 99, 164301 (2007)",
         "pull and contact force over powers of eps, at eps = 0", "152 to 188 elements", limits,
         2e-2, "polynomials through three thicknesses; twice its measured error"),
]  # fmt: skip
