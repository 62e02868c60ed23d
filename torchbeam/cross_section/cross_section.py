"""CrossSection: a cross-section solved by finite elements, with its stresses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import choice, count, instance, some
from ..core.summary import kind, lines, span
from ..core.validation import (
    Value,
    as_tensor,
    axis_last,
    common_dtype,
    concrete,
    finite,
    positive,
    refusal,
    shown,
)
from . import blocks
from .material import Material, bond
from .mesh import Mesh, of_one_material, points_of
from .polygon import polygons
from .tube import tube
from .walls import laminate, thin_walled
from .warping import solution

AXES = "section", "material"
FINEST = 8  # 64 times the elements


@dataclass(frozen=True)
class CrossSection:
    """A cross-section solved by finite elements: matrices, centres, warping, stresses.

    Args:
        mesh: nodes, elements and their materials
        compliance, mass: (..., 6, 6) as a `Section` has them
        warping: (..., n, 3, 6) m, displacement of the nodes by unit [F1 F2 F3 M1 M2 M3]
        strain: (..., e, g, 6, 6) strains 11 22 33 23 13 12 of that, at the points of integration
        points: (..., e, g, 2) m, where these are
        area: (..., e, g) m^2, their shares of the section

    Leading axes are batch axes. `coupled` and `offset` are what the section's symmetry says, see
    `Section`. `fineness` multiplies the number of elements in each direction.

    Examples:
        >>> cross = tb.CrossSection.channel(
        ...     width=0.05, height=0.1, flange=0.008, web=0.006, E=210e9, nu=0.3, rho=7850.0
        ... )
        >>> cross.shear_centre  # m, from the centroid
        tensor([-0.0319,  0.0000])
        >>> section = tb.Section.from_cross_section(cross)
        >>> cross.stress(F=(0, 0, 1e3)).shape  # elements, points in each, 11 22 33 23 13 12
        torch.Size([126, 9, 6])
    """

    mesh: Mesh
    compliance: Tensor
    mass: Tensor
    warping: Tensor
    strain: Tensor
    points: Tensor
    area: Tensor

    @classmethod
    def of(cls, mesh: Mesh) -> CrossSection:
        """The solution of a mesh. Raises ValueError where elements overlap or have no area."""
        return cls(mesh, *solution(mesh))

    def __repr__(self) -> str:
        area = self.area.sum((-2, -1))
        return lines(
            "CrossSection",
            f"area {span(area)} m^2, {self.mesh.nodes.shape[-2]} nodes",
            f"shear centre y {span(self.shear_centre[..., 0])} z {span(self.shear_centre[..., 1])} "
            "m",
            kind(self.compliance.shape[:-2], self.compliance),
        )

    @property
    def stiffness(self) -> Tensor:
        """(..., 6, 6), the inverse of the compliance."""
        return torch.linalg.inv(self.compliance)

    @property
    def shear_centre(self) -> Tensor:
        """(..., 2) m, y and z where a transverse force does not twist the section: the centre of
        Trefftz, where shear and torsion share no energy.
        """
        S = self.compliance
        return torch.stack((-S[..., 3, 2], S[..., 3, 1]), -1) / S[..., 3, 3, None]

    @property
    def elastic_centre(self) -> Tensor:
        """(..., 2) m, y and z where an axial force does not bend the section."""
        S = self.compliance
        zy = -torch.linalg.solve(S[..., 4:, 4:], S[..., 4:, 0])
        return torch.stack((-zy[..., 1], zy[..., 0]), -1)

    @property
    def mass_centre(self) -> Tensor:
        """(..., 2) m, y and z of the centre of mass."""
        m = self.mass
        return torch.stack((m[..., 0, 5].neg(), m[..., 0, 4]), -1) / m[..., 0, 0, None]

    def stress(
        self, F: Value = (0.0, 0.0, 0.0), M: Value = (0.0, 0.0, 0.0), axes: str = "section"
    ) -> Tensor:
        """Stresses (..., e, g, 6) Pa at `points`, order 11 22 33 23 13 12, of a section's load.

        Args:
            F, M: (..., 3) N and N m, in section axes about the origin. Their leading axes broadcast
                with those of the cross-section
            axes: "section": x along the beam, y, z. "material": those of each ply, 1 along the
                fibre and 3 through it

        Raises:
            ValueError: for a load that has not three entries, or unknown axes.
        """
        dtype, device = common_dtype(self.compliance, F, M)
        F, M = (
            axis_last(name, finite(name, as_tensor(x, dtype, device)), 3)
            for name, x in (("F", F), ("M", M))
        )
        load = torch.cat(torch.broadcast_tensors(F, M), -1)[..., None, None, :, None]
        stress = self.mesh.stiffness[..., None, :, :] @ (self.strain @ load)
        if choice("axes", axes, AXES) == "material":
            stress = bond(self.mesh.axes.mT)[..., None, :, :] @ stress
        return stress[..., 0]

    @classmethod
    def tube(
        cls, outer: Value, inner: Value, E: Value, nu: Value, rho: Value, fineness: int = 1
    ) -> CrossSection:
        """Circular tube between two radii (...) m, about its centre."""
        outer, inner = _lengths(outer=outer, inner=inner)
        _more("inner", inner, "outer", outer)
        return cls._plain(tube, (outer, inner), E, nu, rho, fineness, coupled=False)

    @classmethod
    def box(
        cls, width: Value, height: Value, thickness: Value, E: Value, nu: Value, rho: Value,
        fineness: int = 1,
    ) -> CrossSection:  # fmt: skip
        """Rectangular tube of outer `width` along y and `height` along z, about its centre."""
        sizes = _lengths(width=width, height=height, thickness=thickness)
        _more("2 thickness", 2 * sizes[2], "width", sizes[0])
        _more("2 thickness", 2 * sizes[2], "height", sizes[1])
        return cls._plain(blocks.box, sizes, E, nu, rho, fineness, coupled=False)

    @classmethod
    def i_beam(
        cls, width: Value, height: Value, flange: Value, web: Value, E: Value, nu: Value,
        rho: Value, fineness: int = 1,
    ) -> CrossSection:  # fmt: skip
        """I of flanges along y and a web along z, of these thicknesses, about its centre."""
        sizes = _flanged(width, height, flange, web)
        return cls._plain(blocks.i_beam, sizes, E, nu, rho, fineness, coupled=False)

    @classmethod
    def channel(
        cls, width: Value, height: Value, flange: Value, web: Value, E: Value, nu: Value,
        rho: Value, fineness: int = 1,
    ) -> CrossSection:  # fmt: skip
        """Channel: a web along z and two flanges from it along +y, about its centroid."""
        sizes = _flanged(width, height, flange, web)
        return cls._plain(blocks.channel, sizes, E, nu, rho, fineness)

    @classmethod
    def angle(
        cls, width: Value, height: Value, thickness: Value, E: Value, nu: Value, rho: Value,
        fineness: int = 1,
    ) -> CrossSection:  # fmt: skip
        """Angle: a leg along +y and a leg along +z from their corner, about its centroid."""
        sizes = _lengths(width=width, height=height, thickness=thickness)
        _more("thickness", sizes[2], "width", sizes[0])
        _more("thickness", sizes[2], "height", sizes[1])
        return cls._plain(blocks.angle, sizes, E, nu, rho, fineness)

    @classmethod
    def polygon(
        cls, points: Value, E: Value, nu: Value, rho: Value, holes: Sequence[Value] = (),
        fineness: int = 1,
    ) -> CrossSection:  # fmt: skip
        """Polygon of corners (..., n, 2) m, y and z, with holes of the same kind.

        The mesh is that of the first sample, which takes it along with its corners: that gives
        derivatives. So a sample alone differs from the same one in a batch by an error of the mesh.

        Raises:
            ValueError: for fewer than three corners, edges that cross, or a hole outside.
        """
        if not isinstance(holes, (list, tuple)):
            raise refusal(f"holes = {shown(holes)}", "a list of polygons")
        material = Material(E=E, nu=nu, rho=rho)
        parts = [(points_of("points", points, least=3), material)]
        parts += [(points_of("a hole", hole, least=3), None) for hole in holes]
        return cls.of(polygons(parts, _fineness(fineness)))

    @classmethod
    def polygons(cls, parts: Sequence[Any], fineness: int = 1) -> CrossSection:
        """Polygons of several materials, beside and within each other.

        Args:
            parts: each (points, material): corners (..., n, 2) m, y and z, and a `Material`, whose
                axis 1 is along x, 2 along y and 3 along z; or None for a hole. What several contain
                belongs to the last of them: a bar in concrete comes behind the concrete. Parts
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
        if not (isinstance(parts, (list, tuple)) and parts):
            raise refusal(f"parts = {shown(parts)}", "a list of one or more")
        if not all(isinstance(part, (tuple, list)) and len(part) == 2 for part in parts):
            raise refusal(f"parts = {shown(parts)}", "(points, material) of each")
        checked = [
            (points_of("points", x, 3), m if m is None else instance("a material", m, Material))
            for x, m in parts
        ]
        return cls.of(polygons(checked, _fineness(fineness)))

    @classmethod
    def laminate(cls, plies: Sequence[Any], width: Value, fineness: int = 1) -> CrossSection:
        """Flat strip of plies, `width` (...) m along y, stacked along +z about its middle.

        Args:
            plies: from the lowest: each (thickness m, angle rad, material); the angle goes from x
                towards y
        """
        return cls.of(laminate(plies, *_lengths(width=width), _fineness(fineness)))

    @classmethod
    def thin_walled(
        cls, walls: Sequence[Any], line: str = "middle", fineness: int = 1, join: str = "plies"
    ) -> CrossSection:
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
        it, as at a trailing edge, the plies of both sides meet between them.

        Raises:
            ValueError: for walls that meet otherwise, or leave no room for each other.
        """
        return cls.of(thin_walled(walls, line, join, _fineness(fineness)))

    @classmethod
    def _plain(
        cls, shape: Any, sizes: Sequence[Tensor], E: Value, nu: Value, rho: Value, fineness: int,
        coupled: bool = True,
    ) -> CrossSection:  # fmt: skip
        """Of one isotropic material, about its centroid."""
        nodes, cells = shape(*sizes, _fineness(fineness))
        material = Material(E=E, nu=nu, rho=rho)
        return cls.of(of_one_material(nodes, cells, material, coupled=coupled, offset=False))


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
