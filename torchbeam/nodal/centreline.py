"""Centreline: the smooth curve that a beam's nodes stand for where it touches another one.

It is a quadratic spline with the nodes as control points: a piece for each node, from the middle of
the element before to that of the element after,

    c(t) = (1 - t)^2 C_0 + 2 t (1 - t) C_1 + t^2 C_2
    C_0 = (P_- + P)/2,  C_1 = P,  C_2 = (P + P_+)/2

and half an element, straight, at the first and at the last. Its tangent is continuous, so that the
nearest place on it, and the direction to there, are so too, as far as a place is nearer than the
curve's radius of curvature. From an arc of the curvature k through the nodes it is off by k h^2/8,
everywhere, h the length of an element. A single node is a point.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..scene.effects.drag import norm

INNER = ((0.5, 0.5, 0.0), (0.0, 1.0, 0.0), (0.0, 0.5, 0.5))
FIRST = ((0.0, 1.0, 0.0), (0.0, 0.75, 0.25), (0.0, 0.5, 0.5))
LAST = ((0.5, 0.5, 0.0), (0.25, 0.75, 0.0), (0.0, 1.0, 0.0))
POINT = ((0.0, 1.0, 0.0),) * 3
ITERATIONS = 8  # of Newton's method for the nearest place


def piece_nodes(first: int, count: int) -> tuple[tuple[int, int, int], ...]:
    """Of each piece of `count` nodes from `first` on: the node before, its own, the one after."""
    last = first + count - 1
    return tuple((max(k - 1, first), k, min(k + 1, last)) for k in range(first, last + 1))


def control_shares(count: int) -> tuple[tuple[tuple[float, ...], ...], ...]:
    """(count, 3, 3): of each piece its control points by its nodes."""
    if count == 1:
        return (POINT,)
    return (FIRST, *(INNER,) * (count - 2), LAST)


def bernstein(t: Tensor) -> Tensor:
    """(..., 3) of t (...)."""
    return torch.stack(((1 - t) ** 2, 2 * t * (1 - t), t**2), -1)


def least_distance(x: Tensor, points: Tensor) -> Tensor:
    """(...) m that places x (..., 3) are away from pieces of these control points (..., 3, 3), at
    least: from their chords, less by how far the curve is off these.
    """
    first, middle, last = points.unbind(-2)
    chord = last - first
    size = chord.square().sum(-1)
    share = ((x - first) * chord).sum(-1) / torch.where(size > 0, size, torch.ones_like(size))
    off = x - first - share.clamp(0.0, 1.0)[..., None] * chord
    return (norm(off) - norm(middle - (first + last) / 2) / 2)[..., 0]


def nearest(
    x: Tensor, nodes: Tensor, control: Tensor, ends: Tensor, radii: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Where on pieces x (..., 3) is nearest to them: t (...) in [0, 1], and whether (...) it is so
    within the piece, so that of the pieces of a curve one alone says yes to each least distance.

    nodes (..., 3, 3) of the piece, control (..., 3, 3), see `control_shares`; ends (..., 2) bool:
    whether the curve begins or ends with it. radii (..., 3) m at its nodes, of balls about the
    curve: x is then nearest to one of these, where |c - x| - r is least; None = they are alike. t
    has the derivatives of the nearest place.
    """
    before, middle, after = nodes.unbind(-2)
    left = (((before + middle) / 2 - x) * (middle - before)).sum(-1)
    right = (((middle + after) / 2 - x) * (after - middle)).sum(-1)
    if radii is not None:
        rises = radii.diff(dim=-1)
        left = left - norm((before + middle) / 2 - x)[..., 0] * rises[..., 0]
        right = right - norm((middle + after) / 2 - x)[..., 0] * rises[..., 1]
    within = ((left <= 0) | ends[..., 0]) & ((right > 0) | ends[..., 1])
    C_0, C_1, C_2 = (control @ nodes).unbind(-2)
    y, e, g = C_0 - x, C_1 - C_0, C_0 - 2 * C_1 + C_2
    # (c - x) . c'/2 = h_0 + h_1 t + h_2 t^2 + h_3 t^3
    h = [(y * e).sum(-1), 2 * (e * e).sum(-1) + (y * g).sum(-1), 3 * (e * g).sum(-1)]
    h.append((g * g).sum(-1))

    if radii is not None:
        R_0, R_1, R_2 = (control @ radii[..., None])[..., 0].unbind(-1)
        h += [(y * y).sum(-1), R_1 - R_0, R_0 - 2 * R_1 + R_2]

    def newton(t: Tensor, h: list[Tensor]) -> Tensor:
        slope = h[1] + t * (2 * h[2] + 3 * t * h[3])
        value = h[0] + t * (h[1] + t * (h[2] + t * h[3]))
        if radii is not None:  # less |c - x| r'/2; |c - x|^2 has four times `value` as its rate
            square = h[4] + t * (4 * h[0] + t * (2 * h[1] + t * (4 / 3 * h[2] + t * h[3])))
            some = square > 0
            size = torch.where(some, torch.where(some, square, 1.0).sqrt(), 0.0)
            rise = h[5] + t * h[6]
            share = 2 * value / torch.where(some, size, 1.0)
            value, slope = value - size * rise, slope - size * h[6] - share * rise
        rising = slope > 0
        return t - torch.where(rising, value, 0.0) / torch.where(rising, slope, 1.0)

    still = [part.detach() for part in h]
    t = torch.full_like(still[0], 0.5)
    for _ in range(ITERATIONS):
        t = newton(t, still).clamp(0.0, 1.0)
    inner = (t > 0) & (t < 1)
    return torch.where(inner, newton(t, h), t), within
