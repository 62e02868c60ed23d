"""Identification of fields: smoothness priors, and their weights from the data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import choice, count, level_of
from ...core.validation import Value
from .field_search import FieldSearch
from .fit import Fit
from .identify import SearchOptions
from .regularization import CRITERIA, RegularizationChoice, weigh
from .result import warn_of
from .smoothness import Smoothness

LEAST = 1e-8  # deviation of data without noise, over their RMS
# of the logarithm of a weight, or of deviations of the parameters, from one round to the next
SAME = 0.1


@dataclass(frozen=True, eq=False)
class FieldFit:
    """Result of `identify_fields`.

    Args:
        fit: `Fit` with these weights. Its covariance is the posterior's, with the prior: it holds
            for fields of that smoothness
        weight: name -> weight of its smoothness, see `Smoothness`
        sigma: estimated standard deviation of the data; 1 if the data have a sigma
        effective: how many numbers the data determine (trace of the resolution matrix), of
            len(fit.theta)
        weighing: of the last round: misfit, roughness and criterion over the weights
        rounds: number of searches, each with the weights that follow from the one before
        settled: whether the last search confirms its weights, or moved by less than a tenth of the
            deviations
        samples: (n, p) coordinates of the search, drawn from the posterior of the linearised model.
            The draws include the uncertainty of weights and noise, and Student's t of sharp fields.
            None where these are known and the posterior is normal

    Examples:
        >>> x = torch.linspace(0, 3, 20)
        >>> data = torch.sin(x) + 0.05 * torch.randn(20, generator=torch.Generator().manual_seed(0))
        >>> found = tb.identify_fields(
        ...     lambda p: p["f"], data, {"f": torch.zeros(20)}, {"f": tb.Smoothness(2)}
        ... )
        >>> found.effective < 10  # parameters that the data tell
        True
    """

    fit: Fit
    weight: dict[str, float]
    sigma: float
    effective: float
    weighing: RegularizationChoice
    rounds: int
    settled: bool
    samples: Tensor | None = None

    def __getitem__(self, name: str) -> Tensor:
        return self.fit[name]

    def _place(self, name: str) -> tuple[int, tuple[int, ...]]:
        """Where its numbers begin, and its shape; ValueError where there is none."""
        return self.fit.shapes[choice("name", name, self.fit.shapes)]

    def deviation(self, name: str) -> Tensor:
        """Standard deviation of a parameter or field, of its shape."""
        first, shape = self._place(name)
        return self.fit.deviation[first : first + torch.Size(shape).numel()].reshape(shape)

    def interval(self, name: str, level: float = 0.95) -> Tensor:
        """(*shape, 2) ends between which each number of a parameter or field lies with a
        probability `level`, by itself: the posterior's quantiles. They take the model as right: a
        UserWarning says so where the misfit does not (`Fit.doubts`).
        """
        first, shape = self._place(name)
        warn_of(self.fit.doubts)
        if self.samples is None:
            limits = self.fit.interval_without_warning(level)
        else:
            tail = (1 - level_of("level", level)) / 2
            ends = self.samples.quantile(self.samples.new_tensor((tail, 1 - tail)), dim=0)
            limits = self.fit.within(self.fit.transform.theta(ends).mT)
        return limits[first : first + torch.Size(shape).numel()].reshape(*shape, 2)

    def refined(self, model: Any) -> FieldFit:
        """Fit of a finer model, with the same weights and width of the posterior; see
        `Fit.refined`. A field keeps its numbers: of twice as many elements they are
        `theta["EI"].repeat_interleave(2, -1)`.
        """
        fit = self.fit.refined(model)
        samples = None if self.samples is None else self.samples + (fit.x - self.fit.x)
        return replace(self, fit=_with_spread(fit, samples), samples=samples)

    def __repr__(self) -> str:
        weights = ", ".join(f"{name} {weight:.3g}" for name, weight in self.weight.items())
        hints = "".join(f"; {hint}" for hint in self.fit.hints)
        return (
            f"FieldFit(misfit {self.fit.misfit.item():.3g} sigma{hints}; {len(self.fit.theta)} "
            f"numbers, {self.effective:.1f} of them told by the data; weights: {weights}; "
            f"{'settled' if self.settled else 'not settled'} after {self.rounds})"
        )


def identify_fields(
    model: Any,
    data: Any,
    start: Mapping[str, Any],
    smoothness: Mapping[str, Smoothness],
    *,
    criterion: str = "evidence",
    weight: Mapping[str, float] | None = None,
    rounds: int = 20,
    log: bool = False,
    bounds: tuple[Value, Value] | None = None,
    sigma: Value | None = None,
    absolute_sigma: bool = True,
    noise: str = "common",
    names: Sequence[str] | None = None,
    starts: int = 1,
    spread: float = 3.0,
    follow: int = 32,
    seed: int = 0,
    derivatives: str = "auto",
    relative_step: float | None = None,
    iterations: int = 50,
    tolerance: float = 1e-6,
    progress: bool = False,
) -> FieldFit:
    """Identify parameters that include fields (n,): stiffness or mass by element, a load by
    interval, an initial velocity by node. A field of more numbers than the data determine has a
    smoothness prior, whose weight comes from the data.

    Args:
        model, data: as in `identify`
        start: name -> start or `Parameter`, see `identify`
        smoothness: name -> `Smoothness`, for some or all of the parameters
        criterion: of the weights, for the model linearised at the end of each search. "evidence":
            the largest probability of the data, with fields integrated out (MacKay 1992, Neural
            Computation 4, 415; with unknown noise Wahba 1985, Annals of Statistics 13, 1378).
            "gcv": generalised cross validation (Golub, Heath and Wahba 1979, Technometrics 21,
            215). "lcurve": the corner of roughness over misfit, for a single field (Hansen and
            O'Leary 1993, SIAM J. Sci. Comput. 14, 1487)
        weight: name -> fixed weight of each field: a single search, or more with `sharp` fields or
            unknown noise
        rounds: largest number of searches, each from the end of the one before
        log, bounds, starts, sigma, derivatives, tolerance, progress: as in `identify`

    The weights of the first search are small enough to follow the data. Without sigma, the noise is
    estimated: the squares over the number of data less that of determined numbers.

    Raises:
        ValueError: for smoothness of a name that is no field of `start`, absolute_sigma=False, and
            as `identify`.

    Examples:
        >>> x = torch.linspace(0, 3, 20)
        >>> data = torch.sin(x) + 0.05 * torch.randn(20, generator=torch.Generator().manual_seed(0))
        >>> found = tb.identify_fields(
        ...     lambda p: p["f"], data, {"f": torch.zeros(20)}, {"f": tb.Smoothness(2)}
        ... )
        >>> (found.fit.theta - torch.sin(x)).abs().max() < 0.1
        tensor(True)
    """
    options = SearchOptions.of(locals())
    choice("criterion", criterion, CRITERIA)
    search = FieldSearch.of(model, data, start, smoothness, options)
    return _fit(search, criterion, weight, rounds)


def _fit(
    task: FieldSearch, criterion: str, weight: Mapping[str, float] | None, rounds: int
) -> FieldFit:
    """See `identify_fields`."""
    start = task.start
    most = count("rounds", rounds) if weight is None or task.sharp or not task.known else 1
    weights, sigma = task.first() if weight is None else (task.checked(weight), task.noise)
    k, settled, sharpened, before = 0, False, False, None
    while not settled and k < most:
        fit, linear = task.searched(start, weights, sigma)
        weighing, used, noise, k = weigh(linear, criterion, task.known), weights, sigma, k + 1
        sigma = max(weighing.sigma, 0.0 if task.known else LEAST * task.size)
        start = task.start_from(fit)
        weights = weighing.weight / sigma**2 if weight is None else used
        same = ((weights / used).log().abs() < SAME).all().item() and (
            weight is None or abs(sigma - noise) < SAME * noise
        )
        still = (
            before is not None
            and ((fit.x - before).abs() < SAME * fit.x_covariance.diagonal().sqrt()).all().item()
        )
        settled, before = still or (same and not task.sharp), fit.x
        if task.sharp and (same or sharpened):  # the normal law's weight first
            settled, sharpened, task = still and sharpened, True, task.sharpened(fit, weights)
    effective = linear.solved(used * noise**2).determined.item()
    free = weight is None and criterion == "evidence"
    samples = (
        task.samples(linear, used, noise, free) if free or task.sharp or not task.known else None
    )
    weights = dict(zip(task.rows, used.tolist(), strict=True))
    return FieldFit(
        _with_spread(fit, samples), weights, noise, effective, weighing, k, settled, samples
    )


def _with_spread(fit: Fit, samples: Tensor | None) -> Fit:
    """The fit with the covariance of samples (n, p) of its coordinates."""
    if samples is None:
        return fit
    covariance, slope = samples.mT.cov().reshape(fit.x_covariance.shape), fit.transform.slope(fit.x)
    return replace(fit, x_covariance=covariance, covariance=slope[:, None] * covariance * slope)
