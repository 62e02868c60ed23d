"""Pose of a rigid body from measured points."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..core.validation import (
    Value,
    as_tensor,
    axis_last,
    broadcast,
    common_dtype,
    concrete,
    refusal,
)
from ..math import quaternions as quat


class Pose(NamedTuple):
    """Pose of a rigid body, by `pose_from_points`.

    The body's point p is at rotation p + position, with rotation (..., 3, 3) and position (..., 3)
    m. The third field, residual (..., points, 3) m, is the distance of measured points from the
    pose; NaN for a missing point.

    Examples:
        >>> corners = torch.tensor([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])
        >>> rotation, position, residual = tb.pose_from_points(corners, corners)
        >>> residual.abs().max() < 1e-6
        tensor(True)
    """

    rotation: Tensor
    position: Tensor
    residual: Tensor


def pose_from_points(points: Value, measured: Value) -> Pose:
    """Pose of a rigid body from measured points of it, by least squares.

    Three markers of a base, or of a gripper, give arguments for `Support`, `RootMotion` and
    `SensorFrame`. (Absolute orientation; Kabsch 1976, Acta Cryst. A32, 922; Umeyama 1991, IEEE
    TPAMI 13, 376.)

    Args:
        points: (..., n, 3) m, in the body's axes, three or more that are on no line
        measured: (..., n, 3) m; NaN = not seen, and does not count

    Differentiable by both, through the condition that the sum of squares is least.

    Raises:
        ValueError: for fewer than three points seen, or points on a line, whose rotation is
            undetermined.

    Examples:
        >>> triangle = torch.tensor([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])
        >>> pose = tb.pose_from_points(triangle, triangle + torch.tensor([0, 0, 1.0]))
        >>> pose.position
        tensor([0., 0., 1.])
    """
    dtype, device = common_dtype(points, measured)
    points, measured = (
        axis_last(name, as_tensor(x, dtype, device), 3)
        for name, x in (("points", points), ("measured", measured))
    )
    shape = broadcast("points and measured", points.shape, measured.shape)
    if len(shape) < 2:
        raise refusal(f"points of shape {tuple(shape)}", "(..., n, 3)", were=True, are=True)
    points, measured = points.expand(shape), measured.expand(shape)
    seen = (torch.isfinite(measured) & torch.isfinite(points)).all(-1, keepdim=True)
    weight = seen.to(dtype)
    count = weight.sum(-2, keepdim=True).clamp(min=1)
    p, m = (torch.where(seen, x, 0) for x in (points, measured))
    p_mean, m_mean = ((x * weight).sum(-2, keepdim=True) / count for x in (p, m))
    p, m = (p - p_mean) * weight, (m - m_mean) * weight
    with torch.no_grad():
        B = (m.mT @ p).detach()
        U, size, V = torch.linalg.svd(B)
        told = concrete((weight.sum((-2, -1)) >= 3) & (size[..., 1] > 1e-6 * size[..., 0]))
        if not told.all():
            raise ValueError(
                "fewer than three points that were seen, or points on a line, were given; three or "
                "more on no line are wanted"
            )
        proper = (torch.linalg.det(U) * torch.linalg.det(V))[..., None]
        R = (U * torch.cat((torch.ones_like(size[..., :2]), proper), -1)[..., None, :]) @ V
        S = R.mT @ B
        trace = S.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
        stiffness = trace * torch.eye(3, dtype=dtype, device=device) - S
    torque = torch.linalg.cross(p, m @ R).sum(-2)  # zero there, but for its derivative
    turn = torch.linalg.solve(stiffness, torque)
    rotation = R @ quat.matrix(quat.exponential(turn))
    position = m_mean[..., 0, :] - (rotation @ p_mean.mT)[..., 0]
    residual = torch.where(seen, m - p @ rotation.mT, torch.nan)
    return Pose(rotation, position, residual)
