"""`Contact` of a beam with an obstacle."""

from __future__ import annotations

from dataclasses import InitVar, dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor

from ...core.arguments import boolean, count
from ...core.leaves import leaf
from ...core.validation import Value, concrete, shown
from .contact_law import damped, pressure, rubbing
from .load_point import POSITION, SPIN, VELOCITY, LoadEffect, LoadPoint, Wrench, at_instant
from .obstacles import Obstacle
from .values import Inputs, optional, parameter


class Touch(NamedTuple):
    """What a contact does at points (..., points, n): gap m to the surface; normal, out of the
    obstacle; pressure N/m; slip m/s of the surfaces, None = there is no friction; rub N/m, the
    force of friction on the beam, likewise.
    """

    gap: Tensor
    normal: Tensor
    pressure: Tensor
    slip: Tensor | None
    rub: Tensor | None


@dataclass(frozen=True)
class Contact(LoadEffect):
    """Contact of a beam with an obstacle, per length of the beam:

        p n - friction p s,    p = force (y/thickness)^2 (1 + ...),    y = thickness - gap

    `Contact(obstacle, ...)`, in a structure `Contact("arm", obstacle, ...)` for the beam of that
    name, or without a name for all. The gap is that of the beam's surface, at the `radius` about
    its axis; from `thickness` down it is pressed apart with a force per length that rises to
    `force` where surfaces meet, at gap 0, and from there on linearly, by 2 force/thickness for each
    metre. At rest under a force per length q the gap is thickness (1 - (q/force)^(1/2)), and below
    -(q/force - 1) thickness/2 where q is above `force`.

    thickness  (...) m
    force      (...) N/m; or in its place `stiffness` (...) N/m^2, 2 force/thickness
    radius     (...) m of the beam's surface; None or the number 0: its axis
    friction   (...) mu of Coulomb's law; None or the number 0: none
    slip_speed (...) m/s, from which on friction is mu p against the slip; below it surfaces creep
               under a share x of that by slip_speed (1 - (1 - x)^(1/2)). Wanted with friction
    damping    (...) s: p is multiplied by a + (1 + a^2)^(1/2), a = damping (rate of approach)/
               thickness, which never pulls; None or the number 0: none
    points     of an element at which surfaces may meet, Gauss's: what is smaller than the distance
               between two of them can slip through there
    push_out   whether a motion may start inside of the obstacle, which then pushes the beam out,
               with the energy that it has there

    In a midpoint step it is the
    difference of its potential over that of the gap, so that a rebound without friction and damping
    keeps the energy; friction is that of the slip, and of the pressure, in the middle of the step
    itself.

    Raises ValueError for what is no obstacle, a thickness or slip speed that is not above 0,
    negative numbers, both or none of force and stiffness, friction without a slip speed, or a
    radius that has no room in a tube.
    """

    obstacle: Obstacle = leaf(1)
    other: InitVar[Obstacle | None] = None
    thickness: Value = leaf(0, default=None, kw_only=True)
    force: Value | None = leaf(0, default=None, kw_only=True)
    stiffness: Value | None = leaf(0, default=None, kw_only=True)
    radius: Value | None = leaf(0, default=None, kw_only=True)
    friction: Value | None = leaf(0, default=None, kw_only=True)
    slip_speed: Value | None = leaf(0, default=None, kw_only=True)
    damping: Value | None = leaf(0, default=None, kw_only=True)
    points: int = field(default=2, kw_only=True)
    push_out: bool = field(default=False, kw_only=True)
    on: str | None = field(default=None, kw_only=True)

    between_nodes = True
    wants_frame = True
    wants_step = True
    by_place = True  # bodies have no length

    def __post_init__(self, other: Obstacle | None) -> None:
        if isinstance(self.obstacle, str):
            object.__setattr__(self, "on", self.obstacle)
            object.__setattr__(self, "obstacle", other)
        elif other is not None:
            raise ValueError(
                f"{shown(self.obstacle)} was given as the first of two; the name of a beam is "
                "wanted, and an obstacle"
            )
        if not isinstance(self.obstacle, Obstacle):
            raise ValueError(
                f"{shown(self.obstacle)} was given as an obstacle; a Plane, Sphere, Cylinder, "
                "Capsule or Box is wanted"
            )
        if self.thickness is None:
            raise ValueError("Contact without a thickness was given; a length above 0 is wanted")
        if (self.force is None) == (self.stiffness is None):
            given = "without a force" if self.force is None else "with a force and a stiffness"
            raise ValueError(f"Contact {given} was given; a force or a stiffness is wanted")
        given = "force" if self.stiffness is None else "stiffness"
        for name in ("thickness", given):
            value = parameter(f"Contact's {name}", getattr(self, name), zero=False)
            object.__setattr__(self, name, value)
        for name in ("radius", "friction", "damping"):
            object.__setattr__(self, name, optional(f"Contact's {name}", getattr(self, name)))
        if self.friction is not None and self.slip_speed is None:
            raise ValueError(
                "Contact with friction and no slip_speed was given; the speed is wanted below "
                "which surfaces creep"
            )
        if self.slip_speed is not None:
            value = parameter("Contact's slip_speed", self.slip_speed, zero=False)
            object.__setattr__(self, "slip_speed", value)
        count("Contact's points", self.points)
        boolean("Contact's push_out", self.push_out)
        room = self.obstacle.room
        if room is not None and self.radius is not None:
            left = torch.as_tensor(room).detach() - torch.as_tensor(self.radius).detach()
            if concrete(left <= 0).any():
                raise ValueError(
                    "Contact with a radius of the beam's that has no room in the cylinder was "
                    "given; a smaller one is wanted"
                )

    @property
    def conservative(self) -> bool:
        moves = self.obstacle.drift is not None or self.obstacle.turning is not None
        return self.friction is None and self.damping is None and not moves

    @property
    def depends(self) -> frozenset[str]:
        turns = self.friction is not None and self.radius is not None
        return frozenset({POSITION, VELOCITY, *({SPIN} if turns else ())})

    @property
    def rubs(self) -> bool:
        return self.friction is not None

    def resolved(self, s: Tensor, t: Tensor, inputs: Inputs, elements: int) -> Contact:
        return at_instant(self, t, inputs, s, obstacle=at_instant(self.obstacle, t, inputs, s))

    def wrench(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Wrench:
        touch = self.touch(point)
        force = touch.pressure * touch.normal
        if touch.rub is None:
            return force, None
        if self.radius is None:
            return force + touch.rub, None
        arm = -_each(self.radius) * touch.normal
        return force + touch.rub, _cross(arm, touch.rub)

    def touch(self, point: LoadPoint) -> Touch:
        """What it does at points; its numbers are those of an instant (`resolved`)."""
        x, d = point.position, _each(self.thickness)
        normal, v = self.obstacle.gradient(x), self.approach(point)
        y = d - self.gap(x)
        before, after = y, y
        if point.dt is not None:
            half = _each(point.dt) / 2 * v
            before, after = d - self.gap(x - half), d - self.gap(x + half)
        p = pressure(before, after, d, self.slope)
        if self.damping is not None:
            p = p * damped(-(v * normal).sum(-1, keepdim=True) * _each(self.damping) / d)
        if self.friction is None:
            return Touch(d - y, normal, p, None, None)
        slip = self.slip(point, normal)
        rub = -_each(self.friction) * p * rubbing(slip, _each(self.slip_speed))
        return Touch(d - y, normal, p, slip, rub)

    def idle(self, x: Tensor, reach: Tensor) -> Tensor:
        """(..., n) bool: whether nothing presses in balls about x (..., n, 3) m, of radii whose
        squares are reach (..., n) m^2.
        """
        room = (self.gap(x) - _each(self.thickness))[..., 0]
        return (room > 0) & (room * room >= reach)

    def passed(self, x: Tensor, half: Tensor, dt: Tensor) -> Tensor:
        """(..., n) bool: whether the way of points, by `half` (..., n, 3) m on either side of x, in
        dt (...) s, leads through the obstacle: inside in between, and outside at both ends, or out
        on another side than in.
        """
        carried = self.carried(x, dt)
        half = half if carried is None else half - carried
        start, end = x - half, x + half
        inside = sum((self.gap(x + share * half) < 0).to(x) for share in (-0.5, 0.0, 0.5)) > 0
        out = torch.minimum(self.gap(start), self.gap(end)) > 0
        turned = (self.obstacle.gradient(start) * self.obstacle.gradient(end)).sum(-1, keepdim=True)
        return (inside & (out | (turned < 0)))[..., 0]

    def carried(self, x: Tensor, dt: Tensor) -> Tensor | None:
        """(..., n, 3) m by which the obstacle moves at x in half of a step; None = it stands."""
        moves = self.obstacle.velocity(x)
        return None if moves is None else _each(dt) / 2 * moves

    def directions(self, x: Tensor) -> Tensor:
        """(..., n, 3) in which it pushes at points."""
        return self.obstacle.gradient(x)

    @property
    def slope(self) -> Tensor:
        """(..., 1, 1) N/m^2, how steeply the pressure rises where surfaces meet."""
        if self.force is None:
            return _each(self.stiffness)
        return 2 * _each(self.force) / _each(self.thickness)

    def gap(self, x: Tensor) -> Tensor:
        """(..., points, 1) m between surfaces, the beam's axis at x (..., points, 3)."""
        distance = self.obstacle.distance(x)
        return distance if self.radius is None else distance - _each(self.radius)

    def approach(self, point: LoadPoint) -> Tensor:
        """(..., points, 3) m/s of the beam's axis as seen from the obstacle, in frame a."""
        v, moves = _in_frame(point), self.obstacle.velocity(point.position)
        return v if moves is None else v - moves

    def slip(self, point: LoadPoint, normal: Tensor) -> Tensor:
        """(..., points, 3) m/s of the beam's surface along the obstacle's."""
        v, moves = _in_frame(point), self.obstacle.surface_velocity(point.position)
        if self.radius is not None:
            spin, omega = point.spin, point.frame[1]
            spin = spin if omega is None else spin - omega[..., None, :]
            v = v - _cross(spin, _each(self.radius) * normal)
        v = v if moves is None else v - moves
        return v - (v * normal).sum(-1, keepdim=True) * normal


def _in_frame(point: LoadPoint) -> Tensor:
    """Velocity (..., points, 3) as seen in frame a."""
    (origin, omega), v = point.frame, point.velocity
    v = v if origin is None else v - origin[..., None, :]
    return v if omega is None else v - _cross(omega[..., None, :], point.position)


def _each(value: Tensor) -> Tensor:
    """(...) as (..., 1, 1) of points."""
    return value[..., None, None]


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return torch.linalg.cross(*torch.broadcast_tensors(a, b))
