"""Section axes along a curve through nodes: second-order tangents and parallel transport."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.validation import concrete
from ..math import quaternions as quat

BACK = 1e-6  # 1 + cosine of the turn from one tangent to the next: less, and the curve turns back on itself

TURNS_BACK = "a curve that turns back on itself at a node was given; nodes that are nearer to each other are wanted"


def tangents(nodes: Tensor, length: Tensor) -> Tensor:
    """Unit tangents (..., N+1, 3) at nodes (..., N+1, 3) that lie `length` (..., N) m apart along the axis: of the parabola
    through each node and its neighbours, at the ends of that through the three last ones; second order in the length.
    """
    slope, h = nodes.diff(dim=-2) / length[..., None], length[..., None]
    if slope.shape[-2] == 1:
        found = slope.expand(*slope.shape[:-2], 2, 3)
    else:
        a, b = h[..., :-1, :], h[..., 1:, :]
        inner = (b * slope[..., :-1, :] + a * slope[..., 1:, :]) / (a + b)
        found = torch.cat((2 * slope[..., :1, :] - inner[..., :1, :], inner, 2 * slope[..., -1:, :] - inner[..., -1:, :]), -2)
    size = torch.linalg.vector_norm(found, dim=-1, keepdim=True)
    if concrete(size == 0).any():
        raise ValueError(TURNS_BACK)
    return found / size


def shortest_turn(a: Tensor, b: Tensor) -> Tensor:
    """Quaternion (..., 4) of the smallest rotation that takes the unit vectors a to b (..., 3). Raises ValueError where they
    are opposite.
    """
    a, b = torch.broadcast_tensors(a, b)
    cosine = 1 + (a * b).sum(-1, keepdim=True)
    if concrete(cosine < BACK).any():
        raise ValueError(TURNS_BACK)
    return quat.normalize(torch.cat((cosine, torch.linalg.cross(a, b)), -1))


def transported(along: Tensor) -> Tensor:
    """Quaternions (..., N+1, 4) that take what is fixed to the first of the tangents (..., N+1, 3) to each: parallel transport,
    by the smallest rotation from one to the next.
    """
    each = shortest_turn(along[..., :-1, :], along[..., 1:, :])
    found = [pad(torch.zeros_like(along[..., 0, :]), (1, 0), value=1.0)]
    for i in range(each.shape[-2]):
        found.append(quat.normalize(quat.multiply(each[..., i, :], found[-1])))
    return torch.stack(found, -2)


def carried_axes(frames: Tensor, rest: Tensor, nodes: Tensor, length: Tensor, twist: Tensor | None = None) -> Tensor:
    """Axes (..., N+1, 4) of a beam with those `frames` (..., N+1, 4) where its nodes are at `rest`, when they are at `nodes`
    (..., N+1, 3): those at rest, carried to the new curve without a twist beside their own, then turned about it by `twist`
    (..., N+1) rad. At the first node they turn as little as its tangent asks for. What is unchanged stays to rounding.
    """
    before, after = tangents(rest, length), tangents(nodes, length)
    first = shortest_turn(before[..., 0, :], after[..., 0, :])[..., None, :]
    turn = quat.multiply(quat.multiply(transported(after), first), quat.conjugate(transported(before)))
    if twist is not None:
        turn = quat.multiply(quat.exponential(twist[..., None] * after), turn)
    return quat.normalize(quat.multiply(turn, frames))
