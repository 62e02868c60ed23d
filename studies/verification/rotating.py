"""Beams in a rotating frame."""

from __future__ import annotations

import math

import torch
from torch import Tensor

import torchbeam as tb

from .build import INF, along, cantilever, section
from .case import Case, columns, reference


def whirling(N: int, kind: str) -> tuple[Tensor, Tensor]:
    """Wright et al. (1982): hub radius 0, flap out of the plane of rotation, lag in it; eta = Omega
    sqrt(m L^4/EI).
    """
    values = reference("rotating_cantilever_frequencies")["values"]
    eta = torch.tensor([float(v["eta"]) for v in values])
    of = section(GJ=INF, EI=(1.0, INF) if kind == "flap" else (INF, 1.0))
    spun = cantilever(N, of=of, frame=tb.Frame(angular_velocity=along(2, eta)))
    return tb.modes(spun, count=3).frequency, torch.tensor([v[kind] for v in values])


def stretched(N: int) -> tuple[Tensor, Tensor]:
    """tan(lambda L)/lambda - L with lambda = Omega sqrt(m/EA)."""
    EA, m, Omega, L, u = columns(
        reference("rotating_rod_extension")["values"], "EA", "m", "Omega", "L", "u_tip"
    )
    rod = section(EA=EA, GJ=INF, EI=INF, mass=m)
    state = tb.equilibrium(
        cantilever(N, of=rod, L=L, frame=tb.Frame(angular_velocity=along(2, Omega)))
    )
    return state.tip.position[:, 0] - L, u


def spin_up(N: int, dt: float) -> tb.Solution:
    """Simo and Vu-Quoc (1986): from rest to 6 rad/s in 15 s."""

    def omega(t: Tensor) -> Tensor:
        rising = 6 / 15 * (t - 15 / (2 * math.pi) * torch.sin(2 * math.pi * t / 15))
        return torch.where(t < 15, rising, torch.full_like(rising, 6.0)) * torch.eye(3)[2]

    blade = section(EA=2.8e7, GA=1e7, GJ=1.4e4, EI=1.4e4, mass=1.2, inertia=6e-4)
    scene = cantilever(N, of=blade, L=10.0, frame=tb.Frame(angular_velocity=omega), plane="xy")
    return tb.simulate(scene, torch.linspace(0, 20, 201), step=dt)


def spin_up_history(N: int, dt: float) -> tuple[Tensor, Tensor]:
    stored = reference("spin_up")["expected"]["n16_dt001"]
    return spin_up(N, dt).tip.position[:, 1], torch.tensor(stored["tip_uy"])


# fmt: off
CASES = [
    Case("rotating cantilever, flap, Omega to 10 sqrt(EI/(m L^4))",
         "Wright, Smith, Thresher and Wang 1982, 1e-9",
         "frequencies 1 to 3", "64 elements", lambda: whirling(64, "flap"), 1.03e-3),
    Case("rotating cantilever, lag", "Wright, Smith, Thresher and Wang 1982, 1e-9",
         "frequencies 1 to 3", "64 elements",
         lambda: whirling(64, "lag"), 1.03e-3),
    Case("rotating rod, steady", "closed form, 1e-9", "tip extension", "32 elements",
         lambda: stretched(32), 2.7e-4),
    Case("spin-up to 6 rad/s, 20 s", "Simo and Vu-Quoc 1986; two codes",
         "tip across, over its largest (0.573 m)",
         "8 elements, 0.1 s", lambda: spin_up_history(8, 0.1), 9.8e-3, "mesh and step", 0.573),
]
# fmt: on
