"""Beam element of two nodes: strains, the forces that follow from its energy, and their exact
tangent.

Node i carries the position r_i and the rotation R_i. With h the element's length and
R_i^T R_j = exp(~phi):

    R = R_i exp(~phi/2)          d = (r_j - r_i) / h
    gamma = R^T d - gamma_0      kappa = (phi - phi_0) / h
    U = h/2 [gamma; kappa]^T S^-1 [gamma; kappa]

(Crisfield and Jelenic 1999: strains of relative rotations are objective; Simo and Vu-Quoc 1986: the
beam.) With alpha, beta the spins of nodes i and j, l = sin(|phi|/2) n and c = cos(|phi|/2) of the
relative rotation (a quaternion) and w = 4 tan(|phi|/4) n = 4 l/(1 + c), the variations are

    psi = spin of R = (alpha + beta)/2 - w x (beta - alpha)/8
    d(gamma) = R^T (d(d) + d x psi)       d(phi) = R^T G (beta - alpha),    G = g I + k l l^T

Everything but strain and stress is written in frame a, so that no matrix needs to be turned. A
tangent is taken with respect to the nine numbers (dr_j - dr_i, alpha, beta). Every function knows
one element alone; leading axes are free, and (..., N) is one of them.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..math import quaternions as quat
from ..math.quaternions import skew


class Kinematics(NamedTuple):
    """An element at one configuration; leading axes (..., N); vectors in frame a.

    R (3, 3) section axes at its middle -> frame a;  d (3) and l (3), c (1) as above;
    g (1) = x/sin(x) at x = |phi|/2 and k (1) = (1 - g)/|l|^2
    """

    R: Tensor
    d: Tensor
    c: Tensor
    l: Tensor
    g: Tensor
    k: Tensor

    @property
    def w(self) -> Tensor:
        """w/8 (3)."""
        return self.l / (2 + 2 * self.c)

    def rotate(self, stress: Tensor) -> tuple[Tensor, Tensor]:
        """[F; M] (..., N, 6), frame B -> F, M in frame a."""
        return (stress.unflatten(-1, (2, 3)) @ self.R.mT).unbind(-2)


def kinematics(r_i: Tensor, r_j: Tensor, q_i: Tensor, q_j: Tensor, length: Tensor) -> Kinematics:
    """Positions (..., 3) m and rotations (..., 4) of the two nodes, length (..., 1) m."""
    relative, middle = halved(q_i, q_j, quat.multiply(q_j, quat.conjugate(q_i)))
    R = quat.matrix(middle)
    c, l = relative[..., :1], relative[..., 1:]
    s2 = _dot(l, l)
    g = quat.arc_ratio(c, s2)
    return Kinematics(R, (r_j - r_i) / length, c, l, g, _near_zero(s2, 1 - g, -1 / 6, -3 / 40))


def halved(q_i: Tensor, q_j: Tensor, relative: Tensor) -> tuple[Tensor, Tensor]:
    """The relative rotation q_j q_i^-1, of its two signs that of the shorter way, and the rotation
    half way; in space and in a plane.
    """
    sign = torch.where(relative[..., :1] < 0, -1.0, 1.0).to(relative)
    return relative * sign, quat.normalize(q_i + sign * q_j)


def strains(kin: Kinematics, length: Tensor, reference: Tensor | float = 0.0) -> Tensor:
    """[gamma; kappa] (..., N, 6), frame B, less the reference's."""
    vectors = torch.stack(torch.broadcast_tensors(kin.d, 2 * kin.g / length * kin.l), -2)
    return (vectors @ kin.R).flatten(-2) - reference


def forces(kin: Kinematics, stress: Tensor, length: Tensor) -> Tensor:
    """Gradient of the energy with respect to the nine numbers, (..., N, 9): with [F; M] the stress
    in frame a,

    c = h F x d,   n = F,   m_i = c/2 + (c x w)/8 - G M,   m_j = c/2 - (c x w)/8 + G M.
    """
    F, M = kin.rotate(stress)
    return torch.cat(_forces(kin, F, M, length), -1)


def _forces(kin: Kinematics, F: Tensor, M: Tensor, length: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    half = length / 2 * torch.linalg.cross(F, kin.d.expand_as(F))
    turn = (
        torch.linalg.cross(2 * half, kin.w.expand_as(F))
        - kin.g * M
        - kin.k * kin.l * _dot(kin.l, M)
    )
    return F, half + turn, half - turn


def strain_operator(kin: Kinematics, length: Tensor) -> Tensor:
    """B (..., N, 6, 9): d[gamma; kappa] = B (dr_j - dr_i, spin i, spin j), frame a -> frame B."""
    eye = torch.eye(3, dtype=kin.d.dtype, device=kin.d.device)
    h = length[..., None]
    # ~d ~w = w d^T - (d.w) I
    half, dw = skew(kin.d / 2), _outer(kin.w, kin.d) - _dot(kin.d, kin.w)[..., None] * eye
    G = (kin.g[..., None] * eye + _outer(kin.k * kin.l, kin.l)) / h
    half_dw_G = torch.broadcast_tensors(half + dw, half - dw, G)
    by_i, by_j, by_turn = (kin.R.mT @ torch.cat(half_dw_G, -1)).split(3, -1)
    by_r = kin.R.mT / h
    by_r, by_i, by_j, by_turn = torch.broadcast_tensors(by_r, by_i, by_j, by_turn)
    return torch.cat(
        (
            torch.cat((by_r, by_i, by_j), -1),
            torch.cat((torch.zeros_like(by_r), -by_turn, by_turn), -1),
        ),
        -2,
    )


def geometric_stiffness(kin: Kinematics, stress: Tensor, length: Tensor) -> Tensor:
    """Derivative (..., N, 9, 9) of `forces` at fixed stress; unsymmetric, because spins are not
    coordinates. With W = ~w/8, X = h ~F ~d and ~x ~y = y x^T - (x.y) I throughout:

        d(R x) = psi x x + R dx,   d(c) = h F x d(d) + X psi,   d(w) = (1 + |w|^2/16) (beta - alpha)
        d(G M) = P (beta - alpha) beside the turn of R,
        2 P = p M l^T + k l M^T + k (l.M) I - 2 (l.M) (q + k/(1 + c)) l l^T

    with k = (1 - g)/s2, p = (1 - g c)/s2, q = (p/2 + k c)/s2, s2 = |l|^2. Rows n, m_i, m_j; columns
    dr, spin i, spin j:

        0              Y_i^T              Y_j^T            Y_i = (I/2 - W) ~F,  Y_j = (I/2 + W) ~F
        Y_i   A_i (I/2 + W) - Q    A_i (I/2 - W) + Q       A_i = (I/2 - W) X - ~m_i,
              A_j = (I/2 + W) X - ~m_j
        Y_j   A_j (I/2 + W) + Q    A_j (I/2 - W) - Q       Q = (1 + |w|^2/16) ~c/8 - P
    """
    F, M = kin.rotate(stress)
    d, l, w = (v.expand_as(F) for v in (kin.d, kin.l, kin.w))
    eye = torch.eye(3, dtype=F.dtype, device=F.device)
    _, m_i, m_j = _forces(kin, F, M, length)
    s2 = _dot(l, l)
    p = _near_zero(s2, 1 - kin.g * kin.c, 1 / 3, 2 / 15)
    q = _near_zero(s2, p / 2 + kin.k * kin.c, 3 / 40, 29 / 560)
    lM = _dot(l, M)
    sum_c = (m_i + m_j) / 8 * (1 + 4 * _dot(w, w))  # (1 + |w|^2/16) c/8, where w here is w/8
    P = (_outer(p * M - 2 * lM * (q + kin.k / (1 + kin.c)) * l, l)
         + _outer(kin.k * l, M) + (kin.k * lM)[..., None] * eye)  # fmt: skip
    Q = skew(sum_c) - P / 2
    half_F, wF = skew(F / 2), _outer(F, w) - _dot(F, w)[..., None] * eye
    Y_i, Y_j = half_F - wF, half_F + wF
    X = _outer(length * d, F) - (length * _dot(F, d))[..., None] * eye
    W = skew(w)
    WX = _outer(length * torch.linalg.cross(w, d), F) - (length * _dot(F, d))[..., None] * W
    A_i, A_j = X / 2 - WX - skew(m_i), X / 2 + WX - skew(m_j)
    A = torch.cat((A_i, A_j), -2)
    AW, A, Q = A @ W, A / 2, torch.cat((Q, -Q), -2)
    top = torch.cat((torch.zeros_like(Y_i), Y_i.mT, Y_j.mT), -1)
    return torch.cat((top, torch.cat((torch.cat((Y_i, Y_j), -2), A + AW - Q, A - AW + Q), -1)), -2)


# of s2: below, the next term of a series is 1e-12; above, a closed form loses at most 1e-13/|l|
SMALL = 1e-6


def _near_zero(s2: Tensor, numerator: Tensor, *series: float) -> Tensor:
    """numerator / s2; next to s2 = 0 its series."""
    small = s2 < SMALL
    return torch.where(
        small, series[0] + series[1] * s2, numerator / torch.where(small, torch.ones_like(s2), s2)
    )


def _outer(x: Tensor, y: Tensor) -> Tensor:
    """x y^T"""
    return x[..., :, None] * y[..., None, :]


def _dot(x: Tensor, y: Tensor) -> Tensor:
    # a product is six times faster than a short sum
    return (x * y) @ torch.ones(3, 1, dtype=x.dtype, device=x.device)
