"""Laws of joints' coordinates q, the angle of a hinge or the travel of a slider: by which effort
they resist.

    springs and limits   -(V(q_{n+1}) - V(q_n))/D      V = k q^2/2, and beyond a limit k
                         (x^3 - (x - e)^3)/(6 e), see below
    damping              -c D/dt
    friction             -mu r/sqrt(r^2 + s^2)         r = 2 (q_{n+1} - q_n)/dt - r_n, the rate at
                         the end of the step

D is what the effort's work is counted by over a step (see `driven_joints`): 2
sin((q_{n+1} - q_n)/2) of an angle, the difference of a travel. So springs and limits keep their
energy, and damping takes some, to rounding. Friction is Coulomb's, regularised: the gradient of the
dissipation potential mu sqrt(r^2 + s^2), with the slip speed s, at the end of the step, so that
what sticks comes to rest within a step, and errors are of first order. x is how far q is beyond a
limit, and e a hundredth of the range between the limits, over which their stiffness rises. At rest
D is the differential, and there is neither damping nor friction. Of inertia see `joint_inertia`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.leaves import Tree, leaf

SOFT = 0.01  # of the range between limits: over which their stiffness rises
SMALL = 1e-2  # rad: angles whose ratios are series


class CoordinateStep(NamedTuple):
    """Coordinates (..., J, w) before and after, which of them are angles (J, w) bool; dt
    (..., 1, 1) s, None = at rest: there before and after are the same; the rates before, if there
    is friction.
    """

    before: Tensor
    after: Tensor
    angles: Tensor
    dt: Tensor | None
    rate: Tensor | None

    def difference(self) -> tuple[Tensor, Tensor]:
        """D, and its derivative by `after`."""
        change = self.after - self.before
        return (
            torch.where(self.angles, 2 * torch.sin(change / 2), change),
            torch.where(self.angles, torch.cos(change / 2), torch.ones_like(change)),
        )

    def arc(self) -> tuple[Tensor, Tensor]:
        """The change of the coordinate over D, and the derivative of that by `after`."""
        half = torch.where(self.angles, (self.after - self.before) / 2, 0.0)
        small = half.abs() < SMALL
        safe = torch.where(small, 1.0, half)
        sine = torch.sin(safe)
        ratio = torch.where(small, 1 + half**2 / 6 + 7 * half**4 / 360, safe / sine)
        by = torch.where(
            small, half / 6 + 7 * half**3 / 180, (1 - safe * torch.cos(safe) / sine) / (2 * sine)
        )
        return ratio, by


class Losses(Tree):
    """What laws lose by: `damping` and `friction` with a `slip_speed`, None = there is none."""

    damping: Any
    friction: Any
    slip_speed: Any

    @property
    def dissipative(self) -> bool:
        return self.damping is not None or self.friction is not None

    @property
    def damper(self) -> Tensor | float:
        """-d(effort)/d(rate), or of a moment by the spin, next to rest."""
        total = 0.0 if self.damping is None else self.damping
        return total if self.friction is None else total + self.friction / self._slip

    @property
    def _slip(self) -> Tensor:
        return torch.where(self.slip_speed > 0, self.slip_speed, 1.0)


@dataclass(frozen=True)
class JointLaws(Losses):
    """Of all joints (..., J, w), zero where a coordinate has none; None where no joint has one.
    Stiffness N/m or N m/rad, damping N s/m or N m s/rad, friction N or N m with the slip speed m/s
    or rad/s, limits m or rad and their stiffness, inertia kg or kg m^2.
    """

    stiffness: Tensor | None = leaf(2)
    damping: Tensor | None = leaf(2)
    friction: Tensor | None = leaf(2)
    slip_speed: Tensor | None = leaf(2)
    lowest: Tensor | None = leaf(2)
    highest: Tensor | None = leaf(2)
    limit_stiffness: Tensor | None = leaf(2)
    inertia: Tensor | None = leaf(2)

    def effort(self, step: CoordinateStep) -> tuple[Tensor, Tensor]:
        """Effort (..., J, w) N or N m, and its derivative by coordinates after the step."""
        total = by = torch.zeros_like(step.after)
        slope, slope_by = self._slope(step.after, step.before)
        if step.dt is None:
            return total - slope, by - 2 * slope_by
        if slope is not total:
            ratio, ratio_by = step.arc()
            total, by = total - slope * ratio, by - slope_by * ratio - slope * ratio_by
        if self.damping is not None:
            D, D_by = step.difference()
            total, by = total - self.damping * D / step.dt, by - self.damping * D_by / step.dt
        if self.friction is not None:
            rate = 2 * (step.after - step.before) / step.dt - step.rate
            slip = self._slip
            size = torch.sqrt(rate**2 + slip**2)
            total = total - self.friction * rate / size
            by = by - self.friction * slip**2 / size**3 * 2 / step.dt
        return total, by

    def _slope(self, q: Tensor, p: Tensor) -> tuple[Tensor, Tensor]:
        """(V(q) - V(p))/(q - p), where they are one its limit V', and the derivative by q."""
        total = by = torch.zeros_like(q)
        if self.stiffness is not None:
            total, by = total + self.stiffness * (q + p) / 2, by + self.stiffness / 2
        if self.limit_stiffness is not None:
            span = self.highest - self.lowest
            for sign, limit in ((1.0, self.highest), (-1.0, self.lowest)):
                push, push_by = limit_slope(
                    sign * q, sign * p, sign * limit, self.limit_stiffness, span
                )
                total, by = total + sign * push, by + push_by
        return total, by


def limit_slope(
    q: Tensor, p: Tensor, limit: Tensor, stiffness: Tensor, span: Tensor
) -> tuple[Tensor, Tensor]:
    """(V(q) - V(p))/(q - p) of the energy V beyond a limit whose stiffness rises over a hundredth
    of the span, and its derivative by q.
    """
    soft = SOFT * span
    soft = torch.where(soft > 0, soft, 1.0)
    k = stiffness / (6 * soft)
    x, y = q - limit, p - limit
    (near, near_by), (far, far_by) = _cubes(x, y), _cubes(x - soft, y - soft)
    return k * (near - far), k * (near_by - far_by)


def _cubes(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """(a+^3 - b+^3)/(a - b) of the positive parts, and its derivative by a."""
    p, q = a.clamp(min=0), b.clamp(min=0)
    across = (a > 0) != (b > 0)
    apart = torch.where(across, a - b, 1.0)
    squares = p**2 + p * q + q**2
    return (
        torch.where(across, (p**3 - q**3) / apart, squares),
        torch.where(across, (3 * p**2 - (p**3 - q**3) / apart) / apart, 2 * p + q),
    )
