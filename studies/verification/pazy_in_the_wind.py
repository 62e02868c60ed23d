"""The Pazy wing in the wind: how far its tip bends, and where it flutters, by its root angle.

The published beam model of the wing with skin, in the published tip loss of a vortex lattice: both
are Riso's and Cesnik's. Gravity is left out, as the wing stands upright in the tunnel.
"""

from __future__ import annotations

import math
from itertools import product

import torch
from torch import Tensor

import torchbeam as tb

from .case import reference
from .measured import WEIGHTLESS

DENSITY = 1.225


def wing() -> tb.Beam:
    known = reference("pazy_wing_with_skin")
    K = torch.zeros(15, 4, 4)
    for k, name in enumerate(("EA", "GJ", "EI_y", "EI_z")):
        K[:, k, k] = torch.tensor(known[name])
    K[:, 1, 2] = K[:, 2, 1] = torch.tensor(known["twist_bending"])
    K[:, 0, 3] = K[:, 3, 0] = torch.tensor(known["stretch_bending"])
    compliance = torch.zeros(15, 6, 6)
    for (a, i), (b, j) in product(enumerate((0, 3, 4, 5)), repeat=2):
        compliance[:, i, j] = torch.linalg.inv(K)[:, a, b]
    sections = [tb.Section(S, WEIGHTLESS * torch.eye(6)) for S in compliance]
    nodes = known["span"] * torch.tensor(known["nodes"])[:, None] * torch.eye(3)[0]
    return tb.Beam.from_nodes(nodes, sections)


def in_the_wind(wind: Tensor | tb.Input, angle: float, speed: float) -> tb.Scene:
    """With the loss of lift toward the tip that is published for an angle and a speed."""
    known = reference("pazy_wing_with_skin")
    span, terms = known["span"], known["tip_decay"][f"{angle:g}"]
    decay = sum(c * speed**k for k, c in enumerate(terms))
    lumps = list(zip(*(known[f"nodal_{x}"] for x in ("mass", "centre", "inertia")), strict=True))
    masses = [tb.PointMass(m, J, offset=c, node=k) for k, (m, c, J) in enumerate(lumps) if k]
    air = tb.StripAir(
        known["chord"], axis=known["reference_axis"], density=DENSITY, wind=wind,
        lift_slope=lambda s: 2 * math.pi * (1 - torch.exp(-decay * (1 - s / span))),
    )  # fmt: skip
    return tb.Scene(wing(), [air, *masses])


def toward(angle: float) -> Tensor:
    """(3,) along which air meets a wing at this root angle, deg."""
    return torch.tensor([0.0, -math.cos(math.radians(angle)), math.sin(math.radians(angle))])


def deflection(angle: float) -> Tensor:
    """Of the tip's mid-chord at 29 m/s, % of the span."""
    known = reference("pazy_wing_with_skin")
    wind = known["speed"] * toward(angle)
    tip = tb.equilibrium(in_the_wind(wind, angle, known["speed"])).tip
    half = known["chord"] * (known["reference_axis"] - 0.5)
    return 100 * (tip.position[2] + half * tip.rotation[2, 1]) / known["span"]


def onset(angle: float, low: float, high: float) -> tb.Critical:
    """Where it begins to flutter between these speeds, m/s."""
    scene = in_the_wind(tb.Input("wind", 3), angle, (low + high) / 2)
    return tb.critical_load(
        scene, high, lowest=low, points=4, count=4, tolerance=1e-3,
        inputs={"wind": toward(angle)},
    )  # fmt: skip
