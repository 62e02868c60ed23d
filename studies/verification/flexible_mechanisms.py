"""Flexible mechanisms in a plane, beside chains of rigid segments with springs between them: the
same beams by angles in place of nodes, integrated in time by another method.

n segments of a beam without extension and shear have errors of h^2; those of n = 4, 8 and 16 are
extrapolated. Two mechanisms are beside another program's.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from scipy.integrate import solve_ivp
from torch import Tensor

import torchbeam as tb

from .. import mechanisms
from .build import section
from .case import Case, reference

G, EI, MASS = 9.81, 0.05, 0.2  # m/s^2, N m^2, kg/m
CRANK, SLIDER = 0.1, 0.05  # m, kg
COUNTS = 4, 8, 16
STILL = 1e-9, 1e-11  # relative and absolute tolerance of the reference


class Segments(NamedTuple):
    """h (N,) m; mass (N, N), of which the angles' differences take cosines, kg m^2; own inertia
    (N,); first (N,) kg m: moments of the masses about the root, by segment; springs (N, N) N m.
    """

    h: np.ndarray
    mass: np.ndarray
    inertia: np.ndarray
    first: np.ndarray
    springs: np.ndarray

    @classmethod
    def of(cls, lengths: tuple[float, ...], n: int, tip: float = 0.0) -> Segments:
        """Beams one after the other on hinges, each of n segments, with a mass at the tip."""
        h = np.repeat(np.array(lengths) / n, n)
        m, count = MASS * h, len(h)
        centres = np.tril(np.ones((count, count)), -1) * h + np.diag(h / 2)
        springs = np.zeros((count, count))
        for i in range(count - 1):
            if (i + 1) % n:
                pair = np.ix_((i, i + 1), (i, i + 1))
                springs[pair] += 2 * EI / (h[i] + h[i + 1]) * np.array([[1.0, -1.0], [-1.0, 1.0]])
        mass = centres.T @ np.diag(m) @ centres + tip * np.outer(h, h)
        return cls(h, mass, m * h**2 / 12, centres.T @ m + tip * h, springs)

    def matrix(self, angle: np.ndarray) -> np.ndarray:
        return self.mass * np.cos(angle[:, None] - angle) + np.diag(self.inertia)

    def push(self, angle: np.ndarray, rate: np.ndarray, root: np.ndarray) -> np.ndarray:
        """Of inertia, springs, and a root that is accelerated, m/s^2: gravity is that, too."""
        whirled = (self.mass * np.sin(angle[:, None] - angle)) @ rate**2
        carried = -np.sin(angle) * root[0] + np.cos(angle) * root[1]
        return -whirled - self.springs @ angle - self.first * carried

    def tip(self, angle: np.ndarray) -> np.ndarray:
        return np.array([self.h @ np.cos(angle), self.h @ np.sin(angle)])


def pendulum_of_segments(n: int, t: float) -> np.ndarray:
    """Tip of two beams of 0.5 m on hinges, t after they fall from the horizontal."""
    chain, root = Segments.of((0.5, 0.5), n), np.array([0.0, G])

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        angle, rate = np.split(y, 2)
        return np.concatenate(
            (rate, np.linalg.solve(chain.matrix(angle), chain.push(angle, rate, root)))
        )

    return chain.tip(_last(rates, 2 * len(chain.h), t))


def crank_of_segments(n: int, t: float) -> np.ndarray:
    """Middle of a rod of 0.4 m from a crank at the angle 40 t^2 to a slider along x: the crank's
    pin is the root, and a multiplier holds the tip.
    """
    chain = Segments.of((0.4,), n, SLIDER)

    def rates(now: float, y: np.ndarray) -> np.ndarray:
        (angle, rate), (turn, spin, more) = np.split(y, 2), (40 * now**2, 80 * now, 80.0)
        along, across = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        root = CRANK * (more * across - spin**2 * along)
        g = chain.h * np.cos(angle)  # the tip's height by the angles
        whirl = chain.h @ (np.sin(angle) * rate**2) - root[1]
        count = len(angle)
        A = np.zeros((count + 1, count + 1))
        A[:count, :count], A[:count, count], A[count, :count] = chain.matrix(angle), g, g
        right = np.append(chain.push(angle, rate, root), whirl)
        return np.concatenate((rate, np.linalg.solve(A, right)[:count]))

    angle, turn = _last(rates, 2 * len(chain.h), t), 40 * t**2
    half = n // 2
    reach = chain.h[:half] @ np.stack((np.cos(angle), np.sin(angle)), -1)[:half]
    return CRANK * np.array([np.cos(turn), np.sin(turn)]) + reach


def _last(rates: Callable[[float, np.ndarray], np.ndarray], size: int, t: float) -> np.ndarray:
    """The angles after t, from rest at zero."""
    rtol, atol = STILL
    run = solve_ivp(rates, (0, t), np.zeros(size), method="DOP853", rtol=rtol, atol=atol)
    return run.y[: size // 2, -1]


def _extrapolated(of: Callable[[int, float], np.ndarray], t: float) -> Tensor:
    coarse, middle, fine = (of(n, t) for n in COUNTS)
    one, two = (4 * middle - coarse) / 3, (4 * fine - middle) / 3
    return torch.from_numpy((16 * two - one) / 15)


def _section() -> tb.Section:
    rigid = float("inf")
    return section(EA=rigid, GA=rigid, GJ=1.0, EI=EI, mass=MASS)


def pendulum(t: float = 0.3) -> tuple[Tensor, Tensor]:
    """Two flexible links on hinges that fall from the horizontal: place of the tip."""
    parts = {
        name: tb.Beam.straight(0.5, 4, _section(), order=2, root=(root, 0, 0))
        for name, root in (("upper", 0.0), ("lower", 0.5))
    }
    joints = [tb.Hinge(None, ("upper", 0)), tb.Hinge(("upper", -1), ("lower", 0))]
    scene = tb.Scene(parts, [tb.Gravity((0, 0, -G))], joints=joints, plane="xz")
    run = tb.simulate(scene, [0.0, t], step=t / 60, method="midpoint4")
    return run["lower"].tip.position[-1, [0, 2]], _extrapolated(pendulum_of_segments, t)


def crank(t: float = 0.2) -> tuple[Tensor, Tensor]:
    """A slider-crank with a flexible rod, whose crank's angle is given: place of the rod's
    middle.
    """
    parts = {
        "crank": tb.Body(1.0, 0.1),
        "rod": tb.Beam.straight(0.4, 4, _section(), order=2, root=(CRANK, 0, 0)),
    }
    y = dict(axis=(0, 0, 1))
    scene = tb.Scene(
        parts,
        [tb.PointMass(SLIDER, node=("rod", -1))],
        joints=[
            tb.Hinge(None, "crank", angle=lambda t: 40 * t**2, at=(0, 0, 0), **y),
            tb.Hinge(("crank", (CRANK, 0, 0)), ("rod", 0), **y),
        ],
        supports=[tb.Support(("rod", -1), position="yz", rotation="xy")],
        plane="xy",
    )
    run = tb.simulate(scene, [0.0, t], step=t / 60, method="midpoint4")
    return run["rod"].nodes[-1, 4, :2], _extrapolated(crank_of_segments, t)


def of_exudyn(name: str, elements: int, steps: int) -> tuple[Tensor, Tensor]:
    """A linkage or a hand let go: places of its ends every 0.1 s."""
    known = torch.tensor(reference("mechanisms_exudyn")[name])
    motion = mechanisms.motion(name, elements, 2, steps, intervals=len(known))
    return mechanisms.places(name, motion)[1:], known


SEGMENTS = "chains of 4, 8, 16 rigid segments, extrapolated"
MESH = "the measured error of this mesh, rounded up"
CASES = [
    Case("flexible double pendulum", SEGMENTS, "tip after 0.3 s, m",
         "2 x 4 elements of order 2, midpoint4", pendulum, 3e-5, MESH, 1.0),
    Case("slider-crank with a flexible rod", SEGMENTS, "middle of the rod after 0.2 s, m",
         "4 elements of order 2, midpoint4", crank, 3e-5, MESH, 0.4),
    Case("flexible four-bar linkage", "exudyn, 1e-6", "two pins every 0.1 s, m",
         "3 x 3 elements of order 2, 5 ms", lambda: of_exudyn("four-bar", 3, 200), 9.5e-5, MESH,
         1.0),
    Case("hand of three jointed fingers", "exudyn, 1e-4", "tips every 0.1 s, m",
         "6 x 2 elements of order 2, 5 ms", lambda: of_exudyn("hand", 2, 200), 1e-3, MESH, 1.0),
]  # fmt: skip
