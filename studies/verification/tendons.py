"""Tendons against the Cosserat equations, and the law of Euler and Eytelwein."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb

from .case import Case

LENGTH, OFFSET, TWIST, TENSION = 0.3, 0.008, 4 * math.pi, 1.5  # m, m, rad/m, N
STEPS = 100


def helix(N: int) -> tuple[Tensor, Tensor]:
    """Tip of a soft rod that a tendon on a helix bends and twists. There is no load at its end: the
    rod's force and moment are those of the tendon in its tangent t, -T t and -T p x t, which hangs
    on the strains (Rucker and Webster 2011).
    """
    rod = tb.Section.circle(0.005, E=5e6, nu=0.3, rho=1200)
    soft = np.asarray(torch.as_tensor(rod.compliance).diagonal(dim1=-2, dim2=-1)).reshape(6)

    def strains(s: float) -> tuple[np.ndarray, np.ndarray]:
        c, d = OFFSET * math.cos(TWIST * s), OFFSET * math.sin(TWIST * s)
        p, slope = np.array([0, c, d]), TWIST * np.array([0, -d, c])
        v, u = np.array([1.0, 0, 0]), np.zeros(3)
        for _ in range(30):
            t = slope + np.cross(u, p) + v
            t /= np.linalg.norm(t)
            v = np.array([1.0, 0, 0]) - TENSION * soft[:3] * t
            u = -TENSION * soft[3:] * np.cross(p, t)
        return v, u

    def rates(s: float, y: np.ndarray) -> np.ndarray:
        R, (v, u) = y[3:].reshape(3, 3), strains(s)
        return np.concatenate((R @ v, np.cross(R, u).ravel()))

    y, h = np.concatenate((np.zeros(3), np.eye(3).ravel())), LENGTH / STEPS
    for s in h * np.arange(STEPS):  # Runge and Kutta's
        a = rates(s, y)
        b = rates(s + h / 2, y + h / 2 * a)
        c = rates(s + h / 2, y + h / 2 * b)
        y = y + h / 6 * (a + 2 * b + 2 * c + rates(s + h, y + h * c))
    beam = tb.Beam.straight(LENGTH, N, rod)

    def place(s: Tensor) -> Tensor:
        return OFFSET * torch.stack((0 * s, torch.cos(TWIST * s), torch.sin(TWIST * s)), -1)

    scene = tb.Scene(beam, [tb.Tendon.along(beam, place, tension=TENSION)])
    return tb.equilibrium(scene, engine="eager").tip.position, torch.from_numpy(y[:3])


CASES = [
    Case(
        "rod bent and twisted by a tendon on a helix",
        "Cosserat equations, 1e-9 (Rucker and Webster 2011)",
        "tip x, y, z over L",
        "8 elements",
        lambda: helix(8),
        1.01e-2,
        "elements are of second order, and stretches of the tendon are straight",
        LENGTH,
    )
]
