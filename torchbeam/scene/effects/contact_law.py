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


def rubbing(slip: Tensor, slip_speed: Tensor, secant: Tensor | None = None) -> Tensor:
    """Direction and share (..., 3) of what friction takes of its most, from the velocity slip
    (..., 3): slip/|slip| beyond the slip speed v, and below it (2 - |slip|/v) slip/v, which is the
    derivative of a potential by the slip, with one continuous derivative itself.

    secant  1 where its derivative by the slip is to be the secant, share of the most over slip, as
            if that ratio stayed; see `newton`
    """
    speed = norm(slip)
    slow = speed < slip_speed
    fast = 1 / torch.where(slow, torch.ones_like(speed), speed)
    ratio = torch.where(slow, (2 - speed / slip_speed) / slip_speed, fast)
    if secant is not None:
        ratio = ratio.detach() + (1 - secant) * (ratio - ratio.detach())
    return ratio * slip
