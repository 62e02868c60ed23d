"""Square roots of covariances: triangular R with R^T R = P, conditioned on what is read, then
and later.

Rows of an array are independent sources of unit variance, columns what they add up to: the array's
triangle is a square root of the columns' covariance (Kailath, Sayed and Hassibi 2000, chapter 12).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

RANK = 1e-12  # of a triangle's largest number: what counts as none


class Conditioned(NamedTuple):
    """What readings say of the other columns of an array: with y the readings' errors, own^T unit =
    y, and the others' means change by shared^T unit.

    unit (..., m) errors of a deviation each, independent of each other;  own (..., m, m), shared
    (..., m, n);  root (..., k, n) of the others' covariance afterwards
    """

    unit: Tensor
    own: Tensor
    shared: Tensor
    root: Tensor

    @property
    def change(self) -> Tensor:
        """(..., n) of the others' means."""
        return (self.shared.mT @ self.unit[..., None])[..., 0]

    def log_density(self, count: Tensor) -> Tensor:
        """(...) of the errors, `count` (...) of which were read; the others have own = 1."""
        size = self.own.diagonal(dim1=-2, dim2=-1).abs().log().sum(-1)
        return -(self.unit**2).sum(-1) / 2 - size - count * math.log(2 * math.pi) / 2


def triangle(rows: Tensor) -> Tensor:
    """(..., min(s, n), n): upper triangular, with the same product R^T R as rows (..., s, n)."""
    return torch.linalg.qr(rows, mode="r").R


def root_of(name: str, covariance: Tensor) -> Tensor:
    """R (..., n, n) of a covariance (..., n, n). Raises ValueError for a matrix that is none."""
    values, vectors = torch.linalg.eigh((covariance + covariance.mT) / 2)
    if not (values >= -RANK * values[..., -1:].clamp(min=0)).all():
        raise ValueError(
            f"{name} with an eigenvalue of {values.min().item():g} was given; none below 0 is "
            "wanted"
        )
    return (vectors * values.clamp(min=0).sqrt()[..., None, :]).mT


def conditioned(rows: Tensor, error: Tensor) -> Conditioned:
    """rows (..., s, m + n) of readings and others; error (..., m): readings less their means. The
    readings' covariance is positive.
    """
    m = error.shape[-1]
    whole = triangle(rows)
    common, shared = whole[..., :m, :m], whole[..., :m, m:]
    unit = torch.linalg.solve_triangular(common.mT, error[..., None], upper=False)
    return Conditioned(unit[..., 0], common, shared, whole[..., m:, m:])


class Later(NamedTuple):
    """What readings after an instant say of it: with P its covariance, that its mean changes by P
    pull, and P by -P push^T push P (Bryson and Frazier 1963; no covariance is inverted).

    pull (..., n);  push (..., k, n)
    """

    pull: Tensor
    push: Tensor

    def before(self, found: Conditioned, read: Tensor, moved: Tensor) -> Later:
        """What they and the readings `found` say of an interval before, where the readings are
        read (..., m, n), and the motion over it moved (..., n, n), times the deviation there.
        """
        unit = torch.linalg.solve_triangular(found.own.mT, read, upper=False)
        left = moved - found.shared.mT @ unit
        pull = unit.mT @ found.unit[..., None] + left.mT @ self.pull[..., None]
        return Later(pull[..., 0], triangle(torch.cat((unit, self.push @ left), -2)))

    def given(self, root: Tensor) -> tuple[Tensor, Tensor]:
        """Change (..., n) of the mean, and a root of the covariance, of what has this root."""
        change = root.mT @ (root @ self.pull[..., None])
        Q = self.push @ root.mT
        left = torch.eye(Q.shape[-1]).to(Q) - Q.mT @ Q
        failed = ~left.isfinite().all(-1, keepdim=True).all(-2, keepdim=True)
        values, vectors = torch.linalg.eigh(left.masked_fill(failed, 0.0))
        values = values.masked_fill(failed[..., 0], math.nan)
        return change[..., 0], values.clamp(min=0).sqrt()[..., None] * (vectors.mT @ root)
