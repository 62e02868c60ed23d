"""Rotations and vectors as the oracle has them: NumPy arrays, last axes fixed; analytic, so that
complex steps go through.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.inexact]


def skew(x: Array) -> Array:
    """~x (..., 3, 3), ~x y = x cross y."""
    zero = np.zeros_like(x[..., 0])
    a, b, c = x[..., 0], x[..., 1], x[..., 2]
    return np.stack((zero, -c, b, c, zero, -a, -b, a, zero), -1).reshape(*x.shape[:-1], 3, 3)


def turn(A: Array, x: Array) -> Array:
    """A x of matrices (..., n, m) and vectors (..., m)."""
    return (A @ x[..., None])[..., 0]


def back(A: Array, x: Array) -> Array:
    """A^T x."""
    return turn(np.swapaxes(A, -1, -2), x)


def cross(x: Array, y: Array) -> Array:
    """x cross y (..., 3)."""
    a, b, c, d, e, f = (z[..., i] for z in (x, y) for i in range(3))
    return np.stack((b * f - c * e, c * d - a * f, a * e - b * d), -1)


def dot(x: Array, y: Array) -> Array:
    """x.y (..., 1)."""
    return (x * y).sum(-1, keepdims=True)


def length(x: Array) -> Array:
    """|x| (..., 1), analytic: the root of x.x."""
    return np.sqrt(dot(x, x))


def exponential(phi: Array) -> Array:
    """Rodrigues: the rotation (..., 3, 3) of a rotation vector (..., 3), real."""
    angle = np.linalg.norm(phi, axis=-1)[..., None, None]
    K = skew(phi)
    return np.eye(3) + np.sinc(angle / np.pi) * K + np.sinc(angle / (2 * np.pi)) ** 2 / 2 * K @ K


def logarithm(R: Array) -> Array:
    """The rotation vector (..., 3) of a rotation below pi."""
    axial = (
        np.stack(
            (R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]),
            -1,
        )
        / 2
    )
    square, cosine = dot(axial, axial), (np.trace(R, axis1=-2, axis2=-1)[..., None] - 1) / 2
    small = np.abs(square) < 1e-8
    sine = np.sqrt(np.where(small, 1.0, square))
    ratio = np.where(
        small & (cosine.real > 0),
        1 + square / 6 + 3 * square**2 / 40,
        2 * np.arctan(sine / (1 + cosine)) / sine,
    )
    return ratio * axial


def quaternion(R: Array) -> Array:
    """A unit quaternion (..., 4), scalar first, of rotations (..., 3, 3): the eigenvector of
    Bar-Itzhack's matrix (2000).
    """
    t = np.trace(R, axis1=-2, axis2=-1)
    K = np.empty((*R.shape[:-2], 4, 4))
    K[..., 0, 0] = t
    K[..., 0, 1:] = K[..., 1:, 0] = np.stack(
        (R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]), -1
    )
    K[..., 1:, 1:] = R + np.swapaxes(R, -1, -2) - t[..., None, None] * np.eye(3)
    q = np.linalg.eigh(K)[1][..., -1]
    return q * np.where(q[..., :1] < 0, -1.0, 1.0)


def matrix(q: Array) -> Array:
    """The rotation (..., 3, 3) of a quaternion (..., 4), which need not be of unit length."""
    w, v = q[..., :1, None], q[..., 1:]
    K = skew(v)
    return np.eye(3) + 2 * (w * K + K @ K) / dot(q, q)[..., None]


def quaternion_rate(q: Array, kappa: Array) -> Array:
    """q' (..., 4) of axes that turn with kappa (..., 3) in their own axes: q (0, kappa)/2."""
    w, v = q[..., :1], q[..., 1:]
    return np.concatenate((-dot(v, kappa), w * kappa + cross(v, kappa)), -1) / 2
