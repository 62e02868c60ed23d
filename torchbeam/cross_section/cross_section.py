"""CrossSection: a cross-section solved by finite elements, with its stresses."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..core.arguments import choice
from ..core.summary import kind, lines, span
from ..core.validation import Value, as_tensor, axis_last, common_dtype, finite
from .material import bond
from .mesh import Mesh
from .shapes import Shapes
from .warping import solution

AXES = "section", "material"


@dataclass(frozen=True)
class CrossSection(Shapes):
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
    def _solved(cls, mesh: Mesh) -> CrossSection:
        return cls.of(mesh)
