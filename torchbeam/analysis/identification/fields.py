"""Identification of fields: smoothness priors, and their weights from the data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import boolean, choice, count, instance, level_of, number
from ...core.validation import Value, as_tensor, common_dtype, refusal, shown
from . import posterior
from .experiment import experiments_of
from .fit import Fit, warn_of
from .identify import SearchOptions, searched
from .measurement import Measurement, each, sigma_given
from .noise import NOISES
from .parameter import Parameter
from .problem import FitProblem
from .regularization import CRITERIA, Linearised, RegularizationChoice, weigh
from .smoothness import Smoothness, SmoothnessRows

NOISE = 0.05  # first deviation of data without sigma, over their RMS
LEAST = 1e-8  # deviation of data without noise, over their RMS
FIRST = 1e-4  # first weight, over that at which smoothness counts as much as the data
# of the logarithm of a weight, or of deviations of the parameters, from one round to the next
SAME = 0.1


@dataclass(frozen=True, eq=False)
class FieldFit:
    """Result of `identify_fields`.

    Args:
        fit: `Fit` with these weights; its covariance is that of the posterior, the prior included:
            what it says of a field holds as far as it is smooth in that sense
        weight: name -> weight of its smoothness, see `Smoothness`
        sigma: standard deviation of the data, where it was not given with them; else 1
        effective: how many numbers the data determine (trace of the resolution matrix), of
            len(fit.theta)
        weighing: of the last round: misfit, roughness and criterion over the weights
        rounds: searches, each with the weights that the one before asks for;  settled: the last
            asks for the same, or moved by less than a tenth of the deviations
        samples: (n, p) coordinates of the search, drawn from the posterior of the linearised model,
            in which weights and noise that were found are no better known than the data say, and
            rows of a sharp field have Student's t; None where all of that was given, and the
            posterior is normal

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
        """With the fit that a finer model finds, weights and the posterior's width as they are; see
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
    """Parameters of which some are fields, (n,) each: stiffness or mass by element, a load by
    interval, an initial velocity by node. A field of more numbers than the data tell is found with
    a prior that it is smooth, weighted as the data ask for.

    model, data  as in `identify`
    start        name -> start or `Parameter`, see `identify`; so is log
    smoothness   name -> `Smoothness`, for some or all of the parameters
    criterion    by which weights are found, of the model linearised where a search ended:
                 "evidence"  the probability of the data, the fields integrated out, is largest
                 (MacKay 1992, Neural
                             Computation 4, 415; of unknown noise Wahba 1985,
                                 Annals of Statistics 13, 1378)
                 "gcv"       generalised cross validation (Golub, Heath and Wahba 1979,
                             Technometrics 21, 215)
                 "lcurve"    corner of roughness over misfit, of one field (Hansen and O'Leary 1993,
                             SIAM J. Sci. Comput. 14, 1487)
    weight       name -> weight of each field, taken as they are: one search, more where rows are
                 `sharp` or noise is not known
    rounds       searches at most, each from where the one before ended
    log, bounds ... progress  of the searches, as in `identify`

    The first search has weights that are small enough to follow the data. Where data have no sigma,
    that is found too: the squares over the number of data less that of numbers told.

    Raises:
        ValueError: for smoothness of what is no field of `start`, absolute_sigma=False, and what
            `identify` raises.

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
    task = _Task.of(model, data, start, smoothness, options)
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


@dataclass(frozen=True)
class _Task:
    """What is searched: models and measurements by experiment (None: one without a name), and for
    each field its rows, their target (rows,), and factors (rows,) by which they count.
    """

    models: dict[str | None, Any]
    measured: dict[str | None, Any]
    start: Mapping[str, Any]
    rows: dict[str, SmoothnessRows]
    target: dict[str, Tensor]
    factor: dict[str, Tensor]
    sharp: tuple[str, ...]
    known: bool
    options: SearchOptions

    @classmethod
    def of(
        cls,
        model: Any,
        data: Any,
        start: Mapping[str, Any],
        smoothness: Mapping[str, Smoothness],
        options: SearchOptions,
    ) -> _Task:
        if not isinstance(start, Mapping) or not isinstance(smoothness, Mapping) or not smoothness:
            raise ValueError(
                "a start and smoothness by name are wanted: {'EI': tb.Parameter(...)}, {'EI': "
                "tb.Smoothness()}"
            )
        if not boolean("absolute_sigma", options.absolute_sigma):
            raise ValueError(
                "absolute_sigma=False was given to identify_fields, whose weights count on sigma; "
                "data without sigma are wanted, whose noise is found"
            )
        if choice("noise", options.noise, NOISES) != "common":
            raise ValueError(
                f"noise={options.noise!r} was given to identify_fields, which finds one "
                "deviation of all data; channels weighed by their sigma are wanted"
            )
        experiments = experiments_of(model, data, options.sigma)
        options, log = replace(options, sigma=None), options.log
        models = {e.name: e.model for e in experiments}
        measured = {
            e.name: e.measurements[0] if e.single else list(e.measurements) for e in experiments
        }
        every = [m for given in measured.values() for m in each(given)]
        if odd := [m for m in every if m.loss or m.noise != "white"]:
            kind = f"loss={odd[0].loss!r}" if odd[0].loss else f"noise={odd[0].noise!r}"
            raise ValueError(
                f"{kind} was given to identify_fields, whose weights count on normal noise that is "
                "independent; noise='white' is wanted, where neighbours are alike with sigma "
                "over sqrt((1 - rho)/(1 + rho)), rho their correlation"
            )
        known = sigma_given(every)
        if not known and not any(m.values.nan_to_num().any() for m in every):
            raise ValueError(
                "data that are all zero were given to identify_fields without sigma; their noise "
                "is not to be known, and sigma=... is wanted"
            )
        kind = common_dtype(*(m.values for m in every))
        rows, target = {}, {}
        for name, one in smoothness.items():
            if name not in start:
                raise ValueError(
                    f"smoothness of {name!r} was given; there are {', '.join(map(str, start))}"
                )
            given = start[name]
            if not isinstance(given, Parameter):
                given = Parameter(as_tensor(given, *kind), transform="log" if log else None)
            if given.start.ndim != 1 or given.own or given.transform == "logit":
                raise ValueError(
                    f"smoothness of {name!r} was given, of shape {tuple(given.start.shape)}; one "
                    "field (n,) of all experiments is wanted, by itself or by its logarithm"
                )
            L = instance("smoothness", one, Smoothness).rows(given.start)
            rows[name] = SmoothnessRows(name, L, given.transform == "log")
            target[name] = rows[name].of(given.start) if one.order == 0 else L.new_zeros(len(L))
        factor = {name: torch.ones_like(of) for name, of in target.items()}
        sharp = tuple(name for name, one in smoothness.items() if one.sharp)
        return cls(models, measured, start, rows, target, factor, sharp, known, options)

    @property
    def noise(self) -> float:
        """First deviation of the data; 1 where theirs are given."""
        return 1.0 if self.known else NOISE * self.size

    @property
    def size(self) -> float:
        """RMS of the data."""
        values = torch.cat(
            [m.values.flatten() for given in self.measured.values() for m in each(given)]
        )
        return values[~values.isnan()].square().mean().sqrt().item()

    @property
    def _like(self) -> Tensor:
        return next(iter(self.target.values()))

    def checked(self, weight: Mapping[str, float]) -> Tensor:
        if not isinstance(weight, Mapping):
            raise refusal(f"weight = {shown(weight)}", "name -> number")
        if set(weight) != set(self.rows):
            raise ValueError(
                f"weights of {', '.join(map(str, weight))} were given; of {', '.join(self.rows)} "
                "are wanted"
            )
        weights = self._like.new_tensor(
            [number(f"the weight of {name!r}", weight[name]) for name in self.rows]
        )
        if not (weights > 0).all():
            raise refusal(f"a weight of {weights.min().item():g}", "positive ones", are=True)
        return weights

    def first(self) -> tuple[Tensor, float]:
        """Weights that leave the data all they can say, from the derivatives at the start."""
        tiny = self._like.new_full((len(self.rows),), torch.finfo(self._like.dtype).eps)
        once = replace(self.options, iterations=1)
        fit = searched(*self._with_rows(tiny, self.noise), self.start, once)
        problem, x = fit.problem, fit.problem.parameters.x[:1]
        with torch.no_grad():
            linear = self._linearised(problem, x, *problem.linearised(x, _first(x)), self.noise)
        return FIRST * linear.balance / self.noise**2, self.noise

    def searched(
        self, start: Mapping[str, Any], weight: Tensor, sigma: float
    ) -> tuple[Fit, Linearised]:
        fit = searched(*self._with_rows(weight, sigma), start, self.options)
        x = fit.x[None]
        with torch.no_grad():
            r = fit.problem.residuals(x, _first(x))
            return fit, self._linearised(fit.problem, x, r, fit.jacobian[None], sigma)

    def start_from(self, fit: Fit) -> dict[str, Any]:
        """Fields by their logarithms from where they were found; others may have begun at zero."""
        return {
            name: replace(one, start=fit[name])
            if isinstance(one, Parameter) and one.transform == "log" and not one.own
            else one
            for name, one in self.start.items()
        }

    def sharpened(self, fit: Fit, weight: Tensor) -> _Task:
        """With rows that count by how large they are."""
        factor = dict(self.factor)
        for (name, rows), w in zip(self.rows.items(), weight.tolist(), strict=True):
            if name in self.sharp:
                factor[name] = Smoothness.factors(
                    w * (rows.of(fit[name]) - self.target[name]).square()
                )
        return replace(self, factor=factor)

    def samples(self, linear: Linearised, weight: Tensor, sigma: float, free: bool) -> Tensor:
        """Samples of the posterior, see `posterior`, of a problem linearised with these factors."""
        root = [factor.sqrt() for factor in self.factor.values()]
        plain = replace(
            linear,
            L=tuple(L / s[:, None] for L, s in zip(linear.L, root, strict=True)),
            target=tuple(c / s for c, s in zip(linear.target, root, strict=True)),
        )
        return posterior.samples(
            plain, weight, sigma, [name in self.sharp for name in self.rows], free, self.known
        )

    def _with_rows(self, weight: Tensor, sigma: float) -> tuple[dict[str, Any], dict[str, Any]]:
        """Models and data of experiments, one more for each field."""

        def noisy(m: Measurement) -> Measurement:
            return m if self.known else replace(m, sigma=sigma)

        data = {
            name: [noisy(m) for m in given] if isinstance(given, list) else noisy(given)
            for name, given in self.measured.items()
        }
        models = dict(self.models)
        for (name, rows), w in zip(self.rows.items(), weight.tolist(), strict=True):
            models[f"smoothness of {name}"] = rows
            data[f"smoothness of {name}"] = Measurement(
                self.target[name], (w * self.factor[name]) ** -0.5
            )
        return models, data

    def _linearised(
        self, problem: FitProblem, x: Tensor, r: Tensor, J: Tensor, sigma: float
    ) -> Linearised:
        """About x (1, p), of r (1, T) and J (1, T, p) there; misfits over the data's deviations."""
        _, pull, bend = (part[0] for part in problem.prior(x))
        data = problem.measured
        scale = 1.0 if self.known else sigma
        wide, target = [], []
        for name, rows in self.rows.items():
            (place,) = (e.place for e in problem.parameters.entries if e.name == name)
            wide.append(x.new_zeros(len(rows.L), x.shape[1]))
            root = self.factor[name].sqrt()
            wide[-1][:, place] = root[:, None] * rows.L
            target.append(root * self.target[name])
        r, J = scale * r[0, data], scale * J[0, data]
        return Linearised(x[0], r, J, tuple(wide), tuple(target), scale**2 * pull, scale**2 * bend)


def _first(x: Tensor) -> Tensor:
    return torch.zeros(1, dtype=torch.long, device=x.device)
