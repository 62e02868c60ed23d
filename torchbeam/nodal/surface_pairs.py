"""Pairs of a place along a beam, or of a ball's centre, and the surface of a body, which moves with
it. With y the place as the body sees it, at both ends of a step (n, n+1), and d the signed distance
of the surface's shape, the gap is d less the radius about the place, and the force per length

    f = p u - friction p s        on the place, -f on the body
    u = R n,    n (y_{n+1} - y_n) = d_{n+1} - d_n,    R the mean of the body's axes at both ends

with n the `mean_gradient` of the shape (of boxes and bars along one face or edge). It acts where
the surface of the place is: at x - radius u. As R_{n+1} - R_n is theta x R, with theta that by
which the body turns, p u does as much work as p has over y_{n+1} - y_n; p is the difference of the
law's potential over that of the gap, so that surfaces give back what they took (Gonzalez 1996).
Momentum and angular momentum stay.
"""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields, replace
from functools import cache
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from ..core.leaves import AXES, leaf
from ..math.quaternions import cross, skew
from ..math.shapes import stacked
from ..scene.effects.contact_law import damped, leads_through, potential, pressure
from ..scene.effects.drag import norm
from ..scene.effects.load_point import POSITION, ROTATION, SPIN, VELOCITY, jacobians
from ..scene.effects.obstacle import Obstacle
from .touching_pairs import ContactPoint, PairMotion, TouchingPairs

BODY = 4  # of the six nodes of a pair the body's; the two beside it are it again, and have nothing


class Lever(NamedTuple):
    """(..., U, 3) from the body to where surfaces meet; from the place to there."""

    body: Tensor
    place: Tensor


@dataclass(frozen=True)
class SurfacePairs(TouchingPairs):
    """Constants of U pairs; shape: class of the surface, and its `numbers` (..., U, n), in the
    body's axes. The radii are those of the place, and 0.
    """

    shape: type[Obstacle]
    numbers: Tensor = leaf(2)

    POINTS: ClassVar[tuple[int, ...]] = (0, 0, 0, 1, 1, 1)

    def of(self, shape: type[Obstacle] | None) -> TouchingPairs:
        """Pairs of these constants whose surfaces have this shape; None = pieces are curves."""
        if shape is not None:
            return replace(self, shape=shape)
        return TouchingPairs(
            **{field.name: getattr(self, field.name) for field in fields(TouchingPairs)}
        )

    def gap(self, y: Tensor) -> Tensor:
        """(..., U, 1) m of places (..., U, 3) in the body's axes."""
        return self._surface.distance(y[..., None, :])[..., 0, :] - self.radii[..., :1]

    @property
    def _surface(self) -> Obstacle:
        return with_numbers(self.shape, self.numbers)

    @property
    def reads(self) -> frozenset[str]:
        return frozenset({ROTATION} | ({VELOCITY, SPIN} if self.lossy else set()))

    def points(self, motion: PairMotion) -> PairMotion:
        """From the nodes' motion that of the place and of the body."""

        def two(x: Tensor) -> Tensor:
            place = (self.own[..., None] * x[..., :3, :]).sum(-2, keepdim=True)
            return torch.cat((place, x[..., BODY, None, :].expand_as(place)), -2)

        return motion._replace(
            **{
                name: None if x is None else two(x)
                for name, x in motion._asdict().items()
                if name in ("position", "half", "velocity", "spin")
            }
        )

    def slack(self, motion: PairMotion) -> Tensor:
        """Wherever it is on a straight way, as the body sees it: no distance changes by more than
        that is long.
        """
        first, last = self._seen(self.points(motion))
        gaps = (self.gap(first) + self.gap(last))[..., 0]
        way = torch.linalg.vector_norm(last - first, dim=-1)
        return (gaps - way) / 2 - self.thickness

    def closest_point(self, points: PairMotion) -> ContactPoint:
        seen = self._seen(points)
        gaps = [self.gap(y) for y in seen]
        n = self._surface.mean_gradient(*(y[..., None, :] for y in seen))
        R = sum(points.axes) / len(points.axes)
        u = (R @ n.mT)[..., 0]
        d, slope = self.thickness[..., None], self.slope[..., None]
        elastic = p = pressure(d - gaps[0], d - gaps[1], d, slope)
        x, rub, slip = points.position, None, None
        rho = x[..., 0, :] - x[..., 1, :]
        if self.damping is not None and points.velocity is not None:
            approach = -(self.parting(points) * u).sum(-1, keepdim=True)
            p = p * damped(approach * self.damping[..., None] / d)
        if self.friction is not None and points.velocity is not None:
            slip = self._slip(points, self._lever(rho, u))
            rub = self._rub(points, p, slip)
        shares = torch.zeros_like(rho)
        return ContactPoint(
            shares, rho, (gaps[0] + gaps[1]) / 2, p, elastic, u, slip, rub, self.measure[..., None]
        )

    def parting(self, points: PairMotion, shares: Tensor | None = None) -> Tensor:
        x, v = points.position, points.velocity
        rho = x[..., 0, :] - x[..., 1, :]
        return v[..., 0, :] - v[..., 1, :] - cross(points.spin[..., 1, :], rho)

    def _slip(self, points: PairMotion, lever: Lever) -> Tensor:
        """(..., U, 3) m/s of the place's surface on the body's."""
        v, spin = points.velocity, points.spin
        surface = v[..., 0, :] + cross(spin[..., 0, :], lever.place)
        slip = surface - v[..., 1, :] - cross(spin[..., 1, :], lever.body)
        n = lever.place
        size = n.square().sum(-1, keepdim=True)
        return slip - (slip * n).sum(-1, keepdim=True) * n / torch.where(size > 0, size, 1.0)

    def _actions(self, points: PairMotion) -> tuple[Tensor, Tensor, Tensor]:
        """Force (..., U, 3) N on the place, moments N m on it and on the body."""
        contact_point = self.closest_point(points)
        force, lever = contact_point.force, self._lever(contact_point.r, contact_point.u)
        return force, cross(lever.place, force), -cross(lever.body, force)

    def wrenches(self, motion: PairMotion) -> Tensor:
        force, place, body = torch.broadcast_tensors(*self._actions(self.points(motion)))
        two = torch.stack((torch.cat((force, place), -1), torch.cat((-force, body), -1)), -2)
        return self._weights[..., None] * two[..., self.POINTS, :]

    @property
    def _weights(self) -> Tensor:
        alone = torch.zeros_like(self.own)
        alone = torch.cat((alone[..., :1], alone[..., 1:2] + 1, alone[..., 2:]), -1)
        return torch.cat((self.own, alone), -1)

    def slopes(self, motion: PairMotion) -> dict[str, Tensor]:
        points = self.points(motion)
        rates = zip((VELOCITY, SPIN), points[2:4], strict=True)
        asked = {name: x for name, x in rates if name in self.reads and x is not None}
        half, R = points.half, points.axes

        def actions(x: Tensor, turn: Tensor, *moving: Tensor) -> Tensor:
            x, *moving = (part.unflatten(-1, (2, 3)) for part in (x, *moving))
            velocity, spin = (*moving, None, None)[:2]
            now = None if half is None else half + (x - x.detach())
            turned = *R[:-1], R[-1] + skew(turn) @ R[-1]
            motion = PairMotion(x, now, velocity, spin, points.told, turned)
            return torch.cat(torch.broadcast_tensors(*self._actions(motion)), -1)

        still = torch.zeros_like(points.position[..., 0, :])
        arguments = points.position.flatten(-2), still, *(x.flatten(-2) for x in asked.values())
        by_x, by_turn, *by_rates = jacobians(actions, *arguments)
        weights = self._weights[..., None, None]
        slopes = {}
        for name, slope in zip((POSITION, *asked), (by_x, *by_rates), strict=True):
            by_point = slope.unflatten(-1, (2, 3)).movedim(-2, -3)
            slopes[name] = weights * by_point[..., self.POINTS, :, :]
        none = torch.zeros_like(weights[..., :3, :, :])
        only = torch.cat((none, weights[..., 3:, :, :]), -3)
        return slopes | {ROTATION: only * by_turn[..., None, :, :]}

    def blocks(self, motion: PairMotion, change: Tensor) -> Tensor:
        force, place, body = change.split(3, -2)
        rows = torch.stack((torch.cat((force, place), -2), torch.cat((-force, body), -2)), -4)
        return self._weights[..., None, None, None] * rows[..., self.POINTS, :, :, :]

    def energy(self, motion: PairMotion, side: float) -> Tensor:
        y = self._seen(self.points(motion))[1 if side > 0 else 0]
        d, slope = self.thickness[..., None], self.slope[..., None]
        return (self.measure[..., None] * potential(d - self.gap(y), d, slope)).sum((-1, -2))

    def passed_through(self, motion: PairMotion) -> Tensor:
        def directions(y: Tensor) -> Tensor:
            return self._surface.gradient(y[..., None, :])[..., 0, :]

        through = leads_through(self.gap, directions, *self._seen(self.points(motion)))
        return (through & (self.measure > 0)).any(-1)

    def _seen(self, points: PairMotion) -> tuple[Tensor, Tensor]:
        """(..., U, 3) m: the place in the body's axes before and after a step; or it twice."""
        x, half = points.position, points.half

        def seen(x: Tensor, R: Tensor) -> Tensor:
            return (R.mT @ (x[..., 0, :] - x[..., 1, :])[..., None])[..., 0]

        if half is None:
            return (seen(x, points.axes[-1]),) * 2
        return seen(x - half, points.axes[0]), seen(x + half, points.axes[-1])

    def _lever(self, rho: Tensor, u: Tensor) -> Lever:
        size = norm(u)
        n = self.radii[..., :1] * u / torch.where(size > 0, size, torch.ones_like(size))
        return Lever(rho - n, -n)


@cache
def _made_of(shape: type[Obstacle]) -> tuple[tuple[str, int], ...]:
    """Names and axes of what a shape is made of on a body."""
    declared = [x for x in fields(shape) if AXES in x.metadata and x.default is MISSING]
    return tuple((x.name, x.metadata[AXES]) for x in declared)


def count_of(shape: type[Obstacle]) -> int:
    """How many numbers that is."""
    return sum(3**axes for _, axes in _made_of(shape))


def numbers_of(shape: Obstacle) -> Tensor:
    """(..., n) of a shape of a body, see `Obstacle.in_body`."""
    parts = [(getattr(shape, name), axes) for name, axes in _made_of(type(shape))]
    return stacked(*(x.reshape(*x.shape[: x.ndim - n], 3**n) for x, n in parts), axis=-1)


def with_numbers(shape: type[Obstacle], numbers: Tensor) -> Obstacle:
    """Of a class that with these numbers (..., n or more)."""
    new, values, first = object.__new__(shape), dict[str, Any](), 0
    for name, axes in _made_of(shape):
        x, first = numbers[..., first : first + 3**axes], first + 3**axes
        values[name] = x.reshape(*x.shape[:-1], *(3,) * axes)
    vars(new).update(values)
    return new
