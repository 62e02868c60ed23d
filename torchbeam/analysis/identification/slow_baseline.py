"""Slow baseline: polynomials, or splines of stated stiffness, by which an instrument wanders."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ...core.arguments import count, number
from ...core.validation import refusal
from ...math.bsplines import basis

MOST = 200  # pieces


@dataclass(frozen=True)
class SlowBaseline:
    """Slow wander of an instrument: a `baseline` of a `Measurement` that is a smooth function of
    time. It is zero at the first instant; the constant is the `offset`.

    Args:
        first, last: s by the instrument's clock, ends of the smooth function. Beyond them it
            continues along its tangent, with growing uncertainty
        spacing: s between knots. Changes within less than a few spacings are not followed. None = a
            single piece: a polynomial
        degree: of the pieces; the derivative of that order jumps at knots

    A channel has `degree` further parameters, and another for each inner knot; they cost no
    evaluations. A faster baseline absorbs more of the motion itself, which the deviations of the
    other parameters show.

    Raises:
        ValueError: where last is not after first, for a spacing that is not positive, or of more
            than 200 pieces.

    Examples:
        >>> t = torch.linspace(0, 4, 200)
        >>> gauge = tb.Measurement(torch.sin(9 * t) + 0.1 * t**2, 0.01, t, offset=True,
        ...                        baseline=tb.SlowBaseline(0, 4, degree=2))
        >>> model = lambda p: torch.sin(p["w"][:, None] * t)
        >>> tb.identify(model, gauge, {"w": 8.8})["w"]
        tensor(9.)
    """

    first: float
    last: float
    spacing: float | None = None
    degree: int = 3

    def __post_init__(self) -> None:
        first, last = number("first", self.first), number("last", self.last)
        if not math.isfinite(last - first) or not last > first:
            raise refusal(f"a SlowBaseline from {first:g} to {last:g} s", "a later end")
        count("degree", self.degree)
        if self.spacing is not None and not (
            0 < (last - first) / MOST <= number("spacing", self.spacing) < math.inf
        ):
            raise refusal(
                f"spacing = {self.spacing:g} s over {last - first:g} s",
                f"a positive one, of {MOST} pieces at most,",
            )

    def __call__(self, t: Tensor) -> Tensor:
        """(times, k) at times (times,) s."""
        pieces = 1
        if self.spacing is not None:
            pieces = max(1, math.ceil((self.last - self.first) / self.spacing - 1e-9))
        breaks = torch.linspace(self.first, self.last, pieces + 1, dtype=t.dtype, device=t.device)
        inside = t.clamp(self.first, self.last)
        rows, slope = (basis(breaks, inside, self.degree, order) for order in (0, 1))
        return (rows + (t - inside)[:, None] * slope)[:, 1:]
