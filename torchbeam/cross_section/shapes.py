"""Constructors by shape: of a `CrossSection`, which keeps its solution by finite elements, and of a
`Section`, which keeps the two matrices. What solves is imported where it is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import torch
from torch import Tensor

from ..core.arguments import count, some
from ..core.validation import Value, as_tensor, common_dtype, concrete, positive, refusal, shown

if TYPE_CHECKING:
    from .mesh import Mesh

S = TypeVar("S", bound="Shapes")
FINEST = 8  # 64 times the elements
UNCOUPLED = ("tube", "box", "i_beam")  # by symmetry


class Shapes:
    """What is made by its shape. `fineness` multiplies the number of elements each way."""

    @classmethod
    def _solved(cls: type[S], mesh: Mesh) -> S:
        """Of the solution of a mesh."""
        raise NotImplementedError

    @classmethod
    def tube(
        cls: type[S], outer: Value, inner: Value, E: Value, nu: Value, rho: Value, fineness: int = 1
    ) -> S:
        """Circular tube between two radii (...) m, about its centre.

        Examples:
            >>> mast = tb.Section.tube(outer=0.05, inner=0.045, E=70e9, nu=0.33, rho=2700.0)
        """
        outer, inner = _lengths(outer=outer, inner=inner)
        _more("inner", inner, "outer", outer)
        return cls._plain("tube", (outer, inner), E, nu, rho, fineness)

    @classmethod
    def box(
        cls: type[S], width: Value, height: Value, thickness: Value, E: Value, nu: Value,
        rho: Value, fineness: int = 1,
    ) -> S:  # fmt: skip
        """Rectangular tube of outer `width` along y and `height` along z, about its centre."""
        sizes = _lengths(width=width, height=height, thickness=thickness)
        _more("2 thickness", 2 * sizes[2], "width", sizes[0])
        _more("2 thickness", 2 * sizes[2], "height", sizes[1])
        return cls._plain("box", sizes, E, nu, rho, fineness)

    @classmethod
    def i_beam(
        cls: type[S], width: Value, height: Value, flange: Value, web: Value, E: Value, nu: Value,
        rho: Value, fineness: int = 1,
    ) -> S:  # fmt: skip
        """I of flanges along y and a web along z, of these thicknesses, about its centre."""
        sizes = _flanged(width, height, flange, web)
        return cls._plain("i_beam", sizes, E, nu, rho, fineness)

    @classmethod
    def channel(
        cls: type[S], width: Value, height: Value, flange: Value, web: Value, E: Value, nu: Value,
        rho: Value, fineness: int = 1,
    ) -> S:  # fmt: skip
        """Channel: a web along z and two flanges from it along +y, about its centroid."""
        sizes = _flanged(width, height, flange, web)
        return cls._plain("channel", sizes, E, nu, rho, fineness)

    @classmethod
    def angle(
        cls: type[S], width: Value, height: Value, thickness: Value, E: Value, nu: Value,
        rho: Value, fineness: int = 1,
    ) -> S:  # fmt: skip
        """Angle: a leg along +y and a leg along +z from their corner, about its centroid."""
        sizes = _lengths(width=width, height=height, thickness=thickness)
        _more("thickness", sizes[2], "width", sizes[0])
        _more("thickness", sizes[2], "height", sizes[1])
        return cls._plain("angle", sizes, E, nu, rho, fineness)

    @classmethod
    def polygon(
        cls: type[S], points: Value, E: Value, nu: Value, rho: Value, holes: Sequence[Value] = (),
        fineness: int = 1,
    ) -> S:  # fmt: skip
        """Polygon of corners (..., n, 2) m, y and z, with holes of the same kind.

        The mesh is that of the first sample, which takes it along with its corners: that gives
        derivatives. So a sample alone differs from the same one in a batch by an error of the mesh.

        Raises:
            ValueError: for fewer than three corners, edges that cross, or a hole outside.

        Examples:
            >>> wedge = tb.Section.polygon(
            ...     [(0, 0), (0.1, 0), (0.1, 0.02)], E=3e9, nu=0.35, rho=1200.0
            ... )
        """
        from .material import Material

        if not isinstance(holes, (list, tuple)):
            raise refusal(f"holes = {shown(holes)}", "a list of polygons")
        material = Material(E=E, nu=nu, rho=rho)
        return cls.polygons([(points, material), *((hole, None) for hole in holes)], fineness)

    @classmethod
    def polygons(cls: type[S], parts: Sequence[Any], fineness: int = 1) -> S:
        """Polygons of several materials, beside and within each other.

        Args:
            parts: each (points, material): corners (..., n, 2) m, y and z, and a `Material`, whose
                axis 1 is along x, 2 along y and 3 along z; or None for a hole. A place within
                several polygons belongs to the last of them: bars come behind their concrete. Parts
                beside each other share whole edges

        The mesh is that of the first sample, see `polygon`.

        Raises:
            ValueError: for polygons whose edges cross or touch between corners, that do not meet,
                or of which nothing is left below later ones.

        Examples:
            >>> steel = tb.Material(E=210e9, nu=0.3, rho=7850.0)
            >>> concrete = tb.Material(E=33e9, nu=0.2, rho=2400.0)
            >>> outer = torch.tensor([(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)])
            >>> column = tb.CrossSection.polygons([(outer, steel), (0.95 * outer, concrete)])
        """
        from .polygon import polygons

        return cls._solved(polygons(parts, _fineness(fineness)))

    @classmethod
    def laminate(cls: type[S], plies: Sequence[Any], width: Value, fineness: int = 1) -> S:
        """Flat strip of plies, `width` (...) m along y, stacked along +z about its middle.

        Args:
            plies: from the lowest: each (thickness m, angle rad, material); the angle goes from x
                towards y

        Examples:
            >>> carbon = tb.Material(
            ...     E1=142e9, E2=9.8e9, E3=9.8e9, G12=6e9, G13=6e9, G23=4.8e9,
            ...     nu12=0.3, nu13=0.3, nu23=0.34, rho=1600.0,
            ... )
            >>> strip = tb.Section.laminate([(1e-3, 0.3, carbon), (1e-3, -0.3, carbon)], width=0.03)
        """
        from .walls import laminate

        return cls._solved(laminate(plies, *_lengths(width=width), _fineness(fineness)))

    @classmethod
    def thin_walled(
        cls: type[S], walls: Sequence[Any], line: str = "middle", fineness: int = 1,
        join: str = "plies",
    ) -> S:  # fmt: skip
        """Walls of plies along lines.

        Args:
            walls: each (points, plies). The points (..., n, 2) m, y and z, are a line, closed if it
                ends where it begins. The plies (thickness m, angle rad, material) are stacked to
                its left, seen with y to the right and z up. A ply's angle goes from x towards the
                line's direction
            line: what the points describe: the "middle" of the wall, or where its "first" ply
                begins
            join: where two walls meet, each ply goes over into the one of its number in the other,
                of as many "plies"; or keeps its "depth", and a thicker wall ends in a free face

        Walls meet where their lines share a point. Two ends make a corner. A wall that ends within
        another's line stands on its face. Where a corner is so sharp that its faces meet far before
        it, as at a trailing edge, the plies of both sides meet between them. In a batch, the first
        sample says where.

        Raises:
            ValueError: for walls that meet otherwise, or leave no room for each other.
        """
        from .walls import thin_walled

        return cls._solved(thin_walled(walls, line, join, _fineness(fineness)))

    @classmethod
    def _plain(
        cls: type[S], shape: str, sizes: Sequence[Tensor], E: Value, nu: Value, rho: Value,
        fineness: int,
    ) -> S:  # fmt: skip
        """Of one isotropic material, about its centroid."""
        from . import blocks
        from .material import Material
        from .mesh import of_one_material

        nodes, cells = getattr(blocks, shape)(*sizes, _fineness(fineness))
        material, coupled = Material(E=E, nu=nu, rho=rho), shape not in UNCOUPLED
        return cls._solved(of_one_material(nodes, cells, material, coupled=coupled, offset=False))


def _fineness(value: int) -> int:
    if count("fineness", value) > FINEST:
        raise refusal(f"fineness = {shown(value)}", f"a whole number up to {FINEST}")
    return value


def _lengths(**values: Value) -> tuple[Tensor, ...]:
    dtype, device = common_dtype(*values.values())
    tensors = {name: as_tensor(x, dtype, device) for name, x in values.items()}
    return torch.broadcast_tensors(*(positive(name, some(name, x)) for name, x in tensors.items()))


def _flanged(width: Value, height: Value, flange: Value, web: Value) -> tuple[Tensor, ...]:
    """Sizes of a shape with two flanges and a web."""
    sizes = _lengths(width=width, height=height, flange=flange, web=web)
    _more("web", sizes[3], "width", sizes[0])
    _more("2 flange", 2 * sizes[2], "height", sizes[1])
    return sizes


def _more(small: str, a: Tensor, large: str, b: Tensor) -> None:
    if not concrete(a < b).all():
        lengths = f"{small} of {concrete(a).max().item():g} m and {large} of "
        lengths += f"{concrete(b).min().item():g} m"
        raise refusal(lengths, f"{small} below {large}", were=True)
