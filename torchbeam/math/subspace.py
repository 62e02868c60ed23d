"""Subspace iteration: the largest eigenvalues of K^-1 M, both symmetric, K positive definite."""

from __future__ import annotations

import torch
from torch import Tensor

from .block_chain import BlockChain
from .concrete import concrete
from .shapes import broadcast_shapes

EXTRA = 8  # vectors beyond those asked for
SWEEPS, LATE = 40, 8
# change of an eigenvalue in a sweep, relative
CONVERGED = {torch.float64: 1e-11, torch.float32: 1e-5}
STUCK = 0.7  # a change that is not less than this much of the one before, late on, is rounding


def subspace(M: BlockChain, K: BlockChain, count: int) -> tuple[Tensor, Tensor]:
    """The `count` largest eigenvalues (..., count), falling, and vectors (..., n, count) of K^-1 M.

    Block inverse iteration with the Rayleigh-Ritz projection (Bathe 1971), O(N) a sweep. A sample's
    result depends on its neighbours by what is left to converge alone: 1e-11.
    """
    diagonal = K.diagonal
    nodes, k = diagonal.shape[-3], diagonal.shape[-1]
    size = min(2 * count, count + EXTRA)
    batch = broadcast_shapes(diagonal.shape[:-3], M.diagonal.shape[:-3])
    factored = K.factored()
    start = torch.cos(torch.arange(nodes * k, dtype=diagonal.dtype, device=diagonal.device)[:, None]
                      * (1 + torch.arange(size, dtype=diagonal.dtype, device=diagonal.device))
                      * 0.7 + 0.3)  # fmt: skip
    load = M.times(start.unflatten(0, (nodes, k)).expand(*batch, nodes, k, size))
    value = last = None
    for sweep in range(SWEEPS):
        X = factored.solve(load)
        MX = M.times(X)
        flat, flat_load, flat_mass = (x.flatten(-3, -2) for x in (X, load, MX))
        stiff, mass = flat.mT @ flat_load, flat.mT @ flat_mass
        scale = stiff.diagonal(dim1=-2, dim2=-1).rsqrt()
        stiff, mass = (
            scale[..., :, None] * (A + A.mT) / 2 * scale[..., None, :] for A in (stiff, mass)
        )
        axis, turn = torch.linalg.eigh(stiff)
        # directions that coincide count for nothing
        axis = axis.clamp(min=torch.finfo(axis.dtype).eps * size)
        whiten = turn / axis.sqrt()[..., None, :]
        new, turn = torch.linalg.eigh(whiten.mT @ mass @ whiten)
        mix = scale[..., :, None] * (whiten @ turn).flip(-1)
        new, before = new.flip(-1), value
        value, load, vectors = new, MX @ mix[..., None, :, :], flat @ mix
        if before is not None:
            change = concrete((value - before)[..., :count].abs() / value[..., :count]).amax()
            if change <= CONVERGED[value.dtype] or (sweep >= LATE and change > STUCK * last):
                break
            last = change
    return value[..., :count], vectors[..., :count]
