"""Statics and dynamics that were published: the Princeton beam, a flexible rod in flight."""

from __future__ import annotations

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


def flying() -> tuple[Tensor, Tensor]:
    """A force of 8 N and a moment of 80 N m, which rise over 2.5 s and are gone after 5, throw a
    rod by one end: the way of its centre after 5 and 10 s, and momentum, angular momentum about the
    centre and energy after 10 s over those after 5, where it bends freely.
    """
    rod = tb.Section.from_stiffness(EA=1e4, GA=1e4, GJ=500.0, EI=500.0, mass=1.0, inertia=10.0)
    beam = tb.Beam.straight(10.0, 10, rod, direction=(-0.6, 0.8, 0), root=(6.0, 0, 0))

    def share(t: Tensor) -> Tensor:
        return torch.relu(1 - (t / 2.5 - 1).abs())

    thrown = tb.PointLoad(
        0,
        force=lambda t: torch.stack((8 * share(t), 0 * t, 0 * t)),
        moment=lambda t: torch.stack((0 * t, 0 * t, -80 * share(t))),
    )
    scene = tb.Scene(beam, [thrown], supports=())
    motion = tb.simulate(scene, [0.0, 5.0, 10.0], step=0.05, tolerance=1e-12)
    inertia = tb.Stepper(scene, 0.05).model.inertia
    numbers = []
    energy = motion.energy.kinetic + motion.energy.strain
    for k in range(3):
        state = motion.state[k]
        P, H = inertia.momenta(state.rotation, state.velocity, state.spin)[:2]
        mass = torch.tensor([0.5] + 9 * [1.0] + [0.5])[:, None]
        centre = (mass * state.position).sum(0) / 10
        about = (torch.linalg.cross(state.position - centre, P) + H).sum(0)[2]
        numbers.append((centre[0], P.sum(0)[0], about, energy[k]))
    (start, *_), (middle, *before), (end, *after) = numbers
    kept = [b / a for a, b in zip(before, after, strict=True)]
    found = torch.stack((middle - start, end - start, before[0], *kept))
    return found, torch.tensor([5.0, 15.0, 20.0, 1.0, 1.0, 1.0])


# fmt: off
CASES = [
    Case("Princeton beam", "Dowell and Traybar 1975; Ansys, by exudyn's ANCFBeamTest",
         "tip across, b = 45 and 90 degrees", "8 elements of order 2", lambda: princeton(8), 8e-4,
         "St Venant's torsion here; of the other's nothing is told. Of a way of 0.2 m", 0.2),
    Case("flexible rod in flight", "Simo and Vu-Quoc 1986; Newton, conservation",
         "way of the centre, momenta, energy", "10 elements, 50 ms", flying, 2.1e-7,
         "energy that steps of 50 ms leave; the others to 1e-10"),
]
# fmt: on
