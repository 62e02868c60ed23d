"""Spectrum: lines of a series at times that need not be regular."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

# of the mean step between readings, to which times are rounded: a line at the highest frequency
# loses 1 % by that
PARTS = 8


@dataclass(frozen=True)
class Spectrum:
    """Frequencies from that of the whole time to one in two readings, two for each that is
    independent: the k-th is (k + 2)/(2 n step).

    place (n,) of the readings in time, in parts of a step;  step  the mean one, s, or 1
    """

    place: Tensor
    step: float

    @classmethod
    def of(cls, times: Tensor | None, like: Tensor) -> Spectrum | None:
        """Of readings like (n,) at times (n,) in order, None: counted; None where these are at one
        time.
        """
        t = torch.arange(len(like)).to(like) if times is None else times
        step = ((t[-1] - t[0]) / (len(t) - 1)).item()
        return cls((PARTS * (t - t[0]) / step).round().long(), step) if step > 0 else None

    def transform(self, values: Tensor, double: bool = False) -> Tensor:
        """Sums of values (n,) exp(-i w t), or at 2 w."""
        n = len(self.place)
        full = torch.fft.rfft(values.new_zeros(2 * PARTS * n).index_add(0, self.place, values))
        return full[4 : 2 * n : 2] if double else full[2:n]

    def power(self, values: Tensor) -> Tensor:
        """Squares that a cosine and a sine take from values (n,) without a mean: 2/n |sum|^2."""
        return self.transform(values).abs().square() * (2 / len(self.place))

    def period(self, k: int) -> float:
        """s of the k-th."""
        return 2 * len(self.place) * self.step / (k + 2)

    def at(self, power: Tensor, k: int) -> float:
        """Hz of a peak of the power near the k-th, by the parabola through its neighbours."""
        shift = 0.0
        if 0 < k < len(power) - 1:
            a, b, c = power[k - 1 : k + 2].tolist()
            if (bend := a - 2 * b + c) < 0:
                shift = max(-1.0, min(1.0, (a - c) / (2 * bend)))
        return (k + 2 + shift) / (2 * len(self.place) * self.step)

    @property
    def duration(self) -> float:
        """s from the first reading to the last."""
        return (len(self.place) - 1) * self.step
