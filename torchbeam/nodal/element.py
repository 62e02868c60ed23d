"""The nodal element: strains, the forces that follow from its energy, and their exact tangent.

Node i carries the position r_i and the rotation R_i. With h the element's length and Lambda = R_i^T R_j = exp(~phi):

    R = R_i exp(~phi/2)          d = R^T (r_j - r_i) / h
    gamma = d - d_0              kappa = (phi - phi_0) / h
    U = h/2 [gamma; kappa]^T S^-1 [gamma; kappa]

(Crisfield and Jelenic 1999: strains of relative rotations are objective; Simo and Vu-Quoc 1986: the beam.) With a, b the
spins of nodes i and j in R's axes, l = sin(|phi|/2) n and c = cos(|phi|/2) of the relative rotation (its quaternion), and
w = 4 tan(|phi|/4) n = 4 l / (1 + c), the variations are

    spin of R = (a + b)/2 - w x (b - a)/8        d(phi) = G (b - a),    G = g I + k l l^T
    d(gamma)  = R^T (dr_j - dr_i)/h + d x (spin of R)

A tangent is taken with respect to the nine numbers (dr_j - dr_i, spin of i, spin of j), all in frame a.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from .. import quaternions as quat
from ..quaternions import hat


class Kinematics(NamedTuple):
    """An element at one configuration; leading axes (..., N).

    R (3, 3) section axes at its middle -> frame a;  d (3);  c (1), l (3): relative rotation as a quaternion;
    g (1): x/sin(x) at x = |phi|/2
    """

    R: Tensor
    d: Tensor
    c: Tensor
    l: Tensor
    g: Tensor

    @property
    def phi(self) -> Tensor:
        """Rotation vector from node i to node j, rad."""
        return 2 * self.g * self.l

    @property
    def w(self) -> Tensor:
        """4 tan(|phi|/4) n."""
        return 4 * self.l / (1 + self.c)


def kinematics(position: Tensor, rotation: Tensor, length: Tensor) -> Kinematics:
    """position (..., N+1, 3) m, rotation (..., N+1, 4), length (..., N, 1) m -> `Kinematics` of the N elements."""
    q_i, q_j = rotation[..., :-1, :], rotation[..., 1:, :]
    relative = quat.multiply(quat.conjugate(q_i), q_j)
    sign = torch.where(relative[..., :1] < 0, -1.0, 1.0).to(relative)
    relative = relative * sign
    R = quat.matrix(quat.normalize(q_i + sign * q_j))
    d = (R.mT @ (position.diff(dim=-2) / length)[..., None])[..., 0]
    c, l = relative[..., :1], relative[..., 1:]
    return Kinematics(R, d, c, l, quat.arc_ratio(c, l.square().sum(-1, keepdim=True)))


def strain(kin: Kinematics, length: Tensor, reference: Tensor | float = 0.0) -> Tensor:
    """[gamma; kappa] (..., N, 6), frame B, less the reference's."""
    return torch.cat((kin.d, kin.phi / length), -1) - reference


def forces(kin: Kinematics, stress: Tensor, length: Tensor) -> Tensor:
    """Gradient of the energy with respect to the nine numbers, (..., N, 9) in frame a: with [F; M] the stress,

    c = h F x d,   n = F,   m_j = c/2 - (c x w)/8 + G M,   m_i = c/2 + (c x w)/8 - G M.
    """
    F, M = stress[..., :3], stress[..., 3:]
    c = length * torch.linalg.cross(F, kin.d)
    s2 = kin.l.square().sum(-1, keepdim=True)
    GM = kin.g * M + _k(kin, s2) * kin.l * (kin.l * M).sum(-1, keepdim=True)
    turn = torch.linalg.cross(c, kin.w) / 8 - GM
    rows = torch.stack((F.expand_as(c), c / 2 + turn, c / 2 - turn), -2)
    return (rows @ kin.R.mT).flatten(-2)


def strain_operator(kin: Kinematics, length: Tensor) -> Tensor:
    """B (..., N, 6, 9): d[gamma; kappa] = B (dr_j - dr_i, spin i, spin j), frame a -> frame B."""
    eye = torch.eye(3, dtype=kin.d.dtype, device=kin.d.device)
    d, half, W = hat(kin.d), eye / 2, hat(kin.w) / 8
    s2 = kin.l.square().sum(-1, keepdim=True)
    h = length[..., None]
    G = (kin.g[..., None] * eye + _k(kin, s2)[..., None] * (kin.l[..., :, None] * kin.l[..., None, :])) / h
    gamma = torch.cat((eye / h + torch.zeros_like(d), d @ (half + W), d @ (half - W)), -1)
    kappa = torch.cat((torch.zeros_like(G), -G, G), -1)
    return _columns_to_a(torch.cat((gamma, kappa), -2), kin.R)


def geometric_stiffness(kin: Kinematics, stress: Tensor, length: Tensor) -> Tensor:
    """Derivative (..., N, 9, 9) of `forces` at fixed stress; unsymmetric, because spins are not coordinates.

    In R's axes, with psi the spin of R and beta = b - a:
        d(R x)   = psi x x + dx                      d(c)     = h F x d(gamma)
        d(w)     = (1 + |w|^2/16) beta               d(l)     = (beta - l (l.beta)/(1 + c))/2
        d(G M)   = P beta,   2 P = p M l^T + k l M^T + k (l.M) I - 2 (l.M) (q + k/(1 + c)) l l^T
    with k = (1 - g)/s2, p = (1 - g c)/s2, q = (p/2 + k c)/s2 and s2 = |l|^2.
    """
    F, M = stress[..., :3], stress[..., 3:]
    d, l, h = kin.d, kin.l, length
    eye = torch.eye(3, dtype=d.dtype, device=d.device)
    F = F.expand(torch.broadcast_shapes(F.shape, d.shape))
    M = M.expand_as(F)
    c = h * torch.linalg.cross(F, d)
    s2 = l.square().sum(-1, keepdim=True)
    k, p, q = _k(kin, s2), _p(kin, s2), _q(kin, s2)
    lM = (l * M).sum(-1, keepdim=True)
    turn = torch.linalg.cross(c, kin.w) / 8 - (kin.g * M + k * l * lM)
    hats = hat(torch.stack((F, d, kin.w / 8, c * (1 + kin.w.square().sum(-1, keepdim=True) / 16) / 8,
                            c / 2 + turn, c / 2 - turn), -2))
    hF, hd, W, ec, m_i, m_j = hats.unbind(-3)
    # 2 P = M (p l)^T + l (k M - 2 (l.M) (q + k/(1 + c)) l)^T + k (l.M) I, as one product of (3, 2) and (2, 3)
    left = torch.stack((M, l), -1)
    right = torch.stack((p * l, k * M - 2 * lM * (q + k / (1 + kin.c)) * l), -2)
    Q = ec - (left @ right + (k * lM)[..., None] * eye) / 2  # d(c x w)/8 - d(G M) by beta: of m_i; of m_j with minus
    plus, minus = eye / 2 + W, eye / 2 - W
    sides = torch.cat((minus, plus), -2)  # c turns into m_i through (I/2 - W), into m_j through (I/2 + W)
    zero = torch.zeros_like(hF)
    by_rho = torch.cat((zero, sides @ hF), -2)
    by_psi = torch.cat((-hF, h[..., None] * (sides @ (hF @ hd)) - torch.cat((m_i, m_j), -2)), -2)
    by_beta = torch.cat((zero, Q, -Q), -2)
    local = torch.cat((by_rho, by_psi @ plus - by_beta, by_psi @ minus + by_beta), -1)
    turned = _columns_to_a(local, kin.R)
    return (kin.R[..., None, :, :] @ turned.unflatten(-2, (3, 3))).flatten(-3, -2)


def to_nodes(n_mi_mj: Tensor) -> Tensor:
    """(..., N, 9) of elements -> (..., N+1, 6) summed at nodes: -n and m_i at node i, n and m_j at node j."""
    n, m_i, m_j = n_mi_mj[..., :3], n_mi_mj[..., 3:6], n_mi_mj[..., 6:]
    return pad(torch.cat((-n, m_i), -1), (0, 0, 0, 1)) + pad(torch.cat((n, m_j), -1), (0, 0, 1, 0))


def to_blocks(Y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(..., N, 9, 9) of elements -> (diagonal (..., N+1, 6, 6), upper, lower (..., N, 6, 6)) of the chain of nodes."""
    rows = torch.cat((-Y[..., :3, :], Y[..., 3:6, :], Y[..., :3, :], Y[..., 6:, :]), -2)
    K = torch.cat((-rows[..., :3], rows[..., 3:6], rows[..., :3], rows[..., 6:]), -1)
    diagonal = pad(K[..., :6, :6], (0, 0, 0, 0, 0, 1)) + pad(K[..., 6:, 6:], (0, 0, 0, 0, 1, 0))
    return diagonal, K[..., :6, 6:], K[..., 6:, :6]


def _columns_to_a(local: Tensor, R: Tensor) -> Tensor:
    """Every three columns of (..., rows, 9), given in R's axes, times R^T."""
    return (local.unflatten(-1, (3, 3)).flatten(-3, -2) @ R.mT).reshape(local.shape)


def _series(s2: Tensor, exact: Tensor, *coefficients: float) -> Tensor:
    """`exact` away from zero, a series in s2 next to it."""
    near = coefficients[0] + coefficients[1] * s2
    return torch.where(s2 < SMALL, near, exact)


SMALL = 1e-6  # of s2: below, the series' next term is 1e-12 relative; above, the exact forms lose at most 1e-13 / |l|


def _away(s2: Tensor) -> Tensor:
    return torch.where(s2 < SMALL, torch.ones_like(s2), s2)


def _k(kin: Kinematics, s2: Tensor) -> Tensor:
    """(1 - g)/s2 -> -1/6 - 3 s2/40"""
    return _series(s2, (1 - kin.g) / _away(s2), -1 / 6, -3 / 40)


def _p(kin: Kinematics, s2: Tensor) -> Tensor:
    """(1 - g c)/s2 -> 1/3 + 2 s2/15"""
    return _series(s2, (1 - kin.g * kin.c) / _away(s2), 1 / 3, 2 / 15)


def _q(kin: Kinematics, s2: Tensor) -> Tensor:
    """(p/2 + k c)/s2 -> 3/40 + 29 s2/560"""
    return _series(s2, (_p(kin, s2) / 2 + _k(kin, s2) * kin.c) / _away(s2), 3 / 40, 29 / 560)
