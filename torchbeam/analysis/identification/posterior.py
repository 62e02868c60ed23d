"""Posterior of fields: samples of the linearised model, weights, noise and sharp rows."""

from __future__ import annotations

import torch
from torch import Tensor

from ...math.dense import cholesky_unchecked
from .regularization import DECADES, Linearised

CHAINS, BURN_IN, KEPT = 64, 100, 100
SEED = 0
NONE = 1e-4  # variance over the first one that is as good as none


def samples(
    problem: Linearised, weight: Tensor, sigma: float, sharp: list[bool], free: bool, known: bool
) -> Tensor:
    """Coordinates (CHAINS * KEPT, p), by Gibbs sampling (Gelfand and Smith 1990, JASA 85, 398) from
    `weight` (fields,) on: each of these is drawn by the others in turn

    - the coordinates: normal, as the model is linear
    - factors of the rows of `sharp` fields: Student's t is a normal law of which the precision has
      a gamma law (Andrews and Mallows 1974, JRSS B 36, 99)
    - weights, where they are `free`: gamma, with a prior that is flat in the rows' deviation
      (Gelman 2006, Bayesian Analysis 1, 515); and that deviation once more with the rows over it as
      they are, by which it is normal: one of both moves far where the other does not (interweaving;
      Yu and Meng 2011, J. Comput. Graph. Stat. 20, 531)
    - the noise, where it is not `known`, of `sigma` at first: the prior is flat in its logarithm
    """
    x, J = problem.x, problem.J
    random = torch.Generator(device=x.device).manual_seed(SEED)

    def normal(*shape: int) -> Tensor:
        return torch.randn(CHAINS, *shape, generator=random, dtype=x.dtype, device=x.device)

    def chi_squared(freedom: int) -> Tensor:
        return normal(freedom).square().sum(-1)

    data, pull, left = J.mT @ J, J.mT @ problem.r, problem.r.square().sum()
    weights, variance = weight.to(x).expand(CHAINS, -1).clone(), x.new_full((CHAINS,), sigma**2)
    factors = [x.new_ones(CHAINS, len(L)) for L in problem.L]
    fields = [*zip(problem.L, problem.target, map(torch.linalg.pinv, problem.L), strict=True)]
    stiffest = problem.balance * 10 ** DECADES[1]
    drawn = []
    for k in range(BURN_IN + KEPT):
        A = data / variance[:, None, None] + torch.diag(problem.other)
        towards = -pull / variance[:, None] - problem.pull
        for j, (L, target, _) in enumerate(fields):
            rows = (weights[:, j, None] * factors[j])[..., None] * L
            A = A + L.mT @ rows
            towards = towards - (rows.mT @ (L @ x - target)[:, None])[..., 0]
        step = _normal(A, towards, normal(len(x)))
        for j, (L, target, inverse) in enumerate(fields):
            d = (x + step) @ L.mT - target
            if sharp[j]:
                factors[j] = normal(len(L), 2).square().sum(-1) / (
                    1 + weights[:, j, None] * d.square()
                )
            if free:
                weights[:, j] = chi_squared(max(len(L) - 1, 1)) / (factors[j] * d.square()).sum(-1)
                along = d @ inverse.mT
                ahead = (along @ data) / variance[:, None] + along * problem.other
                down = (ahead * step).sum(-1) + (
                    along * (pull / variance[:, None] + problem.pull)
                ).sum(-1)
                bend = (ahead * along).sum(-1).sqrt()
                more = (normal() - down / bend) / bend
                weights[:, j] = torch.minimum(
                    weights[:, j] / (1 + more).square(), stiffest[j] / variance
                )
                step = step + more[:, None] * along
        if k >= BURN_IN:
            drawn.append(x + step)
        if not known:
            misfit = left + 2 * step @ pull + ((step @ data) * step).sum(-1)
            variance = (misfit / chi_squared(len(problem.r))).clamp(min=NONE * sigma**2)
    return torch.cat(drawn)


def _normal(A: Tensor, towards: Tensor, z: Tensor) -> Tensor:
    """Draws (chains, p) of the normal law of mean A^-1 towards and covariance A^-1, from z."""
    size = A.diagonal(dim1=-2, dim2=-1).rsqrt()
    scaled = size[:, :, None] * A * size[:, None] + 8 * torch.finfo(A.dtype).eps * torch.eye(
        A.shape[-1]
    ).to(A)
    root = cholesky_unchecked(scaled)
    half = torch.linalg.solve_triangular(root, (size * towards)[..., None], upper=False)
    return size * torch.linalg.solve_triangular(root.mT, half + z[..., None], upper=True)[..., 0]
