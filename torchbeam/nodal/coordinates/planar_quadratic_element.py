"""Beam element of three nodes in a plane, at one of its stations: see `planar` for the axes,
`quadratic_element` for the names and `planar_element` for J. Rotations are complex numbers, and the
w_i commute:

    d(gamma) = R^T (d(d) - psi J d)   d(kappa) = psi'/h   psi = alpha_2 + sum Re(w_i) beta_i
    psi' = sum Re(w_i') beta_i
    n = F      m_i = Re(w_i) f + Re(w_i') M, by alpha_2 their sum: f = h F x d
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ...math.block_tridiagonal import broadcast_matrices
from ...math.quaternions import aligned
from ..quadratic_element import interpolated
from .planar_element import inverse, matrix, multiply, strains_of, turned


class Kinematics(NamedTuple):
    """A station at one configuration, leading axes (..., 2 N): R (2, 2), d (2), z (2), w and w_x
    (2, 2), Jd (2).
    """

    R: Tensor
    d: Tensor
    z: Tensor
    w: Tensor
    w_x: Tensor
    Jd: Tensor


def kinematics(
    r_1: Tensor, r_2: Tensor, r_3: Tensor, q_1: Tensor, q_2: Tensor, q_3: Tensor, length: Tensor
) -> Kinematics:
    """Positions (..., 2) m and rotations (..., 2) of the three nodes, length (..., 1) m."""
    r, q = torch.stack((r_1, r_2, r_3), -2), aligned(q_1, q_2, q_3)
    rotation, d, *others = interpolated(r, q, length, multiply, inverse)
    return Kinematics(matrix(rotation), d, *others, turned(d))


def strains(kin: Kinematics, length: Tensor, reference: Tensor | float = 0.0) -> Tensor:
    return strains_of(kin.R, kin.d, 2 / length * kin.z[..., 1:]) - reference


def _resolved(kin: Kinematics, stress: Tensor, length: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """F, M and f = h F x d = -h F . J d."""
    F, M = (kin.R @ stress[..., :2, None])[..., 0], stress[..., 2:]
    return F, M, -length * (F * kin.Jd).sum(-1, keepdim=True)


def forces(kin: Kinematics, stress: Tensor, length: Tensor) -> Tensor:
    F, M, f = _resolved(kin, stress, length)
    m = kin.w[..., 0] * f + kin.w_x[..., 0] * M
    return torch.cat((F, m[..., :1], f, m[..., 1:]), -1)


def strain_operator(kin: Kinematics, length: Tensor) -> Tensor:
    """B (..., 2 N, 3, 5): d[gamma; kappa] = B (dr', beta_1, alpha_2, beta_3)."""
    h, turn = length[..., None], -(kin.R.mT @ kin.Jd[..., None])
    by_r, by_spin, by_rate = broadcast_matrices(
        kin.R.mT / h,
        turn * _of_spins(kin.w[..., 0], 1.0)[..., None, :],
        _of_spins(kin.w_x[..., 0], 0.0)[..., None, :] / h,
    )
    below = torch.cat((torch.zeros_like(by_r[..., :1, :]), by_rate), -1)
    return torch.cat((torch.cat((by_r, by_spin), -1), below), -2)


def _of_spins(ends: Tensor, middle: float) -> Tensor:
    """(..., 3) by beta_1, alpha_2 and beta_3."""
    return torch.stack((ends[..., 0], torch.full_like(ends[..., 0], middle), ends[..., 1]), -1)


def geometric_stiffness(kin: Kinematics, stress: Tensor, length: Tensor) -> Tensor:
    """Derivative (..., 2 N, 5, 5) of `forces` at fixed stress, with d(F) = psi J F and

    d Re(w_i)  = -beta_i Im(w_i)/2 + sum beta_j Im(w_i w_j)/2
    d Re(w_i') = -beta_i Im(w_i')/2 + sum beta_j Im(w_i' w_j + w_i w_j')/2
    d(f) = F x dr' - h F.d psi
    """
    F, M, f = _resolved(kin, stress, length)
    (c, s), (c_x, s_x) = (x.unbind(-1) for x in (kin.w, kin.w_x))  # (..., 2)
    JF = turned(F)[..., None]

    def both(a: Tensor, b: Tensor) -> Tensor:
        product = a[..., :, None] * b[..., None, :]
        return product + product.mT

    turn = (
        f[..., None] * both(s, c)
        + M[..., None] * (both(s_x, c) + both(s, c_x))
        - torch.diag_embed(f * s + M * s_x)
    )
    c = _of_spins(c, 1.0)
    turn = _of_spins(_of_spins(turn, 0.0).mT, 0.0) / 2  # alpha_2 turns no w_i
    corner = (turn - (length * (F * kin.d).sum(-1, keepdim=True))[..., None]
              * c[..., :, None] * c[..., None, :])  # fmt: skip
    side = JF * c[..., None, :]
    zero = torch.zeros_like(JF).expand(*JF.shape[:-1], 2)
    return torch.cat((torch.cat((zero, side), -1), torch.cat((side.mT, corner), -1)), -2)
