"""Laws of contact at a point, of any number of them: what presses, what damps, what rubs.

Surfaces press where their gap is below a thickness d, by y = d - gap: with y_+ what of y is above
zero,

    potential  phi(y) = k/(6 d) (y_+^3 - (y - d)_+^3)    J per area, or per length of a line
    pressure   phi'   = P (y/d)^2 up to y = d, where surfaces meet, P = k d/2; then P + k (y - d)

with two continuous derivatives of the potential. Over a step the pressure is the difference of the
potential over that of the gap (Simo and Tarnow 1992; Gonzalez 1996), so that it gives back what it
took.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from .drag import norm


def pressure(before: Tensor, after: Tensor, thickness: Tensor, stiffness: Tensor) -> Tensor:
    """Mean over a step from y to y, (...) each: (phi(after) - phi(before))/(after - before)."""
    cubes = _quotient(before, after) - _quotient(before - thickness, after - thickness)
    return stiffness / (6 * thickness) * cubes


def potential(y: Tensor, thickness: Tensor, stiffness: Tensor) -> Tensor:
    """phi(y), (...) J per area, or per length of a line."""
    cubes = y.clamp(min=0) ** 3 - (y - thickness).clamp(min=0) ** 3
    return stiffness / (6 * thickness) * cubes


def _quotient(x: Tensor, y: Tensor) -> Tensor:
    """(y_+^3 - x_+^3)/(y - x), also where these are next to each other."""
    a, b, change = x.clamp(min=0), y.clamp(min=0), y - x
    both = (x > 0) & (y > 0)
    share = (b - a) / torch.where(both | (change == 0), torch.ones_like(change), change)
    return torch.where(both, torch.ones_like(share), share) * (a * a + a * b + b * b)


def damped(approach: Tensor) -> Tensor:
    """Factor of the pressure, by the rate of approach times a damping time over the thickness, of
    no unit: 1 at rest, above while surfaces come near, below while they part, and never negative.
    """
    root = (1 + approach * approach).sqrt()
    away = approach < 0
    # of approach + root, without the difference of two that are alike
    return torch.where(
        away, 1 / (root - torch.where(away, approach, torch.zeros_like(approach))), approach + root
    )


def rubbing(slip: Tensor, slip_speed: Tensor, told: Tensor | None = None) -> Tensor:
    """Sense of friction (..., 3): direction and share of what it takes of its most, from the
    velocity slip (..., 3): slip/|slip| beyond the slip speed v, and below it (2 - |slip|/v) slip/v,
    which is the derivative of a potential by the slip, with one continuous derivative itself.

    A tangent of it goes from slip to slip the other way and back where surfaces stick. With the
    sense z an unknown of its own in z = ratio(|slip|) slip, Newton's method has the slope ratio I +
    ratio' (y/ratio) (slip/|slip|)^T instead, y what the last iteration's slope has `foretold` of
    z, no longer than 1 (Chan, Golub and Mulet 1999); at the solution y = z, and the slope is that
    of the tangent.

    told  (..., 6), see `telling`; None = the derivative is the tangent
    """
    ratio = _ratio(norm(slip), slip_speed)
    if told is None:
        return ratio * slip
    still = ratio.detach()
    y = foretold(slip.detach(), slip_speed, told)
    return still * slip + (ratio - still) * (y / still)


def foretold(slip: Tensor, slip_speed: Tensor, told: Tensor | None) -> Tensor:
    """The sense (..., 3) that the last iteration's slope gives this slip, see `rubbing`; where it
    has told nothing, the slip's own.
    """
    ahead = _ratio(norm(slip), slip_speed) * slip
    if told is None:
        return ahead
    y, last = told.split(3, -1)
    speed = norm(last)
    known = speed > 0
    change = ((slip - last) * last).sum(-1, keepdim=True) / torch.where(known, speed, 1.0)
    new = _ratio(speed, slip_speed) * slip
    new = new - y * (change / torch.maximum(speed, 2 * slip_speed - speed))
    return torch.where(known, new / norm(new).clamp(min=1), ahead)


def telling(slip: Tensor, slip_speed: Tensor, told: Tensor | None) -> Tensor:
    """What this iteration tells the next one (..., 6): the sense that was foretold, and the slip;
    zeros tell nothing.
    """
    return torch.cat((foretold(slip, slip_speed, told), slip), -1)


def _ratio(speed: Tensor, slip_speed: Tensor) -> Tensor:
    """Of the sense to the slip."""
    slow = speed < slip_speed
    fast = 1 / torch.where(slow, torch.ones_like(speed), speed)
    return torch.where(slow, (2 - speed / slip_speed) / slip_speed, fast)


AtPoints = Callable[[Tensor], Tensor]  # what is asked of points
MEETINGS = 4  # of tangents


def leads_through(gap: AtPoints, directions: AtPoints, start: Tensor, end: Tensor) -> Tensor:
    """(..., n) bool: whether straight ways from points to points (..., n, 3) lead through what has
    the gap (..., n, 1) m and its gradient `directions`: inside in between, and outside at both
    ends, or out on another side than in.
    """
    inside = least_along(gap, directions, start, end - start) < 0
    out = torch.minimum(gap(start), gap(end)) > 0
    turned = (directions(start) * directions(end)).sum(-1, keepdim=True) < 0
    return (inside & (out | turned))[..., 0]


def least_along(gap: AtPoints, directions: AtPoints, start: Tensor, way: Tensor) -> Tensor:
    """(..., n, 1) m: about the smallest gap on straight ways (..., n, 3) from points on, with its
    gradient `directions`. It is convex along a line, as what can be passed through is: least near
    where the tangents at both ends meet, nearer yet between there and the end towards which it
    falls, and so on. Above a face it is straight, so that a few meetings find a thin box.
    """

    def at(share: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        x = start + share * way
        return share, gap(x), (directions(x) * way).sum(-1, keepdim=True)

    none = torch.zeros_like(way[..., :1])
    first, last = at(none), at(none + 1)
    least = torch.minimum(first[1], last[1])
    for _ in range(MEETINGS):
        middle = at(_meeting(first, last))
        least, falls = torch.minimum(least, middle[1]), middle[2] < 0
        first, last = (
            tuple(torch.where(taken, m, x) for m, x in zip(middle, end, strict=True))
            for taken, end in ((falls, first), (~falls, last))
        )
    return least


def _meeting(first: tuple[Tensor, ...], last: tuple[Tensor, ...]) -> Tensor:
    """Where the tangents of a convex function meet, by places, values and slopes at two ends; the
    lower end where it does not fall first and rise then.
    """
    (a, f, fall), (b, g, rise) = first, last
    bent = (fall < 0) & (rise > 0)
    share = (g - f - rise * (b - a)) / torch.where(bent, fall - rise, 1.0)
    return torch.where(bent, a + share, torch.where(fall < 0, b, a))
