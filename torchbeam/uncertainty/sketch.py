"""Quantile sketch: counts in bins whose width is a known part of the value."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

FINEST = 2.0**-30  # logarithm of a bin's largest over its least value, before bins are joined
# number of the bin about zero, that of the finest width: below exp(-ZERO FINEST) = 1e-14231
ZERO = 2**45


@dataclass
class Sketch:
    """Counts of numbers in bins (gamma^(k-1), gamma^k], and the same for negative ones: a quantile
    is known to the relative error `error` = (gamma - 1)/(gamma + 1), about half a bin's width.
    (DDSketch; Masson, Rim and Lee 2019.)

    Where there are more than `most` bins, each two neighbours are joined, gamma squared, until
    there are not (UDDSketch; Epicoco et al. 2020). So counts depend on the numbers alone, not on
    their order or on how they came in parts.

    keys     (K,) int64, increasing with the value: sign times (k + ZERO, at this width), 0 for
             zero;  counts (K,) int64
    least    (K,) the least number in each bin, and the largest: what lies in a bin alone is known
             exactly
    largest  (K,)
    joined   times that bins were joined: log gamma = FINEST 2^joined
    """

    most: int
    keys: Tensor
    counts: Tensor
    least: Tensor
    largest: Tensor
    joined: int = 0

    @classmethod
    def empty(cls, most: int) -> Sketch:
        none = torch.zeros(0, dtype=torch.long)
        return cls(most, none, none, none.double(), none.double())

    @property
    def width(self) -> float:
        """log gamma."""
        return FINEST * 2.0**self.joined

    @property
    def error(self) -> float:
        """Relative error of a value."""
        return math.tanh(self.width / 2)

    @property
    def total(self) -> int:
        return int(self.counts.sum())

    def add(self, x: Tensor) -> None:
        """Count numbers x (n,), finite."""
        x = x.detach().double()
        size = x.abs()
        tiny = math.exp(-700.0)
        place = torch.ceil(size.clamp_min(tiny).log() / FINEST).long() + ZERO
        self._count(
            torch.where(size < tiny, 0, x.sign().long() * place), torch.ones_like(place), x, x, 0
        )

    def merge(self, other: Sketch) -> None:
        """Count all that another sketch has."""
        self._count(other.keys, other.counts, other.least, other.largest, other.joined)

    def at_ranks(self, ranks: Tensor) -> Tensor:
        """Values (R,) of the samples of these ranks (R,), 0 to total - 1, each sample's to the
        relative `error`; linear between those of whole ranks.
        """
        low, high, counts = self.least, self.largest, self.counts
        ranks = ranks.double()
        below = ranks.floor()
        whole = torch.stack((below, below + 1))
        k = torch.searchsorted(counts.cumsum(0), whole, right=True).clamp_max(len(counts) - 1)
        # equally far, relatively, from both ends
        middle = low * (high / torch.where(self.keys == 0, 1.0, low / 2 + high / 2))
        return torch.lerp(*middle[k], ranks - below)

    def above(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Least and largest number (...) of samples above x (...): those of a bin that x lies
        inside of are not told apart.
        """
        beyond = self.counts.sum() - torch.cat((self.counts.new_zeros(1), self.counts.cumsum(0)))
        x = x.double().contiguous()
        return tuple(
            beyond[torch.searchsorted(end, x, right=True)] for end in (self.least, self.largest)
        )

    def _count(
        self, keys: Tensor, counts: Tensor, least: Tensor, largest: Tensor, joined: int
    ) -> None:
        joint = max(joined, self.joined)
        keys = torch.cat((_joined(self.keys, joint - self.joined), _joined(keys, joint - joined)))
        counts, least, largest = (
            torch.cat(pair)
            for pair in ((self.counts, counts), (self.least, least), (self.largest, largest))
        )
        self.joined = joint
        while True:
            self.keys, place = keys.unique(return_inverse=True)
            self.counts = torch.zeros_like(self.keys).index_add(0, place, counts)
            self.least, self.largest = (
                x.new_empty(len(self.keys)).scatter_reduce(0, place, x, how, include_self=False)
                for x, how in ((least, "amin"), (largest, "amax"))
            )
            if len(self.keys) <= self.most:
                return
            keys, counts, least = _joined(self.keys, 1), self.counts, self.least
            largest = self.largest
            self.joined += 1


def _joined(keys: Tensor, times: int) -> Tensor:
    """Keys after bins were joined so often: half of their size, rounded up."""
    return keys.sign() * ((keys.abs() + (2**times - 1)) >> times)
