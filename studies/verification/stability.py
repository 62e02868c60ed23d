"""Loads of buckling and flutter."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.statics.continuation import LIMIT_POINT

from .build import INF, along, cantilever, planar, section
from .case import ORDER, Case, Solve, reference

N = 32


def euler() -> tuple[Tensor, Tensor]:
    critical = tb.critical_load(
        lambda P: cantilever(N, tb.TipLoad(force=along(0, -P)), of=planar()), 10.0
    )
    return critical.factor, torch.tensor(reference("stability_limits")["values"][0]["value"])


def beck() -> tb.Critical:
    def follower(P: Tensor) -> tb.Scene:
        return cantilever(N, tb.TipLoad(force=along(0, -P), follower=True), of=planar())

    return tb.critical_load(follower, 60.0, points=13)


def beck_load() -> tuple[Tensor, Tensor]:
    return beck().factor, torch.tensor(
        reference("stability_limits")["values"][1]["P_cr_L2_over_EI"]
    )


def beck_frequency() -> tuple[Tensor, Tensor]:
    return beck().frequency, torch.tensor(
        reference("stability_limits")["values"][1]["omega_flutter"]
    )


def damped_beck() -> tuple[Tensor, Tensor]:
    def follower(P: Tensor) -> tb.Scene:
        return cantilever(
            16, tb.TipLoad(force=along(0, -P), follower=True), tb.Damping(1e-3), of=planar()
        )

    return tb.critical_load(follower, 15.0, points=9).factor, torch.tensor(10.94)


def sideways() -> tuple[Tensor, Tensor]:
    strip = section(GJ=0.5, EI=(INF, 1.0))
    critical = tb.critical_load(
        cantilever(N, tb.TipLoad(force=tb.Input("P", 3)), of=strip),
        10.0,
        inputs={"P": torch.tensor([0.0, 0, 1])},
    )
    return critical.factor, torch.tensor(4.0126 * 0.5**0.5)


def own_weight() -> tuple[Tensor, Tensor]:
    column = tb.Beam.straight(1.0, N, section(), direction=(0, 0, 1), up=(1, 0, 0))
    return tb.critical_load(
        lambda q: tb.Scene(column, [tb.Gravity(along(2, -q))]), 20.0
    ).factor, torch.tensor(7.8373)


def twisted_ring(elements: int) -> tuple[Tensor, Tensor]:
    """A straight rod bent to a ring, its ends twisted and joined: twist GJ/EI in rad. One section
    is held, and the place across from it in the plane: a ring untwisted or not turns inside out
    freely.
    """
    GJ, R = 0.8, 1.0
    ring = tb.Beam.arc(R, 2 * math.pi, elements, section(GJ=GJ))
    held = tb.Support(0), tb.Support(elements // 2, "z", ""), tb.Support(-1)

    def twisted(twist: Tensor) -> tb.Scene:
        curvature = along(0, -twist / (2 * math.pi * R)) + along(2, torch.full_like(twist, -1 / R))
        return tb.Scene(ring, [tb.Actuation(curvature=curvature)], supports=held)

    critical = tb.critical_load(twisted, 19.0, points=8, count=3)
    return GJ * critical.factor, torch.tensor(2 * math.pi * math.sqrt(3))


def twisted_shaft(elements: int) -> tuple[Tensor, Tensor]:
    """M L/EI about the axis of a rod that is pulled by 5 EI/L^2, by nothing, and pushed: a ball
    joint at its foot, and one that slides along at its head. M keeps its direction at both ends;
    a spring at the foot, which bears nothing, holds the rigid turn about the axis.
    """
    rod, pull = tb.Beam.straight(1.0, elements, section(GJ=0.8)), torch.tensor([5.0, 0.0, -5.0])
    held = tb.Support(0, "xyz", ""), tb.Support(-1, "yz", "")

    def turned(x: Tensor, R: Tensor, v: Tensor, w: Tensor, t: Tensor) -> tuple[None, Tensor]:
        return None, along(0, R[..., 1, 2] - R[..., 2, 1])

    def twisted(M: Tensor) -> tb.Scene:
        ends = (
            tb.PointLoad(-1, force=along(0, pull), moment=along(0, M)),
            tb.PointLoad(0, moment=along(0, -M)),
            tb.Load(turned, node=0, of=("rotation",)),
        )
        return tb.Scene(rod, ends, supports=held)

    critical = tb.critical_load(twisted, 9.0, points=13, count=4)
    return critical.factor, 2 * (math.pi**2 + pull).sqrt()


def buckled() -> tuple[Tensor, Tensor]:
    """Timoshenko and Gere (1961), table 2.4: P/Pcr, and the tip's x, y over L; columns that lean by
    1e-6 of their load.
    """
    table = torch.tensor(
        [
            [1.063, 0.881, 0.422],
            [1.152, 0.741, 0.593],
            [1.293, 0.560, 0.719],
            [1.518, 0.349, 0.792],
            [1.884, 0.123, 0.803],
            [2.541, -0.107, 0.750],
            [4.029, -0.340, 0.625],
        ]
    )
    P = table[:, 0] * torch.pi**2 / 4
    load = tb.TipLoad(force=along(0, -P) + along(1, 1e-6 * P))
    tip = tb.equilibrium(
        cantilever(N, load, of=section(inertia=0.01)), branch="stable"
    ).tip.position
    return tip[:, :2], table[:, 1:]


def limit(path: tb.Path, node: int) -> Tensor:
    """The first largest factor, by a parabola over the node's descent through the highest point and
    its neighbours.
    """
    event = int((path.kind == LIMIT_POINT).nonzero()[0, 0])
    y, F = path.state.position[:, node, 1], path.factor
    k = event if F[event] > F[event - 1] else event - 1
    c = torch.linalg.solve(
        torch.stack((torch.ones(3), y[k - 1 : k + 2], y[k - 1 : k + 2] ** 2), -1), F[k - 1 : k + 2]
    )
    return c[0] - c[1] ** 2 / (4 * c[2])


def deep_arch(elements: int) -> tuple[Tensor, Tensor]:
    """An arch of 215 degrees, clamped at one foot and hinged at the other, P at its crown; P R^2/EI
    of snap-through.
    """
    lean = math.radians(107.5)
    arc = tb.Beam.arc(
        1.0, 2 * lean, elements, section(EA=1e6), direction=(math.cos(lean), math.sin(lean), 0),
        up=(0, 0, -1),
    )  # fmt: skip
    crown = tb.PointLoad(elements // 2, force=(0, -9.5, 0))
    scene = tb.Scene(
        arc, [crown], supports=(tb.Support(0), tb.Support(-1, "xyz", "xy")), plane="xy"
    )
    return 9.5 * limit(tb.path(scene, step=0.1, steps=20), elements // 2), torch.tensor(8.97)


def lee(each: int) -> tuple[Tensor, Tensor]:
    """Lee's frame: a column and a beam of 120, E A = 4320, E I = 1440, hinged at both ends, P down
    at 24 from the corner.
    """
    s = torch.linspace(0, 120, each + 1)
    top = torch.full((each,), 120.0)
    nodes = torch.stack(
        (torch.cat((0 * s, s[1:])), torch.cat((s, top)), torch.zeros(2 * each + 1)), -1
    )
    frame = tb.Beam.from_nodes(nodes, section(EA=4320.0, EI=1440.0, GJ=1e3))
    node, hinge = each + each // 5, [tb.Support(i, "xyz", "xy") for i in (0, -1)]
    scene = tb.Scene(frame, [tb.PointLoad(node, force=(0, -2.0, 0))], supports=hinge, plane="xy")
    return 2 * limit(tb.path(scene, step=0.1, steps=20), node), torch.tensor(1.8552)


def case(name: str, source: str, quantity: str, solve: Solve, bound: float, *more: Any) -> Case:
    return Case(name, source, quantity, f"{N} elements", solve, bound, *more)


# fmt: off
CASES = [
    case("column, dead load", "Euler", "P L^2/EI of buckling", euler, 4.5e-4),
    case("column under its own weight", "Greenhill 1881; Timoshenko and Gere 1961",
         "q L^3/EI of buckling", own_weight, 4.5e-4),
    case("ring of a twisted rod", "Michell 1889", "twist GJ/EI of buckling, 2 pi sqrt(3)",
         lambda: twisted_ring(N), 1.43e-2, ORDER, None, lambda: twisted_ring(N // 2)),
    Case("twisted rod, pulled and pushed, ball joints", "Greenhill 1883; Timoshenko and Gere 1961",
         "M L/EI of buckling, (M/2EI)^2 = P/EI + (pi/L)^2", "20 elements",
         lambda: twisted_shaft(20), 2e-3, ORDER, None, lambda: twisted_shaft(10)),
    case("strip on edge, tip load", "Timoshenko and Gere 1961",
         "P L^2/EI of lateral-torsional buckling, GJ = EI/2",
         sideways, 9e-4),
    case("column, tangential load", "Beck 1952, 1e-6", "P L^2/EI of flutter", beck_load, 4.1e-3),
    case("column, tangential load", "Beck 1952, 1e-6", "frequency of flutter", beck_frequency,
         3e-3),
    Case("column, tangential load, slight material damping", "Bolotin and Zhinzher 1969",
         "P L^2/EI of flutter", "16 elements",
         damped_beck, 6.5e-3, "the mesh's error and that of damping which is not vanishing"),
    case("buckled column, P to 4 times Euler's", "Timoshenko and Gere 1961, table 2.4",
         "tip x, y over L", buckled, 3.2e-3,
         "three digits; the mesh's critical load is 4e-4 high, and near it the tip moves 6 "
         "times as fast", 1.0),
    Case("deep arch, clamped and hinged, 215 degrees", "DaDeppo and Schmidt 1975",
         "P R^2/EI of snap-through", "64 elements",
         lambda: deep_arch(64), 4.6e-3),
    Case("Lee's frame", "Lee, Manuel and Rossow 1968", "load of snap-through", "40 elements",
         lambda: lee(20), 3.6e-3),
]
# fmt: on
