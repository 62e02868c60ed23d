"""Constructors of sections from their shapes, solved by finite elements."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

from ..core.tree import Tree
from ..core.validation import Value

S = TypeVar("S", bound="SolvedShapes")


class SolvedShapes(Tree):
    """What a `Section` is made by where its stiffness has no closed form. `fineness` multiplies the
    number of elements each way; all else is as `CrossSection` has it.
    """

    @classmethod
    def tube(
        cls: type[S], outer: Value, inner: Value, E: Value, nu: Value, rho: Value, fineness: int = 1
    ) -> S:
        """Circular tube between two radii (m), about its centre. This and what follows are solved
        by finite elements, see `CrossSection`; `fineness` multiplies their number each way.

        Examples:
            >>> mast = tb.Section.tube(outer=0.05, inner=0.045, E=70e9, nu=0.33, rho=2700.0)
        """
        return cls._solved("tube", outer, inner, E, nu, rho, fineness=fineness)

    @classmethod
    def box(
        cls: type[S], width: Value, height: Value, thickness: Value, E: Value, nu: Value,
        rho: Value, fineness: int = 1,
    ) -> S:  # fmt: skip
        """Rectangular tube of outer width (along y) and height (along z), about its centre (m)."""
        return cls._solved("box", width, height, thickness, E, nu, rho, fineness=fineness)

    @classmethod
    def i_beam(
        cls: type[S], width: Value, height: Value, flange: Value, web: Value, E: Value, nu: Value,
        rho: Value, fineness: int = 1,
    ) -> S:  # fmt: skip
        """I with flanges along y and a web along z, of these thicknesses (m), about its centre."""
        return cls._solved("i_beam", width, height, flange, web, E, nu, rho, fineness=fineness)

    @classmethod
    def channel(
        cls: type[S], width: Value, height: Value, flange: Value, web: Value, E: Value, nu: Value,
        rho: Value, fineness: int = 1,
    ) -> S:  # fmt: skip
        """Channel: a web along z, flanges from it along +y (m), about its centroid."""
        return cls._solved("channel", width, height, flange, web, E, nu, rho, fineness=fineness)

    @classmethod
    def angle(
        cls: type[S], width: Value, height: Value, thickness: Value, E: Value, nu: Value,
        rho: Value, fineness: int = 1,
    ) -> S:  # fmt: skip
        """Angle: legs along +y and +z from their corner (m), about its centroid."""
        return cls._solved("angle", width, height, thickness, E, nu, rho, fineness=fineness)

    @classmethod
    def polygon(
        cls: type[S], points: Value, E: Value, nu: Value, rho: Value, holes: Sequence[Value] = (),
        fineness: int = 1,
    ) -> S:  # fmt: skip
        """Polygon of corners (..., n, 2) m, y and z, with holes likewise, about their origin.

        Examples:
            >>> wedge = tb.Section.polygon(
            ...     [(0, 0), (0.1, 0), (0.1, 0.02)], E=3e9, nu=0.35, rho=1200.0
            ... )
        """
        return cls._solved("polygon", points, E, nu, rho, holes=holes, fineness=fineness)

    @classmethod
    def laminate(cls: type[S], plies: Sequence[Any], width: Value, fineness: int = 1) -> S:
        """Flat strip of plies (thickness m, angle rad, material) from the lowest up along z,
        `width` (m) along y, about its middle. Angles go from x towards y.

        Examples:
            >>> carbon = tb.Material(
            ...     E1=142e9, E2=9.8e9, E3=9.8e9, G12=6e9, G13=6e9, G23=4.8e9,
            ...     nu12=0.3, nu13=0.3, nu23=0.34, rho=1600.0,
            ... )
            >>> strip = tb.Section.laminate([(1e-3, 0.3, carbon), (1e-3, -0.3, carbon)], width=0.03)
        """
        return cls._solved("laminate", plies, width, fineness=fineness)

    @classmethod
    def thin_walled(
        cls: type[S], walls: Sequence[Any], line: str = "middle", fineness: int = 1
    ) -> S:  # fmt: skip
        """Walls (points, plies) along lines of (..., n, 2) m, y and z, about their origin.

        See `CrossSection.thin_walled` for how plies are stacked, and where walls may meet.
        """
        return cls._solved("thin_walled", walls, line=line, fineness=fineness)

    @classmethod
    def _solved(cls: type[S], shape: str, *args: Any, **options: Any) -> S:
        """Of a shape that `CrossSection` knows, which is imported where it is first asked for; by
        `Section.from_cross_section`.
        """
        from ..cross_section import CrossSection

        return cls.from_cross_section(getattr(CrossSection, shape)(*args, **options))
