"""Equilibria of a rod: the Cosserat equations as a boundary value problem of ordinary differential
equations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .rod import Case, at_node, carried, rates, strain, support_pose
from .rotations import Array, cross, dot, matrix, quaternion, quaternion_rate

# shares of what acts, one after the other
WAYS_UP = (0.5, 1.0), (0.2, 0.4, 0.6, 0.8, 1.0), tuple(np.linspace(0.05, 1, 20))
# relative residual of the last and of those before; the solution's error is a tenth
TOLERANCE, COARSE = 1e-7, 1e-3
NODES = 20_000


class NotFound(RuntimeError):
    """The boundary value problem was not solved."""


@dataclass(frozen=True)
class Equilibrium:
    """Functions of x = s/L (...): position (..., 3), axes (..., 3, 3), force and moment (..., 3) on
    the cut, frame a.

    A place where something acts belongs to the part before it, `after` to that behind.
    """

    case: Case
    part: Callable[[int, Array], Array]

    def at(self, x: Array | float, after: bool = False) -> tuple[Array, Array, Array, Array]:
        x = np.asarray(x, dtype=float)
        breaks = np.array(self.case.breaks)
        which = np.clip(
            np.searchsorted(breaks, x, "right" if after else "left") - 1, 0, len(breaks) - 2
        )
        y = np.empty((*x.shape, 13))
        for k in range(len(breaks) - 1):
            y[which == k] = self.part(k, (x[which == k] - breaks[k]) / (breaks[k + 1] - breaks[k]))
        return y[..., :3], matrix(y[..., 3:7]), y[..., 7:10], y[..., 10:]

    def reaction(self, x: float) -> Array:
        """(6,) load of the support at the end x = 0 or 1 on the rod, frame a."""
        r, R, n, m = self.at(x)
        loads = at_node(self.case, x, carried(self.case, x, r, R))
        sign = -1 if x == 0 else 1
        return np.concatenate([sign * y - load for y, load in zip((n, m), loads, strict=True)])


def equilibrium(case: Case) -> Equilibrium:
    """The equilibrium at t = 0, steady in frame a, that the rod comes to as the loads grow from
    nothing.

    Unknowns are position, quaternion, force and moment of each part between two points where
    something acts, over lengths, and the part's share of the length; forces over EI/L^2. Raises
    NotFound where a share of the loads has none.
    """
    from scipy.integrate import solve_bvp

    rod, breaks = case.rod, np.array(case.breaks)
    span = np.diff(breaks)
    F0 = 1 / (rod.S.diagonal()[3:].max() * rod.length**2)
    unit = np.array([rod.length] * 3 + [1.0] * 4 + [F0] * 3 + [F0 * rod.length] * 3)

    def slopes(share: float) -> Callable[[Array, Array], Array]:
        def rate(xi: Array, y: Array) -> Array:
            parts = []
            for k, h in enumerate(span):
                r, q, n, m = np.split(unit * y[13 * k : 13 * k + 13].T, (3, 7, 10), axis=-1)
                R, x = matrix(q), breaks[k] + h * xi
                p = carried(case, x, r, R, share)
                own = strain(case, p, n, m, share)
                r_s, kappa, n_s, m_s = rates(case, p, own, n, share)
                parts.append(
                    h
                    * rod.length
                    * np.concatenate((r_s, quaternion_rate(q, kappa), n_s, m_s), -1)
                    / unit
                )
            return np.concatenate(parts, -1).T

        return rate

    def conditions(share: float) -> Callable[[Array, Array], Array]:
        def gaps(first: Array, last: Array) -> Array:
            first, last = (unit * y.reshape(-1, 13) for y in (first, last))
            gaps_at_ends = [
                _end(case, 0.0, share, first[0], -1.0, unit),
                [dot(first[0, 3:7], first[0, 3:7])[0] - 1],
                _end(case, 1.0, share, last[-1], 1.0, unit),
            ]
            for x, before, after in zip(breaks[1:-1], last, first[1:], strict=False):
                p = carried(case, x, before[:3], matrix(before[3:7]), share)
                jump = np.concatenate((np.zeros(7), *at_node(case, x, p, share)))
                gaps_at_ends.append((after - before + jump) / unit)
            return np.concatenate(gaps_at_ends)

        return gaps

    r, R = rod.rest(breaks[:-1, None] + span[:, None] * np.linspace(0, 1, 11))
    q = quaternion(R)
    for k in range(1, q.shape[1]):  # one sign along the rod
        q[:, k] *= np.sign((q[:, k] * q[:, k - 1]).sum(-1, keepdims=True))
    for k in range(1, len(q)):
        q[k] *= np.sign(q[k, 0] @ q[k - 1, -1])
    y = (
        np.concatenate((r / rod.length, q, np.zeros((*r.shape[:-1], 6))), -1)
        .swapaxes(-1, -2)
        .reshape(-1, r.shape[1])
    )
    for shares in WAYS_UP:
        xi, guess = np.linspace(0, 1, 11), y
        for share in shares:
            last = share == shares[-1]
            solution = solve_bvp(
                slopes(share), conditions(share), xi, guess, tol=TOLERANCE if last else COARSE,
                max_nodes=NODES,
            )  # fmt: skip
            if not solution.success:
                break
            xi = np.linspace(0, 1, 21)
            guess = solution.sol(xi)
        if solution.success:
            break
    else:
        raise NotFound(f"no equilibrium under {share:g} of the loads: {solution.message}")

    def part(k: int, at: Array) -> Array:
        return unit * solution.sol(at)[13 * k : 13 * k + 13].T

    return Equilibrium(case, part)


def _end(case: Case, x: float, share: float, y: Array, outward: float, unit: Array) -> Array:
    """Six conditions of an end: held components of place and rotation, balances of the others."""
    r, R = y[:3], matrix(y[3:7])
    place, axes = support_pose(case, x, share=share)
    loads = np.concatenate(at_node(case, x, carried(case, x, r, R, share), share))
    balance = (outward * y[7:] - loads) / unit[7:]
    held = case.supports[x].held if x in case.supports else np.zeros(6, dtype=bool)
    turned = R @ axes.T  # from the support's axes, frame a
    away = (
        np.array(
            [turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]
        )
        / 2
    )
    if held[3:].sum() == 2:  # about the third axis alone: that one stays where it is
        free = np.flatnonzero(~held[3:])[0]
        away = cross(np.eye(3)[free], turned[:, free])
    return np.where(held, np.concatenate(((r - place) / unit[0], away)), balance)
