"""A parallel continuum robot: six flexible struts between a base and a platform (the kind of Bryson
and Rucker 2014, IEEE ICRA), which a load pushes aside. Beside the Kirchhoff equations of all six
struts and the platform's balance, by collocation.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb

from .build import section
from .case import Case
from .rods import UNTURNED, Rod, along, collocated, matrix, misfit

HEIGHT, EI, GJ = 0.3, 0.04, 0.03  # m, N m^2
LONGER = 0.01, 0.04, 0.03, 0.02, 0.035, 0.015  # m, of each strut than where it is straight
LOAD = np.array([1.0, 0.5, -2.0])  # N, at the platform's centre
ELEMENTS = 8
EXACT = 1e-6  # residual of collocation


def _circle(radius: float, beside: float, height: float) -> np.ndarray:
    """(6, 3) m: pairs of points, so many degrees on either side of 0, 120 and 240."""
    angle = np.radians([120 * k + side * beside for k in range(3) for side in (-1, 1)])
    return np.stack((radius * np.cos(angle), radius * np.sin(angle), height + 0 * angle), -1)


CORNERS = _circle(0.05, 45, HEIGHT)


def struts() -> list[Rod]:
    """From the base, each along the line to its corner of the platform as drawn; inextensible and
    unshearable.
    """
    rods, compliance = [], np.array([0, 0, 0, 1 / GJ, 1 / EI, 1 / EI])
    for hole, corner, longer in zip(_circle(0.08, 15, 0.0), CORNERS, LONGER, strict=True):
        straight = float(np.linalg.norm(corner - hole))
        x, y = (corner - hole) / straight, np.cross((0.0, 0.0, 1.0), corner - hole)
        axes = np.stack((x, y / np.linalg.norm(y), np.cross(x, y / np.linalg.norm(y))), -1)
        rods.append(Rod(hole, axes, straight + longer, compliance))
    return rods


def robot() -> tb.Scene:
    """Drawn with the struts below the base by what they are longer, from where they are pushed."""
    parts, supports = {}, []
    for k, (rod, longer) in enumerate(zip(struts(), LONGER, strict=True)):
        along = torch.tensor(rod.axes[:, 0])
        parts[f"strut {k}"] = tb.Beam.straight(
            rod.length, ELEMENTS, section(GJ=GJ, EI=EI),
            root=torch.tensor(rod.root) - longer * along, direction=along, order=2,
        )  # fmt: skip
        supports.append(tb.Support((f"strut {k}", 0), displacement=longer * along))
    return tb.Scene(
        {**parts, "platform": tb.Body(0.1, 1e-4, position=(0, 0, HEIGHT))},
        [tb.PointLoad("platform", force=torch.tensor(LOAD))],
        joints=[tb.Weld((name, -1), "platform") for name in parts],
        supports=supports,
    )


def collocation(state: tb.State) -> np.ndarray:
    """(12,) of the platform, place and axes times the height, near that of a state."""
    rods, unit = struts(), float(np.linalg.norm(LOAD))
    levers = CORNERS - (0, 0, HEIGHT)

    def ends(a: np.ndarray, b: np.ndarray, n: np.ndarray) -> np.ndarray:
        """Clamps; the struts' ends on one platform, that of the first; its balance."""
        n, turn = n.reshape(6, 3), matrix(b[0, 3:7])
        centre = b[0, :3] - turn @ levers[0]
        clamps = [a[k, :7] - (*rod.root, *UNTURNED) for k, rod in enumerate(rods)]
        met = [b[k, :3] - centre - turn @ levers[k] for k in range(1, 6)]
        met += [misfit(b[0, 3:7], b[k, 3:7]) for k in range(1, 6)]
        moment = b[:, 7:].sum(0) + np.cross(b[:, :3] - centre, n).sum(0)
        return np.concatenate((*clamps, *met, n.sum(0) - LOAD / unit, moment))

    s = np.linspace(0, 1, 2 * ELEMENTS + 1)
    begin = [along(rod, state.part(f"strut {k}"), unit, s) for k, rod in enumerate(rods)]
    start = np.concatenate([n for _, n in begin])
    last = collocated(rods, lambda n: n.reshape(6, 3), ends, begin, start, unit, EXACT)
    turn = matrix(last[0, 3:7])
    return np.concatenate((last[0, :3] - turn @ levers[0], HEIGHT * turn.flatten()))


def platform() -> tuple[Tensor, Tensor]:
    """Its place, and its axes times the height."""
    state = tb.equilibrium(robot(), tolerance=1e-12)
    body = state["platform"]
    here = torch.cat((body.position, HEIGHT * body.rotation.flatten()))
    return here, torch.tensor(collocation(state))


CASES = [
    Case("six-strut parallel robot", "Kirchhoff equations by collocation, 1e-9",
         "place and axes of the platform, over its height", f"6 x {ELEMENTS} elements of order 2",
         platform, 9e-5, "the measured error of this mesh, rounded up", HEIGHT),
]  # fmt: skip
