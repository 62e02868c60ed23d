"""Hard equilibria."""

from __future__ import annotations

import math

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.statics.continuation import LIMIT_POINT

from .build import cantilever, held, moved, section, tip_force, tip_moment, vector
from .case import Answer, Case

INF = math.inf


def end_moment(turns: float | None, elements: int):
    """Rolled up to a circle: the tip is at L sin(a)/a, L (1 - cos a)/a with a = M L/EI, to the
    mesh's error. Without `turns` the size is their number, of `elements` each.
    """

    def solve(p: Tensor, size: int) -> Answer:
        N, M = (elements, 2 * math.pi * turns) if turns else (elements * size, 2 * math.pi * size)
        state = tb.equilibrium(cantilever(p, N, tip_moment(p, 0, 0, M)), throw=False)
        a = M * p.detach()
        exact = torch.stack((a.sin() / a, (1 - a.cos()) / a, 0 * a), -1)
        return held(state, (state.tip.position - exact).norm(dim=-1))

    return solve


def roll_and_return(p: Tensor, turns: int) -> Answer:
    """Up and back, slowly and damped, in 40 steps a turn: the moment rises to 2 pi turns, falls to
    zero and stays there.
    """
    dt = 0.1
    T = dt * 40 * turns

    def moment(t: Tensor) -> Tensor:
        ramp = torch.where(t < 0.4 * T, t / (0.4 * T), (0.8 * T - t) / (0.4 * T)).clamp(0, 1)
        return vector(p, 0, 0, 2 * math.pi * turns) * ramp

    scene = cantilever(p, 4 * turns, tb.TipLoad(moment=moment), tb.Damping(0.5))
    t = torch.tensor([0.0, 0.4, 1.0], dtype=torch.float64).mul(T).to(p.dtype)
    sol = tb.simulate(scene, t, step=1.0001 * dt, initial=tb.rest(scene, (len(p),)))
    rolled = sol.tip.position[1].norm(dim=-1).detach() < 0.2
    back = (sol.nodes[-1] - scene.beam.nodes).norm(dim=-1).amax(-1).detach()
    return moved(sol, torch.where(rolled, back, torch.inf))


def helix(p: Tensor, turns: int) -> Answer:
    """Ibrahimbegovic (1997): an end moment rolls, a dead force out of the plane pulls the coil
    apart. L = 10, EA = GA = 1e4, EI = GJ = 100, F = 50 at M = 200 pi. Checked: the root's moment
    balances load and its lever.
    """
    share = turns / 10
    load = tb.TipLoad(
        force=vector(p, 0, 0, 50 * share), moment=vector(p, 0, 0, 200 * math.pi * share)
    )
    scene = cantilever(p, 8 * turns, load, L=10.0, EA=1e4, GA=1e4, GJ=100.0, EI=100.0)
    state = tb.equilibrium(scene, throw=False)
    force, lever = load.force.to(p), state.tip.position
    moment = load.moment.to(p) + torch.linalg.cross(lever, force)
    return held(state, ((state.root.moment + moment).norm(dim=-1) / moment.norm(dim=-1)).detach())


def buckled(P: float, imperfection: float):
    """A dead axial load of P EI/L^2 and an imperfection of that share across; the tip's angle a
    solves the elastica sqrt(P) = K(sin(a/2)), and the root moment is P w with w = 2
    sin(a/2)/sqrt(P). Checked: w.
    """

    def solve(p: Tensor, size: int) -> Answer:
        load = tip_force(p, -P, imperfection * P, 0)
        state = tb.equilibrium(
            cantilever(p, 16, load, EA=INF, GA=INF), throw=False, branch="stable"
        )
        w = torch.stack([2 * _modulus(x) / x.sqrt() for x in (P * p.detach().double())])
        return held(state, (state.tip.position[:, 1].detach() / w.to(p) - 1).abs())

    return solve


def _modulus(P: Tensor) -> Tensor:
    """k of sqrt(P) = K(k), by bisection; K = pi/2 / AGM(1, sqrt(1 - k^2))."""
    low, high = P.new_zeros(()), P.new_ones(())
    for _ in range(60):
        k = (low + high) / 2
        a, b = torch.ones_like(k), (1 - k**2).sqrt()
        for _ in range(8):
            a, b = (a + b) / 2, (a * b).sqrt()
        low, high = (k, high) if math.pi / 2 / a < P.sqrt() else (low, k)
    return k


def stiffness_ratio(p: Tensor, size: int) -> Answer:
    """EI about y and z 1e6 : 1 and GJ = 1, bent about both axes; about the stiff one at half of
    what buckles it sideways, 4.01 (EI GJ)^(1/2)/L^2: far beyond that there is more than one
    equilibrium.
    """
    scene = cantilever(p, 16, tip_force(p, 0, 2.0, 2.0), EI=(1e6, 1.0), EA=INF, GA=INF)
    state = tb.equilibrium(scene, throw=False)
    lever = torch.linalg.cross(state.tip.position, vector(p, 0, 2.0, 2.0))
    return held(state, ((state.root.moment + lever).norm(dim=-1) / lever.norm(dim=-1)).detach())


def snap_along_path(p: Tensor, each: int) -> Answer:
    """Lee's frame: a column and a beam of 120, hinged at both ends, pushed down at 24 from the
    corner. Lee, Manuel and Rossow (1968): it snaps at 1.8552 EI/L^2; the path falls, turns round
    and rises to twice that. Checked: the highest load before.
    """
    s = torch.linspace(0, 120, each + 1, dtype=p.dtype)
    corner = torch.stack(
        (
            torch.cat((0 * s, s[1:])),
            torch.cat((s, 0 * s[1:] + 120)),
            torch.zeros(2 * each + 1).to(s),
        ),
        -1,
    )
    frame = tb.Beam.from_nodes(corner, section(p, EA=4320.0, EI=1440.0, GJ=1e3))
    node, hinges = each + each // 5, [tb.Support(i, "xyz", "xy") for i in (0, -1)]
    push = tb.PointLoad(node, force=vector(p, 0, -4.0, 0))
    path = tb.path(
        tb.Scene(frame, [push], supports=hinges, plane="xy", dtype=p.dtype), step=0.1, steps=80
    )
    before = (path.kind == LIMIT_POINT).cumsum(0) == 0
    top = torch.where(before, path.factor, 0.0).amax(0) * 4 * p.detach()
    error = torch.where(path.reached, (top / 1.8552 - 1).abs(), torch.inf)
    return held(path.state[-1], error)._replace(value=path.state.position[-1, :, node])


# fmt: off
CASES = [
    Case("rotation of exactly pi", "the tip points back: rotation vectors have their cut here",
         "tip from the circle's", end_moment(0.5, 16), bound=2e-3),
    Case("rotation of exactly 2 pi", "the tip is back where it was, turned once",
         "tip from the circle's",
         end_moment(1.0, 16), bound=2e-3),
    Case("ten turns by an end moment", "20 pi between root and tip, a quarter turn an element",
         "tip from the circle's",
         end_moment(None, 4), bound=2e-3, size=(10, 4)),
    Case("ten turns and back", "rolled up and unrolled, slowly and damped",
         "node furthest from straight in the end",
         roll_and_return, bound=1e-2, size=(10, 4)),
    Case("ten turns out of plane", "a coil pulled apart by a dead force across it, M = 200 pi",
         "root moment less load and lever", helix, bound=1e-6, size=(10, 2)),
    Case("dead load past Euler's, statics",
         "P = 5 EI/L^2, twice the critical load, imperfection 1e-6: the straight beam is "
         "an equilibrium too", "deflection from the elastica's", buckled(5.0, 1e-6), bound=2e-2),
    Case("snap-through by `path`", "the load turns back twice on the way",
         "load at which Lee's frame snaps", snap_along_path,
         bound=2e-2, size=(20, 10),
         fails={"gradient": "`path` has no derivatives; `equilibrium` has"}),
    Case("bending stiffness ratio 1e6", "EI about y and z", "root moment less load and lever",
         stiffness_ratio, bound=1e-6),
]
# fmt: on
