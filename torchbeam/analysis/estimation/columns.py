"""Columns: what is read, and what x is afterwards, by x and by what comes on top of it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from .interval import Moved
from .unknowns import Slopes, Unknowns


@dataclass(frozen=True)
class Columns:
    """Matrices (..., size + fresh, m + size) of x = [z; unknowns; readings on their way]: rows of x
    and of deviations of what is new, columns of m readings and of x afterwards.

    moves  numbers of z;  read  of readings;  delay  intervals by which these are late
    """

    unknowns: Unknowns
    moves: int
    read: int
    delay: int

    @property
    def size(self) -> int:
        return self.moves + len(self.unknowns.names) + self.delay * self.read

    def after(self, after: Moved) -> Tensor:
        """Over an interval. What is new: what comes on top of the unknowns, and forces."""
        own, n, m = self.unknowns, self.moves, self.read
        k, late = len(own.names), self.delay * m
        fresh = k + int((own.white > 0).sum())

        def column(slopes: Slopes) -> Tensor:
            by = own.by(slopes).mT  # z, unknowns and forces: nothing depends on readings underway
            none = by.new_zeros(*by.shape[:-2], late + k, by.shape[-1])
            return torch.cat((by[..., : n + k, :], none, by[..., n + k :, :]), -2)

        stay = pad(torch.diag(own.stays), (0, 0, n, late))
        stay = torch.cat((stay, pad(torch.diag(own.added), (0, 0, 0, fresh - k))))
        reading, motion = column(after.readings_by), column(after.motion_by)
        lead = motion.shape[:-2]
        if late:
            on = torch.eye(self.size + fresh).to(motion)[:, n + k : self.size].expand(*lead, -1, -1)
            parts = [on[..., -m:], motion, stay.expand(*lead, -1, -1), reading, on[..., :-m]]
        else:
            parts = [reading, motion, stay.expand(*lead, -1, -1)]
        whole = torch.cat(parts, -1)
        whole[..., n + own.of_model + torch.arange(len(own.biased)), own.biased] = 1.0
        return whole

    def placed(self, rows: Tensor) -> Tensor:
        """Rows (..., m + size), of rows (..., moves + m) of z and the readings at an interval's
        end.
        """
        n, m, late = self.moves, self.read, self.delay * self.read
        z, read = rows.split((n, m), -1)
        if not late:
            return torch.cat((read, pad(z, (0, self.size - n))), -1)
        return torch.cat((pad(z, (m, self.size - n - late)), pad(read, (0, late - m))), -1)
