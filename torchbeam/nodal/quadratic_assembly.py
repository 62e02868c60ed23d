"""Assembly of elements of three nodes: element e has the nodes 2 e, 2 e + 1 (midside) and 2 e + 2, and two stations, its Gauss
points, between which all its integrals are shared.

What `assembly` says of elements holds here of stations: there are as many of them, 2 N, as intervals between the 2 N + 1 nodes.
The numbers that a station's motion is told by are (dr' = sum of dN_i/dx dr_i, alpha_1 - alpha_2, alpha_2, alpha_3 - alpha_2) of
the spins alpha_i of the three nodes, p + 3 s of them: T times the moves of the element's nodes. A chain's matrix has five
parts: (diagonal, upper, lower, far upper, far lower), the last two (..., N, w, w) from an element's first node to its third and
back.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..math.quadratic import SLOPES, at_points, threes


def _moved(p: int, s: int) -> Tensor:
    """T (2, p + 3 s, 3 w) of the two stations."""
    T = torch.zeros(2, p + 3 * s, 3, p + s, dtype=SLOPES.dtype)
    at, turn = torch.arange(p), torch.arange(s)
    for i in range(3):
        T[:, at, i, at] = SLOPES[:, i:i + 1]
        T[:, p + i * s + turn, i, p + turn] = 1
    for i in (0, 2):
        T[:, p + i * s + turn, 1, p + turn] = -1
    return T.flatten(-2)


MOVED = {3: _moved(3, 3), 2: _moved(2, 1)}  # by p: in space, in a plane
# half the difference of T of both stations, which holds positions alone, and their mean; one below the other
HALVED = {p: torch.cat(((T[1] - T[0]) / 2, (T[1] + T[0]) / 2)) for p, T in MOVED.items()}


class Trio(NamedTuple):
    """Positions and rotations of the three nodes, of each station, (..., 2 N, ...)."""

    r_1: Tensor
    r_2: Tensor
    r_3: Tensor
    q_1: Tensor
    q_2: Tensor
    q_3: Tensor


def poses(position: Tensor, rotation: Tensor) -> Trio:
    """From those of all nodes."""
    return Trio(*ends(position), *ends(rotation))


def ends(x: Tensor, axes: int = 1) -> tuple[Tensor, ...]:
    """Nodes (..., 2 N + 1, *) -> their values (..., 2 N, *) at the three nodes of the elements, of each station."""
    return tuple(part.repeat_interleave(2, -1 - axes) for part in threes(x, axes))


def slopes(x_1: Tensor, x_2: Tensor, x_3: Tensor) -> Tensor:
    """dx/dx (..., 2 N, *) at the stations, of their nodes' values likewise."""
    a, b, c = (column.repeat(x_1.shape[-2] // 2)[:, None] for column in at_points(x_1)[1].unbind(-1))
    return a * x_1 + b * x_2 + c * x_3


def by_spins(by: Tensor, p: int) -> tuple[Tensor, ...]:
    """Derivative (..., 2 N, k, p + 3 s) by a station's numbers -> by dr' and by the spin of each node."""
    s = (by.shape[-1] - p) // 3
    by_r, first, middle, third = by.split((p, s, s, s), -1)
    return by_r, first, middle - first - third, third


def by_numbers(by_r: Tensor, by_1: Tensor, by_2: Tensor, by_3: Tensor) -> Tensor:
    """The inverse."""
    return torch.cat((by_r, by_1, by_1 + by_2 + by_3, by_3), -1)


def to_elements(move: Tensor, p: int) -> Tensor:
    """Moves of the nodes (..., 2 N + 1, w) -> (..., 2 N, p + 3 s) of the stations."""
    each = torch.cat(threes(move), -1)[..., None, :, None]  # (..., N, 1, 3 w, 1)
    return (MOVED[p].to(move) @ each)[..., 0].flatten(-3, -2)


def to_nodes(load: Tensor, p: int) -> Tensor:
    """[n, m_1, m_1 + m_2 + m_3, m_3] (..., 2 N, p + 3 s) of stations -> (..., 2 N + 1, w) summed at nodes: dN_i/dx n and m_i at
    node i.
    """
    w = p + (load.shape[-1] - p) // 3
    each = (load.unflatten(-2, (-1, 2))[..., None, :] @ MOVED[p].to(load)).sum(-3)[..., 0, :]
    return spread(*each.split(w, -1), 1)


def to_blocks(Y: Tensor, p: int) -> tuple[Tensor, ...]:
    """(..., 2 N, p + 3 s, p + 3 s) of stations -> the five parts of the chain's matrix: T_1^T Y_1 T_1 + T_2^T Y_2 T_2, by their
    sum and their difference.
    """
    w = p + (Y.shape[-1] - p) // 3
    Y_1, Y_2 = Y.unflatten(-3, (-1, 2)).unbind(-3)
    T, total, change = HALVED[p].to(Y), Y_1 + Y_2, Y_2 - Y_1
    K = T.mT @ torch.cat((torch.cat((total, change), -1), torch.cat((change, total), -1)), -2) @ T
    (K11, K12, K13), (K21, K22, K23), (K31, K32, K33) = (row.split(w, -1) for row in K.split(w, -2))
    return spread(K11, K22, K33, 2), interleaved(K12, K23, 2), interleaved(K21, K32, 2), K13, K31


def coupled(x: Tensor, axes: int = 1) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Nodes (..., 2 N + 1, *) -> their values at the rows and at the columns of the parts of the matrix but the first."""
    n, first = x.shape[-1 - axes] - 1, (slice(None),) * (x.ndim - 1 - axes)
    i, j, far_i, far_j = (x[(*first, part)] for part in (slice(n), slice(1, None), slice(0, n, 2), slice(2, None, 2)))
    return (i, j, far_i, far_j), (j, i, far_j, far_i)


def shared(parts: tuple[Tensor, Tensor, Tensor], axes: int = 1) -> Tensor:
    """What stations stand for, as seen by each of their nodes (..., 2 N, *), at the nodes (..., 2 N + 1, *): N_i of it."""
    values = at_points(parts[0])[0][(..., *(None,) * axes)]  # (2, 3, *)
    return spread(*((values[:, i] * x.unflatten(-1 - axes, (-1, 2))).sum(-1 - axes) for i, x in enumerate(parts)), axes)


def interleaved(a: Tensor, b: Tensor, axes: int = 1) -> Tensor:
    """a_0, b_0, a_1, b_1 ... along the axis before `axes` others."""
    return torch.stack((a, b), -axes - 1).flatten(-axes - 2, -axes - 1)


def spread(first: Tensor, middle: Tensor, third: Tensor, axes: int = 1) -> Tensor:
    """What elements (..., N, *) give their nodes, summed (..., 2 N + 1, *)."""
    own = (0, 0) * axes
    inner = interleaved(first, middle, axes)
    return pad(inner, (*own, 0, 1)) + pad(interleaved(torch.zeros_like(third), third, axes), (*own, 1, 0))
