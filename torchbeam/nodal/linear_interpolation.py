"""Linear interpolation between the two nodes i and j of an element, which is its own one station:
what its motion is expressed by. The numbers are (dr_j - dr_i, spin i, spin j), p + 2 s of them, and
w = p + s a node's.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class Ends(NamedTuple):
    """Positions and rotations of the two nodes, (..., N, ...)."""

    r_i: Tensor
    r_j: Tensor
    q_i: Tensor
    q_j: Tensor


class LinearInterpolation:
    """One element knows its two nodes and nothing of the others."""

    order = 1
    # see `mass`: b, of its nodes' values; c of an element's mass, and of a rigid element's
    difference, coupling, consistent = (-1.0, 1.0), 1 / 12, 1 / 6
    positive = True  # whether no share of a node can be less than nothing
    poses = Ends

    @staticmethod
    def at_stations(parts: tuple[Tensor, ...], axes: int = 1) -> tuple[Tensor, ...]:
        """Values at the nodes of elements, for each station of these."""
        return parts

    @staticmethod
    def axes_at_nodes(q: Tensor) -> tuple[Tensor, ...]:
        """Axes (..., stations, 4) that an element whose stations have the axes q (..., stations, 4)
        has at each of its nodes. They are the nodes' but for a kink, however much the beam is
        twisted, so that a section that is the same everywhere gives every node its own inertia.
        """
        return q, q

    @staticmethod
    def shares(parts: tuple[Tensor, ...], axes: int = 1) -> tuple[Tensor, ...]:
        """What stations stand for, as seen by each of their nodes (..., N, *), shared among these:
        half of it each.
        """
        return parts[0] / 2, parts[1] / 2

    @staticmethod
    def slopes(x_i: Tensor, x_j: Tensor) -> Tensor:
        """What a station's motion is of values (..., N, *) at its nodes: their difference."""
        return x_j - x_i

    @staticmethod
    def by_spins(by: Tensor, p: int) -> tuple[Tensor, ...]:
        """Derivative (..., N, k, p + 2 s) by a station's numbers -> by dr_j - dr_i and by the spin
        of each node.
        """
        s = (by.shape[-1] - p) // 2
        return by.split((p, s, s), -1)

    @staticmethod
    def by_numbers(by_r: Tensor, by_i: Tensor, by_j: Tensor) -> Tensor:
        """The inverse."""
        return torch.cat((by_r, by_i, by_j), -1)

    @staticmethod
    def numbers(moves: tuple[Tensor, ...], p: int) -> Tensor:
        """Moves of elements' nodes (..., N, w) -> numbers of the stations (..., N, p + 2 s)."""
        (r_i, spin_i), (r_j, spin_j) = (x.split((p, x.shape[-1] - p), -1) for x in moves)
        return torch.cat((r_j - r_i, spin_i, spin_j), -1)

    @staticmethod
    def loads(load: Tensor, p: int) -> tuple[Tensor, ...]:
        """[n, m_i, m_j] (..., N, p + 2 s) of stations -> (..., N, w) of each node: -n and m_i of i,
        n and m_j of j.
        """
        s = (load.shape[-1] - p) // 2
        n, m_i, m_j = load.split((p, s, s), -1)
        return torch.cat((-n, m_i), -1), torch.cat((n, m_j), -1)

    @staticmethod
    def blocks(Y: Tensor, p: int) -> tuple[tuple[Tensor, ...], ...]:
        """(..., N, p + 2 s, p + 2 s) of stations -> (..., N, w, w) between the nodes of elements,
        by row and column.
        """
        w = (Y.shape[-1] + p) // 2
        rows = torch.cat((-Y[..., :p, :], Y[..., p:w, :], Y[..., :p, :], Y[..., w:, :]), -2)
        K = torch.cat((-rows[..., :p], rows[..., p:w], rows[..., :p], rows[..., w:]), -1)
        return (K[..., :w, :w], K[..., :w, w:]), (K[..., w:, :w], K[..., w:, w:])
