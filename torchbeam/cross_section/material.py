"""Material: elastic constants and density, isotropic or orthotropic."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..core.leaves import Tree, leaf
from ..core.summary import lines, span
from ..core.validation import (
    Value,
    as_tensor,
    broadcast,
    common_dtype,
    concrete,
    finite,
    positive,
    refusal,
)

ISOTROPIC = ("E", "nu")
ORTHOTROPIC = ("E1", "E2", "E3", "G12", "G13", "G23", "nu12", "nu13", "nu23")
PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))  # of stresses: 11 22 33 23 13 12


@dataclass(frozen=True, kw_only=True)
class Material(Tree):
    """A linear elastic material, isotropic by E and nu or orthotropic by nine constants.

    Args:
        E, nu: (...) Pa and 1, Young's modulus and Poisson's ratio
        rho: (...) kg/m^3, density
        E1, E2, E3: (...) Pa, along the fibre, across it in the ply, and through the ply
        G12, G13, G23: (...) Pa
        nu12, nu13, nu23: (...) -strain along the second axis for a stress along the first

    Raises:
        ValueError: for neither two nor nine constants, or for constants of which some strain would
            have no energy.

    Examples:
        >>> steel = tb.Material(E=210e9, nu=0.3, rho=7850.0)
        >>> carbon = tb.Material(
        ...     E1=142e9, E2=9.8e9, E3=9.8e9, G12=6e9, G13=6e9, G23=4.8e9,
        ...     nu12=0.3, nu13=0.3, nu23=0.34, rho=1600.0,
        ... )
    """

    E: Value = leaf(0, default=None)
    nu: Value = leaf(0, default=None)
    rho: Value = leaf(0, default=None)
    E1: Value = leaf(0, default=None)
    E2: Value = leaf(0, default=None)
    E3: Value = leaf(0, default=None)
    G12: Value = leaf(0, default=None)
    G13: Value = leaf(0, default=None)
    G23: Value = leaf(0, default=None)
    nu12: Value = leaf(0, default=None)
    nu13: Value = leaf(0, default=None)
    nu23: Value = leaf(0, default=None)

    def __post_init__(self) -> None:
        constants = {name: x for name, x in vars(self).items() if x is not None}
        names = set(constants)
        if names not in ({*ISOTROPIC, "rho"}, {*ORTHOTROPIC, "rho"}):
            raise refusal(
                f"a material with {', '.join(sorted(names)) or 'nothing'}",
                f"E, nu and rho, or {', '.join(ORTHOTROPIC)} and rho",
                are=True,
            )
        dtype, device = common_dtype(*constants.values())
        for name, x in constants.items():
            x = as_tensor(x, dtype, device)
            vars(self)[name] = finite(name, x) if name[:2] == "nu" else positive(name, x)
        broadcast("a material's constants", *(vars(self)[name].shape for name in constants))
        least = torch.linalg.eigvalsh(concrete(self.compliance).detach())[..., 0]
        if (least <= 0).any():
            raise refusal(
                "a material whose elastic energy is not positive",
                "Poisson's ratios within their bounds (isotropic: above -1 and below 0.5)",
                are=True,
            )

    def __repr__(self) -> str:
        names = ISOTROPIC if self.E is not None else ORTHOTROPIC
        numbers = (f"{name} {span(getattr(self, name))}" for name in (*names, "rho"))
        return lines("Material", ", ".join(numbers))

    @property
    def compliance(self) -> Tensor:
        """(..., 6, 6) 1/Pa in the material's axes: strains by stresses 11 22 33 23 13 12."""
        if self.E is not None:
            E, nu = torch.broadcast_tensors(self.E, self.nu)
            moduli, ratios = [E] * 3, [nu] * 3
            shear = [E / (2 * (1 + nu))] * 3
        else:
            values = torch.broadcast_tensors(*(getattr(self, name) for name in ORTHOTROPIC))
            moduli, shear, ratios = values[:3], values[5:2:-1], values[6:]
        a, b, c = (-nu / E for nu, E in zip(ratios, (moduli[0], moduli[0], moduli[1]), strict=True))
        d, o = [1 / x for x in moduli], torch.zeros_like(a)
        normal = torch.stack((d[0], a, b, a, d[1], c, b, c, d[2]), -1).unflatten(-1, (3, 3))
        zero = o[..., None, None].expand(normal.shape)
        slide = torch.diag_embed(torch.stack([1 / x for x in shear], -1))
        return torch.cat((torch.cat((normal, zero), -1), torch.cat((zero, slide), -1)), -2)

    @property
    def stiffness(self) -> Tensor:
        """(..., 6, 6) Pa in the material's axes."""
        return torch.linalg.inv(self.compliance)


def bond(R: Tensor) -> Tensor:
    """(..., 6, 6) by which stresses 11 22 33 23 13 12 turn with R (..., 3, 3), whose columns are
    the old axes in the new ones; a stiffness turns as T Q T^T (Bond 1943).
    """
    i, j = torch.tensor(PAIRS, device=R.device).unbind(-1)
    Ri, Rj = R[..., i, :], R[..., j, :]  # (..., 6, 3): rows of the pairs
    product = Ri[..., i] * Rj[..., j]
    other = Ri[..., j] * Rj[..., i]
    return product + other * (i != j)


def turned(stiffness: Tensor, R: Tensor) -> Tensor:
    """A stiffness (..., 6, 6) Pa in axes in which its own are the columns of R (..., 3, 3)."""
    T = bond(R)
    return T @ stiffness @ T.mT
