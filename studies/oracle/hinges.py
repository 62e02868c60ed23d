"""A wheel on a hinge that remembers: the differential equations of its law, by SciPy.

    J q'' = sum of size sin(rate t) - M(q, memory)

A wheel that yields goes from one corner to the next: elastic until the yield surface is reached,
plastic until it stops. There M' = k H/(k + H) q', of which the share p' = k/(k + H) q' is plastic
(Lubliner 2008, section 1.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .rotations import Array

EXACT = dict(rtol=1e-11, atol=1e-13, method="DOP853")
MOST = 1000  # corners


@dataclass(frozen=True)
class ElastoPlastic:
    """M = k (q - p); it yields where |M - share H p| = M_y + (1 - share) H kappa, kappa being the
    sum of all |dp|; M_y kappa is lost.
    """

    stiffness: float
    yield_moment: float
    hardening: float
    kinematic: float

    def room(self, q: float, p: float, kappa: float, side: float) -> float:
        """Moment up to the yield surface of a side."""
        H, share = self.hardening, self.kinematic
        effective = self.stiffness * (q - p) - share * H * p
        return self.yield_moment + (1 - share) * H * kappa - side * effective

    def motion(self, wheel: Wheel, t: Array) -> Array:
        from scipy.integrate import solve_ivp

        now, y, side = t[0], np.zeros(4), 0.0  # q, q', p, kappa; side: 0 = elastic
        rows = [y]
        flow = self.stiffness / (self.stiffness + self.hardening)
        for _ in range(MOST):

            def rate(s: float, y: Array, side: float = side) -> list[float]:
                a = wheel.acceleration(s, self.stiffness * (y[0] - y[2]))
                return [y[1], a, (side != 0) * flow * y[1], flow * side * y[1]]

            if side:
                ends = [lambda s, y, side=side: side * y[1]]
            else:
                ends = [lambda s, y, to=to: self.room(y[0], y[2], y[3], to) for to in (1.0, -1.0)]
            for end in ends:
                end.terminal, end.direction = True, -1
            part = solve_ivp(rate, (now, t[-1]), y, events=ends, dense_output=True, **EXACT)
            inside = t[(t > now) & (t <= part.t[-1])]
            rows += list(part.sol(inside).T) if len(inside) else []
            now, y = part.t[-1], part.y[:, -1]
            if part.status == 0:
                break
            side = 0.0 if side else (1.0 if len(part.t_events[0]) else -1.0)
        q, v, p, kappa = np.stack(rows).T
        return np.stack((q, v, p, self.yield_moment * kappa), -1)


@dataclass(frozen=True)
class BoucWen:
    """M = r k q + (1 - r) M_y z, z' = k/M_y (q' - beta |q'| |z|^(n-1) z - gamma q' |z|^n)."""

    stiffness: float
    yield_moment: float
    ratio: float
    n: float
    beta: float
    gamma: float

    def motion(self, wheel: Wheel, t: Array) -> Array:
        from scipy.integrate import solve_ivp

        k, r, rest = self.stiffness, self.ratio, (1 - self.ratio) * self.yield_moment

        def rate(s: float, y: Array) -> list[float]:
            q, v, z, _ = y
            size = abs(z) ** self.n
            fall = self.beta * abs(v) * np.sign(z) * size + self.gamma * v * size
            a = wheel.acceleration(s, r * k * q + rest * z)
            return [v, a, k / self.yield_moment * (v - fall), rest * z * fall]

        found = solve_ivp(rate, (t[0], t[-1]), np.zeros(4), t_eval=t, max_step=0.01, **EXACT)
        return found.y.T


@dataclass(frozen=True)
class Wheel:
    """inertia kg m^2; sizes N m and rates rad/s of what drives it."""

    inertia: float
    sizes: Array
    rates: Array
    law: Any

    def acceleration(self, t: float, moment: float) -> float:
        return float((self.sizes * np.sin(self.rates * t)).sum() - moment) / self.inertia

    def motion(self, t: Array) -> Array:
        """(T, 4): q, q', p or z, and the energy lost, at the instants t, from rest at t = 0."""
        return self.law.motion(self, t)


LAWS = {law.__name__: law for law in (ElastoPlastic, BoucWen)}


def draw(random: np.random.Generator, number: int) -> Wheel:
    """A random wheel, of both laws in turn."""
    k, M = random.uniform(50, 200), random.uniform(1, 3)
    if number % 2:
        beta = random.uniform(0.3, 0.8)
        more = random.uniform(0, 0.3), random.uniform(1, 4), beta, beta * random.uniform(-0.5, 1)
        law: Any = BoucWen(k, M, *more)
    else:
        law = ElastoPlastic(k, M, *(random.uniform(0, x) for x in (0.3 * k, 1)))
    return Wheel(
        random.uniform(0.1, 0.4), M * random.uniform(0.6, 1.2, 2), random.uniform(2, 8, 2), law
    )
