"""Obstacles by their shapes: each the one signed distance of itself, whether it is fixed, moves by
itself, or is the surface of a body.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import boolean
from ...core.declared import real_numbers
from ...core.leaves import leaf, option
from ...core.validation import Value, concrete, refusal
from ...math import quaternions as quat
from .drag import norm
from .obstacle import Obstacle, Turning, direction, each, place, unit

SIGNS = tuple((x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0))


@dataclass(frozen=True)
class Plane(Obstacle):
    """A half space: all points below a plane are solid.

    Args:
        point: (..., 3) m on it, or a function of t; a point that moves along the plane makes it a
            belt
        normal: (..., 3) of any length, away from the solid, or a function of t

    Examples:
        >>> floor = tb.Plane(point=(0, 0, -0.1), normal=(0, 0, 1))
        >>> falling = tb.Scene(
        ...     beam, [tb.Gravity((0, 0, -9.81)), tb.Contact(floor, thickness=0.01, force=100.0)]
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


class Rounded(Obstacle):
    """All that is nearer than its `radius` (...) m to a point or a line."""

    of_bodies = True
    radius: Any

    def away(self, x: Tensor) -> Tensor:
        """(..., points, 3) m from the nearest place of the point or line to points."""
        raise NotImplementedError

    def distance(self, x: Tensor) -> Tensor:
        return norm(self.away(x)) - each(self.radius)

    def gradient(self, x: Tensor) -> Tensor:
        return unit(self.away(x))

    def mean_gradient(self, x: Tensor, y: Tensor) -> Tensor:
        return mean_direction(self.away(x), self.away(y))[0]


def mean_direction(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """(x + y)/(|x| + |y|) (..., 3), whose product with y - x is |y| - |x|; and |x| + |y| (..., 1):
    where that is 0, there is no direction.
    """
    size = norm(x) + norm(y)
    return (x + y) / torch.where(size > 0, size, torch.ones_like(size)), size


@dataclass(frozen=True)
class Sphere(Rounded):
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

    @property
    def reach(self) -> Tensor:
        return torch.linalg.vector_norm(self.centre, dim=-1) + self.radius

    @property
    def corners(self) -> Tensor:
        return self.centre[..., None, :]

    def away(self, x: Tensor) -> Tensor:
        return self._from(x)


@dataclass(frozen=True)
class Cylinder(Rounded):
    """A round bar of infinite length, or with `inside` the outside of a tube.

    Args:
        point: (..., 3) m on its axis, or a function of t
        axis: (..., 3) of any length, or a function of t
        radius: (...) m
        inside: whether the beam is inside
        spin: (...) rad/s of its turn about its axis; None = it does not turn

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

    @property
    def reach(self) -> Tensor:
        return self.radius / torch.finfo(self.radius.dtype).eps  # it has no end

    def distance(self, x: Tensor) -> Tensor:
        return -super().distance(x) if self.inside else super().distance(x)

    def gradient(self, x: Tensor) -> Tensor:
        return -super().gradient(x) if self.inside else super().gradient(x)

    def away(self, x: Tensor) -> Tensor:
        axis, d = self.axis[..., None, :], self._from(x)
        return d - (d * axis).sum(-1, keepdim=True) * axis


@dataclass(frozen=True)
class Capsule(Rounded):
    """A round bar with round ends: all points nearer than the radius to a line from a to b.

    The curvature of the distance jumps where the bar meets its ends; its direction does not.

    Args:
        a, b: (..., 3) m, the ends of the line, or functions of t
        radius: (...) m

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

    @property
    def reach(self) -> Tensor:
        return torch.linalg.vector_norm(self.corners, dim=-1).amax(-1) + self.radius

    @property
    def corners(self) -> Tensor:
        return torch.stack(torch.broadcast_tensors(self.a, self.b), -2)

    def away(self, x: Tensor) -> Tensor:
        along, d = (self.b - self.a)[..., None, :], self._from(x)
        share = (d * along).sum(-1, keepdim=True) / along.square().sum(-1, keepdim=True)
        return d - share.clamp(0, 1) * along


def _rotation_vector(name: str, value: Any) -> Any:
    if callable(place(name, value)):
        raise refusal(f"{name} as a function", "a rotation vector")
    return real_numbers(name, value, 3)


@dataclass(frozen=True)
class Box(Obstacle):
    """A box with rounded edges.

    Args:
        centre: (..., 3) m, or a function of t
        size: (..., 3) m, from side to side along its axes
        rounding: (...) m, radius of its edges, below half of its smallest size. A contact deeper in
            the box than this does not know which side is near
        rotation: (..., 3) rad, the rotation vector of its axes; None = frame a's axes

    Examples:
        >>> table = tb.Box(centre=(0.5, 0, -0.2), size=(1.0, 1.0, 0.1), rounding=0.01)
        >>> laid = tb.Scene(
        ...     beam, [tb.Gravity((0, 0, -9.81)), tb.Contact(table, thickness=0.01, force=100.0)]
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
            raise refusal("Box's rounding of half its smallest size or more", "less")

    of_bodies = True

    def distance(self, x: Tensor) -> Tensor:
        return self._rounded(None).distance(x)

    def gradient(self, x: Tensor) -> Tensor:
        return self._rounded(None).gradient(x)

    @property
    def in_body(self) -> RoundedBox:
        return self._rounded(torch.eye(3, dtype=self.size.dtype, device=self.size.device))

    def _rounded(self, axes: Tensor | None) -> RoundedBox:
        """With these axes where they are those of frame a."""
        half, turn = self.size / 2 - self.rounding[..., None], self.rotation
        axes = axes if turn is None else quat.matrix(quat.exponential(turn))
        return RoundedBox(self.centre, axes, half, self.rounding)


@dataclass(frozen=True)
class RoundedBox(Obstacle):
    """All that is nearer than `radius` (...) m to a box with sharp edges: its centre (..., 3) m,
    its axes (..., 3, 3) as columns, None = those of frame a, half of its size (..., 3) m.
    """

    centre: Tensor = leaf(1)
    axes: Tensor | None = leaf(2)
    half: Tensor = leaf(1)
    radius: Tensor = leaf(0)

    PLACE = "centre"

    @property
    def reach(self) -> Tensor:
        off, half = (torch.linalg.vector_norm(x, dim=-1) for x in (self.centre, self.half))
        return off + half + self.radius

    @property
    def corners(self) -> Tensor:
        local = self.half.new_tensor(SIGNS) * self.half[..., None, :]
        return self.centre[..., None, :] + local @ self.axes.mT

    def distance(self, x: Tensor) -> Tensor:
        q, _ = self._beyond(x)
        inside = q.amax(-1, keepdim=True).clamp(max=0)
        return norm(q.clamp(min=0)) + inside - each(self.radius)

    def gradient(self, x: Tensor) -> Tensor:
        return self._in_frame(self._outward(x))

    def mean_gradient(self, x: Tensor, y: Tensor) -> Tensor:
        away = (side * q.clamp(min=0) for q, side in (self._beyond(x), self._beyond(y)))
        mean, size = mean_direction(*away)
        return self._in_frame(torch.where(size > 0, mean, self._outward((x + y) / 2)))

    def _outward(self, x: Tensor) -> Tensor:
        """The gradient in its own axes."""
        q, side = self._beyond(x)
        out = q.clamp(min=0)
        nearest = (q >= q.amax(-1, keepdim=True)).to(q)
        away = (out > 0).any(-1, keepdim=True)
        return side * torch.where(away, unit(out), unit(nearest))

    def _beyond(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """(..., points, 3) m by which points are beyond the sharp box, along its axes, negative
        within, and on which side, 1 or -1.
        """
        d = self._from(x)
        d = d if self.axes is None else (self.axes[..., None, :, :].mT @ d[..., None])[..., 0]
        side = torch.where(d < 0, -1.0, 1.0).to(d)
        return side * d - self.half[..., None, :], side

    def _in_frame(self, n: Tensor) -> Tensor:
        return n if self.axes is None else (self.axes[..., None, :, :] @ n[..., None])[..., 0]
