"""Beam element of three nodes, at one of its two Gauss points (a station): strains, the forces that
follow from its energy, and their exact tangent.

Node i carries the position r_i and the rotation q_i, a unit quaternion. With x in [-1, 1] along the
element, N_i of `element_shapes` and h the length that the station stands for (dx = ds/h: half of
the element's, as its weight):

    r(x) = sum N_i r_i        Q(x) = sum N_i q_i,
    the rotation R(x) = Q/|Q|, of all q_i that sign which is nearer to q_2
    d = r'/h                  z = Q' Q^-1           gamma = R^T d - gamma_0
    kappa = R^T 2 vec(z)/h - kappa_0

A rotation g of the whole beam takes q_i to g q_i and so Q to g Q: strains are objective, and as
they depend on where the nodes are alone, independent of the path (what Crisfield and Jelenic 1999
ask for; interpolated quaternions: Romero 2004). At the Gauss points the curvature of an arc is
right up to (angle of the element)^4/11520. Two points, where three would be exact, leave no room
for shear and membrane locking, and no motion without energy.

With w_i = N_i q_i Q^-1, w_i' its derivative by x, and alpha_i the spin of node i, all in frame a
and as quaternions,

    psi = spin of R = vec(sum alpha_i w_i)         psi' = vec(sum alpha_i w_i')
    d(gamma) = R^T (d(d) + d x psi)                d(kappa) = R^T psi'/h

As the w_i add up to 1, and the w_i' to 0, the first and the third suffice where spins are told by
alpha_2 and, of these two nodes, by beta_i = alpha_i - alpha_2: psi = alpha_2 + vec(sum beta_i w_i).
A tangent is taken with respect to the numbers (dr', beta_1, alpha_2, beta_3). Every function knows
stations alone; leading axes are free, and (..., 2 N) is one of them, the two of an element after
each other.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..math import quaternions as quat
from ..math.block_tridiagonal import broadcast_matrices
from ..math.element_shapes import at_points
from ..math.quaternions import cross, skew


class Kinematics(NamedTuple):
    """A station at one configuration; leading axes (..., 2 N); vectors in frame a.

    R (3, 3) section axes -> frame a;  d (3) and z (4) as above;  w, w_x (2, 4): w_i and w_i' of the
                                       first and the third node
    """

    R: Tensor
    d: Tensor
    z: Tensor
    w: Tensor
    w_x: Tensor


def kinematics(
    r_1: Tensor, r_2: Tensor, r_3: Tensor, q_1: Tensor, q_2: Tensor, q_3: Tensor, length: Tensor
) -> Kinematics:
    """Positions (..., 3) m and rotations (..., 4) of the three nodes, length (..., 1) m."""
    r, q = torch.stack((r_1, r_2, r_3), -2), quat.aligned(q_1, q_2, q_3)
    rotation, *others = interpolated(r, q, length, quat.multiply, quat.conjugate)
    return Kinematics(quat.matrix(rotation), *others)


def interpolated(
    r: Tensor,
    q: Tensor,
    length: Tensor,
    multiply: Callable[[Tensor, Tensor], Tensor],
    conjugate: Callable[[Tensor], Tensor],
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Q/|Q| and d, z, w, w_x of stations (..., 2 N), from positions r (..., 2 N, 3, p) m and
    rotations q (..., 2 N, 3, .) of their three nodes, of which `multiply` and `conjugate` say what
    they are; length (..., 2 N, 1) m.
    """
    values, slopes = (x.repeat(r.shape[-3] // 2, 1)[..., None] for x in at_points(r))  # (2 N, 3, 1)
    Q = (values.mT @ q)[..., 0, :]
    square = (Q * Q).sum(-1, keepdim=True)
    ends, N, slope = (x[..., ::2, :] for x in (q, values, slopes))
    w = multiply(ends, (conjugate(Q) / square)[..., None, :])
    w, v = N * w, slope * w
    unit = torch.zeros_like(Q) + Q.new_tensor([1.0] + [0.0] * (Q.shape[-1] - 1))
    z = v.sum(-2) + slopes[:, 1] / values[:, 1] * (unit - w.sum(-2))  # w_2 is what is left of 1
    return (
        Q / square.sqrt(),
        (slopes.mT @ r)[..., 0, :] / length,
        z,
        w,
        v - multiply(w, z[..., None, :]),
    )


def strains(kin: Kinematics, length: Tensor, reference: Tensor | float = 0.0) -> Tensor:
    """[gamma; kappa] (..., 2 N, 6), frame B, less the reference's."""
    vectors = torch.stack(torch.broadcast_tensors(kin.d, 2 / length * kin.z[..., 1:]), -2)
    return (vectors @ kin.R).flatten(-2) - reference


def forces(kin: Kinematics, stress: Tensor, length: Tensor) -> Tensor:
    """Gradient of the energy with respect to the numbers, (..., 2 N, 12): with [F; M] the stress in
    frame a and f = h F x d,

    n = F,   m_i = vec(w_i f + w_i' M),   by alpha_2 their sum: f.
    """
    F, M = (stress.unflatten(-1, (2, 3)) @ kin.R.mT).unbind(-2)
    f = length * cross(F, kin.d)
    m_1, m_3 = (_turned(kin.w, f) + _turned(kin.w_x, M))[..., 1:].unbind(-2)
    return torch.cat((F, m_1, f, m_3), -1)


def strain_operator(kin: Kinematics, length: Tensor) -> Tensor:
    """B (..., 2 N, 6, 12): d[gamma; kappa] = B (dr', beta_1, alpha_2, beta_3), a -> B."""
    h, Rt = length[..., None], kin.R.mT
    turn, (A, A_x) = Rt @ skew(kin.d), (_turning(w)[..., 1:, :] for w in (kin.w, kin.w_x))
    by_r, by_spin, *by_spins = broadcast_matrices(
        Rt / h, turn, *(turn[..., None, :, :] @ A).unbind(-3)
    )
    by_rate = broadcast_matrices(by_r, *((Rt / h)[..., None, :, :] @ A_x).unbind(-3))[1:]
    zero = torch.zeros_like(by_r)
    return torch.cat(
        (
            torch.cat((by_r, by_spins[0], by_spin, by_spins[1]), -1),
            torch.cat((zero, by_rate[0], zero, by_rate[1]), -1),
        ),
        -2,
    )


def geometric_stiffness(kin: Kinematics, stress: Tensor, length: Tensor) -> Tensor:
    """Derivative (..., 2 N, 12, 12) of `forces` at fixed stress; unsymmetric, because spins are not
    coordinates.

    With a = sum beta_j w_j/2, a' its derivative by x, dw_i = beta_i w_i/2 - w_i a,
    dw_i' = beta_i w_i'/2 - w_i' a - w_i a'. As a f + a' M = sum beta_j mu_j/2, where
    vec(mu_j) = m_j,

        dn   = psi x F                                            dM = psi x M
        df   = F x dr' + X psi                                    X = h (F d^T - (F.d) I)
        dm_i
            = vec(beta_i mu_i/2 - w_i sum beta_j mu_j/2 - w_i' sum beta_j w_j M/2 + w_i df
                + w_i' dM)

    and by alpha_2, which turns all but r', dm_i = alpha_2 x m_i - A_i^T (F x (alpha_2 x r')) with
    A_i beta = vec(beta w_i).
    """
    F, M = (stress.unflatten(-1, (2, 3)) @ kin.R.mT).unbind(-2)
    d, h = kin.d.expand_as(F), length[..., None]
    f = length * torch.linalg.cross(F, d)
    eye = torch.eye(3, dtype=F.dtype, device=F.device)
    X = h * (F[..., :, None] * d[..., None, :] - (F * d).sum(-1, keepdim=True)[..., None] * eye)
    by_F = skew(-F)
    # (..., 2, 3, 3), (..., 2, 4)
    A, m = _turning(kin.w)[..., 1:, :], _turned(kin.w, f) + _turned(kin.w_x, M)
    dF, dM, df = (x[..., None, :, :] @ A for x in (by_F, skew(-M), X))
    by_w, by_w_x = (
        pad(x, (0, 0, 1, 0)) - _turning(q) / 2 for x, q in ((df, m), (dM, _turned(kin.w, M)))
    )
    K = sum(
        _rows(w)[..., :, None, :, :] @ by[..., None, :, :, :]
        for w, by in ((kin.w, by_w), (kin.w_x, by_w_x))
    )
    spin_part = (m[..., :1, None] * eye - skew(m[..., 1:])) / 2
    turn = df.mT - skew(m[..., 1:])
    K11, K13 = K[..., 0, 0, :, :] + spin_part[..., 0, :, :], K[..., 0, 1, :, :]
    K33 = K[..., 1, 1, :, :] + spin_part[..., 1, :, :]
    (F1, F3), (Z1, Z3), (X1, X3) = (x.unbind(-3) for x in (dF, turn, df))
    rows = (
        (torch.zeros_like(X), F1, by_F, F3),
        (F1.mT, K11, Z1, K13),
        (by_F.mT, X1, X, X3),
        (F3.mT, K13.mT, Z3, K33),
    )
    return torch.cat([torch.cat(row, -1) for row in rows], -2)


def _turned(w: Tensor, x: Tensor) -> Tensor:
    """Quaternions w_i x (..., 3, 4) of w (..., 3, 4) and a vector x (..., 3)."""
    return (_right(x) @ w.mT).mT


def _right(x: Tensor) -> Tensor:
    """(..., 4, 4): what takes q to q x, of a vector x: (-q.x, q_0 x + q x x)."""
    first = torch.cat((torch.zeros_like(x[..., :1]), -x), -1)[..., None, :]
    return torch.cat((first, torch.cat((x[..., :, None], -skew(x)), -1)), -2)


def _turning(w: Tensor) -> Tensor:
    """(..., 4, 3): what takes a vector x to x w: (-x.l, c x + x x l) of w = (c, l)."""
    c, l = w[..., :1, None], w[..., 1:]
    eye = torch.eye(3, dtype=w.dtype, device=w.device)
    return torch.cat((-l[..., None, :], c * eye - skew(l)), -2)


def _rows(w: Tensor) -> Tensor:
    """(..., 3, 4): the vector of w q by q, (l, c + ~l)."""
    c, l = w[..., :1, None], w[..., 1:]
    eye = torch.eye(3, dtype=w.dtype, device=w.device)
    return torch.cat((l[..., :, None], c * eye + skew(l)), -1)
