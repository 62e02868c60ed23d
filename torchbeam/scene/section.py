"""Section: the compliance and the mass of a beam's cross-section, per unit length."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from ..core.leaves import Tree, leaf, with_values
from ..core.summary import kind, lines, span
from ..core.validation import (
    Value,
    as_tensor,
    axis_last,
    broadcast,
    common_dtype,
    concrete,
    dtype_of,
    finite,
    inertia,
    positive,
    present,
    refusal,
    shown,
)
from ..cross_section.shapes import Shapes
from ..math.block_matrices import of_blocks
from ..math.quaternions import skew
from ..math.shapes import broadcast_shapes

SHEAR_FACTOR_RECTANGLE = 5 / 6  # Timoshenko's, Poisson's ratio neglected
# solid circle, Poisson's ratio neglected (Cowper 1966 at nu = 0 gives 6/7)
SHEAR_FACTOR_CIRCLE = 9 / 10
STRAINS = ("axial", "shear y", "shear z", "torsion", "bending y", "bending z")
STRUCTURE = ("coupled", "offset", "rotary")
ODD_FIFTH_POWERS = 1.0045237627951396  # 1 + 1/3^5 + 1/5^5 + ... = 31/32 zeta(5)


@dataclass(frozen=True)
class Section(Shapes, Tree):
    """A cross-section, per unit length, in its own axes: x along the beam, y and z across.

    Args:
        compliance: (..., 6, 6) S, symmetric: [gamma; kappa] = S [F; M]. Rows and columns [F1 F2 F3
            M1 M2 M3]; units 1/N, 1/(N m), 1/(N m^2). A zero row and column makes that strain
            impossible.
        mass: (..., 6, 6) symmetric: [P; H] = mass [V; Omega]. Units kg/m, kg, kg m.

    Leading axes are batch axes. Four attributes say which terms are present:

    - `rigid`: which strains are impossible;
    - `coupled`: whether the compliance has more than its diagonal;
    - `offset`: whether the centre of mass is off the reference axis (mass couples V and Omega);
    - `rotary`: whether the section resists rotation.

    A matrix in a tensor has all terms, whatever its numbers, because a gradient may be asked for
    where they are 0. A matrix of plain numbers has the terms that are not 0. A section made in
    another way has the terms that its arguments ask for.

    Raises:
        ValueError: for a wrong shape, an asymmetric matrix, a negative diagonal, NaN or infinity.
            For an impossible rotary inertia (one principal moment above the sum of the others).

    Examples:
        >>> strip = tb.Section.rectangle(width=0.03, height=0.002, E=69e9, nu=0.33, rho=2700.0)
        >>> rod = tb.Section.circle(radius=0.005, E=210e9, nu=0.3, rho=7850.0)
        >>> given = tb.Section.from_stiffness(
        ...     EA=1e5, GA=4e4, GJ=1.0, EI=(1.0, 2.0), mass=0.3, inertia=1e-3
        ... )
        >>> strip.mass[0, 0]  # kg/m
        tensor(0.1620)
    """

    compliance: Tensor = leaf(2)
    mass: Tensor = leaf(2)
    rigid: tuple[bool, ...] = field(init=False)
    coupled: bool = field(init=False)
    offset: bool = field(init=False)
    rotary: bool = field(init=False)

    def __post_init__(self) -> None:
        matrices = self.compliance, self.mass
        dtype, device = common_dtype(*matrices)
        S, mass = (
            _symmetric(name, as_tensor(x, dtype, device), dtype_of(x))
            for name, x in (("compliance", self.compliance), ("mass", self.mass))
        )
        broadcast("compliance and mass", S.shape[:-2], mass.shape[:-2])
        S_diagonal = positive(
            "a diagonal entry of the compliance", S.diagonal(dim1=-2, dim2=-1), zero=True
        )
        positive("mass per length", mass[..., 0, 0])
        positive("rotary inertia", mass.diagonal(dim1=-2, dim2=-1)[..., 3:], zero=True)
        for name, matrix in (("compliance", S), ("mass", mass)):
            least, largest = torch.linalg.eigvalsh(matrix.detach()).aminmax(dim=-1)
            if concrete(least < -1e-6 * largest.abs()).any():
                raise ValueError(
                    f"{name} with the eigenvalue {concrete(least).min().item():g} was given; "
                    "none may be negative"
                )
        inertia("rotary inertia", _about_centre(mass), mass[..., 3:, 3:].abs().amax((-1, -2)))
        vars(self).update(compliance=S, mass=mass, rigid=_zeros(S_diagonal))
        self.declared(
            coupled=present(matrices[0], S - torch.diag_embed(S_diagonal)),
            offset=present(matrices[1], mass[..., :3, 3:]),
            rotary=present(matrices[1], mass[..., 3:, 3:]),
        )

    def __repr__(self) -> str:
        flexibility = self.compliance.diagonal(dim1=-2, dim2=-1)
        EA, GA_y, GA_z, GJ, EI_y, EI_z = (span(1 / x) for x in flexibility.unbind(-1))
        what = "1/diagonal of the coupled compliance: " if self.coupled else ""
        return lines(
            "Section",
            f"{what}EA {EA} N, GA {GA_y} and {GA_z} N, GJ {GJ} N m^2, EI {EI_y} and {EI_z} N m^2",
            ", ".join([f"mass {span(self.mass[..., 0, 0])} kg/m", *notes(self)]),
            kind(self.batch_shape, self.mass),
        )

    @property
    def batch_shape(self) -> torch.Size:
        return broadcast_shapes(self.compliance.shape[:-2], self.mass.shape[:-2])

    def rotated(self, angle: Value) -> Section:
        """The same section turned about x by `angle` (...) rad.

        A point on its y axis moves to `angle` from the beam's y axis, towards z. Use it for
        principal axes that differ from the beam's, or for a twist in steps.

        Raises:
            ValueError: if only one of the two shears, or of the two bendings, is impossible.
        """
        if self.rigid[1] != self.rigid[2] or self.rigid[4] != self.rigid[5]:
            raise ValueError(
                "a section with an impossible strain across one axis was given; both or none is "
                "wanted to turn it"
            )
        given, angle = angle, finite("angle", self._value(angle))
        turned = present(given)
        zero, one, c = torch.zeros_like(angle), torch.ones_like(angle), torch.cos(angle)
        s = torch.sin(angle)
        R = torch.stack((one, zero, zero, zero, c, -s, zero, s, c), -1).unflatten(-1, (3, 3))
        both = of_blocks(R, torch.zeros_like(R), torch.zeros_like(R), R)
        return Section(both @ self.compliance @ both.mT, both @ self.mass @ both.mT).declared(
            self.coupled or turned, self.offset, self.rotary
        )

    def shifted(self, y: Value = 0.0, z: Value = 0.0) -> Section:
        """The same section described about another reference axis.

        The new axis runs through the point (0, y, z) (...) m of the section's own axes. Nodes then
        lie there, and loads act there. With r = (0, y, z), quantities about the new axis are

            gamma' = gamma + kappa x r      kappa' = kappa      F' = F      M' = M - r x F
            V' = V + Omega x r

        so bending and extension are coupled, and mass couples V and Omega. This is exact for a
        straight beam without twist. On a curved beam the length of the axis changes too, and the
        beam's nodes must lie on the new axis.

        Raises:
            ValueError: if a strain is impossible: about another axis that is a constraint between
                strains.
        """
        if any(self.rigid):
            raise ValueError(
                "a section with an impossible strain was given; one to be shifted needs finite "
                "stiffness"
            )
        offsets = y, z
        y, z = (finite(name, self._value(value)) for name, value in (("y", y), ("z", z)))
        moved = any(map(present, offsets))
        r = skew(torch.stack(torch.broadcast_tensors(torch.zeros_like(y), y, z), -1))
        eye, zero = torch.eye(3, dtype=r.dtype, device=r.device).expand_as(r), torch.zeros_like(r)
        # about the old axis by about the new
        stress, velocity = of_blocks(eye, zero, r, eye), of_blocks(eye, r, zero, eye)
        return Section(
            stress.mT @ self.compliance @ stress, velocity.mT @ self.mass @ velocity
        ).declared(self.coupled or moved, self.offset or moved, self.rotary or moved)

    def like(self, compliance: Tensor, mass: Tensor) -> Section:
        """Section with means or multiples of its matrices: it has what this one has, unchecked."""
        return with_values(self, compliance=compliance, mass=mass)

    def declared(self, coupled: bool, offset: bool, rotary: bool) -> Section:
        """This section, newly made, with what it is known to have."""
        vars(self).update(coupled=coupled, offset=offset, rotary=rotary)
        return self

    def _value(self, value: Value) -> Tensor:
        return as_tensor(value, *common_dtype(self.compliance, value))

    @classmethod
    def from_stiffness(
        cls, EA: Value, GA: Value, GJ: Value, EI: Value, mass: Value, inertia: Value = 0.0
    ) -> Section:
        """Section with uncoupled stiffness.

        Args:
            EA: (...) N, axial stiffness
            GA: (...) N, shear stiffness kGA along y and z; or a pair (along y, along z)
            GJ: (...) N m^2, torsional stiffness
            EI: (...) N m^2, bending stiffness; or a pair (about y: bending in the x-z plane, about
                z)
            mass: (...) kg/m
            inertia: (...) kg m, rotary inertia per length; or a pair (about y, about z). The polar
                inertia is their sum.

        math.inf makes a strain impossible. Linear models (`modes`, `linearize`) give it 1e-7 of the
        largest flexibility of bending and twist, times L^2 where it is of a force: the first three
        frequencies of a cantilever are 3e-7, 2e-6 and 5e-6 low. A pair is a Python list or tuple of
        two, whose entries may have batch axes. All axes of a tensor or an array are batch axes,
        whatever their lengths. If its last axis is the pair, write `EI=EI.unbind(-1)`.

        Raises:
            ValueError: for a stiffness that is not positive, or a mass or inertia that is negative.
        """
        numbers = dict(EA=EA, GA=GA, GJ=GJ, EI=EI, mass=mass, inertia=inertia)
        dtype, device = common_dtype(*numbers.values())
        pair = {name: _pair(name, value, dtype, device) for name, value in numbers.items()}
        for name in ("EA", "GJ", "mass"):
            if isinstance(numbers[name], (list, tuple)):
                raise ValueError(
                    f"{name} = {numbers[name]!r} was given; one value is wanted (a batch is a "
                    "tensor)"
                )
        for name in ("EA", "GA", "GJ", "EI"):
            for value in dict.fromkeys(pair[name]):
                positive(name, value, infinite=True)
        for name in ("mass", "inertia"):
            for value in dict.fromkeys(pair[name]):
                positive(name, value, zero=name == "inertia")
        stiffness = (pair["EA"][0], *pair["GA"], pair["GJ"][0], *pair["EI"])
        m, (i_y, i_z) = pair["mass"][0], pair["inertia"]
        compliance = _row([1 / k for k in stiffness])
        mass = _row([m, m, m, i_y + i_z, i_y, i_z])
        broadcast("compliance and mass", compliance.shape[:-1], mass.shape[:-1])
        section = object.__new__(cls)  # whose matrices are right by what its numbers are
        for name, row in (("compliance", compliance), ("mass", mass)):
            vars(section)[name] = torch.diag_embed(finite(name, row))
        vars(section)["rigid"] = _zeros(compliance)
        return section.declared(coupled=False, offset=False, rotary=present(inertia))

    @classmethod
    def rectangle(cls, width: Value, height: Value, E: Value, nu: Value, rho: Value) -> Section:
        """Solid rectangle, `width` along y and `height` along z (m); Young's modulus E (Pa),
        Poisson's ratio nu, density rho (kg/m^3). Shear factor 5/6; the torsion constant is
        Saint-Venant's series (Timoshenko and Goodier, Theory of Elasticity, art. 109).
        """
        width, height, E, nu, rho = _positive_all(width=width, height=height, E=E, nu=nu, rho=rho)
        G = E / (2 * (1 + nu))
        A = width * height
        I_y, I_z = width * height**3 / 12, height * width**3 / 12
        long, short = torch.maximum(width, height), torch.minimum(width, height)
        odd = torch.arange(1, 20, 2, dtype=A.dtype, device=A.device)
        # the sum of 1/odd^5 is known; what is left converges like exp(-pi odd long/short)
        series = ODD_FIFTH_POWERS + (
            (torch.tanh(odd * math.pi * (long / short)[..., None] / 2) - 1) / odd**5
        ).sum(-1)
        J = long * short**3 * (1 / 3 - 64 / math.pi**5 * (short / long) * series)
        return cls._solid(E, G, rho, A, SHEAR_FACTOR_RECTANGLE, I_y, I_z, J)

    @classmethod
    def circle(cls, radius: Value, E: Value, nu: Value, rho: Value) -> Section:
        """Solid circle: radius (m), E (Pa), Poisson's ratio nu, rho (kg/m^3). Shear factor 9/10."""
        radius, E, nu, rho = _positive_all(radius=radius, E=E, nu=nu, rho=rho)
        G = E / (2 * (1 + nu))
        I = math.pi * radius**4 / 4
        return cls._solid(E, G, rho, math.pi * radius**2, SHEAR_FACTOR_CIRCLE, I, I, 2 * I)

    @classmethod
    def from_cross_section(cls, cross: Any) -> Section:
        """Section of a `CrossSection`, about the origin of its coordinates.

        Terms that the symmetry of the shape excludes are absent: a tube, a box and an I have no
        coupled stiffness. Only a polygon, a laminate and walls have their centre of mass off the
        origin.

        Examples:
            >>> cross = tb.CrossSection.angle(
            ...     width=0.05, height=0.05, thickness=5e-3, E=70e9, nu=0.3, rho=2700.0
            ... )
            >>> y, z = cross.shear_centre
            >>> section = tb.Section.from_cross_section(cross).shifted(y, z)
        """
        if not all(hasattr(cross, name) for name in ("mesh", "compliance", "mass")):
            raise refusal(f"a cross-section {shown(cross)}", "a CrossSection")
        coupled, offset = cross.mesh.coupled, cross.mesh.offset
        S, mass = cross.compliance, cross.mass
        if not coupled:
            S, mass = (torch.diag_embed(x.diagonal(dim1=-2, dim2=-1)) for x in (S, mass))
        elif not offset:
            top, low = mass[..., :3, :3], mass[..., 3:, 3:]
            mass = of_blocks(top, torch.zeros_like(top), torch.zeros_like(top), low)
        return cls(S, mass).declared(coupled, offset, True)

    @classmethod
    def _solved(cls, mesh: Any) -> Section:
        from ..cross_section.public import CrossSection

        return cls.from_cross_section(CrossSection.of(mesh))

    @classmethod
    def _solid(cls, E, G, rho, A, shear_factor, I_y, I_z, J) -> Section:
        kGA = shear_factor * G * A
        return cls.from_stiffness(
            E * A, kGA, G * J, (E * I_y, E * I_z), rho * A, (rho * I_y, rho * I_z)
        )


def _positive_all(nu: Value, **values: Value) -> list[Tensor]:
    """Values as tensors in the order of the keywords, nu among them, each checked for its sign."""
    dtype, device = common_dtype(nu, *values.values())
    values = {
        name: positive(name, as_tensor(value, dtype, device)) for name, value in values.items()
    }
    nu = finite("nu", as_tensor(nu, dtype, device))
    if not concrete((nu > -1) & (nu <= 0.5)).all():
        raise ValueError(
            f"nu = {nu.flatten()[0].item():g} was given; Poisson's ratio lies above -1 and up to "
            "0.5"
        )
    *before, rho = values.values()
    return [*before, nu, rho]


def _pair(
    name: str, value: Value, dtype: torch.dtype, device: torch.device
) -> tuple[Tensor, Tensor]:
    if isinstance(value, (list, tuple)):
        if len(value) != 2:
            raise refusal(f"{name} with {len(value)} entries", "one value or a pair (y, z)")
        return as_tensor(value[0], dtype, device), as_tensor(value[1], dtype, device)
    number = as_tensor(value, dtype, device)
    return number, number


def _row(entries: list[Tensor]) -> Tensor:
    shape = broadcast("a section's numbers", *(x.shape for x in entries))
    return torch.stack([x.expand(shape) for x in entries], -1)


def _zeros(row: Tensor) -> tuple[bool, ...]:
    """Which entries of a row (..., n) are 0 in any sample."""
    return tuple((concrete(row) == 0).reshape(-1, row.shape[-1]).any(0).tolist())


def _about_centre(mass: Tensor) -> Tensor:
    """Rotary inertia (..., 3, 3) about the centre of mass, of a 6x6 mass: M22 - M21 M11^-1 M12."""
    return mass[..., 3:, 3:] - mass[..., 3:, :3] @ torch.linalg.solve(
        mass[..., :3, :3], mass[..., :3, 3:]
    )


def _symmetric(name: str, matrix: Tensor, given: torch.dtype) -> Tensor:
    """The symmetric part of `matrix`, which may be unsymmetric by rounding: |S_ij - S_ji| up to
    `asymmetry` sqrt(S_ii S_jj), the size that no entry of a positive matrix exceeds. An entry that
    is a difference of large numbers is all rounding, so its own size is no measure. 1e-6 admits six
    printed digits; `given` in float32 it is a thousand times its rounding.
    """
    if matrix.ndim < 2 or matrix.shape[-2:] != (6, 6):
        raise refusal(f"a {name} of shape {tuple(matrix.shape)}", "(..., 6, 6)")
    matrix = axis_last(name, finite(name, matrix), 6)
    asymmetry = max(1e-6, 1e3 * torch.finfo(given).eps)
    root = matrix.detach().diagonal(dim1=-2, dim2=-1).abs().sqrt()
    if concrete(
        (matrix - matrix.mT).abs() > asymmetry * root[..., :, None] * root[..., None, :]
    ).any():
        raise refusal(f"a {name} that is not symmetric", "a symmetric one")
    return (matrix + matrix.mT) / 2


def notes(of: Any) -> list[str]:
    """Special properties of a section, or of those of a beam, in words."""
    known = [
        f"no {strain}: infinite stiffness"
        for strain, rigid in zip(STRAINS, of.rigid, strict=True)
        if rigid
    ]
    if all(of.rigid[:3]):
        known = ["inextensible and unshearable", *known[3:]]
    known += ["stiffnesses coupled"] if of.coupled else []
    known += ["centre of mass off the axis"] if of.offset else []
    known += [] if of.rotary else ["no rotary inertia"]
    return known + (_deep(of) if hasattr(of, "length") else [])


def _deep(beam: Any) -> list[str]:
    """That a solid section of the same stiffnesses would be deeper than the beam is long."""
    S, length = (concrete(x.detach()) for x in (beam.compliance, beam.length.sum(-1)))
    S = S.diagonal(dim1=-2, dim2=-1)
    depth = (12 * S[..., :1] / S[..., 4:]).sqrt()
    depth = torch.where(depth.isfinite(), depth, 0.0).flatten(-2).amax(-1)
    deep = f"bends as a section {span(depth)} m deep, more than the length"
    return [deep] if (depth > length).any() else []
