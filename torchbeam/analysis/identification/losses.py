"""Losses that are no squares: weights of readings that miss by much, and what deviations are."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

LOSSES = (None, "huber", "student")
HUBER, STUDENT = 1.345, 4.0  # corner over the deviation: 95 % efficient; degrees of freedom
LEAST = 0.1  # of the mean slope: readings that all miss by much tell little


def weights(loss: Tensor, u: Tensor) -> Tensor:
    """Weights (T,) of squares of misfits u (T,) over their deviations. Huber's (1964, Annals of
    Mathematical Statistics 35, 73) are over their mean slope under normal noise, so that the
    deviation which they find is that of normal noise; Student's are of four degrees of freedom
    (Lange, Little and Taylor 1989, JASA 84, 881), whose deviation is the law's scale.
    """
    huber = (HUBER / u.abs().clamp(min=HUBER)) / _inside(u)
    student = (STUDENT + 1) / (STUDENT + u.square())
    return torch.where(loss == 1, huber, torch.where(loss == 2, student, 1.0))


def squares(loss: Tensor, share: Tensor, r: Tensor) -> Tensor:
    """(T,) of weighted misfits, by which their deviation is found; of Huber's loss those of its
    derivative over their mean under normal noise (his second proposal), which no outlier carries
    away.
    """
    corner = r.new_tensor(HUBER)
    inside, density = _inside(r), (-(corner**2) / 2).exp() * (2 / torch.pi) ** 0.5
    mean = inside - corner * density + corner**2 * (1 - inside)
    return torch.where(loss == 1, (share * r * inside).square() / mean, r.square())


def slopes(loss: Tensor, u: Tensor) -> Tensor:
    """Second derivatives (T,) of the losses."""
    huber = (u.abs() < HUBER).to(u) / _inside(u)
    student = (STUDENT + 1) * (STUDENT - u.square()) / (STUDENT + u.square()).square()
    return torch.where(loss == 1, huber, torch.where(loss == 2, student, 1.0))


def covariance(problem: Any, r: Tensor, J: Tensor, bend: Tensor, scale: float) -> Tensor:
    """(p, p) over scale^2, of weighted r (T,), J (T, p): A^-1 B A^-1, A the mean slope and B the
    mean square of the loss's derivative times the information, of each loss (Huber and Ronchetti
    2009, Robust Statistics, section 7.6).
    """
    share, loss = problem.white.share, problem.loss
    u, plain = r / share / (scale or 1), J / share[:, None]
    A, B = torch.diag(bend), torch.diag(bend)
    for kind in loss.unique():
        rows = loss == kind
        N = plain[rows].mT @ plain[rows]
        if not kind:
            A, B = A + N, B + N
            continue
        slope = slopes(loss[rows], u[rows]).mean().clamp(min=LEAST)
        left = max(int(rows.sum()) - J.shape[1], 1)
        A = A + slope * N
        B = B + (share[rows].square() * u[rows]).square().sum() / left * N
    inverse = torch.linalg.pinv(A, hermitian=True)
    return inverse @ B @ inverse


def _inside(like: Tensor) -> Tensor:
    """Probability of normal noise within the corner."""
    return torch.special.erf(like.new_tensor(HUBER / 2**0.5))
