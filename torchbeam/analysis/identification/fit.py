"""Fit: the result of an identification."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ...core import files
from ...core.arguments import choice, level_of
from ...core.validation import Value, shown
from ...math.distributions import student_quantile
from ...solvers.least_squares import CONVERGED, Found
from ...solvers.region import Region
from .blocks import SANDWICHED, BlockSpread
from .bootstrap import Bootstrap, bootstrap
from .covariance import half_interval
from .discretisation import doubted
from .observed_priors import with_priors_observed
from .prediction import Prediction, predicted, quantiles
from .problem import FitProblem
from .profile import Profile, profiles
from .readings import Readings
from .refinement import refined
from .report import write_report
from .result import REASON, NamedFit, conclusions, warn_of
from .table import table
from .transform import Transform

INTERVALS = ("laplace", "profile", "bootstrap")
FORMAT = 2  # of saved fits
LOST = ("problem", "transform", "readings", "blocks")  # fields that are not saved as they are


@dataclass(frozen=True, eq=False)
class Fit(NamedFit):
    """Result of `identify`, from the best of the starts.

    Args:
        theta: (p,) the parameters
        names: (p,). `fit["EI"]` is a parameter by its name, of its own shape; offsets and drifts
            come last
        covariance: (p, p) of the parameters: sigma^2 (J^T J)^-1, first order, with the known or the
            estimated sigma; with priors, of the posterior. `deviation` (p,) has the roots of its
            diagonal; `correlation` is (p, p). Parameters that the data cannot separate have huge
            deviations and a correlation near 1 or -1. Parameters at a bound, `held` (p,) bool,
            count as known: zeros
        freedom: (p,) degrees of freedom of these deviations: inf with a known sigma; T - p where
            the misfit gives sigma. Noise by channel has Satterthwaite's formula, see
            `covariance.py`
        redundancy: (channels,) number of data less that of parameters, for the estimated noise: a
            single number, or a number for each channel
        scale: deviation of the noise over the sigma that weighs the data: 1 where sigma is known,
            or estimated by channel
        noise: channel -> deviation that `identify(noise="channel")` has estimated
        memory: measurement with noise="ar1" -> correlation of its noise between consecutive
            readings
        y: (...) the model at theta, with offsets and drifts, in the shape of the data
        misfit: RMS of y - data (over sigma, where it is known or estimated by channel)
        status: 0 = converged. 1 = more iterations are needed. 2 = no step reduces the misfit. 3 =
            not identifiable: the data do not determine some parameters, and theta is no estimate of
            them. 4 = the model fails there. 5 (in `statuses`): not followed, because other
            starts were better
        unidentifiable: a sentence for each parameter that ran away, to 1e9 times its start. Also a
            sentence for each direction in which parameters can change by their own size at the same
            misfit. Empty if all are determined. `open` (p,) bool marks the parameters named
        hints: sentences about suspicious results: units, exchanged markers, bounds that are
            reached, parameters that the data hardly separate. `doubts`: a search that did not
            converge; residuals larger than sigma, correlated, with a trend, off by periods; steps,
            mesh. `interval` warns of these
        message: the status in words, with these sentences, and errors that the model raised at
            trials
        iterations: number of evaluations of the model and its derivatives, without the first
        derivatives: their method
        history: (iterations + 1, starts, p) parameters at each iteration
        starts: (starts, p) end of each start
        misfits, statuses: (starts,) of each end
        readings: data beside the model's values, of each measurement
        jacobian: (data, p) derivatives of the measured readings, over sigma, by the coordinates of
            the search

    Examples:
        >>> x = torch.tensor([1.0, 2.0, 3.0, 4.0])
        >>> fit = tb.identify(
        ...     lambda p: p["k"][..., None] * x,
        ...     2 * x + torch.tensor([0.1, -0.1, 0.1, -0.1]),
        ...     {"k": 1.0},
        ... )
        >>> fit.theta, fit.deviation  # the estimate, its standard deviation
        (tensor([1.9933]), tensor([0.0207]))
    """

    theta: Tensor
    names: tuple[str, ...]
    covariance: Tensor
    y: Any
    misfit: Tensor
    status: int
    iterations: int
    history: Tensor
    starts: Tensor
    misfits: Tensor
    statuses: Tensor
    unidentifiable: tuple[str, ...] = ()
    message: str = ""
    hints: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    open: Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.bool))
    held: Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.bool))
    freedom: Tensor = field(default_factory=lambda: torch.zeros(0))
    redundancy: Tensor = field(default_factory=lambda: torch.zeros(0))
    scale: float = 1.0
    noise: dict[str, float] = field(default_factory=dict)
    memory: dict[str, float] = field(default_factory=dict)
    derivatives: str = ""
    shapes: dict[str, tuple[int, tuple[int, ...]]] = field(default_factory=dict)
    x: Tensor = field(default_factory=lambda: torch.zeros(0))
    x_covariance: Tensor = field(default_factory=lambda: torch.zeros(0, 0))
    x_slope: Tensor = field(default_factory=lambda: torch.zeros(0))
    bounds: Tensor = field(default_factory=lambda: torch.zeros(0, 2))
    transform: Transform | None = None
    readings: tuple[Readings, ...] = ()
    jacobian: Tensor = field(default_factory=lambda: torch.zeros(0, 0))
    problem: FitProblem | None = None
    blocks: BlockSpread | None = None

    @classmethod
    def of(
        cls, problem: FitProblem, search: Found, region: Region, derivatives: str, tolerance: float
    ) -> Fit:
        """From what a search has found."""
        return cls(**conclusions(problem, search, region, derivatives, tolerance))

    @property
    def deviation(self) -> Tensor:
        return self.covariance.diagonal().sqrt()

    @property
    def correlation(self) -> Tensor:
        size = torch.where(self.held, 1, self.deviation)
        return self.covariance / (size[:, None] * size) + torch.diag(self.held.to(size))

    def __getitem__(self, name: str) -> Tensor:
        """One parameter by name, of its own shape."""
        if isinstance(name, str) and name in self.shapes:
            first, shape = self.shapes[name]
            return self.theta[first : first + torch.Size(shape).numel()].reshape(shape)
        if not isinstance(name, str) or name not in self.names:
            raise KeyError(f"{shown(name)} was asked for; there are {', '.join(self.names)}")
        return self.theta[self.names.index(name)]

    def interval(
        self, level: float = 0.95, method: str = "laplace", *, repeats: int = 500, seed: int = 0
    ) -> Tensor:
        """(p, 2) least and largest values of the parameters that agree with the data, at a level of
        confidence.

        Args:
            method: "laplace": from the covariance, by quantiles of Student's t with `freedom`, in
                the coordinates of the search: positive parameters stay positive. It is exact for a
                linear model. "profile": ends at which the least misfit, over all other parameters,
                rises by as much as that quantile. It includes the model's curvature, for a batch of
                some ten fits for each parameter. "bootstrap": bias-corrected percentiles of
                `repeats` fits, as a batch, to data from the fitted model and noise

        An undetermined parameter has the interval of all possible values. At a bound, the interval
        ends at the same rise of the least misfit, by slope and curvature there, or by "profile".
        Repeated fits are no measure at a bound (Andrews 2000, Econometrica 68, 399). All methods
        assume that the model is right and the noise independent: a UserWarning says so with
        `doubts`.
        """
        warn_of(self.doubts)
        return self.interval_without_warning(level, method, repeats, seed)

    def interval_without_warning(
        self, level: float, method: str = "laplace", repeats: int = 500, seed: int = 0
    ) -> Tensor:
        """See `interval`."""
        choice("method", method, INTERVALS)
        away = self._half_interval(self._quantile(level))
        limits = torch.stack(
            [self.transform.theta(end) for end in (self.x - away, self.x + away)], -1
        )
        if method == "bootstrap" and not self.held.all():
            limits = torch.where(
                self.held[:, None], limits, self.bootstrap(repeats, seed=seed).interval(level)
            )
        elif method == "profile":
            limits = torch.stack([profile.interval for profile in self.profile(level=level)])
        return self.within(limits)

    def predict(
        self,
        model: Any = None,
        sensor: Any = None,
        times: Any = None,
        *,
        level: float = 0.95,
        sigma: Value | None = None,
        experiment: str | None = None,
        measurement: str | None = None,
    ) -> Prediction:
        """Readings at the fitted parameters, of the measurements or of another model with the same
        parameters, with bands from the covariance C. The readings' derivatives G come from a batch
        of 2 p + 1 samples, and the variance is G C G^T. It is exact if readings are linear in the
        coordinates of the search. Bands have Student's t with the parameters' `freedom`: the least
        of these, or by blocks for each reading. A parameter at a bound counts as known. A reading
        that depends on an undetermined parameter has an infinite band.

        Args:
            model: as in `identify`, for another load, place or time; None = the fitted model
            sensor, times: reading of a Solution, see `tb.observe`; times (s), None = the times of
                the solution. Gains, offsets, drifts, delays, clocks, places and frames of
                instruments are left out
            measurement: name of a `Measurement` of the fit, in place of a sensor. The answer is its
                reading at `times` (None = its own times), with all estimates of the instrument, and
                their share of the band
            sigma: noise of a new measurement: bands then hold the measurement, not the true value.
                A number, or a tensor that broadcasts with the readings. Where the misfit gives the
                noise, use `fit.scale` times the sigma of the data
            experiment: name of the experiment whose model and own parameters apply; needed if
                several have their own

        As in intervals, the model counts as right: a UserWarning says so with `doubts`. Raises
        ValueError for a fit from a file, a model that fails at the fit, or other shapes.
        """
        warn_of(self.doubts)
        y, J = predicted(
            self._problem("prediction"), self.x, model, sensor, times, experiment, measurement
        )
        open_ = self.open if len(self.open) else torch.zeros_like(self.held)
        determined = ~self.held & ~open_
        G = J[..., determined]
        variance = ((G @ self.x_covariance[determined][:, determined]) * G).sum(-1).clamp(min=0)
        variance = torch.where((J[..., open_ & ~self.held] != 0).any(-1), torch.inf, variance)
        quantile = self._quantile(level)
        most = (quantile[determined] if determined.any() else quantile).amax()
        if self.blocks is not None:
            most = quantiles(self.blocks.freedom((J * determined).flatten(0, -2)), level)
            most = most.reshape(y.shape)
        dependent = not self.problem.independent.all()
        noise = student_quantile((1 + level) / 2, torch.inf) if dependent else None
        return Prediction.of(y, variance, sigma, most, level, noise)

    def profile(self, *names: str, level: float = 0.95) -> tuple[Profile, ...]:
        """Profile likelihoods of the parameters (all), see `interval`."""
        for name in names:
            if not isinstance(name, str) or name not in self.names:
                raise ValueError(
                    f"the parameter {shown(name)} was given; there are {', '.join(self.names)}"
                )
        which = [self.names.index(name) for name in names] or [*range(len(self.names))]
        quantile = self._quantile(level)
        noisy, step = self._noisy("profile"), self._half_interval(quantile)
        return profiles(noisy, self.x, self.x_covariance, step, which, quantile, self.scale)

    def bootstrap(self, repeats: int = 500, *, seed: int = 0) -> Bootstrap:
        """Fits to `repeats` sets of data, drawn from the fitted model and noise, as a batch that
        starts at the fit. Normal and log-normal priors act as observations: their centres are drawn
        too. Parameters at a bound stay there. Raises ValueError for other priors.
        """
        problem = with_priors_observed(self._noisy("bootstrap"))
        return bootstrap(problem, self.x, self.held, self.scale, self.redundancy, repeats, seed)

    @doubted
    def refined(self, model: Any) -> Fit:
        """Fit of a finer model (a finer mesh or shorter steps), by its readings and the derivatives
        of this model (defect correction; Boehmer and Stetter 1984). Gauss-Newton steps go on until
        they are a hundredth of a deviation. This takes a few evaluations of one sample. Derivatives
        are computed anew. The change of the parameters is the error of the coarser mesh.

        Args:
            model: as in `identify`, for the same parameters and data

        Raises:
            ValueError: where the finer model fails, or the steps do not shrink because the models
                differ too much.
        """
        finer, search, region = refined(
            self._problem("refined fit"), model, self.x[None], self.jacobian[None], self.scale
        )
        if search.status[0] != CONVERGED:
            raise ValueError(
                "a finer model that fails at the fit, or differs too much from the one that was "
                "fitted, was given; one of the same beam, a little finer, is wanted"
                f"{self._reason}"
            )
        return Fit.of(finer, search, region, self.derivatives, 1e-6)

    def summary(self, level: float = 0.95) -> str:
        """Table of parameters with intervals, the misfit, undetermined parameters, and hints."""
        return table(self, level, REASON)

    def report(
        self, path: str | Path, *, level: float = 0.95, predictions: Mapping[str, Any] | None = None
    ) -> Path:
        """Write a page of HTML with its pictures. It has doubts, parameters with their intervals,
        correlations, predictions, and data, fit and residuals of each measurement. It needs
        matplotlib.

        Args:
            path: ends in .html
            predictions: name -> (times (m,), result of `predict` (m, ...)), or with a third entry,
                data measured there: the page counts how many lie in the bands

        Raises ValueError for other predictions, files.NotWritten (an OSError).
        """
        return write_report(self, path, level_of("level", level), predictions, REASON[self.status])

    def save(self, path: str | Path) -> None:
        """Write the fit without its model to a file. Raises files.NotWritten (an OSError)."""
        plain = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in LOST}
        plain["transform"] = dict(vars(self.transform))
        plain["readings"] = [dict(vars(r)) for r in self.readings]
        files.save(files.file_of("path", path), {"torchbeam fit": FORMAT, **plain})

    @classmethod
    def load(cls, path: str | Path) -> Fit:
        """Read a fit without model, profiles and bootstrap. Raises ValueError for another file."""
        path = files.path_of("path", path)
        saved = files.load(path, "torchbeam fit", FORMAT, "saved fit")
        try:
            transform = Transform(**saved.pop("transform"))
            readings = tuple(Readings(**r) for r in saved.pop("readings"))
            return cls(**saved, transform=transform, readings=readings)
        except (KeyError, TypeError):  # other fields
            raise ValueError(
                f"the file {str(path)!r} was given, which holds no fit of this version; one is "
                "wanted"
            ) from None

    def __repr__(self) -> str:
        rows = zip(self.names, self.theta.tolist(), self.deviation.tolist(), strict=True)
        values = ", ".join(f"{n} = {v:.5g} +- {d:.2g}" for n, v, d in rows)
        reason = f"{REASON[self.status]} in {self.iterations}"
        said = "".join(f"; {sentence}" for sentence in (*self.unidentifiable, *self.doubts))
        return f"Fit({values}; misfit {self.misfit.item():.3g}, {reason}{said})"

    def _quantile(self, level: float) -> Tensor:
        """(p,) of Student's t, at the upper end."""
        return quantiles(self.freedom, level_of("level", level))

    def _half_interval(self, quantile: Tensor) -> Tensor:
        """(p,) of coordinates, from the covariance."""
        return half_interval(quantile, self.x_covariance.diagonal(), self.x_slope)

    def _problem(self, what: str) -> FitProblem:
        if self.problem is None:
            raise ValueError(
                f"a {what} of a fit from a file was asked for, which has no model; one from "
                "tb.identify is wanted"
            )
        if bool(self.open.all()):
            raise ValueError(
                f"a {what} of a fit that determines nothing was asked for{self._reason}"
            )
        return self.problem

    @property
    def _reason(self) -> str:
        """What was odd before."""
        return f"; of the fit it was said: {'; '.join(self.hints)}" if self.hints else ""

    def _noisy(self, what: str) -> FitProblem:
        """The problem, whose noise is known."""
        problem = self._problem(what)
        if not problem.independent.all():
            kind = next(
                f"loss={m.loss!r}" if m.loss else f"noise={m.noise!r}"
                for _, m in problem.measurements
                if m.loss or m.noise in SANDWICHED
            )
            raise ValueError(
                f"a {what} of a fit with {kind} was asked for, which knows no noise to "
                "draw or to weigh by; method='laplace' is wanted, which is by "
                f"{'misfits' if 'loss' in kind else 'blocks'}"
            )
        if not problem.sigma_given and problem.spare < 1:
            raise ValueError(
                f"a {what} of as many parameters as data was asked for; there is no noise to be "
                "known"
            )
        return problem

    def within(self, interval: Tensor) -> Tensor:
        """Cut at bounds; of parameters that are not determined, all that they can be."""
        least, largest = self.bounds.unbind(-1)
        least = torch.where(self.transform.log, least.clamp(min=0), least)
        all_ = torch.stack((least, largest), -1)
        low, high = interval.unbind(-1)
        limited = torch.stack((torch.maximum(low, least), torch.minimum(high, largest)), -1)
        return torch.where(self.open[:, None] | limited.isnan(), all_, limited)
