"""Effects as the oracle has them, a row each: the force and the moment on a point, from what the
documentation says.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .rod import Point, Value
from .rotations import Array, back, cross, dot, length, logarithm, skew, turn


class OracleEffect:
    """kind: load, body, damping, memory or eigenstrain.  at: its place x = s/L, None = along the
    rod.  on_mass: it acts on whatever has mass, bodies too.  holds: it is a support's part.
    """

    kind = "load"
    at: float | None = None
    on_mass = False
    holds = False


@dataclass(frozen=True)
class LineLoad(OracleEffect):
    """Force and moment per length, dead (of frame a) or following the section."""

    force: Value | None = None
    moment: Value | None = None
    follower: bool = False

    def wrench(self, p: Point) -> tuple[Array, Array]:
        zero = np.zeros_like(p.r)
        given = [zero if v is None else v(p.x, p.t) + zero for v in (self.force, self.moment)]
        return tuple(turn(p.R, v) for v in given) if self.follower else tuple(given)


@dataclass(frozen=True)
class PointLoad(LineLoad):
    """Force and moment on a point."""

    at: float = 1.0


@dataclass(frozen=True)
class TipLoad(PointLoad):
    """On the tip."""


@dataclass(frozen=True)
class Gravity(OracleEffect):
    """Weight: m g at the centre of mass, g of inertial axes."""

    g: Array
    on_mass = True

    def wrench(self, p: Point) -> tuple[Array, Array]:
        force = p.mass * turn(p.inertial, self.g)
        return force, cross(turn(p.R, p.centre), force)


@dataclass(frozen=True)
class MassDamping(OracleEffect):
    """-alpha times the momenta."""

    alpha: float
    on_mass = True

    def wrench(self, p: Point) -> tuple[Array, Array]:
        return tuple(-self.alpha * x for x in p.momentum())


@dataclass(frozen=True)
class Drag(OracleEffect):
    """Morison's equation: pressure across the axis, friction along it, and the mass of the fluid
    across.
    """

    density: float
    diameter: float
    normal: float
    tangential: float
    flow: Array
    added_mass: float = 0.0

    def wrench(self, p: Point) -> tuple[Array, Array]:
        axis, v = p.R[..., 0], p.v - turn(p.inertial, self.flow)
        u = dot(v, axis)
        across, a = v - u * axis, p.a - dot(p.a, axis) * axis
        pressure = self.density * self.diameter / 2
        force = -pressure * (
            self.normal * length(across) * across
            + np.pi * self.tangential * np.sqrt(u * u) * u * axis
        )
        fluid = self.added_mass * self.density * np.pi * self.diameter**2 / 4
        return force - fluid * a, np.zeros_like(force)


@dataclass(frozen=True)
class StripAir(OracleEffect):
    """A flat plate in air without a wake that lasts: by the circulation that lets the air leave its
    edge, and by the impulse of the air that moves along, in the plate's axes.
    """

    density: float
    chord: float
    axis: float
    slope: float
    wind: Array
    apparent: bool

    def wrench(self, p: Point) -> tuple[Array, Array]:
        b, ahead = self.chord / 2, (2 * self.axis - 1) * self.chord / 2  # y of mid-chord
        wind = turn(p.inertial, self.wind)

        def of(k: int, v: Array) -> Array:
            return dot(p.R[..., k], v)

        def velocity(y: float) -> Array:  # of the plate against the air
            return p.v - wind + y * cross(p.w, p.R[..., 1])

        U, spin = of(1, p.v - wind), of(0, p.w)
        w = -of(2, velocity(ahead - b / 2))  # at three quarters of the chord
        circulation = self.slope * b * w
        normal = self.density * circulation * U
        suction = self.density * self.slope * b * of(2, velocity(ahead)) ** 2
        moment = normal * (ahead + b / 2) - np.pi / 2 * self.density * b**3 * U * spin
        if self.apparent:
            fluid, arm = np.pi * self.density * b**2, ahead * p.R[..., 1]
            change = p.a + cross(p.alpha, arm) + cross(p.w, cross(p.w, arm))
            # the rate of a velocity's part along z, which turns
            change = of(2, change) + dot(cross(p.w, p.R[..., 2]), velocity(ahead))
            normal = normal - fluid * change
            moment = moment - fluid * (ahead * change + b**2 / 8 * of(0, p.alpha))
        force = suction * p.R[..., 1] + normal * p.R[..., 2]
        return force, moment * p.R[..., 0]


@dataclass(frozen=True)
class PointMass(OracleEffect):
    """A rigid body; inertia about its own centre, `offset` of that from the node, section axes."""

    mass: float
    inertia: Array
    offset: Array
    at: float = 1.0
    kind = "body"

    def body(self) -> tuple[float, Array, Array]:
        """Mass, centre, inertia about the node."""
        return (
            self.mass,
            self.offset,
            self.inertia - self.mass * skew(self.offset) @ skew(self.offset),
        )


@dataclass(frozen=True)
class Spring(OracleEffect):
    """A tie to a point of frame a: linear where its length is None."""

    stiffness: float
    to: Array
    free_length: float | None
    damping: float
    at: float = 1.0

    def wrench(self, p: Point) -> tuple[Array, Array]:
        d = p.r - self.to
        v0, omega = p.frame
        rate = p.v - v0 - cross(omega, p.r)
        if self.free_length is None:
            force = -self.stiffness * d - self.damping * rate
        else:
            n = d / length(d)
            force = (
                -(self.stiffness * (length(d) - self.free_length) + self.damping * dot(n, rate)) * n
            )
        return force, np.zeros_like(force)


@dataclass(frozen=True)
class RootSpring(OracleEffect):
    """An elastic clamp: -k d and -T^-T k phi, with the displacement and the rotation vector of node
    0 in the support's axes; T^-T = I + ~phi/2 + (1 - |phi|/2 cot(|phi|/2))/|phi|^2 ~phi ~phi.
    Dampers act on the motion relative to the support.
    """

    stiffness: Array
    damping: Array
    at: float = 0.0
    holds = True

    def wrench(self, p: Point) -> tuple[Array, Array]:
        place, axes, velocity, spin = p.support()
        arm = p.r - place
        phi = logarithm(np.swapaxes(axes, -1, -2) @ p.R)
        square = dot(phi, phi)
        small = np.abs(square) < 1e-4
        half = np.sqrt(np.where(small, 1.0, square)) / 2
        c = np.where(
            small,
            1 / 12 + square / 720 + square**2 / 30240,
            (1 - half / np.tan(half)) / (4 * half**2),
        )
        couple, K = self.stiffness[3:] * phi, skew(phi)
        couple = couple + turn(K, couple) / 2 + c * turn(K, turn(K, couple))
        force = self.stiffness[:3] * back(axes, arm) + self.damping[:3] * back(
            axes, p.v - velocity - cross(spin, arm)
        )
        return -turn(axes, force), -turn(axes, couple + self.damping[3:] * back(axes, p.w - spin))


@dataclass(frozen=True)
class Contact(OracleEffect):
    """A ball that stands in frame a pushes the rod's surface, at the radius `own` about its axis,
    per length: force (y/d)^2 by y of the thickness d, force (2 y/d - 1) where surfaces overlap.
    """

    centre: Array
    radius: float
    own: float
    thickness: float
    force: float

    def wrench(self, p: Point) -> tuple[Array, Array]:
        d = p.r - self.centre
        y = 1 - (length(d) - self.radius - self.own) / self.thickness
        pressure = np.where(y.real < 1, y * y, 2 * y - 1) * (y.real > 0)
        force = self.force * pressure * d / length(d)
        return force, np.zeros_like(force)


@dataclass(frozen=True)
class Actuation(OracleEffect):
    """Strain and curvature of the unloaded rod."""

    curvature: Value
    strain: Value
    kind = "eigenstrain"

    def eigenstrain(self, t: Array | float) -> Array:
        return np.concatenate((self.strain(0.0, t), self.curvature(0.0, t)), -1)


@dataclass(frozen=True)
class Damping(OracleEffect):
    """Stress by strain rate, D^1/2 S^-1 D^1/2 of it, D = diag(tau)."""

    tau: Array
    kind = "damping"


@dataclass(frozen=True)
class Viscoelastic(OracleEffect):
    """Stress that forgets: S [F; M] = e - sum of share q with time q' = e - q; (6, m), of each
    strain and arm.
    """

    shares: Array
    times: Array
    kind = "memory"


@dataclass(frozen=True)
class Load(OracleEffect):
    """A law of the motion: force -k (r - to) - c |v|^2 v + push R e_y, moment -d w + twist x
    (R e_z).
    """

    k: float
    to: Array
    c: float
    push: float
    d: float
    twist: Array
    at: float | None = None

    def wrench(self, p: Point) -> tuple[Array, Array]:
        force = -self.k * (p.r - self.to) - self.c * dot(p.v, p.v) * p.v + self.push * p.R[..., 1]
        return force, -self.d * p.w + cross(self.twist, p.R[..., 2])


# fmt: off
ROWS: dict[str, type[Any]] = {
    row.__name__: row
    for row in (Actuation, Damping, Drag, Gravity, LineLoad, Load, MassDamping, PointLoad,
                PointMass, RootSpring, Spring, StripAir, TipLoad, Contact, Viscoelastic)
}
# fmt: on
