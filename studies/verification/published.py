"""Statics and dynamics that were published: the Princeton beam, a flexible rod in flight."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

import torchbeam as tb

from .case import Case


def princeton(N: int) -> tuple[Tensor, Tensor]:
    """Dowell and Traybar 1975: 20 in of aluminium, 12.38 x 3.2 mm; the tip's way across both sides
    under a weight at an angle b to the stiff one.
    """
    strip = tb.Section.rectangle(12.3777e-3, 3.2024e-3, E=71.7e9, nu=0.31, rho=1.0)
    F = torch.tensor([8.896, 13.345, 8.896, 13.345])
    b = torch.tensor([45.0, 45, 90, 90]).deg2rad()
    force = torch.stack((0 * F, -F * b.cos(), F * b.sin()), -1)
    beam = tb.Beam.straight(0.508, N, strip, order=2)
    tip = tb.equilibrium(tb.Scene(beam, [tb.TipLoad(force=force)])).tip.position[:, 1:].abs()
    printed = [[0.00883723, 0.108987937], [0.01518618, 0.156467239], [0, 0.146245978],
               [0, 0.200677707]]  # fmt: skip
    return tip, torch.tensor(printed)


def share(t: Tensor) -> Tensor:
    """What rises over 2.5 s, and is gone after 5."""
    return torch.relu(1 - (t / 2.5 - 1).abs())


def rod(direction: tuple[float, ...], EI: float = 500.0, order: int = 1, **at: Any) -> tb.Beam:
    """10 m, of ten elements."""
    section = tb.Section.from_stiffness(EA=1e4, GA=1e4, GJ=500.0, EI=EI, mass=1.0, inertia=10.0)
    return tb.Beam.straight(10.0, 10, section, direction=direction, order=order, **at)


def flight(beam: tb.Beam, thrown: tb.Load) -> list[tuple[Tensor, Tensor, Tensor, Tensor]]:
    """After 0, 5 and 10 s: centre (3,), momentum (3,), angular momentum about the centre (3,) and
    energy of a rod that a load has thrown.
    """
    scene = tb.Scene(beam, [thrown], supports=())
    motion = tb.simulate(scene, [0.0, 5.0, 10.0], step=0.05, tolerance=1e-12)
    inertia = tb.Stepper(scene, 0.05).model.inertia
    energy = motion.energy.kinetic + motion.energy.strain
    numbers = []
    for k in range(3):
        state = motion.state[k]
        P, H = inertia.momenta(state.rotation, state.velocity, state.spin)[:2]
        mass = torch.tensor([0.5] + 9 * [1.0] + [0.5])[:, None]
        centre = (mass * state.position).sum(0) / 10
        about = (torch.linalg.cross(state.position - centre, P) + H).sum(0)
        numbers.append((centre, P.sum(0), about, energy[k]))
    return numbers


def flying() -> tuple[Tensor, Tensor]:
    """A force of 8 N and a moment of 80 N m throw a rod by one end: the way of its centre after 5
    and 10 s, and momentum, angular momentum about the centre and energy after 10 s over those after
    5, where it bends freely.
    """
    thrown = tb.PointLoad(
        0,
        force=lambda t: torch.stack((8 * share(t), 0 * t, 0 * t)),
        moment=lambda t: torch.stack((0 * t, 0 * t, -80 * share(t))),
    )
    numbers = flight(rod((-0.6, 0.8, 0), root=(6.0, 0, 0)), thrown)
    (start, *_), (middle, P, H, E), (end, Q, L, F) = numbers
    way = middle[0] - start[0], end[0] - start[0]
    found = torch.stack((*way, P[0], Q[0] / P[0], L[2] / H[2], F / E))
    return found, torch.tensor([5.0, 15.0, 20.0, 1.0, 1.0, 1.0])


def throw_in_space() -> tb.Load:
    """20 N along x, 200 N m about y and 100 N m about z, at their most."""
    return tb.TipLoad(
        force=lambda t: torch.stack((20 * share(t), 0 * t, 0 * t)),
        moment=lambda t: torch.stack((0 * t, 200 * share(t), 100 * share(t))),
    )


def flying_in_space() -> tuple[Tensor, Tensor]:
    """As `flying`, out of the plane too: momentum after 5 s, and what is kept until 10 s."""
    numbers = flight(rod((0.6, 0, -0.8)), throw_in_space())
    (_, P, H, E), (_, Q, L, F) = numbers[1:]
    size = torch.linalg.vector_norm(H)
    kept = torch.stack((Q[0] / P[0], *(1 + (L - H) / size), F / E))
    return torch.cat((P[:1], kept)), torch.tensor([50.0, 1, 1, 1, 1, 1])


def flying_tips() -> tuple[Tensor, Tensor]:
    """How far the thrown end has come: in the plane, with 8 N and 80 N m until 2.5 s and an EI of
    100, after 7.5 s; in space after 3.5 s.
    """

    def sudden(t: Tensor) -> Tensor:
        return torch.where(t <= 2.5, 1.0, 0.0)

    plane = tb.TipLoad(
        force=lambda t: torch.stack((8 * sudden(t), 0 * t, 0 * t)),
        moment=lambda t: torch.stack((0 * t, 80 * sudden(t), 0 * t)),
    )
    tips = []
    for EI, load, t in ((100.0, plane, 7.5), (500.0, throw_in_space(), 3.5)):
        scene = tb.Scene(rod((0.6, 0, -0.8), EI, order=2), [load], supports=())
        tip = tb.simulate(scene, [0.0, t], step=0.01, tolerance=1e-10).tip.position
        tips.append(tip[1] - tip[0])
    other = [[10.194453, 0.0, -0.387773], [-0.586487, -3.115477, 1.824137]]
    return torch.stack(tips), torch.tensor(other)


# fmt: off
CASES = [
    Case("Princeton beam", "Dowell and Traybar 1975; Ansys, by exudyn's ANCFBeamTest",
         "tip across, b = 45 and 90 degrees", "8 elements of order 2", lambda: princeton(8), 8e-4,
         "St Venant's torsion here; of the other's nothing is told. Of a way of 0.2 m", 0.2),
    Case("flexible rod in flight", "Simo and Vu-Quoc 1986; Newton, conservation",
         "way of the centre, momenta, energy", "10 elements, 50 ms", flying, 2.1e-7,
         "energy that steps of 50 ms leave; the others to 1e-10"),
    Case("flexible rod in flight, in space", "Simo and Vu-Quoc 1988; Newton, conservation",
         "momenta, energy", "10 elements, 50 ms", flying_in_space, 3e-5,
         "energy that steps of 50 ms leave; the others to 1e-10"),
    Case("flexible rod in flight, plane and in space", "AeroBeams.jl, 20 and 10 elements",
         "way of the thrown end after 7.5 and 3.5 s, over the length", "10 elements of order 2, "
         "10 ms", flying_tips, 1.1e-2,
         "their mesh; finer ones move the ends by 3e-3 here", 10.0),
]
# fmt: on
