"""Equilibria against closed forms, converged solutions and published figures."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb

from .build import along, cantilever, section
from .case import ORDER, Case, columns, reference

PRINTED = "half of the last digit that was printed, and the mesh's error"


@dataclass(frozen=True)
class Tips:
    """Tips of a cantilever, an entry of a stored table a sample: columns of the table; scene (N,
    *columns); wanted (*columns), the tip's two coordinates over L, of these axes.
    """

    table: str
    columns: tuple[str, ...]
    scene: Callable[..., tb.Scene]
    wanted: Callable[..., tuple[Tensor, Tensor]] = lambda load, x, y: (x, y)
    axes: tuple[int, int] = (0, 2)

    def __call__(self, N: int, **options: Any) -> tuple[Tensor, Tensor]:
        values = columns(reference(self.table)["values"], *self.columns)
        tip = tb.equilibrium(self.scene(N, *values, **options)).tip.position
        return tip[:, self.axes], torch.stack(self.wanted(*values), -1)


PLACES = "x_tip_over_L", "y_tip_over_L"
dead = Tips(
    "elastica_dead_tip_load",
    ("alpha", "u_over_L", "w_over_L"),
    lambda N, a, *_, **order: cantilever(N, tb.TipLoad(force=along(2, a)), **order),
    lambda a, u, w: (1 - u, w),
)
follower = Tips(
    "elastica_follower_tip_load",
    ("alpha", *PLACES),
    lambda N, a, *_, **order: cantilever(N, tb.TipLoad(force=along(2, a), follower=True), **order),
)
roll_up = Tips(
    "end_moment_rollup",
    ("lam", *PLACES),
    lambda N, lam, *_, **order: cantilever(
        N, tb.TipLoad(moment=along(2, math.pi * lam)), of=section(1e3, 5e2), **order
    ),
    axes=(0, 1),
)
heavy = Tips(
    "heavy_elastica",
    ("beta", "u_over_L", "w_over_L"),
    lambda N, beta, *_, **order: cantilever(
        N, tb.Gravity((0, 0, -1.0)), of=section(mass=beta), **order
    ),
    lambda beta, u, w: (1 - u, -w),
)
reissner = Tips(
    "reissner_cantilever",
    ("P", "EA", "GA", "x_tip", "y_tip"),
    lambda N, P, EA, GA, *_: cantilever(N, tb.TipLoad(force=along(2, P)), of=section(EA, GA)),
    lambda P, EA, GA, x, y: (x, y),
)


def dead_gradient(N: int) -> tuple[Tensor, Tensor]:
    alpha, du, dw = columns(
        reference("elastica_dead_tip_load")["values"], "alpha", "du_dalpha", "dw_dalpha"
    )
    with torch.enable_grad():
        _, slope = torch.func.jvp(
            lambda a: tb.equilibrium(cantilever(N, tb.TipLoad(force=along(2, a)))).tip.position,
            (alpha,),
            (torch.ones_like(alpha),),
        )
    return slope[:, ::2], torch.stack((-du, dw), -1)


def mattiasson(N: int) -> tuple[Tensor, Tensor]:
    """Mattiasson (1981), table 1, five digits: P L^2/EI = 1 and 10: u, w over L and the tip's
    angle.
    """
    printed = torch.tensor([[0.05643, 0.30172, 0.46135], [0.55500, 0.81061, 1.43029]])
    tip = tb.equilibrium(cantilever(N, tb.TipLoad(force=along(2, torch.tensor([1.0, 10.0]))))).tip
    angle = torch.atan2(tip.rotation[..., 2, 0], tip.rotation[..., 0, 0])
    return torch.stack((1 - tip.position[..., 0], tip.position[..., 2], angle), -1), printed


def bend(N: int, P: float) -> tb.State:
    """Bathe and Bolourchi's: an arc of 45 degrees and 100 in, 1 in square, E = 1e7 psi, nu = 0,
    GJ = E/12 as they took it.
    """
    square = section(EA=1e7, GA=5e6, GJ=1e7 / 12, EI=1e7 / 12)
    arc = tb.Beam.arc(100.0, math.pi / 4, N, square, direction=(0, 1, 0), up=(0, 0, -1))
    return tb.equilibrium(tb.Scene(arc, [tb.TipLoad(force=(0, 0, P))]))


def bend_tip(N: int) -> tuple[Tensor, Tensor]:
    (at,) = reference("bend_45deg")["expected"]
    return bend(N, at["P_lb"]).tip.position, torch.tensor(at["tip_position"])


def bend_moment(N: int) -> tuple[Tensor, Tensor]:
    (at,) = reference("bend_45deg")["expected"]
    return bend(N, at["P_lb"]).root.moment, -torch.tensor(at["root_moment"])


def bend_published(N: int) -> tuple[Tensor, Tensor]:
    """Simo and Vu-Quoc (1986), tip at 300, 450 and 600 lb; their axes: first that to the arc's
    side, second along its start.
    """
    printed = torch.tensor([[22.33, 58.84, 40.08], [18.62, 52.32, 48.39], [15.79, 47.23, 53.37]])
    return torch.stack([bend(N, P).tip.position for P in (300.0, 450.0, 600.0)]), printed


def bend_gxbeam(N: int) -> tuple[Tensor, Tensor]:
    moved = torch.tensor(reference("bend_45deg")["gxbeam_displacement_by_elements"][str(N)])
    start = torch.tensor([1 - math.cos(math.pi / 4), math.sin(math.pi / 4), 0]) * 100
    return bend(N, 600.0).tip.position - start, moved


def case(name: str, source: str, quantity: str, solve: Callable, N: int, bound: float,
         why: str = ORDER, scale: float = 1.0) -> Case:  # fmt: skip
    coarse = (lambda: solve(N // 2)) if why == ORDER else None
    mesh = f"{N} elements"
    return Case(name, source, quantity, mesh, lambda: solve(N), bound, why, scale, coarse)


# fmt: off
CASES = [
    case("elastica, dead tip load, P L^2/EI to 12", "elliptic integrals, 1e-11", "tip x, z over L",
         dead, 32, 1.16e-4),
    case("the same, derivative by the load", "elliptic integrals, 1e-11",
         "d(tip)/d(P L^2/EI) over L", dead_gradient, 32, 9e-5),
    case("elastica, dead tip load, P L^2/EI = 1, 10", "Mattiasson 1981, table 1",
         "u, w over L, angle", mattiasson, 64, 1e-4,
         PRINTED),
    case("elastica, follower tip load, P L^2/EI to 16",
         "elliptic integrals, 1e-11 (Argyris and Symeonidis 1981)",
         "tip x, z over L", follower, 32, 1.81e-3),
    case("rolled up by an end moment, to a full circle", "closed form", "tip x, y over L", roll_up,
         32, 2.9e-4),
    case("elastica under its own weight, q L^3/EI to 10",
         "boundary value problem, 1e-9 (Rohde 1953)", "tip x, z over L",
         heavy, 32, 4.8e-5),
    case("with shear and extension, P L^2/EI to 10", "boundary value problem, 1e-9 (Reissner 1972)",
         "tip x, z over L",
         reissner, 32, 1.07e-4),
    case("45 degree bend, 300 lb", "boundary value problem, 1e-6 (Bathe and Bolourchi 1979)",
         "tip x, y, z over R", bend_tip,
         32, 6.3e-5, scale=100.0),
    case("45 degree bend, 300 lb", "boundary value problem, 1e-6", "root moment over P R",
         bend_moment, 32, 5e-5, scale=3e4),
    case("45 degree bend, 300, 450, 600 lb", "Simo and Vu-Quoc 1986 (8 straight elements)",
         "tip x, y, z over R",
         bend_published, 32, 1.2e-3, "their mesh of eight linear elements", scale=100.0),
    case("45 degree bend, 600 lb", "GXBeam.jl, 64 elements", "tip displacement over R", bend_gxbeam,
         64, 1.1e-5,
         "both are 6e-5 R from their common limit", scale=100.0),
]
# fmt: on
