"""Parametric bootstrap: fits of data that the fitted model and noise make."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.special import ndtr, ndtri

from ...core.arguments import count, level_of
from ...math.distributions import student_quantile
from ...solvers.least_squares import search
from ...uncertainty.estimate import between
from .problem import FitProblem
from .transform import Transform

ITERATIONS = 25
TOLERANCE = 1e-6  # of a step
NEGLIGIBLE = 1e-4  # decrease of the squares over the noise's: a step of a hundredth of a deviation


@dataclass(frozen=True)
class Bootstrap:
    """theta (repeats, p) and status (repeats,) of the repeats, 0 = converged; x (repeats, p) their
    coordinates, x_fit (p,) the fit's.
    """

    theta: Tensor
    status: Tensor
    x: Tensor
    x_fit: Tensor
    transform: Transform

    def interval(self, level: float = 0.95) -> Tensor:
        """(p, 2): bias-corrected percentiles of the repeats (Efron and Tibshirani 1993, 14.3,
        without acceleration: normal noise of a known size has none), the same by whatever function
        of the parameters. A share of R repeats is at place (R + 1) times it in their order (Davison
        and Hinkley 1997, 5.2). One that has not converged counts where it is: those that ran away
        are the outermost.
        """
        x, tail = self.x, (1 - level_of("level", level)) / 2
        if len(x) < 2 / tail:
            raise ValueError(
                f"{len(x)} repeats are too few for a level of {level:g}; {int(2 / tail) + 1} or "
                "more are wanted"
            )
        least = 1 / (len(x) + 1)
        bias = ndtri((x < self.x_fit).to(x).mean(0).clamp(least, 1 - least))
        ends = [
            between(x.sort(0).values, ((len(x) + 1) * share - 1).clamp(0, len(x) - 1))
            for share in (ndtr(2 * bias + student_quantile(t, math.inf)) for t in (tail, 1 - tail))
        ]
        return torch.stack([self.transform.theta(end) for end in ends], -1)


def bootstrap(
    problem: FitProblem,
    x: Tensor,
    held: Tensor,
    scale: float,
    redundancy: Tensor,
    repeats: int,
    seed: int,
) -> Bootstrap:
    """Fits of `repeats` sets of data, from the fit's coordinates x (p,); those that are `held` (p,)
    bool stay. The noise on weighted data is of `scale`; where its size was found, of one that is
    drawn for each repeat as the fit knows it, by `redundancy` (channels,): scale
    sqrt(n / chi^2 of n degrees), so that the repeats of a linear model have Student's t.
    """
    repeats, seed = count("repeats", repeats, least=2), count("seed", seed, least=0)
    with torch.no_grad():
        starts = x.expand(repeats, -1).clone()
        every = torch.zeros(1, dtype=torch.long, device=x.device)
        r, J = problem.linearised(x[None], every)
        random = torch.Generator(device=x.device).manual_seed(seed)
        noise = scale * torch.randn(
            repeats, r.shape[1], generator=random, dtype=x.dtype, device=x.device
        )
        if len(redundancy):
            n = redundancy.numpy(force=True)
            size = np.sqrt(n / np.random.default_rng(seed).chisquare(n, (repeats, len(n))))
            noise = noise * problem.noise.each(torch.as_tensor(size).to(x))[:, problem.known]
        repeated = replace(problem, target=r + problem.target + noise)
        region, known = repeated.region(starts).holding(held), (-noise, J.expand(repeats, -1, -1))
        few = dict(known=known, negligible=NEGLIGIBLE * scale**2)
        fits = search(repeated, starts, region, ITERATIONS, TOLERANCE, **few)
    transform = problem.parameters.transform
    return Bootstrap(transform.theta(fits.x), fits.status, fits.x, x, transform)
