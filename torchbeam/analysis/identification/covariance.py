"""Covariance of a fit: held parameters, and degrees of freedom of noise that is found."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ...math.dense import positive_inverse
from ...solvers.least_squares import Found
from . import losses
from .blocks import Blocks, BlockSpread
from .problem import FitProblem


@dataclass(frozen=True)
class Spread:
    """How far coordinates (p,) may be from where a search ended.

    held        (p,) bool: at a bound, and the misfit falls beyond it
    slope       (p,) of half the squares over the noise's variance, there; 0 of those that are free
    covariance  (p, p), row by row: of a parameter that is free with the others, as those that are
                held stay; of one that is held with those that are free, as if it alone were let go
    freedom     (p,) degrees of freedom of each one's deviation;  redundancy (channels,) of the
                noise that is found
    scale       deviation of the noise over the sigma that weighs the data
    white       (p, p) covariance over the variance of weighted noise, were all of it independent;
                zeros of what is held
    blocks      what blocks tell, None where noise has none
    """

    held: Tensor
    slope: Tensor
    covariance: Tensor
    freedom: Tensor
    redundancy: Tensor
    scale: float
    white: Tensor
    blocks: BlockSpread | None = None

    @classmethod
    def of(cls, problem: FitProblem, search: Found, k: int) -> Spread:
        """Where start k ended."""
        (r, J, x), noise = (search.r[k], search.J[k], search.x[k : k + 1]), problem.noise
        pull, bend = (part[0] for part in problem.prior(x)[1:])
        held = problem.region(x).held(x, (J.mT @ r + pull)[None])[0]
        A = J.mT @ J + torch.diag(bend)
        C = _covariance(A, held)
        free = _among(~held & (A.diagonal() > 0), C)
        redundancy = noise.redundancy(J, free, problem.known)
        scale = 1.0
        if not problem.sigma_given:
            redundancy = redundancy.clamp(min=1)
            squares = losses.squares(problem.loss, problem.white.share, r)
            scale = (noise.sums(squares, problem.known) / redundancy).sqrt().item()
        slope = torch.where(held, J.mT @ r + pull, 0) / (scale**2 or 1)
        covariance, freedom = scale**2 * C, _freedom(problem, J, C, free)
        some = (~held & (A.diagonal() > 0)).nonzero()[:, 0]
        square = some[:, None], some
        if problem.loss.any():
            spread = losses.covariance(problem, r, J[:, some], bend[some], scale)
            covariance[square] = scale**2 * spread
        told = None
        if blocks := Blocks.of(problem, r):
            among = torch.eye(len(A), dtype=A.dtype, device=A.device)[some]
            told = blocks.covariance(r, J[:, some], A[square], C[square], scale).moved(among.mT)
            covariance[square], freedom[some] = told.covariance[square], told.freedom(among)
        return cls(held, slope, covariance, freedom, redundancy, scale, free, told)

    @property
    def free(self) -> Tensor:
        """(p, p) covariance with what is held as it is: zeros there."""
        return _among(~self.held, self.covariance)


def half_interval(quantile: Tensor, variance: Tensor, slope: Tensor) -> Tensor:
    """How far (p,) coordinates go until the least squares rise by the squared quantile (p,) of the
    noise's variance: the root d of 2 |slope| d + d^2 / variance = quantile^2.
    """
    return quantile.square() / (
        slope.abs() + (slope.square() + quantile.square() / variance).sqrt()
    )


def _among(some: Tensor, C: Tensor) -> Tensor:
    """C (p, p) of some parameters (p,) bool, zeros elsewhere, where data may tell nothing."""
    return torch.where(some & some[:, None], C, 0)


def _covariance(A: Tensor, held: Tensor) -> Tensor:
    free, C = ~held, torch.zeros_like(A)
    inner = positive_inverse(A[free][:, free])[0] if free.any() else A[free][:, free]
    C[free.nonzero(), free.nonzero()[:, 0]] = inner
    ridge = -A[held][:, free] @ inner  # how the free ones give way
    alone = A.diagonal()[held] + (A[held][:, free] * ridge).sum(-1)
    variance = 1 / torch.maximum(alone, torch.finfo(A.dtype).eps * A.diagonal()[held]).clamp(
        min=torch.finfo(A.dtype).tiny
    )
    C[held.nonzero(), free.nonzero()[:, 0]] = ridge * variance[:, None]
    C[held, held] = variance
    return C


def _freedom(problem: FitProblem, J: Tensor, C: Tensor, free: Tensor) -> Tensor:
    """(p,) by Satterthwaite's formula: 2 V^2 over the variance of V, a parameter's own, to first
    order, the variances of the channels having the inverse information of restricted maximum
    likelihood (Fai and Cornelius 1996, J. Stat. Comput. Simul. 54, 363; Kenward and Roger 1997,
    Biometrics 53, 983). One channel: readings less parameters. Infinite where sigma is known.
    """
    noise, channel = problem.noise, problem.noise.channel[problem.known]
    memory = _of_memory(problem, J, C)
    if not noise.names:
        return 1 / memory
    # (channels, p, p)
    N = torch.stack([J[channel == c].mT @ J[channel == c] for c in range(len(noise.names))])
    share = torch.einsum("ji,cik,jk->cj", C, N, C) / C.diagonal()
    taken = free @ N
    alone = (
        noise.sums(torch.ones_like(J[:, 0]), problem.known)
        - J.new_tensor(noise.fitted)
        - 2 * taken.diagonal(dim1=-2, dim2=-1).sum(-1)
    )
    information = torch.einsum("cij,dji->cd", taken, taken) + torch.diag(alone)
    if len(information) == 1:  # as many parameters as data: one degree is left
        information = information.clamp(min=1)
    freedoms = 1 / (
        torch.einsum("cj,cd,dj->j", share, torch.linalg.inv(information), share) + memory
    )
    # of those that the data tell nothing of
    return torch.where(torch.isfinite(freedoms), freedoms, 1.0)


def _of_memory(problem: FitProblem, J: Tensor, C: Tensor) -> Tensor:
    """(p,) half the squared relative error of variances that correlations of the noise bring in,
    by the information of n steps: n (1 + rho^2)/(1 - rho^2)^2 of rho, -n rho/(1 - rho^2) of rho and
    the logarithm of the variance, n/2 of that; 0 where there are none.
    """
    memory, none = problem.memory, torch.zeros_like(J[0])
    if memory is None:
        return none
    plain, left = problem.white.inverse(J.mT).mT, 1 - memory.rho.square()
    for k, n in enumerate(memory.steps.tolist()):

        def N(rho: Tensor, k: int = k) -> Tensor:
            K = memory.with_(k, rho).in_(problem.white)(plain.mT)
            return K @ K.mT

        step = 1e-3 * left[k]
        by = -(C @ ((N(memory.rho[k] + step) - N(memory.rho[k])) / step) * C).sum(-1)
        by = by / C.diagonal()
        if (problem.noise.channel[problem.known][memory.number == k] < 0).all():
            error = by.square() * left[k].square() / (1 + memory.rho[k].square())
        else:  # the size of the noise is found beside
            error = (by + 2 * memory.rho[k] / left[k]).square() * left[k]
        none = none + error / (2 * max(n, 1))
    return none
