"""Arms that relax in small motions: what their dashpots have crept by are internal states, behind
those of loads.

With R the rows of the elements' strains by the nodes' moves, of each strain and arm

    q' = (R a - q)/tau        the nodes are pushed by h R^T C g q

beside the instantaneous stiffness h R^T C R, which is in K. Of moves a = V b, arms of one time
creep within the strains R V alone: q = R V y with y' = (b - y)/tau, without loss.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..math.block_matrices import block_diagonal
from ..math.shapes import broadcast_shapes
from ..nodal.constitutive_law import times
from ..nodal.loads import Lags
from ..nodal.model import Model

DEPENDENT = 1e-6  # of the largest strains


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
    of_arms = Lags(L.mT, G, H, none, none)
    return of_arms if lags is None else _both(lags, of_arms)


def reduced_arms(H: Tensor, G: Tensor) -> tuple[Tensor, Tensor]:
    """What arms have crept by, q = right y, y = left q, of few moves: q' = H b + G q (..., Z, c)
    and (..., Z, Z) by these. One y for each move and time; where the strains of arms of a time are
    dependent, as of bending moves in torsion, all q of that time; all of them where arms act on
    each other, by turns without inertia.
    """
    rates = G.diagonal(dim1=-2, dim2=-1)
    if (G.detach() != torch.diag_embed(rates.detach())).any():
        eye = torch.eye(G.shape[-1], dtype=H.dtype, device=H.device).expand_as(G)
        return eye, eye
    strains, count = -H / rates[..., None], H.shape[-1]
    _, time = torch.unique(rates.detach().reshape(-1, rates.shape[-1]), dim=-1, return_inverse=True)
    rights, lefts = [], []
    for k in range(int(time.max()) + 1):
        at = (time == k).nonzero()[:, 0]
        part = strains[..., at, :]
        sizes = torch.linalg.svdvals(part.detach())
        eye = torch.eye(len(at), dtype=H.dtype, device=H.device).expand(*H.shape[:-2], -1, -1)
        if len(at) > count and (sizes[..., -1] > DEPENDENT * sizes[..., 0]).all():
            Q, R = torch.linalg.qr(part)
            right, left = part, torch.linalg.solve_triangular(R, Q.mT, upper=True)
        else:
            right = left = eye
        none = H.new_zeros(*H.shape[:-2], H.shape[-2], right.shape[-1])
        rights.append(none.index_copy(-2, at, right))
        lefts.append(none.mT.index_copy(-1, at, left))
    return torch.cat(rights, -1), torch.cat(lefts, -2)


def _both(first: Lags, second: Lags) -> Lags:
    """States of the one before those of the other."""
    lead = broadcast_shapes(*(x.shape[:-2] for x in (*first, *second)))
    first, second = (
        Lags(*(x.expand(*lead, *x.shape[-2:]) for x in part)) for part in (first, second)
    )
    rates = (torch.cat(pair, -2) for pair in zip(first[2:], second[2:], strict=True))
    G = block_diagonal(first.G, second.G)
    return Lags(torch.cat((first.L, second.L), -1), G, *rates)
