"""Elements that neither shear nor bend, and which of a section's strains say so."""

from __future__ import annotations

from torch import Tensor

from ..core.validation import concrete
from ..scene.beam import Beam
from .coordinates.spatial import Spatial

EXTENSION, TWIST = 0, 3  # of strains, in a plane and in space; the others are across the beam


def impossible_strains(beam: Beam) -> Tensor | None:
    """(..., stations or 1, 6), 1 where a section's strain is impossible, else 0; None = no section
    has the shear and the bending across one axis impossible both.
    """
    if not any(map(all, (beam.rigid[1:6:4], beam.rigid[2:5:2]))):
        return None
    return (beam.compliance.diagonal(dim1=-2, dim2=-1) == 0).to(beam.length)


def rigid_elements(impossible: Tensor | None, beam: Beam, space: Spatial) -> Tensor | None:
    """(..., elements or 1, 1) bool: which neither shear nor bend; None = none do not."""
    if impossible is None:
        return None
    strains = space.project_diagonal(impossible)
    across = [k for k in range(space.dims.strain) if k not in (EXTENSION, TWIST)]
    rigid = (strains[..., across] > 0).all(-1)
    if not concrete(rigid).any():
        return None
    if rigid.shape[-1] > 1:
        rigid = rigid.unflatten(-1, (-1, beam.order)).all(-1)
    return rigid[..., None]
