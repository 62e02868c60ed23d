"""Elements that neither stretch, shear nor bend, and which of a section's strains say so."""

from __future__ import annotations

from torch import Tensor

from ..core.validation import concrete
from ..scene.beam import Beam
from .coordinates.spatial import Spatial

TWIST = 3  # of strains, in space


def impossible_strains(beam: Beam) -> Tensor | None:
    """(..., stations or 1, 6), 1 where a section's strain is impossible, else 0; None = no section
    has stretch, and the shear and the bending across one axis, impossible.
    """
    if not (beam.rigid[0] and any(map(all, (beam.rigid[1:6:4], beam.rigid[2:5:2])))):
        return None
    return (beam.compliance.diagonal(dim1=-2, dim2=-1) == 0).to(beam.length)


def rigid_elements(impossible: Tensor | None, beam: Beam, space: Spatial) -> Tensor | None:
    """(..., elements or 1, 1) bool: which neither stretch, shear nor bend; None = all do."""
    if impossible is None:
        return None
    strains = space.project_diagonal(impossible)
    others = [k for k in range(space.dims.strain) if k != TWIST]
    rigid = (strains[..., others] > 0).all(-1)
    if not concrete(rigid).any():
        return None
    if rigid.shape[-1] > 1:
        rigid = rigid.unflatten(-1, (-1, beam.order)).all(-1)
    return rigid[..., None]
