"""Stations of elements, where strain and stress are told and sections stand, by the elements'
order. Another element is a class here.
"""

from __future__ import annotations

from torch import Tensor

from ..math import quaternions as quat
from ..math.quadratic import X, at_points, threes
from ..topology.framework import within_elements


class Middle:
    """The middle of an element of two nodes, which stands for all of it: a section that changes
    along the beam is averaged over the element.
    """

    averaged = True

    @staticmethod
    def axes(frames: Tensor) -> Tensor:
        """Axes (..., stations, 4) at rest, of nodes with the axes (..., nodes, 4)."""
        return quat.half_way(frames[..., :-1, :], frames[..., 1:, :])

    @staticmethod
    def places(length: Tensor) -> Tensor:
        """Arc lengths (..., stations) m, of stations that stand for a length each."""
        return length.cumsum(-1) - length / 2

    @staticmethod
    def lines(length: Tensor) -> tuple[Tensor, int]:
        """Straight lines by which values at stations are told between them, each through two:
        where one ends and the next begins (..., lines - 1) m, and how many stations further on
        that has its two.
        """
        return Middle.places(length)[..., 1:-1], 1


class GaussPoints:
    """The two Gauss points of an element of three nodes; see `Middle`, and `quadratic_element`."""

    averaged = False

    @staticmethod
    def axes(frames: Tensor) -> Tensor:
        axes = at_points(frames)[0] @ quat.aligned(*threes(frames))
        return quat.normalize(axes).flatten(-3, -2)

    @staticmethod
    def places(length: Tensor) -> Tensor:
        return within_elements(length, (-X, X)).flatten(-2)

    @staticmethod
    def lines(length: Tensor) -> tuple[Tensor, int]:
        return length.cumsum(-1)[..., 1:-1:2], 2


STATIONS = {1: Middle, 2: GaussPoints}  # by the order of the elements
