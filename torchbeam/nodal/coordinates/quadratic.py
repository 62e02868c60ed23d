"""Coordinates of beams whose elements have three nodes: the same unknowns of a node, with another element between nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from .. import quadratic_element
from ..quadratic_interpolation import QuadraticInterpolation
from . import planar_quadratic_element
from .linearised import LinearElement, Small
from .planar import Plane
from .spatial import Space


class QuadraticSpace(Space):
    """See `Space` and `quadratic_element`."""

    interpolation = QuadraticInterpolation()
    functions = quadratic_element


@dataclass(frozen=True)
class QuadraticPlane(Plane):
    """See `Plane` and `planar_quadratic_element`."""

    interpolation = QuadraticInterpolation()
    functions = planar_quadratic_element


@dataclass(frozen=True)
class LinearQuadraticElement(LinearElement):
    """chord: dr/dx of the undeformed beam at the stations; numbers of a station as in `QuadraticInterpolation`."""

    interpolation: ClassVar[Any] = QuadraticInterpolation()
    finite: ClassVar[Any] = quadratic_element


@dataclass(frozen=True)
class QuadraticSmall(Small):
    """See `Small`."""

    interpolation = QuadraticInterpolation()
    linear: ClassVar[type[LinearElement]] = LinearQuadraticElement
