"""The joined wing of Blair: two clamped limbs that meet at a tip, which a force lifts by metres;
the rear one buckles on the way. Beside the Cosserat equations of both limbs, by collocation.

Geometry and compliances are those of GXBeam's example "Static Analysis of a Joined-Wing"
(docs/src/literate/static-joined-wing.jl), after Blair, "An Equivalent Beam Formulation for
Joined-Wings in a Post-Buckled State". Its results, and Yu's by GEBT, are curves without numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from scipy.integrate import solve_bvp
from scipy.spatial.transform import Rotation
from torch import Tensor

import torchbeam as tb

from .case import Case

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


class Piece(NamedTuple):
    """Of one section: root m, section axes as columns (along it, level, upwards), length m."""

    root: np.ndarray
    axes: np.ndarray
    length: float
    compliance: np.ndarray


def pieces() -> dict[str, Piece]:
    """By name: four of the front limb and one of the rear, each from its clamp towards the tip."""
    found = {}
    for name, clamp, limb in (
        ("front", FRONT, FRONT_COMPLIANCE),
        ("rear", REAR, (REAR_COMPLIANCE,)),
    ):
        x, y = -clamp / np.linalg.norm(clamp), np.cross((0.0, 0.0, 1.0), -clamp)
        y = y / np.linalg.norm(y)
        length, axes = np.linalg.norm(clamp) / len(limb), np.stack((x, y, np.cross(x, y)), -1)
        for k, own in enumerate(limb):
            root = clamp + k * length * x
            found[f"{name} {k}"] = Piece(root, axes, length, np.array(own))
    return found


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
    return tb.path(scene).state


def collocation(force: Force, state: tb.State) -> np.ndarray:
    """The tip's place (3,) by the Cosserat equations, all pieces side by side over 0 < s < 1:
    r' = R (e_1 + gamma), q' = (0, R kappa) q / 2, m' = -r' x n; n the same along each limb, both
    unknown. A state says where the search begins, and so which of the equilibria is meant.
    """
    own = [*pieces().values()]

    def rates(s: np.ndarray, y: np.ndarray, n: np.ndarray) -> np.ndarray:
        found = []
        for k, (_, axes, length, compliance) in enumerate(own):
            _, q, m = np.split(y.reshape(5, 10, -1)[k].T, (3, 7), -1)
            R = matrix(q) @ axes
            N = n[:3] if k < 4 else n[3:]
            gamma, kappa = (
                LOAD * c * np.einsum("sji,sj->si", R, np.broadcast_to(x, m.shape))
                for c, x in ((compliance[:3], N), (compliance[3:], m))
            )
            slope, spin = (R @ (gamma + np.eye(3)[0])[..., None])[..., 0], (R @ kappa[..., None])
            spin, w, v = spin[..., 0], q[:, :1], q[:, 1:]
            turn = -(spin * v).sum(-1, keepdims=True) / 2, (w * spin + np.cross(spin, v)) / 2
            found.append(length * np.concatenate((slope, *turn, -np.cross(slope, N)), -1).T)
        return np.concatenate(found)

    def ends(a: np.ndarray, b: np.ndarray, n: np.ndarray) -> np.ndarray:
        a, b = a.reshape(5, 10), b.reshape(5, 10)
        front, rear = b[3], b[4]
        clamps = [a[k, :7] - (*own[k].root, 1.0, 0.0, 0.0, 0.0) for k in (0, 4)]
        (w, *v), (c, *u) = front[3:7], rear[3:7]
        apart = front[:3] - rear[:3], np.multiply(c, v) - np.multiply(w, u) - np.cross(v, u)
        loads = n[:3] + n[3:] - force(matrix(front[None, 3:7])[0]), front[7:] + rear[7:]
        return np.concatenate((*clamps, *(b[:3] - a[1:4]), *apart, *loads))

    s, begun, n = np.linspace(0, 1, 2 * ELEMENTS + 1), [], []
    for name, piece in pieces().items():
        part = state.part(name)
        R, stress = part.axes[-1].numpy(), part.stress[-1].numpy() / LOAD
        N, M = (np.einsum("sij,sj->si", R[1:], x) for x in np.split(stress, 2, -1))
        at = (np.arange(len(M)) + 0.5) / len(M)
        q = Rotation.from_matrix(R @ piece.axes.T).as_quat(scalar_first=True)
        q = q * np.cumprod(np.sign(np.r_[q[:1, 0], (q[1:] * q[:-1]).sum(-1)]))[:, None]
        m = np.stack([np.interp(s, at, x) for x in M.T], -1)
        begun.append(np.concatenate((part.position[-1].numpy(), q, m), -1).T)
        n.append(N.mean(0))
    done = solve_bvp(rates, ends, s, np.concatenate(begun), np.concatenate((n[0], n[4])), tol=EXACT)
    if done.status:
        raise RuntimeError(f"collocation of the joined wing has failed: {done.message}")
    return done.y[30:33, -1]


def matrix(q: np.ndarray) -> np.ndarray:
    """Of quaternions (S, 4), which collocation may scale: (S, 3, 3)."""
    return Rotation.from_quat(q, scalar_first=True).as_matrix()


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
    return state["front 3"].tip.position[-1]


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
