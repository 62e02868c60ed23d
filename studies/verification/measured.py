"""Beams that were measured: composite strips under weights, and the Pazy wing.

Of each, what another code answers with the same numbers, and what an experiment did: the second
tells how good the published stiffness is, and no more than that of this library.
"""

from __future__ import annotations

import math
from functools import cache
from itertools import product

import torch
from torch import Tensor

import torchbeam as tb

from .case import Case, reference

G = 9.81  # m/s^2
WEIGHTLESS = 1e-9  # kg/m, kg: what a section or a weight of nothing has
PAIRS = ((0, 0), (1, 1), (2, 2), (3, 3), (0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


def strip(values: dict, grams: Tensor) -> Tensor:
    """(weights, 3) m: how a place of a strip moves under weights (weights,) g at its tip; its
    normal is turned from the vertical about its length.
    """
    known = reference("composite_strips")
    stiffness = torch.tensor(known["stiffness"][values["strip"] - 1])
    section = tb.Section(torch.linalg.inv(stiffness), WEIGHTLESS * torch.eye(6))
    angle = math.radians(values["roll"])
    up = (0, -math.sin(angle), math.cos(angle))
    beam = tb.Beam.straight(known["length"], 22, section, up=up)  # a node at the place
    force = -1e-3 * known["gravity"] * grams[:, None] * torch.eye(3)[2]
    state = tb.equilibrium(tb.Scene(beam, [tb.TipLoad(force=force)]))
    return state.position[:, 20] - known["station"] * torch.eye(3)[0]


def strips_other() -> tuple[Tensor, Tensor]:
    known = reference("composite_strips")
    grams = torch.tensor(known["other_weight"]) * 1.0
    ours = torch.stack([strip(values, grams) for values in known["values"]])
    return ours, torch.tensor([values["other"] for values in known["values"]])


def strips_measured() -> tuple[Tensor, Tensor]:
    """RMS of the distances from each strip's readings, over its length, against 0."""
    known, numbers = reference("composite_strips"), []
    for values in known["values"]:
        grams, axes, seen = torch.tensor(values["measured"]).T
        ours = strip(values, grams)[torch.arange(len(grams)), axes.long()]
        numbers.append((ours - seen).square().mean().sqrt() / known["length"])
    return torch.stack(numbers), torch.zeros(len(numbers))


def pazy(hung: Tensor | None, y: float = 0.0) -> tb.Scene:
    """The Pazy wing without skin, by its fifteen condensed elements and its lumped masses; `hung`
    (weights,) kg at the tip, y m before the axis. Without it, nothing has weight.
    """
    known = reference("pazy_wing")
    K = torch.zeros(15, 4, 4)
    for (a, b), column in zip(PAIRS, torch.tensor(known["stiffness"]).T, strict=True):
        K[:, a, b] = K[:, b, a] = column
    compliance = torch.zeros(15, 6, 6)
    elastic = (0, 3, 4, 5)  # no shear
    for (a, i), (b, j) in product(enumerate(elastic), repeat=2):
        compliance[:, i, j] = torch.linalg.inv(K)[:, a, b]
    sections = [tb.Section(S, WEIGHTLESS * torch.eye(6)) for S in compliance]
    nodes = known["span"] * torch.tensor(known["nodes"])[:, None] * torch.eye(3)[0]
    lumps = list(zip(*(known[f"nodal_{x}"] for x in ("mass", "centre", "inertia")), strict=True))
    effects: list = [
        tb.PointMass(mass, inertia, offset=centre, node=k)
        for k, (mass, centre, inertia) in enumerate(lumps)
        if k  # the first is clamped
    ]
    if hung is not None:
        effects += [tb.Gravity((0, 0, -G)), tb.PointMass(hung, offset=(0, y, 0), node=-1)]
    return tb.Scene(tb.Beam.from_nodes(nodes, sections), effects)


def moved(hung: list[float], behind: float | None) -> tuple[Tensor, Tensor]:
    """From where the wing hangs by itself: displacement of half of the tip's chord upwards, over
    the span, and twist, deg, by the heights of its edges, under weights `hung` kg, so far `behind`
    the trailing edge (m), None = at half of the chord.
    """
    known = reference("pazy_wing")
    half = known["chord"] * (known["reference_axis"] - 0.5)
    y = half if behind is None else known["chord"] * (known["reference_axis"] - 1) - behind
    tip = tb.equilibrium(pazy(torch.tensor([WEIGHTLESS, *hung]), y)).tip
    edge = tip.rotation[:, 2, 1]
    height, twist = (tip.position[:, 2] + half * edge) / known["span"], edge.asin().rad2deg()
    return (height - height[0])[1:], (twist - twist[0])[1:]


@cache
def under_weights(behind: float | None) -> tuple[Tensor, Tensor]:
    return moved(reference("pazy_wing")["um_nast"]["mass"], behind)


def published(name: str) -> Tensor:
    return torch.tensor(reference("pazy_wing")["um_nast"][name])


def heights() -> tuple[Tensor, Tensor]:
    ours = torch.stack((under_weights(None)[0], under_weights(0.04)[0]))
    wanted = torch.stack((published("bending_displacement"), published("torsion_displacement")))
    return ours, wanted / 100


def heights_measured() -> tuple[Tensor, Tensor]:
    flat, eccentric = reference("pazy_static_bending"), reference("pazy_wing")["measured"]
    ours = [moved(flat["mass"], None)[0], moved(eccentric["mass"], 0.04)[0]]
    wanted = torch.tensor([flat["displacement"], eccentric["torsion_displacement"]])
    return torch.stack(ours), wanted / 100


def twist_measured() -> tuple[Tensor, Tensor]:
    seen = reference("pazy_wing")["measured"]
    return moved(seen["mass"], 0.04)[1], torch.tensor(seen["torsion_twist"])


def frequencies() -> tuple[Tensor, Tensor]:
    hertz = tb.modes(pazy(None), count=5).frequency / (2 * math.pi)
    return hertz, published("frequency")


STRIPS, WING, MESH = "composite strips, flat and rolled", "Pazy wing without skin", "15 elements"
UM_NAST = "UM/NAST, the same beam model (Riso and Cesnik 2022)"
CURVED = "their elements are of constant curvature: the mesh's error differs"
AVIN = "measured by Avin et al. 2022"
# fmt: off
CASES = [
    Case(STRIPS, "AeroBeams.jl, 22 elements", "place at 0.5 m, 3 strips, to 500 g, over the length",
         "22 elements", strips_other, 1.4e-4, CURVED, 0.55),
    Case(STRIPS, "measured by Minguet and Dugundji 1990",
         "RMS of the distance over the length, 3 strips", "22 elements", strips_measured, 2.1e-2,
         "the published stiffness: small deflections are 6 to 18 % larger than it says", 1.0),
    Case(WING, UM_NAST, "height of the tip under 0.5 to 3 kg, bending and torsion, over the span",
         MESH, heights, 2.6e-4, CURVED, 1.0),
    Case(WING, UM_NAST, "twist of the tip, over that under 3 kg", MESH,
         lambda: (under_weights(0.04)[1], published("torsion_twist")), 1.7e-4, CURVED, 8.0384),
    Case(WING, UM_NAST, "frequencies 1 to 5", MESH, frequencies, 1.4e-4, CURVED),
    Case(WING, AVIN, "height of the tip under 0.2 to 2 kg, over the span", MESH, heights_measured,
         2.9e-2, "the condensed beam's stiffness: the wing is softer", 1.0),
    Case(WING, AVIN, "twist of the tip under 0.2 to 2 kg, 4 cm behind it, over that under 2 kg",
         MESH, twist_measured, 0.08, "readings in steps of 0.6 degrees, a tenth of it", 6.0311),
]
# fmt: on
