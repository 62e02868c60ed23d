"""Noise that remembers: an autoregression of the first order along each channel, whose correlation
is found with the parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch
from torch import Tensor

from ...math.extremum import golden_section
from .blocks import series_of

LARGEST = 0.9999  # correlation of neighbours


@dataclass(frozen=True)
class Memory:
    """Correlations rho (m,) of noise from one reading to the next, of measurements by `names`; two
    readings so many steps apart have rho^lag, `lag` (T,), 0 of the first of a series.

    number  (T,) of the measurement, -1 where noise is independent;  before, place  see `Whitening`
    """

    names: tuple[str, ...]
    rho: Tensor
    number: Tensor
    lag: Tensor
    before: Tensor
    place: Tensor

    @classmethod
    def of(cls, problem: Any) -> Memory | None:
        """Of a problem; None where no measurement asks for it."""
        whole = torch.full_like(problem.target[0], -1, dtype=torch.long)
        lag, names = torch.zeros_like(problem.target[0]), []
        before, place = torch.zeros_like(whole), torch.zeros_like(whole)
        for e, m, rows in problem.rows():
            if m.noise != "ar1":
                continue
            times, ordered, _ = series_of(m, rows)
            steps = times.diff()
            step = steps.median() if len(steps) else 1.0
            for column in ordered.unbind(-1):
                own = column[column >= 0]
                number = torch.arange(len(own), device=own.device)
                whole[own], place[own] = len(names), number
                lag[own[1:]] = times[column >= 0].diff() / step
                before[own[1:]] = own[:-1]
            name = m.name or (m.labels[0] if len(m.labels) == 1 else "")
            names.append(" ".join(filter(None, (e.name, name))) or "data")
        rho = lag.new_zeros(len(names))
        return cls(tuple(names), rho, whole, lag, before, place) if names else None

    def in_(self, white: Any) -> Any:
        """A `Whitening` with this memory."""
        rho = torch.nn.functional.pad(self.rho, (0, 1))[self.number]  # -1 is the last
        carried = torch.where(self.lag > 0, rho**self.lag, 0)
        return replace(white, before=self.before, carried=carried, place=self.place)

    def found(self, problem: Any, r: Tensor, J: Tensor, bend: Tensor, pull: Tensor) -> Memory:
        """With the correlations of largest restricted likelihood, one after the other, of readings
        that miss by r (T,), J (T, p) their derivatives, without weights.
        """
        memory = self

        def least(k: int, rho: float) -> float:
            white = memory.with_(k, rho).in_(problem.white)
            z, K = white(r), white(J.mT).mT
            A, g = K.mT @ K + torch.diag(bend), K.mT @ z + pull
            size = A.diagonal().clamp(min=torch.finfo(A.dtype).tiny).sqrt()
            values, axes = torch.linalg.eigh(A / size / size[:, None])
            seen = values > torch.finfo(A.dtype).eps * len(values)
            fall = ((axes.mT @ (g / size))[seen].square() / values[seen]).sum()
            squares = z.square().sum() - fall
            if problem.noise.names:  # and their size
                squares = max(len(z) - len(g), 1) * squares.log()
            log_det = values[seen].log().sum() + 2 * size.log().sum()
            return (squares + log_det + (1 - white.carried.square()).log().sum()).item()

        for k in range(len(self.names)):
            memory = memory.with_(k, golden_section(partial(least, k), 0.0, LARGEST))
        return memory

    @property
    def steps(self) -> Tensor:
        """(m,) readings that have one before them."""
        there = self.lag > 0
        return torch.stack([((self.number == k) & there).sum() for k in range(len(self.rho))])

    def with_(self, k: int, rho: Any) -> Memory:
        """With one correlation changed."""
        changed = self.rho.clone()
        changed[k] = rho
        return replace(self, rho=changed)
