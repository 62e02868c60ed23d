"""Residuals of a fit against noise: their size, their correlation from reading to reading, the
largest line among them, and outliers.

Of a model that is right, and linear as far as the noise reaches, residuals over sigma are M e: e is
noise of unit deviation, and M = 1 - J C J^T what the parameters, fitted with it, leave of it (J
derivatives, C the covariance of the parameters). All probabilities here are of such residuals, so
that parameters which take a trend or a line away raise no alarm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ...math.distributions import beta_probability, normal_probability
from .spectrum import Spectrum

FEWEST = 20  # degrees of freedom of a series that is tested for its order
LAGS = 10
# a sum of squared correlations of n readings has the tail of F with n/2 + HEAVY second degrees of
# freedom, or a
HEAVY = 15
#             lighter one: counted to 1e-3 in 200,000 series of noise of 20, 40 and 100 readings,
#                 50,000 of 400
MEDIAN = 0.6745  # of the size of normal noise of unit deviation
OUTLIER = 4.0  # deviations, by the median, beyond which a residual is called one
DETERMINED = 1e-3  # of a line's squares that the parameters leave, below which it is theirs


@dataclass(frozen=True)
class ResidualTest:
    """Probability that a channel's residuals are noise; `size` and `at` go into a sentence."""

    name: str
    probability: float
    size: float
    at: str = ""


@dataclass(frozen=True)
class Residuals:
    """Residuals of one channel, or of all, and what the parameters take from them.

    times    (n,) in order, regular or not; None: they are counted
    r, J, C  residuals (n,) over sigma, their derivatives (n, p), covariance (p, p) of the
             parameters over such noise
    known    sigma is that of the noise; else one factor of it is not known
    """

    name: str
    times: Tensor | None
    r: Tensor
    J: Tensor
    C: Tensor
    known: bool

    @property
    def left(self) -> float:
        """Trace of M: squares that noise leaves on average."""
        return len(self.r) - (self.C * (self.J.mT @ self.J)).sum().item()

    @property
    def freedom(self) -> float:
        """Degrees of freedom of chi squared with this mean and variance (Satterthwaite 1946)."""
        taken = self.C @ (self.J.mT @ self.J)
        return self.left**2 / max(
            len(self.r) - 2 * taken.trace().item() + (taken * taken.mT).sum().item(), 1e-9
        )

    @property
    def variance(self) -> float:
        """Of the noise over sigma: by the residuals, but no less than sigma says."""
        variance = self.r.square().sum().item() / self.left
        return max(variance, 1.0) if self.known else variance

    def excess(self) -> ResidualTest:
        """More squares than sigma allows: `size` is their root over that of noise."""
        ratio, half = self.r.square().sum().item() / self.left, self.freedom / 2
        tail = torch.special.gammaincc(
            *torch.tensor((half, half * ratio), dtype=torch.float64)
        ).item()
        return ResidualTest(self.name, tail, math.sqrt(ratio))

    def correlation(self) -> ResidualTest:
        """Ljung's and Box's sum (1978, Biometrika 65, 297) over lags, of squared correlations less
        their means under noise, over their variances there, which are exact where M is a
        projection; `size` is the largest correlation.
        """
        n, lags, left = len(self.r), range(1, min(LAGS, len(self.r) // 5) + 1), self.left
        # A J of each lag, whose correlation is r A r
        moved = [_neighbours(self.J, lag) for lag in lags]
        inner = [self.C @ (self.J.mT @ B) for B in moved]
        mean = -torch.stack([G.trace() for G in inner])
        pairs = list(zip(inner, moved, strict=True))
        both = [
            [(G * H.mT).sum() - 2 * (self.C * (A.mT @ B)).sum() for H, B in pairs] for G, A in pairs
        ]
        both = torch.stack([torch.stack(row) for row in both])
        both = both + torch.diag(mean.new_tensor([(n - lag) / 2 for lag in lags]))
        outer = mean[:, None] * mean
        covariance = (outer + 2 * both) / (
            self.freedom * (self.freedom + 2)
        ) - outer / self.freedom**2
        correlation = torch.stack([self.r @ _neighbours(self.r, lag) for lag in lags]) / (
            self.variance * left
        )
        off = (correlation - mean / left) / covariance.diagonal().sqrt()
        alike = covariance / covariance.diagonal().outer(covariance.diagonal()).sqrt()
        first, second = len(off) ** 2 / alike.square().sum().item(), self.freedom / 2 + HEAVY
        ratio = off.square().mean().item()
        tail = beta_probability(second / (second + first * ratio), second / 2, first / 2)
        return ResidualTest(self.name, tail, correlation[off.abs().argmax()].item())

    def outliers(self) -> ResidualTest:
        """Residuals that are too far off for normal noise: the largest (Grubbs 1950, Ann. Math.
        Stat. 21, 27), or many, by their fourth moment (Anscombe and Glynn 1983, Biometrika 70,
        227). `size` is the largest, in deviations by the median, and `at` says how many there are.
        """
        leverage = ((self.J @ self.C) * self.J).sum(-1).clamp(max=1 - 1e-9)
        r = (self.r.square() / (1 - leverage)).sqrt()
        size = r / (r.median() / MEDIAN)
        far, n, left = int((size > OUTLIER).sum()), len(r), self.left
        if not 0 < far < n / 2 or left < 3 or not torch.isfinite(size).all():
            return ResidualTest(self.name, 1.0, 0.0)
        share = min((r.max().square() / self.r.square().sum()).item(), 1.0)
        tail = n * beta_probability(1 - share, (left - 1) / 2, 0.5)
        if n >= FEWEST:
            tail = 2 * min(tail, _heavy_tailed(n * (r**4).sum() / r.square().sum() ** 2, n))
        return ResidualTest(self.name, min(tail, 1.0), size.max().item(), f"{far} of {n}")

    def line(self) -> ResidualTest:
        """The largest line of the periodogram: by how much a cosine and a sine beside the
        parameters make the squares fall, over what they do of noise on average (`size`).
        Frequencies go from that of the whole time to one in two readings, two for each that is
        independent. (Fisher 1929, Proc. R. Soc. A 125, 54; of irregular times Scargle 1982,
        Astrophys. J. 263, 835.)
        """
        n, spectrum = len(self.r), Spectrum.of(self.times, self.r)
        if spectrum is None:
            return ResidualTest(self.name, 1.0, 0.0)
        transform = spectrum.transform
        r, D = transform(self.r), transform(torch.ones_like(self.r), double=True)
        W = D.new_zeros(len(D), self.J.shape[1])
        for k, column in enumerate(self.J.unbind(-1)):
            W[:, k] = transform(column)
        cos, sin = W.real @ self.C, W.imag @ self.C
        cc = (n + D.real) / 2 - (cos * W.real).sum(-1)
        ss = (n - D.real) / 2 - (sin * W.imag).sum(-1)
        cs = D.imag / 2 - (cos * W.imag).sum(-1)  # of the cosine and minus the sine
        area = cc * ss - cs.square()
        fall = (ss * r.real.square() - 2 * cs * r.real * r.imag + cc * r.imag.square()) / area
        fall = torch.where(area > DETERMINED * n**2 / 4, fall, 0) / self.variance
        k = int(fall.argmax())
        share = min(fall[k].item() / self.left, 1 - 1e-12)
        tail = len(fall) * math.exp((self.freedom / 2 - 1) * math.log1p(-share))
        period = spectrum.period(k)
        at = (
            f"of {period:.3g} readings a period"
            if self.times is None
            else f"at {1 / period:.4g} Hz"
        )
        return ResidualTest(self.name, min(tail, 1.0), fall[k].item() / 2, at)


def _heavy_tailed(kurtosis: Tensor, n: int) -> float:
    """Probability that n normal numbers have this kurtosis or more (Anscombe and Glynn 1983)."""
    variance = 24 * n * (n - 2) * (n - 3) / ((n + 1) ** 2 * (n + 3) * (n + 5))
    x = (kurtosis - 3 * (n - 1) / (n + 1)) / math.sqrt(variance)
    skew = 6 * (n * n - 5 * n + 2) / ((n + 7) * (n + 9))
    skew *= math.sqrt(6 * (n + 3) * (n + 5) / (n * (n - 2) * (n - 3)))
    a = 6 + 8 / skew * (2 / skew + math.sqrt(1 + 4 / skew**2))
    cube = (1 - 2 / a) / (1 + x * math.sqrt(2 / (a - 4)))
    root = cube.abs() ** (1 / 3) * cube.sign()
    return normal_probability(-(1 - 2 / (9 * a) - root) / math.sqrt(2 / (9 * a))).item()


def _neighbours(values: Tensor, lag: int) -> Tensor:
    """Mean of the two values (n, ...) that are `lag` before and after each; 0 beyond the ends."""
    sums = torch.zeros_like(values)
    sums[lag:] += values[:-lag] / 2
    sums[:-lag] += values[lag:] / 2
    return sums
