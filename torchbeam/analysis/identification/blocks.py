"""Blocks of times: how far parameters move as readings of one while are left out, in place of what
noise that is independent from reading to reading would move them by.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

SANDWICHED = ("blocks", "repeats")
FEWEST = 6  # blocks of an experiment
REPEATS = 2  # experiments that are a block each
LEVERAGE = 0.95  # share of what is known that one block alone may tell; more counts as so much


@dataclass(frozen=True)
class Blocks:
    """number (T,): block of each reading, -1 where noise is independent;  count of blocks."""

    number: Tensor
    count: int

    @classmethod
    def of(cls, problem: Any, r: Tensor) -> Blocks | None:
        """Of a problem with residuals r (T,); None where no measurement asks for them. All readings
        of an experiment in one while are one block: what a model misses is in all channels.
        Without times the values of one place along the first axis are: those of a pose. With
        "repeats" all of an experiment are one.

        Blocks of times are as long as those that estimate the variance of a mean best where
        residuals remember as an autoregression of the first order does: (6 (a/(1 - a^2))^2 n)^(1/3)
        of n instants, a the correlation of neighbours (Carlstein 1986, Ann. Statist. 14, 1171), but
        no longer than a sixth of the experiment.
        """
        number, first = torch.full_like(r, -1, dtype=torch.long), 0
        for e in problem.experiments:
            own = [(m, rows) for owner, m, rows in problem.rows() if owner is e]
            if repeated := [rows for m, rows in own if m.noise == "repeats"]:
                for rows in repeated:
                    number[rows[rows >= 0]] = first
                first += 1
            series = [series_of(m, rows) for m, rows in own if m.noise == "blocks"]
            if not series:
                continue
            instants = torch.cat([t for t, _, _ in series]).unique()
            length = 1.0
            if all(ordered for _, _, ordered in series):
                a = min(max(correlation_of(r, [rows for _, rows, _ in series]), 0.0), 0.99)
                length = max(1.0, (6 * (a / (1 - a * a)) ** 2 * len(instants)) ** (1 / 3))
            count = min(len(instants), max(FEWEST, math.floor(len(instants) / length)))
            for t, rows, _ in series:
                block = torch.searchsorted(instants, t) * count // len(instants)
                there = rows >= 0
                number[rows[there]] = first + block[:, None].expand_as(rows)[there]
            first += count
        return cls(number, first) if first else None

    @staticmethod
    def check(experiments: Any) -> None:
        """ValueError for a repeat that is the only one."""
        repeated = [e for e in experiments if any(m.noise == "repeats" for m in e.measurements)]
        if 0 < len(repeated) < REPEATS:
            raise ValueError(
                "noise='repeats' was given with one experiment; two that repeat each other are "
                "wanted, or noise='blocks'"
            )

    def covariance(self, r: Tensor, J: Tensor, A: Tensor, C: Tensor, scale: float) -> BlockSpread:
        """Covariance (p, p) of coordinates, and what it knows of itself.

        r (T,), J (T, p) weighted;  A (p, p) with priors, C its inverse;  scale of independent noise

            V = sum_g d_g d_g^T + C (A - sum_g N_g) C
            d_g = C^(1/2) (1 - H_g)^(-1/2) C^(1/2) J_g^T r_g

        d_g is what the readings of block g move the parameters by, N_g = J_g^T J_g, H_g = C^(1/2)
        N_g C^(1/2) the share of what is known that they tell, by which their residuals are too
        small (the sandwich of blocks, with the correction that leaves no bias where noise is
        independent: Liang and Zeger 1986, Biometrika 73, 13; Bell and McCaffrey 2002, Survey
        Methodology 28, 169). Priors and readings of independent noise count as they are.
        Parameters that one block alone tells, as the start of a repeat, have no scatter among them:
        theirs is that of independent noise, and what the others move them by.
        """
        told_by = [(J[self.number == g] != 0).any(0) for g in range(self.count)]
        outside = (J[self.number < 0] != 0).any(0) | (A.diagonal() > (J * J).sum(0) * (1 + 1e-9))
        alone = (torch.stack(told_by).sum(0) == 1) & ~outside
        if alone.any() and not alone.all():
            inner = torch.linalg.inv(A[alone][:, alone])
            ridge = -inner @ A[alone][:, ~alone]
            common = A[~alone][:, ~alone] + A[~alone][:, alone] @ ridge
            inner_spread = self.covariance(
                r, J[:, ~alone] + J[:, alone] @ ridge, common, torch.linalg.inv(common), scale
            )
            T = C.new_zeros(len(C), len(common))
            T[~alone], T[alone] = torch.eye(len(common)).to(C), ridge
            spread = inner_spread.moved(T)
            spread.covariance[alone.nonzero(), alone.nonzero()[:, 0]] += scale**2 * inner
            return spread
        root, failed = torch.linalg.cholesky_ex((C + C.mT) / 2)  # C = root root^T
        if failed:  # some are not told by the data
            return BlockSpread(scale**2 * C, torch.zeros_like(C), C.new_zeros(0, *C.shape))
        V, shares, told = torch.zeros_like(C), [], torch.zeros_like(A)
        for g in range(self.count):
            here = self.number == g
            N = J[here].mT @ J[here]
            part, axes = torch.linalg.eigh(root.mT @ N @ root)
            less = axes * (1 - part.clamp(0, LEVERAGE)).rsqrt() @ axes.mT
            d = root @ less @ (root.mT @ (J[here].mT @ r[here]))
            V, told = V + d[:, None] * d, told + N
            shares.append(C @ N @ C)
        other = (self.number < 0)[:, None] * J
        rest = C @ (A - told + (scale**2 - 1) * other.mT @ other) @ C
        return BlockSpread(V + rest, V, torch.stack(shares))


@dataclass(frozen=True)
class BlockSpread:
    """Covariance (p, p) of coordinates;  sandwich (p, p) what of it the scatter of blocks tells;
    shares (blocks, p, p) what each block would add to that if noise were independent.
    """

    covariance: Tensor
    sandwich: Tensor
    shares: Tensor

    def moved(self, T: Tensor) -> BlockSpread:
        """Of T (q, p) times the coordinates."""
        parts = (self.covariance, self.sandwich, self.shares)
        return BlockSpread(*(T @ part @ T.mT for part in parts))

    def freedom(self, G: Tensor) -> Tensor:
        """(n,) degrees of freedom of the deviation of each combination G (n, p) of coordinates:
        Satterthwaite's, by the shares; infinite where no block tells of it.
        """
        if not len(self.shares):
            return G.new_full(G.shape[:1], torch.inf)
        share = torch.stack([((G @ S) * G).sum(-1) for S in self.shares])
        least = torch.finfo(G.dtype).tiny
        freedom = share.sum(0).square() / share.square().sum(0).clamp(min=least)
        scatter, whole = (
            ((G @ V) * G).sum(-1).clamp(min=least) for V in (self.sandwich, self.covariance)
        )
        freedom = freedom * (len(share) - 1) / len(share) * (whole / scatter).square()
        told = share.sum(0) > 0
        return torch.where(told, freedom, torch.inf).clamp(min=1)


def series_of(m: Any, rows: Tensor) -> tuple[Tensor, Tensor, bool]:
    """Times (n,) of a measurement in their order, its rows (n, channels), and whether they are
    times; else places along the first axis.
    """
    rows = rows.reshape(len(rows), -1)
    if m.times is None:
        return torch.arange(len(rows), device=rows.device).to(m.values), rows, False
    order = m.times.argsort()
    return m.times[order], rows[order], True


def correlation_of(r: Tensor, series: list[Tensor]) -> float:
    """Of residuals r (T,) with their neighbours, over all channels of rows (n, channels)."""
    product, squares = 0.0, torch.finfo(r.dtype).tiny
    for rows in series:
        for column in rows.unbind(-1):
            reading = r[column[column >= 0]]
            product += (reading[1:] * reading[:-1]).sum().item()
            squares += reading.square().sum().item()
    return product / squares
