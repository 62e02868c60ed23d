"""Prediction: what a fit says about readings, measured or not, and how well."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import function as check_function
from ...core.validation import Value, as_tensor, broadcast, finite, positive, refusal, shown
from ...math.distributions import student_quantile
from ...sensors.observe import observe
from ...state.solution import Solution
from ...state.state import State
from .experiment import status_of, with_status
from .measurement import Measurement
from .nuisance import Nuisance, wave_names
from .problem import FitProblem

KNOTS = 65  # degrees of freedom that quantiles of many are found between


@dataclass(frozen=True)
class Prediction:
    """Readings that a fitted model gives, with their bands: `y, low, high = ...`; all of the
    readings' shape (...).

    y          at the fitted parameters
    deviation  of y, as the parameters are known; with `sigma`, of a new measurement of it
    low, high  between which y, or a new measurement, lies in `level` of all cases, each reading by
               itself
    """

    y: Tensor
    deviation: Tensor
    low: Tensor
    high: Tensor
    level: float

    def __iter__(self) -> Iterator[Tensor]:
        return iter((self.y, self.low, self.high))

    @classmethod
    def of(
        cls,
        y: Tensor,
        variance: Tensor,
        sigma: Value | None,
        quantile: Tensor,
        level: float,
        noise_quantile: float | None = None,
    ) -> Prediction:
        """Of y (...) with its variance and quantile (...), and the noise of a new measurement,
        which has a quantile of its own where its size is better known than the parameters. Raises
        ValueError for a sigma that is not positive, or does not broadcast.
        """
        half = quantile * variance.sqrt()
        if sigma is not None:
            noise = positive("sigma", finite("sigma", as_tensor(sigma, y.dtype, y.device)))
            if broadcast("sigma and a prediction", noise.shape, y.shape) != y.shape:
                raise ValueError(
                    f"sigma of shape {tuple(noise.shape)} was given for a prediction of shape "
                    f"{tuple(y.shape)}; one that broadcasts is wanted"
                )
            variance = variance + noise.square()
            own = quantile if noise_quantile is None else noise_quantile
            half = (half.square() + (own * noise).square()).sqrt()
        return cls(y, variance.sqrt(), y - half, y + half, level)


def quantiles(freedom: Tensor, level: float) -> Tensor:
    """Of Student's t with `freedom` (n,) degrees, at the upper end of `level`: (n,). More than
    KNOTS of them are found by cubics between that many, to 1e-4.
    """
    few = set(freedom.tolist())
    if len(few) <= KNOTS:
        each = {f: student_quantile((1 + level) / 2, f) for f in few}
        return freedom.new_tensor([each[f] for f in freedom.tolist()])
    place, value, slope = (x.to(freedom) for x in _knots(level))
    at = 1 / freedom
    k = (torch.searchsorted(place, at) - 1).clamp(0, KNOTS - 2)
    step = place[k + 1] - place[k]
    u = (at - place[k]) / step
    start, end = value[k] + step * u * slope[k], value[k + 1] - step * (1 - u) * slope[k + 1]
    return (start + u * u * (3 - 2 * u) * (end - start)).exp()


@cache
def _knots(level: float) -> tuple[Tensor, Tensor, Tensor]:
    """1 over degrees of freedom, the logarithm of the quantile there, and its slope."""
    place = torch.linspace(0, 1, KNOTS, dtype=torch.float64)
    value = [student_quantile((1 + level) / 2, 1 / x if x else math.inf) for x in place.tolist()]
    log = torch.tensor(value, dtype=torch.float64).log()
    return place, log, torch.gradient(log, spacing=(place,), edge_order=2)[0]


def predicted(
    problem: FitProblem,
    x: Tensor,
    model: Any,
    sensor: Any,
    times: Any,
    experiment: str | None,
    measurement: str | None = None,
) -> tuple[Tensor, Tensor]:
    """Readings (...) of a model at coordinates x (p,), and their derivatives (..., p)."""
    instrument, nuisance = _instrument(problem, measurement, experiment, sensor, times)
    read = _reader(problem, model, instrument or sensor, times, experiment)
    m = problem.parameters.model

    def readings(x: Tensor) -> Tensor:
        return read(problem.theta(x))

    with torch.no_grad():
        y = readings(x[None, :m])[0]
        if not torch.isfinite(y).all():
            raise ValueError(
                "a model that fails at the fit, or is not finite there, was given to predict; one "
                "that answers is wanted"
            )

        def flat(x: Tensor) -> Tensor:
            return readings(x).reshape(len(x), -1)

        J = problem.derivatives(flat, x[None], y.flatten()[None])[1][0]
    J = torch.nn.functional.pad(J, (0, len(x) - m)).reshape(*y.shape, len(x))
    if nuisance is not None and nuisance.names:
        if instrument.values.shape != y.shape:
            raise ValueError(
                f"a model that gave readings of shape {tuple(y.shape)} was given to predict a "
                f"measurement with offsets, of shape {tuple(instrument.values.shape)}; the same is "
                "wanted"
            )
        theta, slope = problem.theta(x[None]), problem.parameters.transform.slope(x)
        y = y + nuisance.values(theta)[0].reshape(y.shape)
        J = J + slope * nuisance.derivatives(theta)[0].mT.reshape(J.shape)
    return y, J


def _instrument(
    problem: FitProblem, name: str | None, experiment: str | None, sensor: Any, times: Any
) -> tuple[Measurement | None, Nuisance | None]:
    """A measurement of the fit, by its name, at these times, and its linear parameters."""
    if name is None:
        return None, None
    known = {
        m.name: (e, m)
        for e, m in problem.measurements
        if m.name is not None and e.name in (None, experiment)
    }
    if name not in known or sensor is not None:
        raise ValueError(
            f"measurement = {name!r} was given{' with a sensor' if sensor is not None else ''}; "
            f"one of {', '.join(map(repr, known)) or 'none by name'} is wanted, without a sensor"
        )
    e, m = known[name]
    if times is not None:
        at = as_tensor(times, m.values.dtype, m.values.device)
        like = m.values.new_zeros(len(at), *m.values.shape[1:])
        m = replace(m, values=like, times=at, sigma=None, noise="white")
    nuisance = Nuisance.of([(e.name, m)], 0)
    place = nuisance.place.new_tensor([problem.parameters.names.index(n) for n in nuisance.names])
    frequencies = (problem.parameters.number(n, e.name) for n in wave_names(m))
    return m, replace(nuisance, place=place).with_frequencies(frequencies)


def _reader(
    problem: FitProblem, model: Any, sensor: Any, times: Any, experiment: str | None
) -> Callable[[Tensor], Tensor]:
    """theta (N, p) -> readings (N, ...), NaN of samples that failed; `sensor` may be a
    `Measurement`, with times of its own.
    """
    names = [e.name for e in problem.experiments if e.measured]
    if experiment is not None and not (isinstance(experiment, str) and experiment in names):
        raise ValueError(
            f"experiment = {shown(experiment)} was given; there are "
            f"{', '.join(filter(None, names)) or 'none by name'}"
        )
    own = next((e for e in problem.parameters.entries if e.experiment is not None), None)
    if experiment is None and (own is not None or (model is None and len(names) > 1)):
        raise ValueError(
            "a prediction without an experiment was asked for of a fit of several; experiment= "
            f"one of {', '.join(filter(None, names))} is wanted"
        )
    if model is None:
        model = next(
            e.model for e in problem.experiments if e.measured and e.name in (None, experiment)
        )
    check_function("a model", model, "theta")

    def read(theta: Tensor) -> Tensor:
        values = problem.parameters.given(theta, experiment)
        y, status = with_status(model(values), len(theta))
        named = values if isinstance(values, dict) else None
        if isinstance(y, (Solution, State)) and isinstance(sensor, Measurement):
            status = status_of(y, status)
            y = sensor.read(y, named)
        elif isinstance(y, (Solution, State)):
            if sensor is None:
                raise ValueError(
                    f"a model that gave a {type(y).__name__} was given to predict without a "
                    "sensor; sensor= of tb.sensors is wanted"
                )
            status = status_of(y, status)
            y = (
                sensor(y)
                if isinstance(y, State)
                else observe(y, sensor, y.t if times is None else times).movedim(0, 1)
            )
        elif isinstance(sensor, Measurement):
            if sensor.sensor is not None:
                raise refusal(
                    f"a measurement by a sensor, of a model that gave a {type(y).__name__},",
                    "a model that gives a Solution",
                )
        elif sensor is not None or times is not None:
            raise ValueError(
                "a sensor or times were given to predict with a model that gave a "
                f"{type(y).__name__}; one that gives a Solution is wanted"
            )
        if not isinstance(y, Tensor) or not y.ndim or len(y) != len(theta):
            what = (
                f"a tensor {tuple(y.shape)}" if isinstance(y, Tensor) else f"a {type(y).__name__}"
            )
            raise ValueError(
                f"a model that gave {what} for {len(theta)} samples was given to predict; a "
                f"tensor ({len(theta)}, ...) or a Solution is wanted"
            )
        if isinstance(sensor, Measurement) and sensor.sensor is None:
            y = sensor.scaled(y, named)
        if status is None:
            return y
        return torch.where((status == 0).reshape(-1, *[1] * (y.ndim - 1)), y, torch.nan)

    return read
