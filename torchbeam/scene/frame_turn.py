"""Rotation of axes whose angular velocity is told in themselves: the integral of R' = R ~omega."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.validation import concrete
from ..math import quaternions as quat
from ..math.shapes import broadcast_shapes

Omega = Callable[[Tensor], Tensor]  # t (...) s -> (..., 3) rad/s

# Lobatto's points and weights on [0, 1], exact to the fifth power: with the ends, next to which a
# jump would else stay unseen
POINTS = 0.0, 0.5 - 0.05**0.5, 0.5 + 0.05**0.5, 1.0
WEIGHTS = 1 / 12, 5 / 12, 5 / 12, 1 / 12
FIRST, MOST = 16, 2**17  # parts of the interval: at first, and at most
ACCURACY = 500.0  # ulp of a turn over a part, beside those of its angle
NARROWEST = 2.0**-46  # part, of the interval: a jump of omega is somewhere in it


def turn_between(omega: Omega, start: Tensor, end: Tensor) -> Tensor:
    """Quaternion (..., 4) of the rotation R(start)^T R(end), start and end (...) s: a vector told
    in the axes at `end` in those at `start`. By the Magnus expansion of sixth order (see `magnus`)
    over parts of the interval that are halved until halves agree with the whole to rounding, so
    that kinks and jumps of omega cost parts, no accuracy. Differentiable.

    Raises ValueError for an omega that this takes too many parts for.
    """
    # functions bring batch axes of their own
    shape = broadcast_shapes(start.shape, end.shape, omega(start).shape[:-1])
    start, end = (t.reshape([1] * (len(shape) - t.ndim) + [*t.shape]) for t in (start, end))
    with no_derivatives():
        edges = _parts(omega, start, end)
    turns = quat.exponential(_vectors(omega, start, end, edges[:-1], edges[1:]))
    while len(turns) > 1:  # neighbours together, in their order
        pairs = quat.multiply(turns[: len(turns) // 2 * 2 : 2], turns[1::2])
        turns = torch.cat((pairs, turns[len(turns) // 2 * 2 :]))
    return quat.normalize(turns[0]).expand(*shape, 4)


def magnus(omega: tuple[Tensor, ...], h: Tensor) -> Tensor:
    """Rotation vector (..., 3) rad over h (...) s from omega (..., 3) rad/s at the four points, of
    sixth order (Blanes, Casas and Ros 2000; with [x, y] = -x x y, because omega is told in the axes
    that turn). With A_i the integral of (t/h)^i omega, t from the middle:

        a_1 = 9/4 A_0 - 15 A_2,   a_2 = 12 A_1,   a_3 = 180 A_2 - 15 A_0
        C_1 = [a_1, a_2],   C_2 = -[a_1, 2 a_3 + C_1]/60
        turn = a_1 + a_3/12 + [-20 a_1 - a_3 + C_1, a_2 + C_2]/240
    """
    A_0, A_1, A_2 = (
        h[..., None]
        * sum(b * (x - 0.5) ** i * w for x, b, w in zip(POINTS, WEIGHTS, omega, strict=True))
        for i in range(3)
    )
    a_1, a_2, a_3 = 9 / 4 * A_0 - 15 * A_2, 12 * A_1, 180 * A_2 - 15 * A_0
    C_1 = torch.linalg.cross(a_2, a_1)
    C_2 = torch.linalg.cross(a_1, 2 * a_3 + C_1) / 60
    return a_1 + a_3 / 12 + torch.linalg.cross(a_2 + C_2, C_1 - 20 * a_1 - a_3) / 240


def _vectors(omega: Omega, start: Tensor, end: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Rotation vectors (n, ..., 3) over the parts from low to high (n), of the interval."""
    ndim = max(start.ndim, end.ndim)
    low, high = (x.reshape([-1] + [1] * ndim) for x in (low, high))
    h = (high - low) * (end - start)
    w = omega(torch.cat([start + (low + x * (high - low)) * (end - start) for x in POINTS]))
    return magnus(w.unflatten(0, (len(POINTS), -1)).unbind(0), h)


def _parts(omega: Omega, start: Tensor, end: Tensor) -> Tensor:
    """Edges (n + 1) in [0, 1] of parts that are short enough for all samples."""
    accuracy = ACCURACY * torch.finfo(start.dtype).eps
    edges = torch.linspace(0, 1, FIRST + 1, dtype=start.dtype, device=start.device)
    low, high, edges_of_parts = edges[:-1], edges[1:], [edges[:1]]
    while len(low):
        middle = (low + high) / 2
        parts = (low, high), (low, middle), (middle, high)
        whole, *halves = (_vectors(omega, start, end, *part) for part in parts)
        turn, first, second = map(quat.exponential, (whole, *halves))
        off = quat.multiply(quat.conjugate(turn), quat.multiply(first, second))[..., 1:].abs()
        over = off - accuracy * (1 + torch.linalg.vector_norm(whole, dim=-1, keepdim=True))
        worst = concrete(over.flatten(1).amax(-1)).reshape(-1, len(low)).amax(0)
        bad = (worst > 0) & (high - low > NARROWEST)
        edges_of_parts += [high[~bad], middle[~bad]]
        low, high = torch.cat((low[bad], middle[bad])), torch.cat((middle[bad], high[bad]))
        if len(low) > MOST:
            raise ValueError(
                f"an angular velocity of the frame that takes more than {MOST} parts to be "
                "integrated from t = 0 was given; a smoother function is wanted, or a start at t "
                "= 0"
            )
    return torch.cat(edges_of_parts).sort().values
