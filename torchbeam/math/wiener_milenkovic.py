"""Wiener-Milenkovic rotation parameters theta = 4 tan(phi/4) n, (..., 3): the mixed element's
rotations.

C(theta) and Q(theta) as in Hodges' mixed beam theory (Wang and Yu 2017, GEBT): C^T turns vectors,
and Q theta_dot is the angular velocity in turned axes. Good up to phi = 2 pi, where theta is
infinite; `shadow` is the same rotation the other way round, smaller once |theta| > 4 (phi > pi).
"""

from __future__ import annotations

import torch
from torch import Tensor

from .quaternions import exponential, matrix, skew


def C(theta: Tensor) -> Tensor:
    """C (..., 3, 3); C^T is the rotation."""
    return turn(theta).mT


def turn(theta: Tensor) -> Tensor:
    """C^T (..., 3, 3), the rotation matrix."""
    return matrix(to_quaternion(theta))


def Q_inverse(theta: Tensor) -> Tensor:
    """Q^-1 = (1 - q/16) I + ~theta/2 + theta theta^T/8, q = theta.theta."""
    return _eye(theta) * (1 - _dot(theta, theta) / 16) + skew(theta) / 2 + _outer(theta, theta) / 8


def Q(theta: Tensor) -> Tensor:
    """Q = Q^-T / (1 + q/16)^2."""
    return Q_inverse(theta).mT / (1 + _dot(theta, theta) / 16).square()


def Q_inverse_rate(theta: Tensor, theta_dot: Tensor) -> Tensor:
    """(Q^-1)_dot = -(theta.theta_dot)/8 I + ~theta_dot/2 + (theta_dot theta^T + theta
    theta_dot^T)/8 = -Q^-1 Q_dot Q^-1.
    """
    twist = _outer(theta, theta_dot)
    return (twist + twist.mT) / 8 + skew(theta_dot) / 2 - _eye(theta) * (_dot(theta, theta_dot) / 8)


def shadow(theta: Tensor) -> Tensor:
    """The other parameters of the same rotation, phi -> phi - 2 pi: -16 theta / |theta|^2. Infinite
    at theta = 0.

    (The rule theta (1 - 8/|theta|) agrees with it at |theta| = 4 only: at |theta| = 5 it is off by
    7 degrees.)
    """
    return -16 * theta / theta.square().sum(-1, keepdim=True)


def to_quaternion(theta: Tensor) -> Tensor:
    """Unit quaternion (1 - q/16, theta/2) / (1 + q/16)."""
    s = theta.square().sum(-1, keepdim=True) / 16
    return torch.cat((1 - s, theta / 2), -1) / (1 + s)


def from_quaternion(q: Tensor) -> Tensor:
    """theta = 4 qv / (1 + q0) of the shorter way round, |theta| <= 4."""
    q = torch.where(q[..., :1] < 0, -q, q)
    return 4 * q[..., 1:] / (1 + q[..., :1])


def from_rotation_vector(phi: Tensor) -> Tensor:
    """theta of a rotation vector (rad), any number of turns taken off: |theta| <= 4."""
    return from_quaternion(exponential(phi))


def _eye(theta: Tensor) -> Tensor:
    return torch.eye(3, dtype=theta.dtype, device=theta.device)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1)[..., None, None]


def _outer(a: Tensor, b: Tensor) -> Tensor:
    return a[..., :, None] * b[..., None, :]
