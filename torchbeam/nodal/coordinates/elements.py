"""Elements: all that the nodal form knows of each, by its order. Another one is its files (see
`Element`) and a row here; how its nodes follow each other is the topology's to say.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from .. import element, quadratic_element
from ..linear_interpolation import LinearInterpolation
from ..quadratic_interpolation import QuadraticInterpolation
from . import planar_element, planar_quadratic_element


class Element(NamedTuple):
    """interpolation: between its nodes, see `LinearInterpolation`; spatial, planar: its kinematics,
    strains, forces, strain operator and geometric stiffness, see the module `element`.
    """

    interpolation: Any
    spatial: Any
    planar: Any


ELEMENTS = {
    1: Element(LinearInterpolation(), element, planar_element),
    2: Element(QuadraticInterpolation(), quadratic_element, planar_quadratic_element),
}
