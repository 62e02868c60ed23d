"""Ropes and cables: beams of little bending stiffness, and what they lie on."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb

from .build import planar
from .case import Case, Solve

# Over a cylinder


def _lifts_off(P: float, R: float, L: float) -> tuple[float, float, float]:
    """Angle at which a beam of EI = 1, clamped along a cylinder of radius R, leaves it under a dead
    tip load P across its root; and where its tip is then, along the root and downwards.

    On the cylinder the curvature is 1/R, so that M is constant and there is no shear; the free rest
    is an elastica, theta'^2/2 = P (sin theta_tip - sin theta), theta' = 1/R where it begins. With
    theta = theta_tip - u^2 its integrals are smooth.
    """
    u, weights = np.polynomial.legendre.leggauss(40)
    u, weights = (u + 1) / 2, weights / 2

    def free(phi: float) -> tuple[float, np.ndarray, np.ndarray]:
        """theta_tip, and theta and ds at the quadrature's points."""
        tip = math.asin(math.sin(phi) + 1 / (2 * R * R * P))
        own = math.sqrt(tip - phi) * u
        theta = tip - own**2
        rate = np.sqrt(2 * P * (math.sin(tip) - np.sin(theta)))
        return tip, theta, 2 * own / rate * weights * math.sqrt(tip - phi)

    low, high = 0.0, math.asin(1 - 1 / (2 * R * R * P)) - 1e-9
    for _ in range(60):  # by halves: the further it lies on, the longer it would be
        phi = (low + high) / 2
        longer = R * phi + free(phi)[2].sum() > L
        low, high = (low, phi) if longer else (phi, high)
    _, theta, ds = free(phi)
    across = R * (1 - math.cos(phi)) + (np.sin(theta) * ds).sum()
    return phi, R * math.sin(phi) + (np.cos(theta) * ds).sum(), across


def over_a_cylinder(N: int = 40) -> tuple[Tensor, Tensor]:
    """Tip, moment at the clamp 1/R, and force of the cylinder: what the clamp does not bear is the
    load and, along the beam, its tension P sin phi there.
    """
    P, R, L, thickness, share = 6.0, 0.4, 1.0, 4e-6, 10.0
    phi, along, down = _lifts_off(P, R, L)
    pressure = P * math.sin(phi) / R
    gap = thickness * (1 - share**-0.5)  # at that pressure
    contact = tb.Contact(
        tb.Cylinder((0.0, 0, -R), (0.0, 1, 0), R - gap),
        thickness=thickness,
        force=share * pressure,
        points=6,
    )
    beam = tb.Beam.straight(L, N, planar(), order=2)
    load = tb.TipLoad(force=(0, 0, -P))
    scene = tb.Scene(beam, [contact, load], plane="xz")
    state = tb.equilibrium(scene)
    force = tb.sensors.ContactForce(scene)(state)
    moment = state.root.moment[1].abs()[None]
    ours = torch.cat((state.tip.position[[0, 2]], moment, force[[0, 2]]))
    return ours, torch.tensor([along, -down, 1 / R, P * math.sin(phi), P])


# Hanging


def _hung(L: float, span: float, EI: float, EA: float = math.inf, N: int = 40) -> tb.State:
    """A cable of 1 N/m between two points at the same height, from straight in one call."""
    section = tb.Section.from_stiffness(
        EA=EA, GA=math.inf, GJ=1.0, EI=EI, mass=1 / 9.81, inertia=0.0
    )
    beam = tb.Beam.straight(L, N, section, order=2)
    ends = [tb.Support(0, "xyz", ""), tb.Support(-1, "xyz", "", displacement=(span - L, 0.0, 0.0))]
    scene = tb.Scene(beam, [tb.Gravity((0.0, 0, -9.81))], supports=ends, plane="xz")
    return tb.equilibrium(scene, relax=True)


def slack() -> tuple[Tensor, Tensor]:
    """Heights of the nodes, a cosh((x - l/2)/a) less that at the ends, and the horizontal force a;
    the cable starts straight and longer than its span.
    """
    a, span = 0.4, 1.0
    state = _hung(2 * a * math.sinh(span / (2 * a)), span, EI=1e-6)
    x, z = state.position[:, 0], state.position[:, 2]
    height = a * (torch.cosh((x - span / 2) / a) - math.cosh(span / (2 * a)))
    return torch.cat((z, -state.root.force[:1])), torch.cat((height, torch.tensor([a])))


def taut() -> tuple[Tensor, Tensor]:
    """The same of an elastic cable that is shorter than its span: with the horizontal force H and
    half of the weight V, l = H L/EA + 2 H asinh(V/H) and, at s,
    z = (s^2/2 - V s)/EA + (H^2 + (s - V)^2)^(1/2) - (H^2 + V^2)^(1/2) (Irvine 1981).
    """
    EA, L, span = 200.0, 1.0, 1.001
    V, low, high = L / 2, 0.1, 100.0
    for _ in range(60):
        H = (low + high) / 2
        shorter = H * L / EA + 2 * H * math.asinh(V / H) < span
        low, high = (H, high) if shorter else (low, H)
    state = _hung(L, span, EI=1e-7, EA=EA)
    s = torch.linspace(0, L, len(state.position))
    z = (s * s / 2 - V * s) / EA + (H * H + (s - V) ** 2).sqrt() - math.hypot(H, V)
    ours = torch.cat((state.position[:, 2] / z.abs().amax(), -state.root.force[:1] / H))
    return ours, torch.cat((z / z.abs().amax(), torch.ones(1)))


def _case(name: str, source: str, quantity: str, solve: Solve, bound: float, why: str,
          scale: float | None = 1.0) -> Case:  # fmt: skip
    return Case(name, source, quantity, "40 elements of order 2", solve, bound, why, scale)


BENDS = "what little bending stiffness there is; twice its measured error"
CASES = [
    _case("cantilever bent over a cylinder", "elastica that leaves an arc of 1/R",
          "tip, moment, force of the cylinder", over_a_cylinder, 3e-4,
          "layer of the contact, twice over", None),
    _case("slack cable", "catenary", "heights and horizontal force, over length and weight",
          slack, 1.4e-5, BENDS),
    _case("taut elastic cable", "elastic catenary (Irvine 1981)", "heights over sag, force", taut,
          1e-6, BENDS),
]  # fmt: skip
