"""Weights of Tikhonov regularisation: evidence, cross validation, corner of the L-curve."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ...math.dense import positive_inverse

CRITERIA = ("evidence", "gcv", "lcurve")
DECADES = (-12.0, 4.0)  # of a weight, about that at which smoothness counts as much as the data
EACH = 8  # weights a decade
SWEEPS = 6  # over the weights of several fields


@dataclass(frozen=True)
class Linearised:
    """Misfits r (T,) of the data and J (T, p) at x (p,), over the data's deviations where these are
    known; smoothness rows L (rows, p) of each field, whose values are to be near to target (rows,).
    Of other priors, gradient `pull` (p,) of minus the logarithm at x, and diagonal `other` (p,) of
    its second derivative.
    """

    x: Tensor
    r: Tensor
    J: Tensor
    L: tuple[Tensor, ...]
    target: tuple[Tensor, ...]
    pull: Tensor
    other: Tensor

    @property
    def balance(self) -> Tensor:
        """(fields,) weights at which smoothness counts as much as the data."""
        return torch.stack(
            [self.J[:, (L != 0).any(0)].square().sum() / L.square().sum() for L in self.L]
        )

    def solved(self, weight: Tensor) -> Solved:
        """The linear problem's solution for weights (..., fields)."""
        data = self.J.mT @ self.J
        A, towards = data + torch.diag(self.other), -(self.J.mT @ self.r) - self.pull
        for w, L, c in zip(weight.unbind(-1), self.L, self.target, strict=True):
            A = A + w[..., None, None] * (L.mT @ L)
            towards = towards - w[..., None] * (L.mT @ (L @ self.x - c))
        inverse, log_det = positive_inverse(A)
        step = (inverse @ towards[..., None])[..., 0]
        misfit = (self.r + step @ self.J.mT).square().sum(-1)
        rows = zip(self.L, self.target, strict=True)
        rough = torch.stack([((self.x + step) @ L.mT - c).square().sum(-1) for L, c in rows], -1)
        determined = (inverse * data).sum((-1, -2))
        normal = self.other > 0
        over = torch.where(normal, self.other, 1)
        apart = torch.where(
            normal, self.other * (step + self.pull / over).square(), 2 * self.pull * step
        ).sum(-1)
        return Solved(misfit, rough, apart, determined, log_det)


@dataclass(frozen=True)
class Solved:
    """misfit (...) squares of the data's misfits;  rough (..., fields) squares of the rows;  apart
    (...) squares of other
    priors;  determined (...): how many numbers the data determine;  log_det (...) of the
             posterior's inverse covariance.
    """

    misfit: Tensor
    rough: Tensor
    apart: Tensor
    determined: Tensor
    log_det: Tensor


@dataclass(frozen=True)
class RegularizationChoice:
    """What a criterion found: weight (fields,); sigma of the data, over that given; effective:
    numbers that the data determine.

    weights, misfit, rough, value  (fields, tried): along each field's weight, the others as found;
                                   of the criterion, the least
    value is taken
    """

    weight: Tensor
    sigma: float
    effective: float
    weights: Tensor
    misfit: Tensor
    rough: Tensor
    value: Tensor


def weigh(problem: Linearised, criterion: str, known: bool) -> RegularizationChoice:
    """Weights by a criterion, each in turn; those of unknown noise are over the data's variance.
    `known`: misfits are over the data's deviations. Raises ValueError for the L-curve of several
    fields.
    """
    fields = len(problem.L)
    if criterion == "lcurve" and fields > 1:
        raise ValueError(
            f"the L-curve was asked for with {fields} fields; it is of one, 'evidence' and 'gcv' "
            "take several"
        )
    low, high = DECADES
    tried = (
        10
        ** torch.linspace(low, high, int((high - low) * EACH) + 1, dtype=torch.float64).to(
            problem.x
        )
        * problem.balance[:, None]
    )
    weight = problem.balance * 1e-4
    curves = torch.zeros(3, *tried.shape).to(tried)
    for _ in range(SWEEPS if fields > 1 else 1):
        before = weight.clone()
        for j in range(fields):
            along = weight.repeat(tried.shape[1], 1)
            along[:, j] = tried[j]
            solved = problem.solved(along)
            value = _value(problem, solved, along, criterion, known)
            curves[:, j] = torch.stack((solved.misfit, solved.rough[:, j], value))
            weight[j] = _least(tried[j], value)
        if (weight / before).log().abs().max() < 0.01:
            break
    solved = problem.solved(weight)
    freedom = (len(problem.r) - solved.determined).clamp(min=1)
    sigma = 1.0 if known else (solved.misfit / freedom).sqrt().item()
    return RegularizationChoice(weight, sigma, solved.determined.item(), tried, *curves)


def _value(
    problem: Linearised, solved: Solved, weight: Tensor, criterion: str, known: bool
) -> Tensor:
    """What is to be least (tried,)."""
    T = len(problem.r)
    if criterion == "gcv":
        return T * solved.misfit / (T - solved.determined).clamp(min=1e-3 * T) ** 2
    if criterion == "lcurve":
        return -_curvature(solved.misfit.log() / 2, solved.rough[:, 0].log() / 2)
    ranks = torch.tensor([float(len(L)) for L in problem.L]).to(weight)
    squares = solved.misfit + (weight * solved.rough).sum(-1) + solved.apart
    freedom = max(T + ranks.sum().item() + int((problem.other > 0).sum()) - len(problem.x), 1.0)
    own = squares if known else freedom * squares.log()
    return (own + solved.log_det - (ranks * weight.log()).sum(-1)) / 2


def _curvature(a: Tensor, b: Tensor) -> Tensor:
    """Of the curve (a, b) (n,) at even parameters; -inf at its ends."""

    def slope(x: Tensor) -> Tensor:
        return (x[2:] - x[:-2]) / 2

    da, db, dda, ddb = slope(a), slope(b), a.diff(n=2), b.diff(n=2)
    curvature = (da * ddb - dda * db) / (da.square() + db.square()).clamp(
        min=torch.finfo(a.dtype).eps
    ) ** 1.5
    return torch.nn.functional.pad(curvature, (1, 1), value=-torch.inf)


def _least(weights: Tensor, value: Tensor) -> Tensor:
    """Weight of the least value, by a parabola through its neighbours in the weight's logarithm."""
    value = torch.where(torch.isfinite(value), value, torch.inf)
    k = int(value.argmin())
    if k in (0, len(value) - 1) or not torch.isfinite(value[k - 1 : k + 2]).all():
        return weights[k]
    before, here, after = value[k - 1 : k + 2]
    bend = before - 2 * here + after
    shift = (before - after) / (2 * bend) if bend > 0 else 0.0
    return weights[k] * (weights[k + 1] / weights[k]) ** shift
