"""Viscoelasticity: stress that relaxes, by Maxwell arms beside a spring (a Prony series)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import torch

from ...core.arguments import boolean, whole
from ...core.leaves import leaf, option
from ...core.validation import Value, as_tensor, common_dtype, concrete, refusal
from ...math.nonnegative import nonnegative_least_squares
from .effect import Effect

REACH = 10.0  # of the times of a fitted series, beyond its band
FITTED = 60  # frequencies in the band
REST = 100.0  # weight of the stiffness at rest beside one of these


@dataclass(frozen=True)
class Viscoelastic(Effect):
    """Generalised Maxwell material: the section as given is the instantaneous one, and its stress
    relaxes to 1 - sum(shares) of that.

        [F; M] = C (e - sum of share_i q_i)        time_i dq_i/dt = e - q_i

    with e the strain less eigenstrain and C the section's stiffness. At a constant strain the
    stress is C e (1 - sum of share_i (1 - exp(-t/time_i))). An equilibrium has come to rest, with
    the long-time stiffness; that of the scene without the effect is the instantaneous one. A motion
    that starts from a state without memory starts unrelaxed, at q_i = 0.

    Args:
        shares: (..., m) of the instantaneous stiffness, one of each arm; or (..., 6, m), for each
            strain [gamma1..3, kappa1..3] its own
        times: (..., m) s, relaxation times; or (..., 6, m), as the shares
        six: whether shares and times have a row for each strain. Default: true for a sequence of
            sequences. A tensor or an array is (..., m), one row with batch axes
        on: name of a beam of a structure; None = all. Each beam may have its own

    Attributes:
        error: how far the complex stiffness of `fractional` is off in its band, relative

    Six rows are for a section whose stiffness is diagonal: arms that relax some strains alone could
    make a coupled one indefinite. With linked interpolation a strain of shear, which bending has a
    part in, takes the mean of both rows by their flexibilities; the part vanishes with the
    elements' length.

    Source: Christensen 1982, Theory of Viscoelasticity, chapter 1; Simo and Hughes 1998,
    Computational Inelasticity, chapter 10.

    Raises:
        ValueError: for negative shares, shares whose sum is 1 or more, times that are not positive,
            and other shapes.

    Examples:
        >>> soft = tb.Scene(beam, [tb.Viscoelastic(shares=(0.3, 0.2), times=(0.1, 2.0))])  # s
        >>> tb.modes(soft, count=1).damping_ratio
        tensor([0.1033])
    """

    shares: Value = leaf(lambda arms: 1 + int(arms.six), nonnegative=True, name="shares")
    times: Value = leaf(lambda arms: 1 + int(arms.six), positive=True, name="times")
    six: bool | None = option(boolean, default=None, name="six")
    on: str | None = field(default=None, kw_only=True)
    error: float = field(default=0.0, kw_only=True)

    by_place = False
    kind = "memory"

    def __post_init__(self) -> None:
        if self.six is None:
            object.__setattr__(self, "six", _rows(self.shares) or _rows(self.times))
        super().__post_init__()
        for name in ("shares", "times"):
            value = getattr(self, name)
            if self.six and value.ndim == 1:  # the same of all strains
                rows = as_tensor(value, *common_dtype(value)).expand(6, -1)
                object.__setattr__(self, name, rows)
        both = [(name, tuple(getattr(self, name).shape)) for name in ("shares", "times")]
        wanted = "(..., 6, m)" if self.six else "(..., m)"
        for name, shape in both:
            if len(shape) < 1 + self.six or shape[-1] == 0 or (self.six and shape[-2] != 6):
                raise refusal(f"{name} of shape {shape}", wanted)
        if both[0][1][-1] != both[1][1][-1]:
            raise ValueError(
                f"{both[0][1][-1]} shares and {both[1][1][-1]} times were given; one time for each "
                "share is wanted"
            )
        total = torch.as_tensor(self.shares).detach().sum(-1)
        if concrete(total >= 1).any():
            raise ValueError(
                f"shares with the sum {concrete(total).max().item():g} were given; less than 1 is "
                "wanted, which leaves the beam a stiffness"
            )

    @classmethod
    def fractional(
        cls,
        order: Value,
        share: Value,
        time: Value,
        frequencies: tuple[float, float],
        *,
        arms: int | None = None,
        on: str | None = None,
    ) -> Viscoelastic:
        """A spring-pot beside a spring: damping that hardly depends on the frequency, as of rubber.

        The stiffness at s = i w is C (1 - share/(1 + (s time)^order)), with Caputo's derivative

            [F; M] + time^order D^order [F; M] = C ((1 - share) e + time^order D^order e)

        (Bagley and Torvik 1983: the fractional Zener model). A Prony series stands for it: times
        are spread evenly, in their logarithm, a decade beyond the band; shares are fitted to the
        complex stiffness there in least squares, relative, and to its value at rest. Differentiable
        by order, share and time, which are one number each.

        Args:
            order: 0 < order < 1 of the derivative; 1 would be one arm
            share: of the stiffness that relaxes, less than 1
            time: s
            frequencies: rad/s, from the lowest to the highest, of the band that is wanted
            arms: how many; None = two a decade of the band, and three
            on: name of a beam of a structure; None = all

        Raises:
            ValueError: for numbers out of these ranges.

        Examples:
            >>> rubber = tb.Viscoelastic.fractional(0.4, 0.8, 1e-3, frequencies=(1.0, 1e3))  # rad/s
            >>> round(rubber.error, 4)
            0.0043
        """
        names = ("order", "share", "time")
        dtype, device = common_dtype(order, share, time)
        order, share, time = (as_tensor(x, dtype, device) for x in (order, share, time))
        for name, value in zip(names, (order, share, time), strict=True):
            above = value >= 1 if name != "time" else value != value
            if value.ndim or concrete(above | (value <= 0)):
                raise refusal(
                    f"{name} = {value.tolist()}",
                    "a positive number" + " less than 1" * (name != "time"),
                )
        low, high = (float(w) for w in frequencies)
        if not 0 < low < high < torch.inf:
            raise refusal(f"frequencies = ({low:g}, {high:g})", "(lowest, highest) rad/s")
        decades = math.log10(high / low)
        count = math.ceil(2 * decades) + 3 if arms is None else whole("arms", arms)
        if count < 2:
            raise refusal(f"arms = {count}", "two or more")
        ends = -math.log10(REACH * high), -math.log10(low / REACH)
        times = torch.logspace(*ends, count, dtype=dtype, device=device)
        w = torch.logspace(math.log10(low), math.log10(high), FITTED, dtype=dtype, device=device)
        phase = torch.polar(torch.ones_like(order), order * math.pi / 2)
        lost = share / (1 + (w * time) ** order * phase)
        size = (1 - lost).abs()
        each = 1 / (1 + 1j * w[:, None] * times) / size[:, None]
        rest = torch.full((1, count), REST, dtype=dtype, device=device)
        wanted = lost / size
        rows = torch.cat((each.real, each.imag, rest))
        shares = nonnegative_least_squares(
            rows, torch.cat((wanted.real, wanted.imag, REST * share[None]))
        )
        left = (each.detach() @ shares.detach().to(each.dtype) - wanted.detach()).abs()
        return cls(shares, times, six=False, on=on, error=left.amax().item())


def _rows(value: Any) -> bool:
    """Whether it is a sequence of sequences, one for each strain."""
    plain = (list, tuple)
    return isinstance(value, plain) and any(isinstance(row, plain) for row in value)
