"""Compliance of elements: what their ends show of that of their sections, with the bending within
an element, and which strains it excludes.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..scene.beam import Beam
from ..scene.taper import residual_bending

# of the flexibility around it: a strain's least, in a tangent
REGULARISATION = {torch.float64: 1e-7, torch.float32: 1e-3}


def impossible(beam: Beam) -> tuple[bool, ...]:
    """Which of an element's strains are impossible. With linked interpolation, or a taper, an
    element shears as well by bending.
    """
    extension, shear_y, shear_z, twist, bending_y, bending_z = beam.rigid
    if beam.linked_interpolation or beam.taper is not None:
        shear_y, shear_z = shear_y and bending_z, shear_z and bending_y
    return extension, shear_y, shear_z, twist, bending_y, bending_z


def coupled(beam: Beam) -> bool:
    """Whether an element's compliance has more than its diagonal."""
    return beam.coupled or beam.taper is not None


def element_compliance(beam: Beam) -> Tensor:
    """S (..., N or 1, 6, 6) that the ends of elements show."""
    if beam.taper is None:
        return with_residual_bending(beam, beam.compliance)
    return beam.compliance + beam.taper[..., int(beam.linked_interpolation), :, :]


def with_residual_bending(beam: Beam, flexibility: Tensor) -> Tensor:
    """A flexibility (..., N or 1, 6, 6) of sections as that of elements: with linked interpolation
    a force F also bends an element by M' = -e1 x F, which its ends show as shear (MacNeal 1978:
    residual bending flexibility):

        S_FF + h^2/12 ~e1^T S_MM ~e1
    """
    return (
        flexibility + residual_bending(flexibility, beam.length)
        if beam.linked_interpolation
        else flexibility
    )


def section_share(beam: Beam, flexibility: Tensor) -> Tensor | None:
    """(..., N or 1, 6): which part of an element's flexibilities is its section's; None = all."""
    if not beam.linked_interpolation:
        return None
    section, whole = (x.diagonal(dim1=-2, dim2=-1) for x in (beam.compliance, flexibility))
    return torch.where(whole > 0, section / torch.where(whole > 0, whole, 1.0), 1.0)


def without_residual_bending(beam: Beam, strain: Tensor, elements: slice = slice(None)) -> Tensor:
    """The strain (..., n, 6) of sections in elements' middles with this one, less eigenstrain."""
    if not beam.linked_interpolation and beam.taper is None:
        return strain
    S = element_compliance(beam)
    part = ((S - beam.compliance) @ regular_inverse(beam, S))[..., elements, :, :]
    return strain - (part @ strain[..., None])[..., 0]


def regular_inverse(beam: Beam, S: Tensor, resistance: Tensor | None = None) -> Tensor:
    """S^-1; a strain that S makes impossible gets a flexibility that is small beside the others,
    for the tangent only; where all are impossible, beside that of a resistance (...) N m/rad to
    turns.
    """
    if not any(impossible(beam)):
        return torch.linalg.inv(S)
    rigid = torch.tensor(impossible(beam), device=S.device)
    L = beam.length.sum(-1)[..., None, None]
    # (..., 1, 6)
    scale = torch.cat((L.expand(*L.shape[:-1], 3), torch.ones_like(L).expand(*L.shape[:-1], 3)), -1)
    diagonal = S.diagonal(dim1=-2, dim2=-1)
    # flexibility of a bending or twist, 1/(N m^2)
    largest = (diagonal / scale**2).amax(-1, keepdim=True).detach()
    if resistance is None:
        alone = torch.ones_like(L)
    else:
        alone = (resistance[..., None, None] * L).reciprocal()
    largest = torch.where(largest > 0, largest, alone.detach())
    small = REGULARISATION[S.dtype] * largest * scale.detach() ** 2
    return torch.linalg.inv(
        S + torch.diag_embed(torch.where(rigid & (diagonal == 0), small, torch.zeros_like(small)))
    )
