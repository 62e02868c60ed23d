"""Coordinates of beams whose elements have three nodes: the same unknowns of a node, with another
element between nodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from .. import quadratic_element
from ..quadratic_interpolation import QuadraticInterpolation
from . import planar_quadratic_element
from .linearised import LinearElement, Linearised
from .planar import Planar
from .spatial import Spatial


class QuadraticSpatial(Spatial):
    """See `Spatial` and `quadratic_element`."""

    interpolation = QuadraticInterpolation()
    functions = quadratic_element


@dataclass(frozen=True)
class QuadraticPlanar(Planar):
    """See `Planar` and `planar_quadratic_element`."""

    interpolation = QuadraticInterpolation()
    functions = planar_quadratic_element


@dataclass(frozen=True)
class LinearQuadraticElement(LinearElement):
    """chord: dr/dx of the undeformed beam at the stations; numbers of a station as in
    `QuadraticInterpolation`.
    """

    interpolation: ClassVar[Any] = QuadraticInterpolation()
    finite: ClassVar[Any] = quadratic_element


@dataclass(frozen=True)
class QuadraticLinearised(Linearised):
    """See `Linearised`."""

    interpolation = QuadraticInterpolation()
    linear: ClassVar[type[LinearElement]] = LinearQuadraticElement
