"""Obstacles: rigid bodies that a beam may touch, each by its signed distance, positive outside of
what is solid. A contact asks for that `distance`, its `gradient`, and the velocity of its points.
Places and directions (..., 3) are in frame a, or functions of t, written in torch, that give them:
what moves so carries its surface along.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from ...core.arguments import boolean
from ...core.declared import real_numbers
from ...core.functions_of_time import taken, with_user_rate
from ...core.leaves import FunctionOfTime, Tree, bound, leaf, option, own_leaves
from ...core.validation import Value, concrete
from ...math import quaternions as quat
from .drag import norm
from .load_point import cross
from .values import Input, load_value


@dataclass(frozen=True)
class Drift(FunctionOfTime):
    """Velocity (..., 3) m/s of a place (..., 3) m that is a function of t."""

    place: Callable[[Tensor], Tensor] = leaf(1)

    def __call__(self, t: Tensor) -> Tensor:
        return _with_rate(self.place, t)[1]


@dataclass(frozen=True)
class Unit(FunctionOfTime):
    """A direction of length 1, by a function of t that gives one of any."""

    direction: Callable[[Tensor], Tensor] = leaf(1)

    def __call__(self, t: Tensor) -> Tensor:
        return _unit(taken("an obstacle's direction", self.direction(t), t, 3))


@dataclass(frozen=True)
class Turning(FunctionOfTime):
    """Angular velocity (..., 3) rad/s, across it, of the direction (..., 3) from one place to
    another, of which one at least is a function of t; origin: None = the end is the direction.
    """

    end: Value | Callable[[Tensor], Tensor] = leaf(1)
    origin: Value | Callable[[Tensor], Tensor] | None = leaf(1, default=None)

    def __call__(self, t: Tensor) -> Tensor:
        d, rate = _with_rate(self.end, t)
        if self.origin is not None:
            origin, moves = _with_rate(self.origin, t)
            d, rate = d - origin, rate - moves
        return cross(d, rate) / d.square().sum(-1, keepdim=True)


def _with_rate(value: Any, t: Tensor) -> tuple[Tensor, Tensor]:
    """A place and its rate at t."""
    if not callable(value):
        return value, torch.zeros_like(value)
    what = "an obstacle's place"
    return with_user_rate(what, lambda now: taken(what, value(now), now, 3), t)


def place(name: str, value: Any) -> Any:
    """A place (..., 3), or a function of t; ValueError otherwise."""
    if isinstance(value, Input):
        raise ValueError(f"{name} as an Input was given; a value, or a function of t, is wanted")
    return load_value(name, value)


def direction(name: str, value: Any) -> Any:
    """A direction likewise, of any length but 0; kept of length 1."""
    value = place(name, value)
    if callable(value):
        return value if isinstance(value, Unit) else Unit(value)
    if not (torch.as_tensor(value) != 0).any(-1).all():
        raise ValueError(f"{name} of length 0 was given; a direction is wanted")
    return value / (value * value).sum(-1)[..., None] ** 0.5


def _of_points(method: Callable[[Any, Tensor], Any]) -> Callable[[Any, Tensor], Any]:
    """A method of an obstacle and points whose numbers are tensors like the points, as in a scene;
    ValueError where one is a function of t.
    """

    @wraps(method)
    def of_points(self: Obstacle, x: Tensor) -> Any:
        for one in own_leaves(self):
            if callable(one.value):
                raise ValueError(
                    f"{self.called}'s {one.name} as a function of t was given; at an instant a "
                    "value is wanted"
                )
        return method(bound(self, x.dtype, x.device), x)

    return of_points


@dataclass(frozen=True)
class Obstacle(Tree):
    """Base of all obstacles. drift m/s of its `place` and turning rad/s (..., 3): None = it stands.

    Attributes:
        PLACE: name of the field about which it turns
        passes: whether a beam could be on its other side, beyond what is solid

    Examples:
        >>> @dataclass(frozen=True)
        ... class Ball(extend.Obstacle):  # of 0.1 m
        ...     centre: extend.Value = extend.leaf(1)
        ...     PLACE = "centre"
        ...
        ...     def distance(self, x):
        ...         return (x - self.centre).norm(dim=-1, keepdim=True) - 0.1
        >>> Ball((0, 0, 0)).distance(torch.tensor([[0.5, 0, 0]]))
        tensor([[0.4000]])
    """

    drift: Value | Callable[[Tensor], Tensor] | None = leaf(1, default=None, init=False)
    turning: Value | Callable[[Tensor], Tensor] | None = leaf(1, default=None, init=False)

    PLACE: ClassVar[str]
    passes: ClassVar[bool] = True

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        for name in ("distance", "gradient"):
            if name in vars(cls):
                setattr(cls, name, _of_points(vars(cls)[name]))

    def __post_init__(self) -> None:
        super().__post_init__()
        at = getattr(self, getattr(self, "PLACE", ""), None)
        object.__setattr__(self, "drift", Drift(at) if callable(at) else None)
        object.__setattr__(self, "turning", self._turned())

    def _turned(self) -> Turning | None:
        """How it turns, where a direction of it is a function of t."""
        return None

    def distance(self, x: Tensor) -> Tensor:
        """(..., points, 1) m of points (..., points, 3), frame a."""
        raise NotImplementedError

    def gradient(self, x: Tensor) -> Tensor:
        """Of the distance (..., points, 3): of length 1, out of what is solid."""
        raise NotImplementedError

    @property
    def room(self) -> Tensor | None:
        """(...) m, the largest radius that has room in a hollow; None = it is none."""
        return None

    @property
    def spinning(self) -> Tensor | None:
        """(..., 3) rad/s by which its surface turns in itself; None = it does not."""
        return None

    @_of_points
    def velocity(self, x: Tensor) -> Tensor | None:
        """(..., points, 3) m/s in frame a of its points as it moves; None = it stands."""
        return self._carried(x, self.turning)

    @_of_points
    def surface_velocity(self, x: Tensor) -> Tensor | None:
        """The same of its surface."""
        parts = [spin for spin in (self.turning, self.spinning) if spin is not None]
        return self._carried(x, sum(parts[1:], parts[0]) if parts else None)

    def _carried(self, x: Tensor, spin: Tensor | None) -> Tensor | None:
        moves = None if self.drift is None else self.drift[..., None, :]
        if spin is None:
            return moves
        turns = cross(spin[..., None, :], self._from(x))
        return turns if moves is None else turns + moves

    def _from(self, x: Tensor, field: str | None = None) -> Tensor:
        """Points from a place of it, its own unless another is named."""
        return x - getattr(self, field or self.PLACE)[..., None, :]


@dataclass(frozen=True)
class Plane(Obstacle):
    """All that lies below a plane.

    Args:
        point: (..., 3) m on it, or a function of t; one that moves along the plane makes it a belt
        normal: (..., 3) of any length, away from what is solid, or a function of t

    Examples:
        >>> floor = tb.Plane(point=(0, 0, -0.1), normal=(0, 0, 1))
        >>> falling = tb.Scene(
        ...     beam,
        ...     [tb.Gravity((0, 0, -9.81)), tb.Contact(floor, thickness=0.01, force=100.0)],
        ... )
        >>> tb.sensors.ContactGap(falling)(tb.rest(falling))  # m
        tensor([0.1000])
    """

    point: Value | Callable[[Tensor], Tensor] = leaf(1, check=place)
    normal: Value | Callable[[Tensor], Tensor] = leaf(1, check=direction)

    PLACE = "point"
    passes = False

    def _turned(self) -> Turning | None:
        return Turning(self.normal) if callable(self.normal) else None

    def distance(self, x: Tensor) -> Tensor:
        return (self._from(x) * self.normal[..., None, :]).sum(-1, keepdim=True)

    def gradient(self, x: Tensor) -> Tensor:
        return self.normal[..., None, :] + torch.zeros_like(self._from(x))


@dataclass(frozen=True)
class Sphere(Obstacle):
    """A ball.

    Args:
        centre: (..., 3) m, or a function of t
        radius: (...) m
        spin: (..., 3) rad/s by which it turns, frame a; None = it does not

    Examples:
        >>> ball = tb.Sphere(centre=(0.8, 0, -0.2), radius=0.1)
        >>> laid = tb.Scene(
        ...     beam, [tb.Gravity((0, 0, -9.81)), tb.Contact(ball, thickness=0.01, force=100.0)]
        ... )
        >>> tb.sensors.ContactGap(laid)(tb.rest(laid))  # m
        tensor([0.1000])
    """

    centre: Value | Callable[[Tensor], Tensor] = leaf(1, check=place)
    radius: Value = leaf(0, positive=True)
    spin: Value | None = leaf(1, default=None, check=place)

    PLACE = "centre"

    @property
    def spinning(self) -> Tensor | None:
        return self.spin

    def distance(self, x: Tensor) -> Tensor:
        return norm(self._from(x)) - each(self.radius)

    def gradient(self, x: Tensor) -> Tensor:
        return _unit(self._from(x))


@dataclass(frozen=True)
class Cylinder(Obstacle):
    """A round bar without end, or with `inside` all that is outside of a tube.

    Args:
        point: (..., 3) m on its axis, or a function of t
        axis: (..., 3) of any length, or a function of t
        radius: (...) m
        inside: whether the beam is inside
        spin: (...) rad/s by which it turns about its axis; None = it does not

    Examples:
        >>> tube = tb.Cylinder(point=(0, 0, 0), axis=(1, 0, 0), radius=0.02, inside=True)
        >>> held = tb.Scene(
        ...     beam,
        ...     [tb.TipLoad(force=(0, 0, 1.0)), tb.Contact(tube, thickness=0.005, force=100.0)],
        ... )
        >>> tb.sensors.ContactGap(held)(tb.rest(held))  # m
        tensor([0.0200])
    """

    point: Value | Callable[[Tensor], Tensor] = leaf(1, check=place)
    axis: Value | Callable[[Tensor], Tensor] = leaf(1, check=direction)
    radius: Value = leaf(0, positive=True)
    inside: bool = option(boolean, default=False)
    spin: Value | None = leaf(0, default=None, finite=True)

    PLACE = "point"

    def _turned(self) -> Turning | None:
        return Turning(self.axis) if callable(self.axis) else None

    @property
    def passes(self) -> bool:
        return not self.inside

    @property
    def room(self) -> Tensor | None:
        return self.radius if self.inside else None

    @property
    def spinning(self) -> Tensor | None:
        return None if self.spin is None else self.spin[..., None] * self.axis

    def distance(self, x: Tensor) -> Tensor:
        out = norm(self._across(x)) - each(self.radius)
        return -out if self.inside else out

    def gradient(self, x: Tensor) -> Tensor:
        out = _unit(self._across(x))
        return -out if self.inside else out

    def _across(self, x: Tensor) -> Tensor:
        """(..., points, 3) from the axis."""
        axis, d = self.axis[..., None, :], self._from(x)
        return d - (d * axis).sum(-1, keepdim=True) * axis


@dataclass(frozen=True)
class Capsule(Obstacle):
    """A round bar with round ends: all that is nearer than `radius` (...) m to the line from a to b
    (..., 3) m, each a function of t, or not. Where the bar goes over to its ends the distance has a
    jump in its curvature, and none in its direction.

    Examples:
        >>> bar = tb.Capsule(a=(0.8, -0.1, -0.1), b=(0.8, 0.1, -0.1), radius=0.05)
        >>> laid = tb.Scene(
        ...     beam, [tb.Gravity((0, 0, -9.81)), tb.Contact(bar, thickness=0.01, force=100.0)]
        ... )
        >>> tb.sensors.ContactGap(laid)(tb.rest(laid))  # m
        tensor([0.0500])
    """

    a: Value | Callable[[Tensor], Tensor] = leaf(1, check=place)
    b: Value | Callable[[Tensor], Tensor] = leaf(1, check=place)
    radius: Value = leaf(0, positive=True)

    PLACE = "a"

    def __post_init__(self) -> None:
        super().__post_init__()
        ends = () if self.turning else (torch.as_tensor(self.a), torch.as_tensor(self.b))
        if ends and not (ends[1] - ends[0]).any(-1).all():
            raise ValueError("Capsule with a = b was given; two places are wanted, or a Sphere")

    def _turned(self) -> Turning | None:
        return Turning(self.b, self.a) if callable(self.a) or callable(self.b) else None

    def distance(self, x: Tensor) -> Tensor:
        return norm(self._away(x)) - each(self.radius)

    def gradient(self, x: Tensor) -> Tensor:
        return _unit(self._away(x))

    def _away(self, x: Tensor) -> Tensor:
        """(..., points, 3) from the nearest place between a and b."""
        along, d = (self.b - self.a)[..., None, :], self._from(x)
        share = (d * along).sum(-1, keepdim=True) / along.square().sum(-1, keepdim=True)
        return d - share.clamp(0, 1) * along


def _rotation_vector(name: str, value: Any) -> Any:
    if callable(place(name, value)):
        raise ValueError(f"{name} as a function was given; a rotation vector is wanted")
    return real_numbers(name, value, 3)


@dataclass(frozen=True)
class Box(Obstacle):
    """A box with rounded edges.

    Args:
        centre: (..., 3) m, or a function of t
        size: (..., 3) m, from side to side along its axes
        rounding: (...) m, radius of its edges, below half of its smallest size; no deeper in the
            box does a contact know which side is near
        rotation: (..., 3) rad, the rotation vector of its axes; None = those of frame a

    Examples:
        >>> table = tb.Box(centre=(0.5, 0, -0.2), size=(1.0, 1.0, 0.1), rounding=0.01)
        >>> laid = tb.Scene(
        ...     beam,
        ...     [tb.Gravity((0, 0, -9.81)), tb.Contact(table, thickness=0.01, force=100.0)],
        ... )
        >>> tb.sensors.ContactGap(laid)(tb.rest(laid))  # m
        tensor([0.1500])
    """

    centre: Value | Callable[[Tensor], Tensor] = leaf(1, check=place)
    size: Value = leaf(1, positive=True, size=3)
    rounding: Value = leaf(0, positive=True)
    rotation: Value | None = leaf(1, default=None, check=_rotation_vector)

    PLACE = "centre"

    def __post_init__(self) -> None:
        super().__post_init__()
        half = torch.as_tensor(self.size).detach().amin(-1) / 2
        if concrete(torch.as_tensor(self.rounding).detach() >= half).any():
            raise ValueError(
                "Box's rounding of half its smallest size or more was given; less is wanted"
            )

    def distance(self, x: Tensor) -> Tensor:
        return self._beyond(x).gap

    def gradient(self, x: Tensor) -> Tensor:
        n = self._beyond(x).direction
        return n if self.rotation is None else (self._axes @ n[..., None])[..., 0]

    @property
    def _axes(self) -> Tensor:
        """(..., 1, 3, 3) its axes -> frame a."""
        return quat.matrix(quat.exponential(self.rotation))[..., None, :, :]

    def _beyond(self, x: Tensor) -> Beyond:
        d = self._from(x)
        d = d if self.rotation is None else (self._axes.mT @ d[..., None])[..., 0]
        rounding = each(self.rounding)
        return beyond(d, self.size[..., None, :] / 2 - rounding, rounding)


class Beyond(NamedTuple):
    """Of places: q (..., 3) m by which they are beyond a box smaller by its rounding (..., 1) m,
    along its axes, negative within, on the side (..., 3), 1 or -1.
    """

    q: Tensor
    side: Tensor
    rounding: Tensor

    @property
    def gap(self) -> Tensor:
        """(..., 1) m to the rounded surface."""
        inside = self.q.amax(-1, keepdim=True).clamp(max=0)
        return norm(self.q.clamp(min=0)) + inside - self.rounding

    @property
    def direction(self) -> Tensor:
        """Its gradient (..., 3) by the places, in the box's axes."""
        out = self.q.clamp(min=0)
        nearest = (self.q >= self.q.amax(-1, keepdim=True)).to(self.q)
        away = (out > 0).any(-1, keepdim=True)
        return self.side * torch.where(away, _unit(out), _unit(nearest))


def beyond(y: Tensor, half: Tensor, rounding: Tensor) -> Beyond:
    """Of places y (..., 3) m from the centre of a box, in its axes, that has half the size (..., 3)
    m without its rounding (..., 1) m.
    """
    side = torch.where(y < 0, -1.0, 1.0).to(y)
    return Beyond(side * y - half, side, rounding)


def each(value: Tensor) -> Tensor:
    """(...) as (..., 1, 1) of points."""
    return value[..., None, None]


def _unit(v: Tensor) -> Tensor:
    """v/|v| (..., 3); at v = 0 none."""
    size = norm(v)
    return v / torch.where(size > 0, size, torch.ones_like(size))
