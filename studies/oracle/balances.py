"""Balances of a motion: momentum, angular momentum and energy, by a quadrature of its own over what
nodes do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from .rod import E1, Case, Point, bodies, dot_, node_loads, support_pose, with_section
from .rotations import Array, cross, exponential, logarithm, turn


@dataclass(frozen=True)
class Motion:
    """What nodes do: t (T,) in equal steps from 0; r, v (T, n, 3), w (T, n, 3) absolute spin, all
    in frame a, R (T, n, 3, 3); reactions (T, k, 6) by support, the mean over the step before t.
    elements of order 1 or 2, equal.
    """

    case: Case
    t: Array
    r: Array
    R: Array
    v: Array
    w: Array
    reactions: Array
    order: int

    @property
    def x(self) -> Array:
        """(n,) places s/L of the nodes."""
        return np.linspace(0, 1, self.r.shape[1])

    def weights(self) -> Array:
        """(n,) m of the trapezoidal rule, of order 2 of Simpson's."""
        n = self.r.shape[1]
        weight = np.ones(n)
        if self.order == 2:
            weight[1::2], weight[2:-1:2] = 4, 2
            weight /= 3
        else:
            weight[0] = weight[-1] = 1 / 2
        return weight * self.case.rod.length / (n - 1)

    def points(self) -> Point:
        """All nodes at all instants, (T, n, .)."""
        v0, omega = self.case.frame()
        t = self.t[:, None]
        a = np.gradient(self.v, self.t, axis=0, edge_order=2) + cross(omega + 0 * self.v, self.v)
        alpha = np.gradient(self.w, self.t, axis=0, edge_order=2) + cross(
            omega + 0 * self.w, self.w
        )
        inertial = exponential(-t[..., None] * omega)
        moving = self.r, self.R, self.v, self.w, a, alpha
        support = partial(_support, self.case, t[:, 0])
        return Point(self.x, t, *moving, (v0, omega), inertial, support)

    def node(self, p: Point, x: float) -> Point:
        """One node of them, (T, .)."""
        i = round(x * (self.r.shape[1] - 1))
        return replace(
            p, x=np.asarray(x), t=p.t[:, 0], inertial=p.inertial[:, 0],
            **{name: getattr(p, name)[:, i] for name in ("r", "R", "v", "w", "a", "alpha")},
        )  # fmt: skip


def _support(case: Case, t: Array) -> tuple[Array, Array, Array, Array]:
    """Place, axes, velocity and spin (T, .) of what an elastic clamp hangs in; rates of it by
    differences.
    """
    v0, omega = case.frame()
    pose = [np.stack(z) for z in zip(*(support_pose(case, 0.0, now) for now in t), strict=True)]
    d = 1e-5 * t[-1]
    (r_1, R_1), (r_0, R_0) = (
        [np.stack(z) for z in zip(*(support_pose(case, 0.0, now + e) for now in t), strict=True)]
        for e in (d, -d)
    )
    spin = logarithm(R_1 @ np.swapaxes(R_0, -1, -2)) / (2 * d)
    return (
        pose[0],
        pose[1],
        (r_1 - r_0) / (2 * d) + v0 + cross(omega + 0 * r_0, pose[0]),
        spin + omega,
    )


def wrenches(motion: Motion) -> Iterator[tuple[Any, Array, Array, Array, Array, Array]]:
    """Of every load, on every node that it acts on: the effect, r, v, w, force and moment,
    (T, k, 3) each.
    """
    case, p = motion.case, motion.points()
    weight = motion.weights()[:, None]
    for effect in case.along():
        force, moment = effect.wrench(with_section(case, p))
        yield effect, p.r, p.v, p.w, weight * force, weight * moment
    for x in case.breaks:
        here = motion.node(p, x)
        for effect, body in node_loads(case, x):
            force, moment = effect.wrench(here if body is None else _with(here, body))
            yield (effect, *(z[:, None] for z in (here.r, here.v, here.w, force, moment)))


def _with(p: Point, body: Any) -> Point:
    mass, centre, inertia = body.body()
    return p.carrying(np.full(p.r.shape[:-1], mass), centre, inertia)


def carriers(motion: Motion) -> Iterator[tuple[Point, Array]]:
    """What has mass: points and how much of each."""
    p = motion.points()
    yield with_section(motion.case, p), motion.weights()
    for x in motion.case.breaks:
        for body in bodies(motion.case, x):
            carrier = _with(motion.node(p, x), body)
            yield carrier, np.ones(())


def momenta(motion: Motion) -> tuple[Array, Array, Array]:
    """Linear and angular momentum (T, 3) about the origin of frame a, in its axes, and kinetic
    energy (T,).
    """
    P = H = T = 0.0
    for p, weight in carriers(motion):
        linear, angular = p.momentum()
        angular, energy = cross(p.r, linear) + angular, p.kinetic()
        if weight.ndim:
            linear, angular = (weight[:, None] * linear).sum(1), (weight[:, None] * angular).sum(1)
            energy = energy @ weight
        P, H, T = P + linear, H + angular, T + energy
    return P, H, T


def strains(motion: Motion) -> Array:
    """(T, n - 1, 6) from node to node, less those at rest: of the chord, in the axes half way, and
    of the turn.
    """

    def of(r: Array, R: Array) -> Array:
        h = motion.case.rod.length / (r.shape[-2] - 1)
        phi = logarithm(np.swapaxes(R[..., :-1, :, :], -1, -2) @ R[..., 1:, :, :])
        middle = R[..., :-1, :, :] @ exponential(phi / 2)
        chord = turn(np.swapaxes(middle, -1, -2), np.diff(r, axis=-2)) / h
        return np.concatenate((chord - E1, phi / h), -1)

    return of(motion.r, motion.R) - of(*motion.case.rod.rest(motion.x))


def balances(motion: Motion) -> dict[str, Array]:
    """What is left of each balance since t = 0, over the largest term in it: (T, 3) of momentum and
    of angular momentum about the origin, (T,) of energy. And "work" (T,) J, done by loads and
    moving supports, "kinetic" and "strain" (T,) J.

        P - P(0) + int omega x P = int forces
        H - H(0) + int (omega x H + v0 x P) = int moments
        T + U - (T + U)(0)
            = int (power of loads and supports - dissipation - stress . rate of the eigenstrain)
    """
    case, t = motion.case, motion.t
    v0, omega = (z + np.zeros((len(t), 3)) for z in case.frame())
    P, H, T = momenta(motion)
    force, moment, power = np.zeros_like(P), np.zeros_like(P), np.zeros_like(T)
    for _, r, v, w, f, m in wrenches(motion):
        force, moment = force + f.sum(1), moment + (m + cross(r, f)).sum(1)
        power = power + (dot_(f, v) + dot_(m, w)).sum(1)
    held = [
        round(x * (motion.r.shape[1] - 1)) for x, s in sorted(case.supports.items()) if s.held.any()
    ]
    push, couple = motion.reactions[1:, :, :3], motion.reactions[1:, :, 3:]
    r, v, w = (_means(z[:, held]) for z in (motion.r, motion.v, motion.w))
    impulse = _sum(t, force) + _steps(t, push.sum(1))
    twist = _sum(t, moment) + _steps(t, (couple + cross(r, push)).sum(1))
    work = _sum(t, power) + _steps(t, (dot_(push, v) + dot_(couple, w)).sum(1))
    strain, dissipated, driven = _elastic(motion)
    linear = P - P[0] + _sum(t, cross(omega, P)) - impulse
    angular = H - H[0] + _sum(t, cross(omega, H) + cross(v0, P)) - twist
    energy = T + strain - (T + strain)[0] - work + dissipated - driven
    size = [
        max(np.abs(z).max() for z in terms)
        for terms in (
            (P, _sum(t, cross(omega, P)), impulse),
            (H, _sum(t, cross(omega, H)), twist),
            (T - T[0], strain - strain[0], work),
        )
    ]
    left = (z / s for z, s in zip((linear, angular, energy), size, strict=True))
    return {
        **dict(zip(("momentum", "angular momentum", "energy"), left, strict=True)),
        "size": np.array(size[2]), "work": work, "kinetic": T, "strain": strain,
    }  # fmt: skip


def _elastic(motion: Motion) -> tuple[Array, Array, Array]:
    """(T,) J: strain energy, what damping and arms that forget have dissipated, and what a change
    of the eigenstrain has brought in.
    """
    case, t = motion.case, motion.t
    flexible = case.rod.S.diagonal() > 0
    K = np.zeros((6, 6))
    K[np.ix_(flexible, flexible)] = np.linalg.inv(case.rod.S[np.ix_(flexible, flexible)])
    middle = (motion.x[1:] + motion.x[:-1]) / 2
    K = case.rod.thinned(middle)[:, None, None] * K
    h = case.rod.length / len(middle)
    own = np.stack([case.eigenstrain(now) for now in t])[:, None, :]
    total = strains(motion)
    elastic, (shares, times) = total - own, case.arms()
    lags = [elastic - _crept(t, elastic, tau) for tau in times.T]
    stress = turn(K, (1 - shares.sum(-1)) * elastic)
    strain = h * dot_(elastic, stress).sum(1) / 2
    dissipated = np.zeros_like(t)
    for share, time, lag in zip(shares.T, times.T, lags, strict=True):
        own_stress = turn(K, share * lag)
        stress, strain = stress + own_stress, strain + h * dot_(lag, own_stress).sum(1) / 2
        dissipated = dissipated + _sum(t, h * dot_(lag / time, own_stress).sum(1))
    change = -h * (_means(stress) * np.diff(own, axis=0)).sum((1, 2))
    tau, zero = case.damping(), np.zeros(1)
    if tau is not None:
        T = np.diag(np.sqrt(tau))
        step = np.diff(total, axis=0)
        dissipated = dissipated + np.concatenate(
            (zero, np.cumsum(h * dot_(step, turn(T @ K @ T, step)).sum(1) / np.diff(t)))
        )
    return strain, dissipated, np.concatenate((zero, np.cumsum(change)))


def _crept(t: Array, strain: Array, time: Array) -> Array:
    """q (T, n, 6) of time q' = strain - q, at rest at t = 0, by the trapezoidal rule."""
    crept = [strain[0]]
    for h, before, after in zip(np.diff(t), strain, strain[1:], strict=False):
        half = h / (2 * time)
        crept.append(((1 - half) * crept[-1] + half * (before + after)) / (1 + half))
    return np.stack(crept)


def _means(x: Array) -> Array:
    return (x[1:] + x[:-1]) / 2


def _steps(t: Array, rate: Array) -> Array:
    """Running integral (T, ...) of what is constant over each step (T - 1, ...)."""
    dt = np.diff(t).reshape(-1, *[1] * (rate.ndim - 1))
    return np.concatenate((np.zeros((1, *rate.shape[1:])), np.cumsum(dt * rate, 0)))


def _sum(t: Array, rate: Array) -> Array:
    """Running integral (T, ...) by the trapezoidal rule."""
    return _steps(t, _means(rate))
