"""Beam element of two nodes in a plane, see `planar` for its axes and `element` for the names. With
J x = e_3 x x:

d(gamma) = R^T (d(d) - (alpha + beta)/2 J d)      d(phi) = beta - alpha      c = h F x d
m_i = c/2 - M    m_j = c/2 + M
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ...math.block_tridiagonal import broadcast_matrices
from ..element import halved


class Kinematics(NamedTuple):
    """An element, leading axes (..., N): R (2, 2), d (2), half angle phi/2 (1), J d (2)."""

    R: Tensor
    d: Tensor
    half: Tensor
    Jd: Tensor


def turned(x: Tensor) -> Tensor:
    """J x = e_3 x x."""
    return x @ torch.tensor(((0.0, 1), (-1, 0)), dtype=x.dtype, device=x.device)


def kinematics(r_i: Tensor, r_j: Tensor, q_i: Tensor, q_j: Tensor, length: Tensor) -> Kinematics:
    """Positions (..., 2) m and rotations (..., 2) of the two nodes, length (..., 1) m."""
    relative, middle = halved(q_i, q_j, multiply(q_j, inverse(q_i)))
    d = (r_j - r_i) / length
    half = torch.atan2(relative[..., 1:], relative[..., :1])
    return Kinematics(matrix(middle), d, half, turned(d))


def strains(kin: Kinematics, length: Tensor, reference: Tensor | float = 0.0) -> Tensor:
    return strains_of(kin.R, kin.d, 2 / length * kin.half) - reference


def strains_of(R: Tensor, d: Tensor, kappa: Tensor) -> Tensor:
    """[gamma; kappa] (..., N, 3), frame B."""
    gamma = (d[..., None, :] @ R)[..., 0, :]
    return torch.cat(torch.broadcast_tensors(gamma[..., :1], gamma[..., 1:], kappa), -1)


def _resolved(kin: Kinematics, stress: Tensor) -> tuple[Tensor, Tensor]:
    return (kin.R @ stress[..., :2, None])[..., 0], stress[..., 2:]


def forces(kin: Kinematics, stress: Tensor, length: Tensor) -> Tensor:
    F, M = _resolved(kin, stress)
    half = -length / 2 * _dot(F, kin.Jd)  # F x d = -F . J d
    return torch.cat((F, half - M, half + M), -1)


def strain_operator(kin: Kinematics, length: Tensor) -> Tensor:
    """B (..., N, 3, 4): d[gamma; kappa] = B (dr_j - dr_i, spin i, spin j)."""
    h = length[..., None]
    by_r = kin.R.mT / h
    by_spin = -(kin.R.mT @ kin.Jd[..., None]) / 2
    by_r, by_i, by_j = broadcast_matrices(by_r, by_spin, by_spin)
    last = torch.tensor((0.0, 0, -1, 1), dtype=by_r.dtype, device=by_r.device) / h
    return torch.cat((torch.cat((by_r, by_i, by_j), -1), last.expand(*by_r.shape[:-2], 1, 4)), -2)


def geometric_stiffness(kin: Kinematics, stress: Tensor, length: Tensor) -> Tensor:
    """[[0, JF/2, JF/2], [., -h F.d/4, -h F.d/4], [., ., .]] (..., N, 4, 4), symmetric."""
    F, _ = _resolved(kin, stress)
    JF = turned(F / 2)[..., None]
    corner = (-length / 4 * _dot(F, kin.d))[..., None]
    JF, corner = torch.broadcast_tensors(JF, corner)[0], corner
    side = JF.mT
    corner = corner.expand(*side.shape[:-2], 1, 1)
    row = torch.cat((side, corner, corner), -1)
    zero = torch.zeros_like(JF)
    return torch.cat((torch.cat((zero, zero, JF, JF), -1), row, row), -2)


def multiply(p: Tensor, q: Tensor) -> Tensor:
    (a, b), (c, d) = p.split(1, -1), q.split(1, -1)
    return torch.cat(torch.broadcast_tensors(a * c - b * d, a * d + b * c), -1)


def inverse(q: Tensor) -> Tensor:
    return q * torch.tensor((1.0, -1.0), dtype=q.dtype, device=q.device)


def matrix(q: Tensor) -> Tensor:
    """(..., 2, 2) [[c, -s], [s, c]] of the whole angle."""
    q2 = multiply(q, q)
    return (
        q2 @ torch.tensor(((1.0, 0, 0, 1), (0, -1, 1, 0)), dtype=q.dtype, device=q.device)
    ).unflatten(-1, (2, 2))


def _dot(x: Tensor, y: Tensor) -> Tensor:
    return (x * y) @ torch.ones(2, 1, dtype=x.dtype, device=x.device)
