"""Frequencies and motions."""

from __future__ import annotations

import math

import torch
from torch import Tensor

import torchbeam as tb

from .. import common_case
from .build import INF, along, cantilever, planar, section
from .case import Case, reference


def frequencies(slender: bool, N: int) -> tuple[Tensor, Tensor]:
    """The first three of Euler and Bernoulli's beam, or of three stocky ones of Timoshenko's."""
    values = reference("cantilever_frequencies")["values"]
    values = values[:1] if slender else values[1:]
    ours = [
        tb.modes(
            cantilever(N, of=planar(GA=1 / v["s2"] if v["s2"] else INF, inertia=v["r2"])), count=3
        ).frequency
        for v in values
    ]
    return torch.stack(ours), torch.tensor([v["omega"][:3] for v in values])


def torsion(N: int) -> tuple[Tensor, Tensor]:
    rod = section(GJ=0.8, EI=INF, mass=0.2, inertia=1e-3)
    return tb.modes(cantilever(N, of=rod), count=1).frequency[0], torch.tensor(
        math.pi / 2 * math.sqrt(0.8 / 2e-3)
    )


def axial(N: int) -> tuple[Tensor, Tensor]:
    rod = section(EA=9.0, EI=INF, GJ=INF, mass=1.0)
    return tb.modes(cantilever(N, of=rod), count=1).frequency[0], torch.tensor(math.pi / 2 * 3)


def step_load(N: int, dt: float) -> tuple[Tensor, Tensor]:
    """RMS distance of the tips over the RMS tip displacement, against 0."""
    known = common_case.Case.load()
    ours = common_case.motion(known, "plane", N, dt, every=1)
    return torch.tensor(known.error(ours)), torch.tensor(0.0)


def semidiscrete() -> tuple[Tensor, Tensor]:
    """The derivation's own element, N = 4: the tip to 0.1 s, under a ramped and a sudden load."""
    stored = [
        reference("semidiscrete_trajectories")["values"][name]
        for name in ("ramp_planar_N4", "step_planar_N4")
    ]
    compliance = torch.diag(1 / torch.tensor([1e3, 400, 400, 0.8, 1, 2]))
    mass = torch.diag(torch.tensor([1, 1, 1, 0.02, 0.01, 0.01]))

    def force(t: Tensor) -> Tensor:
        s = torch.clamp(t / 0.2, max=1.0)
        return along(2, 3 * torch.stack((1 - (1 - s) ** 2 * (1 + 2 * s), torch.ones_like(t))))

    scene = cantilever(4, tb.TipLoad(force=force), of=tb.Section(compliance, mass))
    sol = tb.simulate(
        scene, stored[0]["t"][:2], method="dopri8", form="minimal", rtol=1e-9, atol=1e-10
    )
    return sol.tip.position - torch.tensor([1.0, 0, 0]), torch.tensor(
        [s["tip_u"][:2] for s in stored]
    ).transpose(0, 1)


# fmt: off
CASES = [
    Case("slender cantilever", "Euler and Bernoulli, 1e-9", "frequencies 1 to 3", "64 elements",
         lambda: frequencies(True, 64),
         1.03e-3, coarse=lambda: frequencies(True, 32)),
    Case("stocky cantilevers", "Timoshenko, 1e-9", "frequencies 1 to 3 of three beams",
         "64 elements",
         lambda: frequencies(False, 64), 8e-4, coarse=lambda: frequencies(False, 32)),
    Case("torsion of a rod", "closed form", "frequency 1", "32 elements", lambda: torsion(32),
         1.1e-4, coarse=lambda: torsion(16)),
    Case("stretching of a rod", "closed form", "frequency 1", "32 elements", lambda: axial(32),
         1.4e-8,
         "mass coupled to neighbours by 1/12 makes it fourth order"),
    Case("sudden tip load, 2 s", "two independent codes, 3e-4",
         "tip, RMS distance over RMS displacement",
         "16 elements, 5 ms", lambda: step_load(16, 0.005), 4.5e-3,
         "mesh and step: see the table of accuracy", 1.0),
    Case("the derivation's element, ramped and sudden load", "the same equations, 1e-8",
         "tip displacement to 0.1 s over L",
         "4 elements, dopri8", semidiscrete, 1e-9, "time integration at 1e-9", 1.0),
]
# fmt: on
