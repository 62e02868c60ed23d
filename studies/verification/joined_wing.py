"""The joined wing of Blair: two clamped limbs that meet at a tip, which a force lifts by metres;
the rear one buckles on the way. Beside the Cosserat equations of both limbs, by collocation.

Geometry and compliances are those of GXBeam's example "Static Analysis of a Joined-Wing"
(docs/src/literate/static-joined-wing.jl), after Blair, "An Equivalent Beam Formulation for
Joined-Wings in a Post-Buckled State". Its results, and Yu's by GEBT, are curves without numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb

from .case import Case
from .rods import UNTURNED, Rod, along, collocated, matrix, misfit

FRONT, REAR = np.array([-7.1726, -12.0, -3.21539]), np.array([7.1726, -12.0, 3.21539])  # clamps, m
# 1/N and 1/(N m^2): extension, two shears, twist, two bendings, from a clamp to the tip
FRONT_COMPLIANCE = (
    (1.05204e-9, 3.19659e-9, 2.13106e-8, 1.15475e-7, 1.52885e-7, 7.1672e-9),
    (1.24467e-9, 3.77682e-9, 2.51788e-8, 1.90461e-7, 2.55034e-7, 1.18646e-8),
    (1.60806e-9, 4.86724e-9, 3.24482e-8, 4.07637e-7, 5.57611e-7, 2.55684e-8),
    (2.56482e-9, 7.60456e-9, 5.67609e-8, 1.92171e-6, 2.8757e-6, 1.02718e-7),
)
REAR_COMPLIANCE = (2.77393e-9, 7.60456e-9, 1.52091e-7, 1.27757e-5, 2.7835e-5, 1.26026e-7)
LOAD, ELEMENTS = 70e3, 16  # N; of each piece
# residual of collocation, whose tip is then within 3e-7 m of that of 1e-8
EXACT = 1e-4
TIP = ("front 3", -1)
Force = Callable[[np.ndarray], np.ndarray]  # in LOAD, of the turn of the tip (3, 3)


def pieces() -> dict[str, Rod]:
    """By name: four of the front limb and one of the rear, each from its clamp towards the tip."""
    rods = {}
    for name, clamp, limb in (
        ("front", FRONT, FRONT_COMPLIANCE),
        ("rear", REAR, (REAR_COMPLIANCE,)),
    ):
        x, y = -clamp / np.linalg.norm(clamp), np.cross((0.0, 0.0, 1.0), -clamp)
        y = y / np.linalg.norm(y)
        length, axes = np.linalg.norm(clamp) / len(limb), np.stack((x, y, np.cross(x, y)), -1)
        for k, own in enumerate(limb):
            root = clamp + k * length * x
            rods[f"{name} {k}"] = Rod(root, axes, length, np.array(own))
    return rods


def wing(load: tb.PointLoad) -> tb.State:
    """Under the whole load, along the path of equilibria: five beams, welded one to the next."""
    parts = {
        name: tb.Beam.straight(
            piece.length,
            ELEMENTS,
            tb.Section(torch.tensor(piece.compliance).diag(), torch.eye(6)),
            root=torch.tensor(piece.root),
            direction=torch.tensor(piece.axes[:, 0]),
            order=2,
        )
        for name, piece in pieces().items()
    }
    front = [name for name in parts if name != "rear 0"]
    welds = [tb.Weld((a, -1), (b, 0)) for a, b in pairwise(front)]
    held = [tb.Support((front[0], 0)), tb.Support(("rear 0", 0))]
    scene = tb.Scene(parts, [load], joints=[*welds, tb.Weld(TIP, ("rear 0", -1))], supports=held)
    return tb.path(scene).state[-1]


def collocation(force: Force, state: tb.State) -> np.ndarray:
    """The tip's place (3,) by the Cosserat equations: n the same along each limb, both unknown. A
    state says where the search begins, and so which of the equilibria is meant.
    """
    own = [*pieces().values()]

    def ends(a: np.ndarray, b: np.ndarray, n: np.ndarray) -> np.ndarray:
        front, rear = b[3], b[4]
        clamps = [a[k, :7] - (*own[k].root, *UNTURNED) for k in (0, 4)]
        apart = front[:3] - rear[:3], misfit(front[3:7], rear[3:7])
        loads = n[:3] + n[3:] - force(matrix(front[3:7])), front[7:] + rear[7:]
        return np.concatenate((*clamps, *(b[:3] - a[1:4]), *apart, *loads))

    s = np.linspace(0, 1, 2 * ELEMENTS + 1)
    begin = [along(rod, state.part(name), LOAD, s) for name, rod in pieces().items()]
    start = np.concatenate((begin[0][1], begin[4][1]))

    def of_rods(n: np.ndarray) -> np.ndarray:
        return np.stack([n[:3]] * 4 + [n[3:]])

    return collocated(own, of_rods, ends, begin, start, LOAD, EXACT)[3, :3]


def dead() -> tuple[Tensor, Tensor]:
    """Under a force that stays upright."""
    up = np.array([0.0, 0.0, 1.0])
    state = wing(tb.PointLoad(TIP, force=torch.tensor(LOAD * up)))
    return _tip(state), torch.tensor(collocation(lambda turn: up, state))


def follower() -> tuple[Tensor, Tensor]:
    """Under one that turns with the tip."""
    up = np.array([0.0, 0.0, 1.0])
    own = torch.tensor(pieces()["front 3"].axes.T @ (LOAD * up))
    state = wing(tb.PointLoad(TIP, force=own, follower=True))
    return _tip(state), torch.tensor(collocation(lambda turn: turn @ up, state))


def _tip(state: tb.State) -> Tensor:
    return state["front 3"].tip.position


MESH = f"5 x {ELEMENTS} elements of order 2"
QUANTITY = "place of the tip under 70 kN, over the length of a limb"
SOURCE, WHY = (
    "Cosserat equations by collocation, 3e-8",
    "the measured error of this mesh, rounded up",
)
LIMB = float(np.linalg.norm(FRONT))
# fmt: off
CASES = [
    Case("joined wing, dead force", SOURCE, QUANTITY, MESH, dead, 5e-7, WHY, LIMB),
    Case("joined wing, follower force", SOURCE, QUANTITY, MESH, follower, 1e-5, WHY, LIMB),
]
# fmt: on
