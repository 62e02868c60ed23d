"""Arms that relax in small motions: what their dashpots have crept by are internal states, behind
those of loads.

With R the rows of the elements' strains by the nodes' moves, of each strain and arm

    q' = (R a - q)/tau        the nodes are pushed by h R^T C g q

beside the instantaneous stiffness h R^T C R, which is in K.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..math.shapes import broadcast_shapes
from ..nodal.constitutive_law import times
from ..nodal.loads import Lags
from ..nodal.model import Model


def with_arms(model: Model, B: Tensor, lags: Lags | None) -> Lags | None:
    """`lags` of loads with those of a model's arms; B (..., N, k, p + 2 s): the strain operator."""
    arms = model.law.arms
    if arms is None:
        return lags
    w, nodes = model.space.unknowns, model.node_count
    eye = torch.eye(w * nodes, dtype=B.dtype, device=B.device).unflatten(-1, (nodes, w))
    moves = model.assembly.to_elements(eye)  # (w (N+1), N, p + 2 s)

    def rows(operator: Tensor) -> Tensor:
        """(..., N, 1, k, w (N+1))"""
        return torch.einsum("...eij,mej->...eim", operator, moves)[..., None, :, :]

    shares, tau = (x.mT[..., None] for x in (arms.shares, arms.times))  # (..., N, m, k, 1)
    L = shares * rows(times(model.law.C, model.length[..., None] * B))
    H = rows(B) / tau
    shape = torch.Size((*B.shape[-3:-2], arms.count, B.shape[-2]))
    lead = broadcast_shapes(L.shape[:-4], H.shape[:-4])
    L, H = (x.expand(*lead, *shape, x.shape[-1]).flatten(-4, -2) for x in (L, H))
    G = torch.diag_embed((-1 / tau[..., 0]).expand(*lead, *shape).flatten(-3))
    none = torch.zeros_like(H)
    own = Lags(L.mT, G, H, none, none)
    return own if lags is None else _both(lags, own)


def _both(first: Lags, second: Lags) -> Lags:
    """States of the one before those of the other."""
    lead = broadcast_shapes(*(x.shape[:-2] for x in (*first, *second)))
    first, second = (
        Lags(*(x.expand(*lead, *x.shape[-2:]) for x in part)) for part in (first, second)
    )
    rates = (torch.cat(pair, -2) for pair in zip(first[2:], second[2:], strict=True))
    a, b = first.G, second.G
    upper = torch.cat((a, a.new_zeros(*lead, a.shape[-1], b.shape[-1])), -1)
    lower = torch.cat((b.new_zeros(*lead, b.shape[-1], a.shape[-1]), b), -1)
    return Lags(torch.cat((first.L, second.L), -1), torch.cat((upper, lower), -2), *rates)
