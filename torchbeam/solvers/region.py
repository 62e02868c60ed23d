"""Region in which a least-squares search may move: limited steps, limited reach, bounds."""

from __future__ import annotations

import math
from copy import copy

import torch
from torch import Tensor

STRIDE = 10.0  # largest change in a step: of a parameter's size; of a logarithm, the largest factor
REACH = 1e9  # largest size on the way, of that at the start; of a logarithm, the largest factor


class Region:
    """Where each start may go: from its place by a limited step, never far beyond its own size,
    within the bounds.

    start     (S, p);  least, largest  (S, p) bounds; equal ones hold a parameter
    additive  (p,) bool: coordinates whose zero means nothing (logarithms); a change of 1 is large
    target    (1 or S, T): what the misfits are counted from
    size      (S, p) of the parameters at the start. One that starts at zero, and has none given,
              has that of a change that moves the model's values by their own size, as soon as it
              moves them at all; until then its steps have no limit
    """

    def __init__(
        self,
        start: Tensor,
        size: Tensor,
        additive: Tensor,
        least: Tensor,
        largest: Tensor,
        target: Tensor,
    ) -> None:
        self.start, self.additive, self.target = start, additive, target
        self.least, self.largest = least.expand_as(start), largest.expand_as(start)
        self.size = torch.where(start == 0, size, start.abs())

    def sized(self, which: Tensor, r: Tensor, J: Tensor) -> None:
        """Find sizes of the starts `which` that are not known, from misfits (N, T), J (N, T, p)."""
        if not (self.size == 0).any():
            return
        target = self.target[which] if len(self.target) > 1 else self.target
        size = torch.linalg.vector_norm(
            r + target, dim=-1, keepdim=True
        ) / torch.linalg.vector_norm(J, dim=-2)
        here = self.size[which]
        self.size[which] = torch.where((here == 0) & torch.isfinite(size), size, here)

    def of(self, which: Tensor) -> Region:
        """That of some starts."""
        some = copy(self)
        some.start, some.size, some.least, some.largest = (
            v[which] for v in (self.start, self.size, self.least, self.largest)
        )
        return some

    def against(self, target: Tensor) -> Region:
        """The same for other targets."""
        other = copy(self)
        other.target = target
        return other

    def holding(self, held: Tensor) -> Region:
        """The same in which parameters (S, p) bool stay at the start."""
        other = copy(self)
        other.least, other.largest = (
            torch.where(held, self.start, end) for end in (self.least, self.largest)
        )
        return other

    def cut(self, x: Tensor, trial: Tensor) -> Tensor:
        """The trial, or where it leaves the region the nearest there."""
        size = torch.where(self.size == 0, torch.inf, self.size)
        stride = torch.where(self.additive, math.log(STRIDE), STRIDE * torch.maximum(x.abs(), size))
        centre = torch.where(self.additive, self.start, 0.0)
        reach = torch.where(self.additive, math.log(REACH), REACH * size)
        trial = x + torch.clamp(trial - x, -stride, stride)
        trial = centre + torch.clamp(trial - centre, -reach, reach)
        return torch.maximum(torch.minimum(trial, self.largest), self.least)

    def held(self, x: Tensor, gradient: Tensor) -> Tensor:
        """(S, p) bool: which parameters stay, at a bound that the descent leads out of."""
        return (
            ((x <= self.least) & (gradient > 0))
            | ((x >= self.largest) & (gradient < 0))
            | (self.least == self.largest)
        )

    def away(self, x: Tensor) -> Tensor:
        """(S, p) bool: which parameters ran away."""
        far = torch.where(
            self.additive,
            (x - self.start).abs() >= 0.99 * math.log(REACH),
            x.abs() >= 0.99 * REACH * self.size,
        )
        return far & (self.additive | (self.size > 0))
