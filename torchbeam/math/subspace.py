"""Eigenvalues by a subspace: the lowest of K x = w^2 M x, both symmetric, by subspace iteration;
the `nearest` to zero of (I + mu A) v = 0, with a real A that is known by its products, by one that
grows by the residuals of the pairs that are looked for, side by side (Davidson 1975).
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from .block_tridiagonal import BlockChain
from .concrete import concrete
from .shapes import broadcast_shapes

EXTRA = 8  # vectors beyond those asked for
SWEEPS = 80
# change of w^2 + shift in a sweep, and what is left of (K + shift M)^-1 M x - x / (w^2 + shift),
# which counts by its square; relative
CONVERGED = {torch.float64: (1e-11, 1e-5), torch.float32: (1e-5, 1e-2)}
SPREAD = 4.0  # of rounding, by the ratio of the projection's largest value to one
FLEXIBLE = 1e3  # times what rounding of K makes of it: a square that is no rigid motion's
COVERING = 100.0  # times the same, of rigid motions: a shift
APART = 4.0  # the lowest square that is no rigid motion's over the shift, and that over growth
NEARLY = 16.0  # a shift that is nearer to the one that is wanted stays


def subspace(
    M: BlockChain, K: BlockChain, shift: Tensor, count: int
) -> tuple[Tensor, Tensor, Tensor] | None:
    """The `count` lowest w^2 and some estimates of the next (..., m), rising, vectors (..., n, m),
    and what rounding of K makes of w^2, see `quadratic_eigen.rounding`; None where they do not
    converge.

    Block inverse iteration of K + shift M, positive definite, with the Rayleigh-Ritz projection
    (Bathe 1971), O(N) a sweep. The shift (...) follows the lowest Rayleigh quotient that is no
    rigid motion's: beside a larger one the slowest motions are all alike. A sample's result
    depends on its neighbours by what is left to converge alone: 1e-11.
    """
    diagonal = K.diagonal
    nodes, k = diagonal.shape[-3], diagonal.shape[-1]
    size = min(2 * count, count + EXTRA)
    batch = broadcast_shapes(diagonal.shape[:-3], M.diagonal.shape[:-3])
    start = torch.cos(torch.arange(nodes * k, dtype=diagonal.dtype, device=diagonal.device)[:, None]
                      * (1 + torch.arange(size, dtype=diagonal.dtype, device=diagonal.device))
                      * 0.7 + 0.3)  # fmt: skip
    MV = M.times(start.unflatten(0, (nodes, k)).expand(*batch, nodes, k, size)).flatten(-3, -2)
    eps = torch.finfo(diagonal.dtype).eps
    entries = eps * K.entries.abs()[..., None]
    change, residual = CONVERGED[diagonal.dtype]
    shift, last = shift.expand(batch), None
    factored = K.plus(shift, M).factored()
    for _ in range(SWEEPS):
        X = factored.solve(MV.unflatten(-2, (nodes, k)))
        MX, X, load = M.times(X).flatten(-3, -2), X.flatten(-3, -2), MV
        stiff, mass = X.mT @ load, X.mT @ MX
        if not concrete(stiff.diagonal(dim1=-2, dim2=-1) > 0).all():
            return None  # not definite but for rounding
        mix, value = _projected(stiff, mass)
        done = torch.tensor(False)
        if last is not None:
            before, V, KV = last
            left = (X - V * before[..., None, :]) * (load - KV * before[..., None, :])
            left = left.sum(-2).abs().sqrt() / before
        V, KV, MV = X @ mix, load @ mix, MX @ mix
        unknown = (entries * V.square()).sum(-2) / value
        square = 1 / value - shift[..., None]
        wanted = _shift(square, unknown, shift)
        if last is not None:
            # of K, by the motion and those mixed with it; of the projection, by the largest
            weighted = unknown * value
            mixed = (weighted * weighted.amax(-1, True)).sqrt()
            spread = SPREAD * eps * value[..., :1] / value
            done = ((value - before).abs() <= value * (weighted + spread).clamp(min=change)) & (
                left <= (mixed + spread).clamp(min=residual)
            )
            done = done[..., :count].all(-1) & (wanted == shift)
        if concrete(done).all():
            return square, V, unknown
        if concrete(wanted != shift).any():
            wanted = torch.where(K.plus(wanted, M).positive_definite(), wanted, shift)
            factored = K.plus(wanted, M).factored()
            KV = KV + (wanted - shift)[..., None, None] * MV
            scale = (1 + (wanted - shift)[..., None] * value).rsqrt()
            V, KV, MV = (x * scale[..., None, :] for x in (V, KV, MV))
            value, shift = value * scale.square(), wanted
        last = value, V, KV
    return None


def _projected(stiff: Tensor, mass: Tensor) -> tuple[Tensor, Tensor]:
    """Vectors v (..., size, size) and values m (..., size), falling, of mass v = m stiff v, with
    v^T stiff v = 1; of symmetric matrices, up to rounding.
    """
    scale = stiff.diagonal(dim1=-2, dim2=-1).rsqrt()
    stiff, mass = (
        scale[..., :, None] * (A + A.mT) / 2 * scale[..., None, :] for A in (stiff, mass)
    )
    axis, turn = torch.linalg.eigh(stiff)
    # directions that coincide count for nothing
    axis = axis.clamp(min=torch.finfo(axis.dtype).eps * axis.shape[-1])
    whiten = turn / axis.sqrt()[..., None, :]
    value, turn = torch.linalg.eigh(whiten.mT @ mass @ whiten)
    value = value.clamp(min=torch.finfo(axis.dtype).eps * value[..., -1:])  # less is rounding
    return scale[..., :, None] * (whiten @ turn).flip(-1), value.flip(-1)


def _shift(square: Tensor, unknown: Tensor, shift: Tensor) -> Tensor:
    """(...) the shift for squares (..., size) that rounding knows to within `unknown`, or the one
    that is there, where it is near to that, or too small where nothing is rigid.
    """
    flexible = square > FLEXIBLE * unknown
    lowest = torch.where(flexible, square, torch.inf).amin(-1) / APART
    covering = torch.where(flexible, 0.0, COVERING * unknown).amax(-1)
    wanted = torch.maximum(torch.where(torch.isfinite(lowest), lowest, 0.0), covering)
    wanted = torch.maximum(wanted, -APART * square.amin(-1))
    small = (shift < wanted / NEARLY) & ~flexible.all(-1)
    return torch.where((shift > NEARLY * wanted) | small, wanted, shift)


KRYLOV = 2  # blocks by A, before the first pairs are looked at
GROWTH = 12  # blocks by residuals, at most
SLACK = 32  # of rounding, relative to the largest 1 / mu, that a residual may be
STUCK = 0.7  # a small one that is not less than this much of the one before is rounding of products


def nearest(
    product: Callable[[Tensor], Tensor], start: Tensor, wanted: Callable[[Tensor], Tensor]
) -> tuple[Tensor, Tensor] | None:
    """Eigenvalues (..., m) and vectors (..., n, m), complex, among them those next to zero; None
    where these do not converge.

    product  A by vectors (..., n, p)
    start    (..., n, p): the subspace begins with what A makes of it
    wanted   eigenvalues (..., m) -> places (..., count) of those that are to converge
    """
    block = product(start)
    basis = image = block[..., :0]
    eps, done, last = torch.finfo(start.dtype).eps, torch.tensor(False), torch.inf
    for step in range(1 + KRYLOV + GROWTH):
        if basis.shape[-1] + block.shape[-1] > block.shape[-2] or not _finite(block):
            return None
        block = _beside(basis, block)
        basis = torch.cat((basis, block), -1)
        image = torch.cat((image, product(block)), -1)
        if step < KRYLOV:
            block = image[..., -block.shape[-1] :]
            continue
        values, vectors = torch.linalg.eig(-basis.mT @ image)
        mu = 1 / values
        chosen = wanted(mu)
        near = vectors.gather(-1, chosen[..., None, :].expand(*vectors.shape[:-1], -1))
        residual = _times(image, near) + (
            values.gather(-1, chosen)[..., None, :] * _times(basis, near)
        )
        size = residual.norm(dim=-2).amax(-1) / values.abs().amax(-1)
        done = done | (size <= SLACK * eps) | ((size > STUCK * last) & (size <= eps**0.5))
        if concrete(done).all():
            return mu, _times(basis, vectors)
        # most pairs are real; of one that is not its two directions come in two steps
        last, block = size, residual.real + residual.imag
        block = block / block.norm(dim=-2, keepdim=True).clamp(min=torch.finfo(block.dtype).tiny)
    return None


def _finite(x: Tensor) -> bool:
    return bool(concrete(torch.isfinite(x)).all())


def _beside(V: Tensor, W: Tensor) -> Tensor:
    """W made orthonormal and orthogonal to V, even of rounding alone: projected twice."""
    for _ in range(2):
        W = torch.linalg.qr(W - V @ (V.mT @ W)).Q
    return W


def _times(A: Tensor, v: Tensor) -> Tensor:
    """A v, A real, v complex."""
    return torch.complex(A @ v.real, A @ v.imag)
