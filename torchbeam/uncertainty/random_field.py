"""Random fields along a beam, by the Karhunen-Loeve expansion."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..core.arguments import choice, count
from ..core.validation import Value, converted, finite, refusal
from .parametric_laws import plain_number, set_fields

KERNELS = ("exponential", "gaussian")
MARGINALS = ("lognormal", "normal")
LOST = 0.01  # share of the variance that the terms which are left out would have


@dataclass(frozen=True)
class RandomField:
    """Law of a quantity that varies along the beam, at places s. Each place is a column of theta.

    Args:
        s: (m,) m, places such as the middles of elements, increasing
        mean, deviation: of the quantity, the same everywhere
        correlation_length: c, m: the correlation at a distance r is exp(-r/c) ("exponential":
            rough, no slope) or exp(-(r/c)^2) ("gaussian": smooth). A lognormal field has this
            correlation of its logarithm
        marginal: "lognormal" (positive) or "normal"
        terms: number of terms of the expansion; None: enough for 99 % of the variance, on average
            over the length

    At s a normal field is mean + deviation sum_k sqrt(lambda_k) phi_k(s) z_k, with independent
    standard normal z. lambda and phi are the eigenvalues and eigenfunctions of the correlation on
    [s_0, s_m] (Loeve 1978; Ghanem and Spanos 1991, section 2.3). They come from Gauss-Legendre
    quadrature and Nystrom's interpolation. Truncation reduces the deviation a little, not the mean:
    `captured` (m,) is the share of the variance that remains at each place.

    Examples:
        >>> E = tb.laws.RandomField(
        ...     torch.linspace(0, 1, 8), mean=1.0, deviation=0.1, correlation_length=0.3
        ... )
        >>> tb.monte_carlo(lambda E: E, {"E": E}, 256, by_name=True).y.shape  # along the beam
        torch.Size([256, 8])
    """

    s: Value
    mean: float
    deviation: float
    correlation_length: float
    kernel: str = "exponential"
    marginal: str = "lognormal"
    terms: int | None = None

    def __post_init__(self) -> None:
        s = finite("RandomField's s", converted(self.s, torch.float64)).cpu()
        if s.ndim != 1 or len(s) < 2 or not (s[1:] > s[:-1]).all():
            raise ValueError(
                f"RandomField's s {tuple(s.shape)} was given; (m,) increasing places, at least "
                "two, are wanted"
            )
        numbers = ("mean", "deviation", "correlation_length")
        values = {n: plain_number(f"RandomField's {n}", getattr(self, n)) for n in numbers}
        set_fields(self, s=s, **values)
        choice("RandomField's kernel", self.kernel, KERNELS)
        choice("RandomField's marginal", self.marginal, MARGINALS)
        for name in numbers if self.marginal == "lognormal" else numbers[1:]:
            if not values[name] > 0:
                raise refusal(f"RandomField's {name} = {values[name]:g}", "a positive number")
        eigenvalue, shape = self._expansion(
            None if self.terms is None else count("RandomField's terms", self.terms)
        )
        set_fields(self, eigenvalue=eigenvalue, shape=shape, terms=len(eigenvalue))

    @property
    def size(self) -> int:
        """Columns of theta."""
        return len(self.s)

    @property
    def dimension(self) -> int:
        """Normal scores that a sample takes."""
        return len(self.eigenvalue)

    @property
    def captured(self) -> Tensor:
        """Share (m,) of the variance (of a lognormal field's logarithm) that the terms hold."""
        return (self.shape.square() * self.eigenvalue).sum(-1)

    def of_scores(self, z: Tensor) -> Tensor:
        """Values (N, m) of normal scores z (N, terms)."""
        field = z @ (self.shape * self.eigenvalue.sqrt()).mT.to(z.dtype)
        if self.marginal == "normal":
            return self.mean + self.deviation * field
        variance = math.log1p((self.deviation / self.mean) ** 2)
        middle = math.log(self.mean) - variance * self.captured.to(z.dtype) / 2
        return (middle + math.sqrt(variance) * field).exp()

    def _correlation(self, r: Tensor) -> Tensor:
        r = r.abs() / self.correlation_length
        return (-r if self.kernel == "exponential" else -r.square()).exp()

    def _expansion(self, terms: int | None) -> tuple[Tensor, Tensor]:
        """Eigenvalues (terms,) in m over the length, so that all of them sum to 1, and
        eigenfunctions (m, terms) at s.
        """
        least, length = self.s[0], self.s[-1] - self.s[0]
        points = int(min(max(256, 16 * length / self.correlation_length), 1024))
        x, w = (torch.from_numpy(v) for v in np.polynomial.legendre.leggauss(points))
        x, root = least + length * (1 + x) / 2, (w / 2).sqrt()
        values, vectors = torch.linalg.eigh(
            root[:, None] * self._correlation(x[:, None] - x) * root
        )
        values, vectors = values.flip(0), vectors.flip(-1)
        held = values.clamp_min(0).cumsum(0)  # of 1, the mean of the variance over the length
        terms = int((held < 1 - LOST).sum()) + 1 if terms is None else terms
        if terms > points // 2 or not values[terms - 1] > 1e-14:
            raise ValueError(
                f"a RandomField of {terms} terms with a correlation length of "
                f"{self.correlation_length:g} m over {length.item():g} m was given; fewer terms, "
                "or a longer correlation, are wanted"
            )
        values, vectors = values[:terms], vectors[:, :terms]
        shape = self._correlation(self.s[:, None] - x) @ (root[:, None] * vectors) / values
        return values, shape

    def __repr__(self) -> str:
        return (
            f"RandomField({len(self.s)} places; {self.marginal}, mean {self.mean:g}, deviation "
            f"{self.deviation:g}; {self.kernel}, correlation length {self.correlation_length:g} m; "
            f"{self.terms} terms, {100 * self.captured.mean().item():.1f} % of the variance)"
        )
