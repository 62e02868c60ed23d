"""Assembly: from nodes to the two ends of each element, and from elements back to nodes.

Element e lies between the nodes e and e + 1. Its own functions know two nodes and nothing of the chain; here alone stands which
nodes these are. Quantities of elements have an axis of N and those of nodes one of N+1, before `axes` axes of their own. The
numbers that an element's motion is told by are (dr_j - dr_i, spin i, spin j), p + 2 s of them, and w = p + s a node's.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad


class Ends(NamedTuple):
    """Positions and rotations of the two nodes, (..., N, ...)."""

    r_i: Tensor
    r_j: Tensor
    q_i: Tensor
    q_j: Tensor


def poses(position: Tensor, rotation: Tensor) -> Ends:
    """From those of all nodes."""
    return Ends(*ends(position), *ends(rotation))


def ends(x: Tensor, axes: int = 1) -> tuple[Tensor, Tensor]:
    """Nodes (..., N+1, *) -> their values (..., N, *) at the nodes i and at the nodes j of the elements."""
    N = x.shape[-1 - axes] - 1
    return x.narrow(-1 - axes, 0, N), x.narrow(-1 - axes, 1, N)


def slopes(x_i: Tensor, x_j: Tensor) -> Tensor:
    """What an element's motion is told by of values (..., N, *) at its nodes: their difference."""
    return x_j - x_i


def at_i(x: Tensor, axes: int = 1) -> Tensor:
    """What each element (..., N, *) gives its node i, as nodes (..., N+1, *)."""
    return pad(x, (0, 0) * axes + (0, 1))


def at_j(x: Tensor, axes: int = 1) -> Tensor:
    """What each element (..., N, *) gives its node j, as nodes (..., N+1, *)."""
    return pad(x, (0, 0) * axes + (1, 0))


def coupled(x: Tensor, axes: int = 1) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Nodes (..., N+1, *) -> their values (..., N, *) at the rows and at the columns of the upper and of the lower part of the
    chain's matrix.
    """
    i, j = ends(x, axes)
    return (i, j), (j, i)


def shared(parts: tuple[Tensor, Tensor], axes: int = 1) -> Tensor:
    """What elements stand for, as seen by each of their nodes (..., N, *), at the nodes (..., N+1, *): half of it each."""
    return at_i(parts[0] / 2, axes) + at_j(parts[1] / 2, axes)


def by_spins(by: Tensor, p: int) -> tuple[Tensor, Tensor, Tensor]:
    """Derivative (..., N, k, p + 2 s) by an element's numbers -> by dr_j - dr_i and by the spin of each node."""
    s = (by.shape[-1] - p) // 2
    return by.split((p, s, s), -1)


def by_numbers(by_r: Tensor, by_i: Tensor, by_j: Tensor) -> Tensor:
    """The inverse."""
    return torch.cat((by_r, by_i, by_j), -1)


def to_elements(move: Tensor, p: int) -> Tensor:
    """Moves of the nodes (..., N+1, w) -> (..., N, p + 2 s) of the elements."""
    r, spin = move.split((p, move.shape[-1] - p), -1)
    r_i, r_j = ends(r)
    return torch.cat((r_j - r_i, *ends(spin)), -1)


def to_nodes(load: Tensor, p: int) -> Tensor:
    """[n, m_i, m_j] (..., N, p + 2 s) of elements -> (..., N+1, w) summed at nodes: -n and m_i at node i, n and m_j
    at node j.
    """
    s = (load.shape[-1] - p) // 2
    n, m_i, m_j = load.split((p, s, s), -1)
    return at_i(torch.cat((-n, m_i), -1)) + at_j(torch.cat((n, m_j), -1))


def to_blocks(Y: Tensor, p: int) -> tuple[Tensor, Tensor, Tensor]:
    """(..., N, p + 2 s, p + 2 s) of elements -> (diagonal (..., N+1, w, w), upper, lower (..., N, w, w)) of the chain."""
    w = (Y.shape[-1] + p) // 2
    rows = torch.cat((-Y[..., :p, :], Y[..., p:w, :], Y[..., :p, :], Y[..., w:, :]), -2)
    K = torch.cat((-rows[..., :p], rows[..., p:w], rows[..., :p], rows[..., w:]), -1)
    return at_i(K[..., :w, :w], 2) + at_j(K[..., w:, w:], 2), K[..., :w, w:], K[..., w:, :w]
