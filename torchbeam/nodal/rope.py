"""Rope: the force of a tendon on the points that it goes through.

Through the points p_0 ... p_n, with q_k = p_{k+1} - p_k, d_k = |q_k| and the length c = sum d_k,
the tension of stretch k is T_k = T rho_k, and over a step

    f(p_k) = T_k u_k - T_{k-1} u_{k-1}        u_k = 2 (mean q_k)/(d_k,n + d_k,n+1)

As mean q_k . (q_{n+1} - q_n) = (d_{n+1}^2 - d_n^2)/2, u_k . (q_{n+1} - q_n) is the change of its
length, and stretch k does the work -T_k times that, to rounding: f is a discrete gradient (Gonzalez
1996). T is given (what is negative of it is 0), or follows from the length l that a winch gives at
both ends of the step,

    T = (V(x_{n+1}) - V(x_n))/(x_{n+1} - x_n)        x = c - l, V = k x^2/2 where x > 0, else 0

so that T (c_{n+1} - c_n) = V(x_{n+1}) - V(x_n) + T (l_{n+1} - l_n): the winch's work is the rest.
With the mean of l instead, a haul makes a rope slack at the end of each step that is taut there.

At the point j between two stretches, whose directions differ by theta_j, the rope slides by the
rate r_j = d/dt sum_{k >= j} d_k, and (Euler and Eytelwein)

    ln rho_k = sum_{1 <= j <= k} mu theta_j r_j/sqrt(r_j^2 + s^2)

with r at the end of the step: 2 (change of length)/dt less the rate before. theta is smooth where
stretches are in line: with the chord e between their directions 2 asin(e/2), e from sqrt(|.|^2 +
SOFT^2) - SOFT. At an instant d_n = d_{n+1}, and friction is that of a rope which is pulled at its
first end, r/sqrt(r^2 + s^2) = -1.

A tangent of the sense z = r/sqrt(r^2 + s^2) goes from slip to slip the other way and back where a
rope sticks. With z an unknown of its own in z sqrt(r^2 + s^2) = r, Newton's method has the slope
(1 - y z)/sqrt(r^2 + s^2) instead, y what the last iteration's slope has foretold of z, within -1
and 1 (Chan, Golub and Mulet 1999); at the solution y = z, and the slope is that of the tangent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.leaves import Tree, leaf

SOFT = 1e-3  # rad


class RopeStep(NamedTuple):
    """Points (..., m, 3) where forces act, after and before (None = an instant, where they are the
    same); given (..., 1 or 2): tension N or length m, two of a winch, at start and end; dt (...) s,
    rates of the points before and the way that they go (..., m, 3), None = at an instant, or
    without friction. The way is not from after and before, of which single precision leaves too few
    digits. told (..., m - 2, 2): see `Grip`.
    """

    acting: Tensor
    after: Tensor
    before: Tensor | None
    given: Tensor
    dt: Tensor | None = None
    rates: Tensor | None = None
    way: Tensor | None = None
    told: Tensor | None = None


class Stretches(NamedTuple):
    """Between neighbouring points: mean q (..., n, 3), lengths before and after (..., n),
    directions before and after (..., n, 3).
    """

    q: Tensor
    lengths: tuple[Tensor, Tensor]
    directions: tuple[Tensor, Tensor]

    @classmethod
    def of(cls, step: RopeStep) -> Stretches:
        after = _unit(step.after.diff(dim=-2))
        before = after if step.before is None else _unit(step.before.diff(dim=-2))
        return cls(step.acting.diff(dim=-2), (before[0], after[0]), (before[1], after[1]))

    @property
    def size(self) -> Tensor:
        """(..., n, 1) sum of the lengths before and after."""
        return (self.lengths[0] + self.lengths[1])[..., None]

    @property
    def u(self) -> Tensor:
        return 2 * self.q / self.size

    def change(self, step: RopeStep) -> Tensor:
        """(..., n) m of their lengths, over a step with friction."""
        ends = step.after.diff(dim=-2) + step.before.diff(dim=-2)
        return (ends * step.way.diff(dim=-2)).sum(-1) / self.size[..., 0]


class Grip(NamedTuple):
    """Friction at a point between two stretches: by which the logarithm of the tension rises
    (...), and its derivatives by the directions before the point and behind it (..., 3), which are
    `turn` and less that, and by how much longer is what lies beyond (...), None = not at all; told
    (..., 2): the sense where nothing slides and its slope s/m, as the next iteration is told them.
    """

    log: Tensor
    turn: Tensor
    slide: Tensor | None
    told: Tensor | None = None


class Tensions(NamedTuple):
    """T_k (..., n), and its derivative (..., n, n, 3) by each stretch's q after the step,
    None = not asked for.
    """

    value: Tensor
    by: Tensor | None


@dataclass(frozen=True)
class Rope(Tree):
    """Of one tendon.

    drawn       (...) m, its length as drawn
    stiffness   (...) N/m, friction (...), slip_speed (...) m/s; None = it has none
    """

    drawn: Tensor = leaf(0)
    stiffness: Tensor | None = leaf(0, default=None)
    friction: Tensor | None = leaf(0, default=None)
    slip_speed: Tensor | None = leaf(0, default=None)

    def raised(self, drive: Tensor, share: Tensor | None) -> Tensor:
        """What is given (..., 1 or 2) where loads are raised as far as `share` (...), None = all:
        from slack, or from as drawn.
        """
        if share is None:
            return drive
        start = 0.0 if self.stiffness is None else self.drawn[..., None]
        return start + share[..., None] * (drive - start)

    def forces(self, step: RopeStep) -> Tensor:
        """(..., m, 3) N on the points."""
        stretches = Stretches.of(step)
        return _at_points(self.tensions(step, stretches, False).value[..., None] * stretches.u)

    def tangent(self, step: RopeStep) -> tuple[Tensor, Tensor]:
        """Their derivatives (..., m, 3, m, 3) by the points where forces act and after the step."""
        stretches = Stretches.of(step)
        T, by = self.tensions(step, stretches, True)
        u, n, e = stretches.u, stretches.q.shape[-2], stretches.directions[1]
        same = torch.eye(n, dtype=u.dtype, device=u.device)[:, None, :, None]
        eye = torch.eye(3, dtype=u.dtype, device=u.device)[:, None, :]
        weight = (T[..., None] / stretches.size)[..., None, None]
        acting = 2 * weight * same * eye
        sides = 2 if step.before is None else 1  # both lengths are that after
        after = u[..., None, None] * by[..., :, None, :, :] - sides * weight * same * (
            u[..., None, None] * e[..., None, None, :, :]
        )
        return _both(acting.expand(after.shape)), _both(after)

    def readings(self, step: RopeStep) -> tuple[Tensor, Tensor]:
        """Tensions (..., n) N of the stretches; their lengths (..., 2, n) m before and after."""
        stretches = Stretches.of(step)
        T = self.tensions(step, stretches, False).value
        return T, torch.stack(torch.broadcast_tensors(*stretches.lengths), -2)

    def tensions(self, step: RopeStep, stretches: Stretches, derivative: bool) -> Tensions:
        before, after = stretches.lengths
        over = None if step.before is None else before.sum(-1)
        change = None if step.way is None else stretches.change(step).sum(-1)
        T, slope = self.pull(step.given, after.sum(-1), over, change)
        e = stretches.directions[1]
        T, slope, _ = torch.broadcast_tensors(T[..., None], slope[..., None], after)
        by = slope[..., None, None] * e[..., None, :, :] if derivative else None
        if self.friction is None or e.shape[-2] == 1:
            return Tensions(T, by)
        log, log_by = self._friction(step, stretches, derivative)
        rho = torch.exp(log)
        if derivative:
            by = rho[..., None, None] * (by + T[..., None, None] * log_by)
        return Tensions(T * rho, by)

    def pull(
        self,
        drive: Tensor,
        after: Tensor,
        before: Tensor | None = None,
        change: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """T (...) of the whole, of this length after a step and before it, None = at an instant;
        and its derivative by the length after. drive: see `RopeStep`. change (...) m: of the
        length, which single precision has to more digits than the difference of both, None = not
        known by itself.
        """
        start, end = drive[..., 0], drive[..., -1]
        if self.stiffness is None:
            return end.clamp(min=0), torch.zeros_like(after)
        x = after - end
        p = x.clamp(min=0)
        if before is None:
            return self.stiffness * p, self.stiffness * (x > 0)
        y = before - start
        if change is not None:
            x = y + change if drive.shape[-1] == 1 else y + change - (end - start)
            p = x.clamp(min=0)
        q = y.clamp(min=0)
        across = (x > 0) != (y > 0)
        apart = torch.where(across, x - y, 1.0)
        mean = torch.where(across, (p**2 - q**2) / apart, p + q) / 2
        by = torch.where(across, (p - mean) / apart, ((x > 0) & (y > 0)).to(p) / 2)
        return self.stiffness * mean, self.stiffness * by

    def _friction(
        self, step: RopeStep, stretches: Stretches, derivative: bool
    ) -> tuple[Tensor, Tensor | None]:
        """ln rho_k (..., n), and its derivative (..., n, n, 3) by each stretch's q after."""
        after, e, grip = stretches.lengths[1], stretches.directions[1], self.grips(step, stretches)
        n = e.shape[-2]
        log = pad(grip.log.cumsum(-1), (1, 0))
        if not derivative:
            return log, None
        eye = torch.eye(n, dtype=e.dtype, device=e.device)
        turns = grip.turn[..., None, :] * (eye[:-1] - eye[1:])[..., None]  # (..., n - 1, n, 3)
        by = along_stretch(turns, e[..., None, :, :], after[..., None, :])
        if grip.slide is not None:
            beyond = torch.ones(n - 1, n, dtype=e.dtype, device=e.device).triu(1)[..., None]
            by = by + grip.slide[..., None, None] * beyond * e[..., None, :, :]
        return log, pad(by.cumsum(-3), (0, 0, 0, 0, 1, 0))

    def grips(self, step: RopeStep, stretches: Stretches) -> Grip:
        """At all points between stretches."""
        e, slide = stretches.directions[1], None
        if step.dt is not None:
            start = stretches.directions[0] * step.rates.diff(dim=-2)
            slide = _beyond(stretches.change(step)), _beyond(start.sum(-1)), step.dt
        return self.grip(e[..., :-1, :], e[..., 1:, :], slide, step.told)

    def grip(
        self,
        before: Tensor,
        behind: Tensor,
        slide: tuple[Tensor, Tensor, Tensor] | None,
        told: Tensor | None = None,
    ) -> Grip:
        """At points (..., n), of the directions before and behind them (..., n, 3); slide: how much
        longer what lies beyond has become in the step (..., n) m, the rate at which it did before
        m/s, and dt (...) s; None = at an instant. told (..., n, 2): by the last iteration, None, or
        a slope of 0, = there was none.
        """
        chord = behind - before
        size = torch.sqrt(chord.square().sum(-1) + SOFT**2)
        half = (size - SOFT) / 2
        theta = 2 * torch.asin(half.clamp(max=1.0))
        mu = self.friction[..., None]
        if slide is None:
            sense, sense_by, tells = -torch.ones_like(theta), None, None
        else:
            changes, start, dt = slide
            r, s = 2 * changes / dt[..., None] - start, self.slip_speed[..., None]
            root = torch.sqrt(r.square() + s.square())
            sense, slope = r / root, s**2 / root**3
            if told is not None:
                foretold = (told[..., 0] + told[..., 1] * r).clamp(-1.0, 1.0)
                foretold = torch.where(told[..., 1] == 0, sense, foretold)
                slope = slope + (sense - foretold) * sense / root
            tells = torch.stack((sense - slope * r, slope), -1)
            sense_by = slope * 2 / dt[..., None]
        turn = mu * sense / torch.sqrt((1 - half.square()).clamp(min=SOFT**2)) / size
        by_slide = None if sense_by is None else mu * theta * sense_by
        return Grip(mu * theta * sense, -turn[..., None] * chord, by_slide, tells)


def along_stretch(by: Tensor, direction: Tensor, length: Tensor) -> Tensor:
    """Derivative (..., 3) by a stretch's q, from that by its direction."""
    return (by - (by * direction).sum(-1, keepdim=True) * direction) / length[..., None]


def _unit(q: Tensor) -> tuple[Tensor, Tensor]:
    """Lengths (..., n) and directions (..., n, 3); of no length, one of 1 and none."""
    there = (q != 0).any(-1, keepdim=True)
    size = torch.linalg.vector_norm(torch.where(there, q, 1.0), dim=-1)
    size = torch.where(there[..., 0], size, 1.0)
    return size, q / size[..., None]


def _beyond(x: Tensor) -> Tensor:
    """(..., n) of the stretches -> (..., n - 1) sums of those beyond each point between."""
    return x.flip(-1).cumsum(-1).flip(-1)[..., 1:]


def _at_points(x: Tensor) -> Tensor:
    """Of the stretches (..., n, 3): what pulls their points together, (..., m, 3)."""
    return pad(x, (0, 0, 0, 1)) - pad(x, (0, 0, 1, 0))


def _both(x: Tensor) -> Tensor:
    """(..., n, 3, n, 3) of the stretches, rows and columns -> of the points."""
    rows = pad(x, (0, 0, 0, 0, 0, 0, 0, 1)) - pad(x, (0, 0, 0, 0, 0, 0, 1, 0))
    return pad(rows, (0, 0, 1, 0)) - pad(rows, (0, 0, 0, 1))
