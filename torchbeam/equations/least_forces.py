"""Forces that a balance is measured against where nothing else acts."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ..nodal import loads as external
from ..nodal.conditions import Conditions
from ..nodal.constitutive_law import times
from ..nodal.loads import Nodes
from ..nodal.model import Model
from ..state.state import rest


def least_forces(
    model: Model, C: Tensor, conditions: Callable[[], Conditions]
) -> tuple[Tensor, ...]:
    """Forces N and moments N m (..., n, *), of which p are forces, that a balance is measured
    against where nothing else acts: the stress of rounding, efforts between nodes, which what
    resists there may balance by itself, and the dead loads that what a body touches may.
    """
    terms = [rounding_stress(model, C)]
    if not (model.interactions or model.bodies_touch):
        return tuple(terms)
    now = conditions()
    efforts = [interaction.efforts(now) for interaction in model.interactions]
    terms += [effort for effort in efforts if effort is not None]
    if model.bodies_touch:
        drawn = model.space.to_reduced(rest(model.scene))
        nodes = Nodes(drawn.position, drawn.rotation, frame=drawn.frame)
        dead = external.external(model, nodes, now, now.still)
        terms += [] if isinstance(dead, float) else [dead]
    return tuple(terms)


def rounding_stress(model: Model, C: Tensor) -> Tensor:
    """(..., N, k) N and N m, the stress of strains that are rounding alone, in differences of
    places over an element; C of the tangent.
    """
    p, h = model.space.dims.position, model.length.detach()
    eps = torch.finfo(h.dtype).eps
    strain = torch.cat(
        (
            torch.full_like(h, eps).expand(*h.shape[:-1], p),
            (eps / h).expand(*h.shape[:-1], C.shape[-2] - p),
        ),
        -1,
    )
    return times(C.abs(), strain[..., None])[..., 0]
