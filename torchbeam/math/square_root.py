"""Square roots of covariances: triangular R with R^T R = P, conditioned on what is read, and on
what comes after.

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
    """What readings say of the other columns of an array.

    error (..., m) of the readings, in independent units of one deviation each
    change (..., n) of the others' means;  root (..., k, n) of their covariance afterwards
    size  (...) logarithm of the root of the determinant of the readings' covariance
    """

    error: Tensor
    change: Tensor
    root: Tensor
    size: Tensor


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
    own, shared = whole[..., :m, :m], whole[..., :m, m:]
    unit = torch.linalg.solve_triangular(own.mT, error[..., None], upper=False)
    return Conditioned(
        unit[..., 0],
        (shared.mT @ unit)[..., 0],
        whole[..., m:, m:],
        own.diagonal(dim1=-2, dim2=-1).abs().log().sum(-1),
    )


def regression(root: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Of the root (..., k, count + n) of what comes after and what came before: the gain (..., n,
    count) by which the latter follows the former, and the root of what is left of it. What comes
    after may be known in part: directions without variance say nothing.
    """
    after, shared = root[..., :count, :count], root[..., :count, count:]
    gain = torch.linalg.pinv(after, rtol=RANK) @ shared
    return gain.mT, torch.cat((shared - after @ gain, root[..., count:, count:]), -2)


def normal_log_density(unit: Tensor, size: Tensor, count: Tensor) -> Tensor:
    """(...) of errors in units of one deviation (..., m), `count` (...) of which were read."""
    return -(unit**2).sum(-1) / 2 - size - count * math.log(2 * math.pi) / 2
