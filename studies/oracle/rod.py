"""A neutral description of a rod, what holds and moves it, and the Cosserat equations of a point of
it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from .rotations import Array, back, cross, exponential, turn

E1 = np.array((1.0, 0.0, 0.0))


@dataclass(frozen=True)
class Value:
    """A vector (3,), `along` (1 + along x) of its place x = s/L, in time (1 - cos(frequency t))/2,
    or constant.
    """

    vector: Array
    along: float = 0.0
    frequency: float | None = None

    def __call__(self, x: Array | float, t: Array | float) -> Array:
        """(..., 3) of x (...) and t (...)."""
        shape = 1.0 if self.frequency is None else (1 - np.cos(self.frequency * t)) / 2
        return np.asarray((1 + self.along * np.asarray(x)) * shape)[..., None] * self.vector

    def rate(self, t: Array | float) -> Array:
        """By t."""
        shape = 0.0 if self.frequency is None else self.frequency * np.sin(self.frequency * t) / 2
        return np.asarray(shape)[..., None] * self.vector


@dataclass(frozen=True)
class Rod:
    """An axis that is straight, an arc or a helix at rest, and a section that is the same
    everywhere or thins out.

    length     m
    root       (3,) m, frame a;  axes (3, 3) of the section there, columns in frame a
    curvature  (3,) 1/m at rest, section axes: twist, and turning about y and z
    S          (6, 6) compliance of [F; M] at the root, zero rows where a strain is impossible
    mass       kg/m;  centre (3,) m of it in section axes, its x = 0;  inertia (3, 3) kg m about the
               axis' point
    taper      the stiffness and the mass per length are (1 - taper s/L) of those at the root
    """

    length: float
    root: Array
    axes: Array
    curvature: Array
    S: Array
    mass: float
    centre: Array
    inertia: Array
    taper: float = 0.0

    def thinned(self, x: Array) -> Array:
        """1 - taper x."""
        return 1 - self.taper * np.asarray(x)

    def rest(self, x: Array) -> tuple[Array, Array]:
        """Position (..., 3) and axes (..., 3, 3) at rest at x = s/L (...): a screw about the axis
        of curvature.
        """
        s = self.length * np.asarray(x)[..., None]
        size = np.linalg.norm(self.curvature)
        turned = exponential(s * self.curvature)
        if size == 0:
            along = s * E1
        else:  # integral of exp(s ~k) e1
            n = self.curvature / size
            a = size * s
            along = (
                np.sin(a) * E1 + (1 - np.cos(a)) * cross(n, E1) + (a - np.sin(a)) * (n @ E1) * n
            ) / size
        return self.root + along @ self.axes.T, self.axes @ turned


@dataclass(frozen=True)
class Support:
    """What holds a node: letters of the held components of its position and rotation, frame a, and
    where it holds them.
    """

    position: str = "xyz"
    rotation: str = "xyz"
    displacement: Value | None = None
    turn: Value | None = None

    @property
    def held(self) -> Array:
        """(6,) bool."""
        return np.array([c in letters for letters in (self.position, self.rotation) for c in "xyz"])


@dataclass(frozen=True)
class Case:
    """A rod, what acts on it, what holds its ends (x = 0 or 1 -> `Support`), and the motion of its
    frame.

    velocity, spin  (3,) of frame a in its own axes, or None
    order           of the elements that the library is to take, or "linked"
    plane           None, "xy" or "xz"
    """

    rod: Rod
    effects: tuple[Any, ...] = ()
    supports: dict[float, Support] = field(default_factory=lambda: {0.0: Support()})
    velocity: Array | None = None
    spin: Array | None = None
    order: int | str = 2
    plane: str | None = None
    name: str = ""

    @cached_property
    def breaks(self) -> list[float]:
        """0, the places x between the ends at which something acts on a point, 1."""
        return sorted({0.0, 1.0, *(e.at for e in self.effects if e.at is not None)})

    def frame(self) -> tuple[Array, Array]:
        """Velocity and spin of frame a, zero where it stands."""
        return tuple(np.zeros(3) if x is None else x for x in (self.velocity, self.spin))

    def along(self) -> list[Any]:
        """What acts along the rod."""
        return [e for e in self.effects if e.kind == "load" and e.at is None]

    def damping(self) -> Array | None:
        """(6,) s of the stress by strain rate, or None."""
        return next((e.tau for e in self.effects if e.kind == "damping"), None)

    def arms(self) -> tuple[Array, Array]:
        """Shares and times s (6, m) of what forgets; m may be 0."""
        none = np.zeros((6, 0)), np.zeros((6, 0))
        return next(((e.shares, e.times) for e in self.effects if e.kind == "memory"), none)

    def eigenstrain(self, t: Array | float = 0.0) -> Array:
        """(..., 6) of the unloaded rod."""
        return sum((e.eigenstrain(t) for e in self.effects if e.kind == "eigenstrain"), np.zeros(6))


@dataclass(frozen=True)
class Point:
    """Motion of points of a rod, (..., 3) each in frame a, absolute; R (..., 3, 3) section axes.
    x = s/L and t (...).

    mass (..., 1) kg or kg/m, centre (..., 3) m and inertia (..., 3, 3) about the point, section
    axes: what moves there
    frame: velocity and spin of frame a;  inertial (..., 3, 3): inertial axes -> frame a
    support: place, axes, velocity and spin of what an elastic clamp hangs in
    """

    x: Array
    t: Array
    r: Array
    R: Array
    v: Array
    w: Array
    a: Array
    alpha: Array
    frame: tuple[Array, Array]
    inertial: Array
    support: Callable[[], tuple[Array, Array, Array, Array]]
    mass: Array | float = 0.0
    centre: Array | None = None
    inertia: Array | None = None

    def carrying(self, mass: Array | float, centre: Array, inertia: Array) -> Point:
        """The same with this mass."""
        return replace(self, mass=np.asarray(mass)[..., None], centre=centre, inertia=inertia)

    def momentum(self) -> tuple[Array, Array]:
        """Linear and angular momentum about the point, frame a."""
        e, I = self._body()
        return (
            self.mass * (self.v + cross(self.w, e)),
            self.mass * cross(e, self.v) + turn(I, self.w),
        )

    def inertia_force(self) -> tuple[Array, Array]:
        """Rate of momentum, and the moment about the point that the motion asks for:
        m (a + alpha x e + w x (w x e)),  e x m a + I alpha + w x I w.
        """
        e, I = self._body()
        force = self.mass * (self.a + cross(self.alpha, e) + cross(self.w, cross(self.w, e)))
        return force, self.mass * cross(e, self.a) + turn(I, self.alpha) + cross(
            self.w, turn(I, self.w)
        )

    def kinetic(self) -> Array:
        """(...) energy."""
        e, I = self._body()
        own = dot_(self.v, self.v) + 2 * dot_(self.v, cross(self.w, e))
        return (np.asarray(self.mass)[..., 0] * own + dot_(self.w, turn(I, self.w))) / 2

    def _body(self) -> tuple[Array, Array]:
        """Centre of mass from the point, and inertia about it, frame a."""
        return turn(self.R, self.centre), self.R @ self.inertia @ np.swapaxes(self.R, -1, -2)


def dot_(x: Array, y: Array) -> Array:
    """x.y (...)."""
    return (x * y).sum(-1)


def carried(case: Case, x: Array | float, r: Array, R: Array, share: float = 1.0) -> Point:
    """Points that stand in frame a at t = 0, which turns steadily: w = omega, v = v0 + omega x r,
    a = omega x v.
    """
    v0, omega = case.frame()
    v, still = v0 + cross(omega, r), np.zeros_like(r) + omega
    moving = r, R, v, still, cross(omega, v), np.zeros_like(still)
    support = partial(carried_support, case, share)
    return Point(np.asarray(x), np.zeros(()), *moving, (v0, omega), np.eye(3), support)


def carried_support(case: Case, share: float = 1.0) -> tuple[Array, Array, Array, Array]:
    """Place, axes, velocity and spin of what an elastic clamp hangs in, as it stands in frame a at
    t = 0.
    """
    v0, omega = case.frame()
    place, axes = support_pose(case, 0.0, share=share)
    return place, axes, v0 + cross(omega, place), omega


def with_section(case: Case, p: Point) -> Point:
    """A point of the rod with the mass per length."""
    rod = case.rod
    thin = rod.thinned(p.x)
    return p.carrying(rod.mass * thin, rod.centre, thin[..., None, None] * rod.inertia)


def strain(case: Case, p: Point, n: Array, m: Array, share: float = 1.0) -> Array:
    """[gamma; kappa] (..., 6) at rest under the stress resultants n, m (..., 3), frame a, and a
    share of the eigenstrain.
    """
    stress = np.concatenate((back(p.R, n), back(p.R, m)), -1)
    left = (1 - case.arms()[0].sum(-1)) * case.rod.thinned(p.x)[..., None]  # of the stiffness
    return turn(case.rod.S, stress) / left + share * case.eigenstrain(p.t)


def rates(
    case: Case, p: Point, strain: Array, n: Array, share: float = 1.0
) -> tuple[Array, Array, Array, Array]:
    """r', the curvature (section axes), n' and m', by s (..., 3), of points under a share of what
    acts.

    r' = R (e1 + gamma)     R' = R ~(k0 + kappa)     n' = inertia - f     m' = inertia - mu - r' x n
    """
    tangent = turn(p.R, E1 + strain[..., :3])
    p = with_section(case, p)
    force, moment = (share * w for w in p.inertia_force())
    for effect in case.along():
        f, mu = effect.wrench(p)
        force, moment = force - share * f, moment - share * mu
    return tangent, case.rod.curvature + strain[..., 3:], force, moment - cross(tangent, n)


def bodies(case: Case, x: float) -> list[Any]:
    """Rigid bodies at x."""
    return [e for e in case.effects if e.kind == "body" and e.at == x]


def node_loads(case: Case, x: float) -> list[tuple[Any, Any]]:
    """What loads the node at x: pairs of an effect and the body that it acts on, None = the node
    itself.
    """
    loads = [e for e in case.effects if e.kind == "load"]
    return [(e, None) for e in loads if e.at == x] + [
        (e, b) for e in loads if e.on_mass for b in bodies(case, x)
    ]


def at_node(case: Case, x: float, p: Point, share: float = 1.0) -> tuple[Array, Array]:
    """Force and moment (..., 3), frame a, on the node at x: point loads, less what bodies there ask
    for. An elastic clamp is there whatever the share of the others.
    """
    force, moment = np.zeros_like(p.r), np.zeros_like(p.r)
    for body in bodies(case, x):
        f, mu = p.carrying(*body.body()).inertia_force()
        force, moment = force - share * f, moment - share * mu
    for effect, body in node_loads(case, x):
        f, mu = effect.wrench(p if body is None else p.carrying(*body.body()))
        part = 1.0 if effect.holds else share
        force, moment = force + part * f, moment + part * mu
    return force, moment


def support_pose(case: Case, x: float, t: float = 0.0, share: float = 1.0) -> tuple[Array, Array]:
    """Where the support at x has its node, and the axes that it gives it."""
    r, R = case.rod.rest(np.asarray(x))
    support = case.supports.get(x)
    if support is not None and support.displacement is not None:
        r = r + share * support.displacement(0.0, t)
    if support is not None and support.turn is not None:
        R = exponential(share * support.turn(0.0, t)) @ R
    return r, R
