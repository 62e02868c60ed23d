"""Whitening: readings as numbers whose noise is independent and of unit deviation."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Whitening:
    """Linear map of readings y (..., T), b the reading before t:

        z_t = f_t (w_t y_t - a_t w_b y_b) / sqrt(1 - a_t^2)

    weight  (T,) w: 1 / sigma;  share (T,) f: roots of the weights of a loss that is no square
    before  (T,) b;  carried (T,) a: correlation with it, 0 of independent noise;  place (T,) of
            each in its series
    """

    weight: Tensor
    share: Tensor
    before: Tensor
    carried: Tensor
    place: Tensor

    @classmethod
    def of(cls, weight: Tensor) -> Whitening:
        """Of independent noise."""
        none = torch.zeros_like(weight, dtype=torch.long)
        return cls(weight, torch.ones_like(weight), none, torch.zeros_like(weight), none)

    def __call__(self, y: Tensor) -> Tensor:
        z = y * self.weight
        if self.remembers:
            z = (z - self.carried * z[..., self.before]) * (1 - self.carried.square()).rsqrt()
        return z * self.share

    def inverse(self, z: Tensor) -> Tensor:
        """y (..., T)."""
        return self.alone(z) / self.weight

    def alone(self, z: Tensor) -> Tensor:
        """w y (..., T): each reading over its own deviation, as it is."""
        y = z / self.share
        if self.remembers:
            y = y * (1 - self.carried.square()).sqrt()
            for k in range(1, int(self.place.max()) + 1):
                rows = (self.place == k).nonzero()[:, 0]
                y[..., rows] += self.carried[rows] * y[..., self.before[rows]]
        return y

    @property
    def remembers(self) -> bool:
        return bool((self.carried != 0).any())

    def longer(self, weight: Tensor) -> Whitening:
        """With readings of independent noise behind the others."""
        more = Whitening.of(weight)
        return Whitening(*(torch.cat((a, vars(more)[k])) for k, a in vars(self).items()))
