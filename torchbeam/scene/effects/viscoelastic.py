"""Viscoelasticity: stress that relaxes, by Maxwell arms beside a spring (a Prony series)."""

from __future__ import annotations

from dataclasses import dataclass, field

from typing import Any

import torch

from ...core.arguments import boolean
from ...core.leaves import leaf, option
from ...core.validation import Value, as_tensor, common_dtype, concrete, refusal
from .effect import Effect


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
        six: whether shares and times have a row for each strain. Default: true for sequences of six
            sequences. A tensor or an array (..., m) is one row with batch axes
        on: name of a beam of a structure; None = all. Each beam may have its own

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
        tensor([0.1])
    """

    shares: Value = leaf(lambda arms: 1 + int(arms.six), nonnegative=True, name="shares")
    times: Value = leaf(lambda arms: 1 + int(arms.six), positive=True, name="times")
    six: bool | None = option(boolean, default=None, name="six")
    on: str | None = field(default=None, kw_only=True)

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


def _rows(value: Any) -> bool:
    """Whether it is six sequences, one for each strain."""
    plain = (list, tuple)
    return isinstance(value, plain) and len(value) == 6 and isinstance(value[0], plain)
