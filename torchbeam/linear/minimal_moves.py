"""Minimal moves: those of the nodes' moves that joints leave free, by which the others follow."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.validation import concrete
from ..math.dense import solve

RANK = {torch.float64: 1e-9, torch.float32: 1e-4}  # of columns of a matrix of rows of norm 1
NEARLY = 0.5  # of the largest pivot: the last of those that are as large is taken


def pivots(G: Tensor, groups: Iterable[Tensor]) -> Tensor:
    """(rank,) places of independent columns of G (..., m, n), the same for all samples: those of
    the first group (n,) bool first, as many as there are, then those of the next.

    Where columns are nearly alike the last is taken, so that rounding does not choose. Raises
    ValueError where samples have different ranks.
    """
    if 0 in G.shape[:-2]:
        raise ValueError(
            f"a structure's batch with the axes {tuple(G.shape[:-2])} was given, without a sample; "
            "one or more are wanted"
        )
    with no_derivatives():
        rest = concrete(G).detach().reshape(-1, *G.shape[-2:])
        norm = torch.linalg.vector_norm(rest, dim=-1, keepdim=True)
        rest, least, chosen = rest / torch.where(norm > 0, norm, 1.0), RANK[G.dtype], []
        for group in groups:
            while len(chosen) < G.shape[-2]:
                size = torch.linalg.vector_norm(rest, dim=-2) * group
                common = size.amin(0)
                if not bool(common.amax() > least):
                    if bool(size.amax() > least**0.5):
                        raise ValueError(
                            "samples whose joints hold different motions were given; one kind is "
                            "wanted"
                        )
                    break
                place = int((common >= NEARLY * common.amax()).nonzero()[-1])
                column = rest[..., place] / size[:, place, None]
                rest = rest - column[..., None] * (column[..., None, :] @ rest)
                rest[..., place] = 0.0
                chosen.append(place)
    return torch.tensor(sorted(chosen), dtype=torch.long, device=G.device)


def others(places: Tensor, count: int) -> Tensor:
    """The numbers below `count` that are not among `places`."""
    left = torch.ones(count, dtype=torch.bool, device=places.device)
    return left.index_fill(0, places, False).nonzero()[:, 0]


def following(G: Tensor, dependent: Tensor) -> Tensor:
    """(..., n, n - m) moves by those not `dependent` (m,), where G (..., m, n) moves = 0."""
    n = G.shape[-1]
    free = others(dependent, n)
    eye = torch.eye(n, dtype=G.dtype, device=G.device)[:, free]
    return eye.expand(*G.shape[:-2], -1, -1).index_copy(
        -2, dependent, -solve(G[..., dependent], G[..., free])
    )
