"""Unit quaternions (..., 4), scalar first: rotations. R(q) maps section axes to frame a."""

from __future__ import annotations

import torch
from torch import Tensor

# Linear maps as small constant matrices: one matrix product each, whatever the batch.
_HAT = torch.tensor(
    (
        (0.0, 0, 0, 0, 0, -1, 0, 1, 0),
        (0.0, 0, 1, 0, 0, 0, -1, 0, 0),
        (0.0, -1, 0, 1, 0, 0, 0, 0, 0),
    ),
    dtype=torch.float64,
)
_EYE = torch.eye(3, dtype=torch.float64)
_LEFT = torch.tensor(
    (
        (1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1),
        (0.0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0),
        (0.0, 0, -1, 0, 0, 0, 0, 1, 1, 0, 0, 0, 0, -1, 0, 0),
        (0.0, 0, 0, -1, 0, 0, -1, 0, 0, 1, 0, 0, 1, 0, 0, 0),
    ),
    dtype=torch.float64,
)
_CONJUGATE = torch.tensor((1.0, -1, -1, -1), dtype=torch.float64)


def skew(v: Tensor) -> Tensor:
    """~v (..., 3, 3), the matrix of the cross product: hat(v) @ x = v x x."""
    return (v @ _HAT.to(v)).unflatten(-1, (3, 3))


def cross(a: Tensor, b: Tensor) -> Tensor:
    """a x b of vectors (..., 3) whose axes broadcast."""
    return torch.linalg.cross(*torch.broadcast_tensors(a, b))


def identity(
    shape: tuple[int, ...], dtype: torch.dtype, device: torch.device | None = None
) -> Tensor:
    """The rotation that changes nothing, (*shape, 4)."""
    return torch.tensor([1.0, 0, 0, 0], dtype=dtype, device=device).expand(*shape, 4)


def conjugate(q: Tensor) -> Tensor:
    """The inverse of a unit quaternion."""
    return q * _CONJUGATE.to(q)


def multiply(p: Tensor, q: Tensor) -> Tensor:
    """p q: R(p q) = R(p) R(q)."""
    left = (p @ _LEFT.to(p)).unflatten(-1, (4, 4))
    return (left @ q[..., None])[..., 0]


def normalize(q: Tensor) -> Tensor:
    """q / |q|."""
    return q / torch.linalg.vector_norm(q, dim=-1, keepdim=True)


def matrix(q: Tensor) -> Tensor:
    """R (..., 3, 3) = I + 2 q0 ~qv + 2 ~qv ~qv."""
    qv = skew(q[..., 1:])
    return _EYE.to(q) + 2 * (q[..., :1, None] * qv + qv @ qv)


def rotate(q: Tensor, v: Tensor) -> Tensor:
    """R(q) v."""
    qv = q[..., 1:]
    if qv.shape != v.shape:
        qv, v = torch.broadcast_tensors(qv, v)
    t = 2 * torch.linalg.cross(qv, v)
    return v + q[..., :1] * t + torch.linalg.cross(qv, t)


def exponential(phi: Tensor) -> Tensor:
    """Quaternion of the rotation vector phi (rad)."""
    angle2 = (phi * phi).sum(-1, keepdim=True)
    small = angle2 < 1e-8
    half = torch.where(small, torch.ones_like(angle2), angle2).sqrt() / 2
    scale = torch.where(small, 0.5 - angle2 / 48, torch.sin(half) / (2 * half))
    return torch.cat((torch.where(small, 1 - angle2 / 8, torch.cos(half)), scale * phi), -1)


def spin_of_vector(phi: Tensor, rate: Tensor) -> Tensor:
    """Angular velocity (..., 3), spatial axes, of the rotation vector phi (rad) with the rate phi'
    (rad/s), |phi| = x:

    phi' + (1 - cos x)/x^2 phi x phi' + (x - sin x)/x^3 phi x (phi x phi')
    """
    square = (phi * phi).sum(-1, keepdim=True)
    small = square < 1e-4
    x2 = torch.where(small, torch.ones_like(square), square)
    x = x2.sqrt()
    b = torch.where(small, 1 / 2 - square / 24 + square**2 / 720, 2 * torch.sin(x / 2) ** 2 / x2)
    c = torch.where(small, 1 / 6 - square / 120 + square**2 / 5040, (x - torch.sin(x)) / (x * x2))
    once = torch.linalg.cross(phi, rate)
    return rate + b * once + c * torch.linalg.cross(phi, once)


def logarithm(q: Tensor) -> Tensor:
    """Rotation vector (rad) of a unit quaternion, |phi| <= pi."""
    q = torch.where(q[..., :1] < 0, -q, q)
    return 2 * arc_ratio(q[..., :1], q[..., 1:].square().sum(-1, keepdim=True)) * q[..., 1:]


def arc_ratio(c: Tensor, s2: Tensor) -> Tensor:
    """g = x / sin(x) with cos(x) = c >= 0 and sin(x)^2 = s2; smooth through x = 0."""
    small = s2 < 1e-6
    s = torch.where(small, torch.ones_like(s2), s2).sqrt()
    return torch.where(small, 1 + s2 / 6 + 3 * s2 * s2 / 40, torch.atan2(s, c) / s)


def nearer(q: Tensor, to: Tensor) -> Tensor:
    """Of q and -q, the same rotation, the nearer one; in a plane, (cos, sin), as well."""
    return torch.where((q * to).sum(-1, keepdim=True) < 0, -q, q)


def half_way(p: Tensor, q: Tensor) -> Tensor:
    """The rotation half way from p to q along the shorter arc."""
    return normalize(p + nearer(q, p))


def aligned(q_1: Tensor, q_2: Tensor, q_3: Tensor) -> Tensor:
    """Three rotations (..., 3, 4), to be interpolated: each by that of its two quaternions which is
    nearer to the second's.
    """
    return torch.stack((nearer(q_1, q_2), q_2, nearer(q_3, q_2)), -2)


def from_matrix(R: Tensor) -> Tensor:
    """Unit quaternion of a rotation matrix (Shepperd 1978: the largest of four pivots)."""
    m = R.flatten(-2)
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = m.unbind(-1)
    pivots = torch.stack((
        torch.stack((1 + m00 + m11 + m22, m21 - m12, m02 - m20, m10 - m01), -1),
        torch.stack((m21 - m12, 1 + m00 - m11 - m22, m01 + m10, m02 + m20), -1),
        torch.stack((m02 - m20, m01 + m10, 1 - m00 + m11 - m22, m12 + m21), -1),
        torch.stack((m10 - m01, m02 + m20, m12 + m21, 1 - m00 - m11 + m22), -1),
    ), -2)  # fmt: skip
    best = pivots.detach().diagonal(dim1=-2, dim2=-1).argmax(-1)
    row = torch.gather(pivots, -2, best[..., None, None].expand(*best.shape, 1, 4))[..., 0, :]
    return normalize(row)
