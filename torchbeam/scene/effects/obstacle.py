"""Obstacle: a rigid body that a beam may touch, by its signed distance, positive outside of what is
solid. A contact asks for that `distance`, its `gradient`, and the velocity of its points. Places
and directions (..., 3) are in frame a, or functions of t, written in torch, that give them: what
moves so carries its surface along.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Any, ClassVar

import torch
from torch import Tensor

from ...core.functions_of_time import taken
from ...core.leaves import FunctionOfTime, Tree, bound, leaf, own_leaves
from ...core.validation import Value, refusal, shown
from ...math.quaternions import cross
from .drag import norm
from .values import Input, Rate, load_value, with_rate

PLACE = "an obstacle's place"


@dataclass(frozen=True)
class Unit(FunctionOfTime):
    """A direction of length 1, by a function of t that gives one of any."""

    direction: Callable[[Tensor], Tensor] = leaf(1)

    def __call__(self, t: Tensor) -> Tensor:
        return unit(taken("an obstacle's direction", self.direction(t), t, 3))


@dataclass(frozen=True)
class Turning(FunctionOfTime):
    """Angular velocity (..., 3) rad/s, across it, of the direction (..., 3) from one place to
    another, of which one at least is a function of t; origin: None = the end is the direction.
    """

    end: Value | Callable[[Tensor], Tensor] = leaf(1)
    origin: Value | Callable[[Tensor], Tensor] | None = leaf(1, default=None)

    def __call__(self, t: Tensor) -> Tensor:
        d, rate = with_rate(self.end, t, PLACE)
        if self.origin is not None:
            origin, moves = with_rate(self.origin, t, PLACE)
            d, rate = d - origin, rate - moves
        return cross(d, rate) / d.square().sum(-1, keepdim=True)


def place(name: str, value: Any) -> Any:
    """A place (..., 3), or a function of t; ValueError otherwise."""
    if isinstance(value, Input):
        raise refusal(f"{name} as an Input", "a value, or a function of t,")
    return load_value(name, value)


def direction(name: str, value: Any) -> Any:
    """A direction likewise, of any length but 0; kept of length 1."""
    value = place(name, value)
    if callable(value):
        return value if isinstance(value, Unit) else Unit(value)
    if not (torch.as_tensor(value) != 0).any(-1).all():
        raise refusal(f"{name} of length 0", "a direction")
    return value / (value * value).sum(-1)[..., None] ** 0.5


def _of_points(method: Callable[[Any, Tensor], Any]) -> Callable[[Any, Tensor], Any]:
    """A method of an obstacle and points whose numbers are tensors like the points, as in a scene;
    ValueError where one is a function of t.
    """

    @wraps(method)
    def of_points(self: Obstacle, x: Tensor) -> Any:
        for part in own_leaves(self):
            if callable(part.value):
                raise refusal(
                    f"{self.called}'s {part.name} as a function of t", "at an instant a value"
                )
        return method(bound(self, x.dtype, x.device), x)

    return of_points


@dataclass(frozen=True)
class Obstacle(Tree):
    """Base of all obstacles.

    An obstacle moves by the drift, m/s, of its `place` and by its turning (..., 3) rad/s; None = it
    stands.

    Attributes:
        PLACE: name of the field about which it turns
        passes: whether a beam could be on its other side, beyond the solid
        of_bodies: whether it may be the surface of a body. It then has a `reach`, and may be made
            of other numbers (`in_body`); if it touches planes it has `corners`

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
    of_bodies: ClassVar[bool] = False

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        for name in ("distance", "gradient"):
            if name in vars(cls):
                setattr(cls, name, _of_points(vars(cls)[name]))

    def __post_init__(self) -> None:
        super().__post_init__()
        at = getattr(self, getattr(self, "PLACE", ""), None)
        vars(self).update(drift=Rate(at, PLACE) if callable(at) else None, turning=self._turned())

    def _turned(self) -> Turning | None:
        """How it turns, where a direction of it is a function of t."""
        return None

    def distance(self, x: Tensor) -> Tensor:
        """(..., points, 1) m of points (..., points, 3), frame a."""
        raise NotImplementedError

    def gradient(self, x: Tensor) -> Tensor:
        """Gradient (..., points, 3) of the distance: unit vectors out of the solid."""
        raise NotImplementedError

    def mean_gradient(self, x: Tensor, y: Tensor) -> Tensor:
        """Discrete gradient (..., points, 3): its product with y - x is the change of distance from
        points x to y. It is the gradient half way, corrected along y - x (Gonzalez 1996).
        """
        n, way = self.gradient((x + y) / 2), y - x
        square = way.square().sum(-1, keepdim=True)
        more = self.distance(y) - self.distance(x) - (n * way).sum(-1, keepdim=True)
        return n + more / torch.where(square > 0, square, 1.0) * way

    @property
    def in_body(self) -> Obstacle:
        """The obstacle as surface of a body, in its axes. Its fields are tensors of 3 to the power
        of their number of axes; none is absent.
        """
        return self

    @property
    def reach(self) -> Tensor:
        """(...) m from the origin of its axes: no place of its surface is farther."""
        raise NotImplementedError

    @property
    def corners(self) -> Tensor | None:
        """(..., K, 3) m, centres of balls of its `radius` that may touch planes; None = none."""
        return None

    @property
    def room(self) -> Tensor | None:
        """(...) m, largest radius that fits into a hollow; None = no hollow."""
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
        """Velocity of its surface, likewise."""
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


def each(value: Tensor) -> Tensor:
    """(...) as (..., 1, 1) of points."""
    return value[..., None, None]


def unit(v: Tensor) -> Tensor:
    """v/|v| (..., 3); at v = 0 none."""
    size = norm(v)
    return v / torch.where(size > 0, size, torch.ones_like(size))


def body_surface(name: str, shape: object) -> Obstacle:
    """A body's surface. Raises ValueError for what is none."""
    if not isinstance(shape, Obstacle) or not shape.of_bodies:
        raise ValueError(
            f"{shown(shape)} was given as {name}; a Sphere, Capsule, Cylinder or Box in the body's "
            "axes is wanted"
        )
    if shape.room is not None:
        raise ValueError(
            f"a {shape.called} with inside=True was given as {name}; what is solid within is wanted"
        )
    if any(callable(part.value) for part in own_leaves(shape)):
        raise ValueError(
            f"a {shape.called} that is a function of t was given as {name}; it moves with the "
            "body, and numbers are wanted"
        )
    if getattr(shape, "spin", None) is not None:
        raise ValueError(
            f"a {shape.called} with a spin was given as {name}; it turns with the body, and none "
            "is wanted"
        )
    return shape
