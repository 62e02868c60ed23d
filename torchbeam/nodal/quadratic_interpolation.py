"""Quadratic interpolation between the three nodes of an element, at its two stations, its Gauss
points, between which all its integrals are shared: what its motion is expressed by.

There are 2 N stations, after each other, for N elements. The numbers that a station's motion is
expressed by are (dr' = sum of dN_i/dx dr_i, alpha_1 - alpha_2, alpha_2, alpha_3 - alpha_2) of the
spins alpha_i of the three nodes, p + 3 s of them: T times the moves of the element's nodes.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..math import quaternions as quat
from ..math.element_shapes import SLOPES, X, at_points


def _moved(p: int, s: int) -> Tensor:
    """T (2, p + 3 s, 3 w) of the two stations."""
    T = torch.zeros(2, p + 3 * s, 3, p + s, dtype=SLOPES.dtype)
    at, turn = torch.arange(p), torch.arange(s)
    for i in range(3):
        T[:, at, i, at] = SLOPES[:, i : i + 1]
        T[:, p + i * s + turn, i, p + turn] = 1
    for i in (0, 2):
        T[:, p + i * s + turn, 1, p + turn] = -1
    return T.flatten(-2)


MOVED = {3: _moved(3, 3), 2: _moved(2, 1)}  # by p: in space, in a plane
# half the difference of T of both stations, which holds positions alone, and their mean; one below
# the other
HALVED = {p: torch.cat(((T[1] - T[0]) / 2, (T[1] + T[0]) / 2)) for p, T in MOVED.items()}


class Trio(NamedTuple):
    """Positions and rotations of the three nodes, of each station, (..., 2 N, ...)."""

    r_1: Tensor
    r_2: Tensor
    r_3: Tensor
    q_1: Tensor
    q_2: Tensor
    q_3: Tensor


class QuadraticInterpolation:
    """See `LinearInterpolation`."""

    order = 2
    difference, coupling, consistent = (1.0, -2.0, 1.0), -1 / 30, 1 / 30
    positive = False  # of what changes more than threefold within an element
    poses = Trio

    @staticmethod
    def at_stations(parts: tuple[Tensor, ...], axes: int = 1) -> tuple[Tensor, ...]:
        return tuple(part.repeat_interleave(2, -1 - axes) for part in parts)

    @staticmethod
    def axes_at_nodes(q: Tensor) -> tuple[Tensor, ...]:
        """Those that a turn at a constant rate through both stations has there."""
        first, second = q.unflatten(-2, (-1, 2)).unbind(-2)
        turn = quat.logarithm(quat.multiply(quat.conjugate(first), second))
        parts = ((x / X + 1) / 2 for x in (-1.0, 0.0, 1.0))
        at = (quat.multiply(first, quat.exponential(part * turn)) for part in parts)
        return tuple(here.repeat_interleave(2, -2) for here in at)

    @staticmethod
    def shares(parts: tuple[Tensor, ...], axes: int = 1) -> tuple[Tensor, ...]:
        """N_i of it."""
        values = at_points(parts[0])[0][(..., *(None,) * axes)]  # (2, 3, *)
        return tuple(
            (values[:, i] * x.unflatten(-1 - axes, (-1, 2))).sum(-1 - axes)
            for i, x in enumerate(parts)
        )

    @staticmethod
    def slopes(x_1: Tensor, x_2: Tensor, x_3: Tensor) -> Tensor:
        """dx/dx (..., 2 N, *) at the stations, of their nodes' values likewise."""
        a, b, c = (
            column.repeat(x_1.shape[-2] // 2)[:, None] for column in at_points(x_1)[1].unbind(-1)
        )
        return a * x_1 + b * x_2 + c * x_3

    @staticmethod
    def by_spins(by: Tensor, p: int) -> tuple[Tensor, ...]:
        s = (by.shape[-1] - p) // 3
        by_r, first, middle, third = by.split((p, s, s, s), -1)
        return by_r, first, middle - first - third, third

    @staticmethod
    def by_numbers(by_r: Tensor, by_1: Tensor, by_2: Tensor, by_3: Tensor) -> Tensor:
        return torch.cat((by_r, by_1, by_1 + by_2 + by_3, by_3), -1)

    @staticmethod
    def numbers(moves: tuple[Tensor, ...], p: int) -> Tensor:
        each = torch.cat(moves, -1)[..., None, :, None]  # (..., N, 1, 3 w, 1)
        return (MOVED[p].to(each) @ each)[..., 0].flatten(-3, -2)

    @staticmethod
    def loads(load: Tensor, p: int) -> tuple[Tensor, ...]:
        """[n, m_1, m_1 + m_2 + m_3, m_3] of stations -> dN_i/dx n and m_i of node i."""
        w = p + (load.shape[-1] - p) // 3
        each = (load.unflatten(-2, (-1, 2))[..., None, :] @ MOVED[p].to(load)).sum(-3)[..., 0, :]
        return each.split(w, -1)

    @staticmethod
    def blocks(Y: Tensor, p: int) -> tuple[tuple[Tensor, ...], ...]:
        """T_1^T Y_1 T_1 + T_2^T Y_2 T_2, by their sum and their difference."""
        w = p + (Y.shape[-1] - p) // 3
        Y_1, Y_2 = Y.unflatten(-3, (-1, 2)).unbind(-3)
        T, total, change = HALVED[p].to(Y), Y_1 + Y_2, Y_2 - Y_1
        K = (
            T.mT
            @ torch.cat((torch.cat((total, change), -1), torch.cat((change, total), -1)), -2)
            @ T
        )
        return tuple(row.split(w, -1) for row in K.split(w, -2))
