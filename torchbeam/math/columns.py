"""Columns: matrices that move numbers, and change their signs at most, applied as slices."""

from __future__ import annotations

from itertools import groupby
from typing import NamedTuple

import torch
from torch import Tensor

FEW = 4096  # numbers, of which a product is one operation that takes no time


class Run(NamedTuple):
    """So many columns of a result: those from `first` of what is given, times `sign`; 0 = zeros."""

    first: int
    count: int
    sign: int


class Columns(NamedTuple):
    """A matrix (n, m), for (..., n) -> (..., m). Where each of its columns has one entry at most,
    1 or -1, these are copied, of many numbers: a product of few columns takes several times as
    long, and is the same to the bit.
    """

    matrix: Tensor
    runs: tuple[Run, ...] | None

    @classmethod
    def of(cls, matrix: Tensor) -> Columns:
        picks = []
        for column in matrix.detach().mT.tolist():
            entries = [(row, x) for row, x in enumerate(column) if x]
            if len(entries) > 1 or any(abs(x) != 1 for _, x in entries):
                return cls(matrix, None)
            picks.append(entries[0] if entries else (0, 0.0))
        # those that follow each other on both sides
        follows = [(sign, row - k if sign else 0) for k, (row, sign) in enumerate(picks)]
        runs, k = [], 0
        for (sign, _), group in groupby(follows):
            count = len([*group])
            runs.append(Run(picks[k][0], count, int(sign)))
            k += count
        return cls(matrix, tuple(runs))

    def __call__(self, x: Tensor, rest: Tensor | None = None) -> Tensor:
        """rest (m): what stands where the matrix has zeros alone; None = 0."""
        if self.runs is None or x.numel() < FEW:
            return x @ self.matrix if rest is None else x @ self.matrix + rest
        parts, k = [], 0
        for run in self.runs:
            if run.sign:
                part = x[..., run.first : run.first + run.count]
                parts.append(part if run.sign > 0 else -part)
            else:
                part = x.new_zeros(()) if rest is None else rest[k : k + run.count]
                parts.append(part.expand(*x.shape[:-1], run.count))
            k += run.count
        return torch.cat(parts, -1)
