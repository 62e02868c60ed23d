"""Maxwell arms beside a spring: what a section's stress forgets.

With e the strain less eigenstrain, C the instantaneous stiffness, g_i and tau_i the shares and
times of the arms, and q_i what their dashpots have crept by,

    [F; M] = C ((1 - sum g_i) e + sum g_i d_i)        d_i = e - q_i        tau_i q_i' = d_i

Over a step of h the strain is taken for linear in time. Then the arms have a closed form, and so
has the mean of their stress: with z = h/tau, de the change of strain,

    d_{n+1} = E d_n + phi de             E = exp(-z)    phi = (1 - E)/z
    mean d  = phi d_n + psi de           psi = (1 - phi)/z

(Simo and Hughes 1998, section 10.3, have the first line; Taylor, Pister and Goudreau 1970.) A
midpoint step has the mean, generalized alpha the end.

The energy balance of a step is that of the exact solution along this strain: as de/dt is constant,
the work of an arm is the integral of g d C de/dt = g (mean d) C de. Its energy g d C d/2 changes by
the integral of g d C (de/dt - d/tau). So what it dissipates is

    g (mean d) C de - [g d C d/2]_n^{n+1} = integral of g d C d/tau dt >= 0

whatever the step is to the time: no step gains energy, and the sum is exact to rounding. (The
exact end with the mean of both ends' stress, (d_n + d_{n+1})/2, does not have this: its dissipation
is the product of two different linear forms, and negative for some d_n and de.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.leaves import Tree, leaf

SMALL = 0.5  # of h/tau: below it psi comes from its series
TERMS = 14  # of that, of which the next is below rounding


class Decay(NamedTuple):
    """E, phi and psi (..., N or 1, k or 1, m) of a step."""

    kept: Tensor
    mean: Tensor
    rising: Tensor


@dataclass(frozen=True)
class MaxwellArms(Tree):
    """shares (..., N or 1, k or 1, m) of the stiffness; times s likewise. What dashpots have crept
    by is (..., N, m k) in a state, (..., N, k, m) here.
    """

    shares: Tensor = leaf(3)
    times: Tensor = leaf(3)

    @property
    def count(self) -> int:
        return self.shares.shape[-1]

    @property
    def remaining(self) -> Tensor:
        """(..., N or 1, k or 1): of the stiffness, at last."""
        return 1 - self.shares.sum(-1)

    def each(self, crept: Tensor) -> Tensor:
        """(..., N, k, m) of a state's."""
        return crept.unflatten(-1, (self.count, -1)).mT

    def decay(self, h: Tensor) -> Decay:
        """Over a step of h (..., 1, 1) s."""
        z = h[..., None] / self.times
        rise = -torch.expm1(-z)
        phi = rise / z
        small = z.abs() < SMALL
        few = torch.where(small, z, 0.0)
        series = torch.zeros_like(few)
        for n in range(TERMS, 1, -1):  # 1/2 - z/6 + z^2/24 - ...
            series = (1 - few * series) / n
        return Decay(1 - rise, phi, torch.where(small, series, (1 - phi) / z))

    def relaxed(
        self,
        strain: Tensor,
        start: Tensor,
        change: Tensor,
        crept: Tensor,
        of: tuple[Tensor, Tensor],
    ) -> Tensor:
        """The strain (..., N, k) that stress answers to, from the strain at the same time or in the
        mean, that at the start, its change over the step, and what has crept at the start; of: E
        and phi at the end, phi and psi in the mean.
        """
        by_start, by_change = of
        lag = by_start * (start[..., None] - self.each(crept)) + by_change * change[..., None]
        return self.remaining * strain + (self.shares * lag).sum(-1)

    def relaxed_by(self, change: Tensor) -> Tensor:
        """(..., N or 1, k or 1): derivative of `relaxed` by the strain at its time, by which the
        change over the step has the derivative `change` over that of the lag.
        """
        return self.remaining + (self.shares * change).sum(-1)

    def advanced(self, start: Tensor, change: Tensor, crept: Tensor, decay: Decay) -> Tensor:
        """What has crept at the end of a step, (..., N, m k)."""
        left = decay.kept * (start[..., None] - self.each(crept)) + decay.mean * change[..., None]
        return ((start + change)[..., None] - left).mT.flatten(-2)

    def now(self, strain: Tensor, crept: Tensor) -> Tensor:
        """The strain (..., N, k) that stress answers to, of a strain at an instant."""
        return strain - (self.shares * self.each(crept)).sum(-1)

    def unrelaxed(self, strain: Tensor) -> Tensor:
        """The strain (..., N, k) of which `at_rest` of the law makes this one."""
        return strain / self.remaining

    def rate(self, strain: Tensor, crept: Tensor) -> Tensor:
        """1/s: of what has crept, (..., N, m k)."""
        return ((strain[..., None] - self.each(crept)) / self.times).mT.flatten(-2)

    def at_rest(self, strain: Tensor) -> Tensor:
        """What has crept under a strain (..., N, k) that lasts, (..., N, m k)."""
        return torch.cat([strain] * self.count, -1)


def arms_of(scene: Any, space: Any, own: Tensor | None) -> MaxwellArms | None:
    """Of the elements of a scene; own (..., N or 1, 6): of their flexibilities, the section's own
    part, the rest being that of bending across (linked interpolation), None = all.

    Raises ValueError for six rows on a coupled section, or on elements that taper.
    """
    beam, effects = scene.beam, scene.viscoelastic
    if not effects:
        return None
    if (beam.coupled or beam.taper is not None) and any(effect.six for effect in effects):
        raise ValueError(
            "Viscoelastic with a row for each strain was given for a section whose strains are "
            "coupled, or that tapers; one row of shares and times is wanted there"
        )
    rows = [_rows(effect, own, scene.arms) for effect in effects]
    if effects[0].on is None:
        shares, times = rows[0]
    else:
        shares, times = 0.0, 1.0
        for effect, (share, time) in zip(effects, rows, strict=True):
            (span,) = beam.spans(effect)
            here = torch.zeros(beam.station_count, 1, 1, dtype=share.dtype, device=share.device)
            here[span.stations] = 1
            shares, times = shares + here * share, times + here * (time - 1)
    if shares.shape[-2] > 1 or times.shape[-2] > 1:
        shares, times = (x.expand(*x.shape[:-2], 6, x.shape[-1]) for x in (shares, times))
        shares, times = (space.project_diagonal(x.mT).mT for x in (shares, times))
    return MaxwellArms(shares, times)


def _rows(effect: Any, own: Tensor | None, count: int) -> tuple[Tensor, Tensor]:
    """Shares and times (..., N or 1, 6 or 1, m) of an effect, for so many arms: of those that it
    lacks the shares are zero.
    """
    values = []
    for x, none in ((effect.shares, 0.0), (effect.times, 1.0)):
        if x.shape[-1] < count:
            x = pad(x, (0, count - x.shape[-1]), value=none)
        x = x[..., None, :, :] if effect.six else x[..., None, None, :]
        if effect.six and own is not None:
            across = x[..., [0, 5, 4, 3, 4, 5], :]  # y and z of shear: bent about z and y
            x = own[..., None] * x + (1 - own)[..., None] * across
        values.append(x)
    return values[0], values[1]
