"""Prediction: what a fit says about readings, measured or not, and how well."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import function as check_function
from ...core.validation import Value, as_tensor, broadcast, finite, positive, shown
from ...sensors.observe import observe
from ...solvers.jacobian import difference, forward
from ...state.solution import Solution
from .experiment import with_status
from .problem import FitProblem


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
        cls, y: Tensor, variance: Tensor, sigma: Value | None, quantile: float, level: float
    ) -> Prediction:
        """Of y (...) with its variance (...), and the noise of a new measurement. Raises ValueError
        for a sigma that is not positive, or does not broadcast.
        """
        if sigma is not None:
            noise = positive("sigma", finite("sigma", as_tensor(sigma, y.dtype, y.device)))
            if broadcast("sigma and a prediction", noise.shape, y.shape) != y.shape:
                raise ValueError(
                    f"sigma of shape {tuple(noise.shape)} was given for a prediction of shape "
                    f"{tuple(y.shape)}; one that broadcasts is wanted"
                )
            variance = variance + noise.square()
        deviation = variance.sqrt()
        return cls(y, deviation, y - quantile * deviation, y + quantile * deviation, level)


def predicted(
    problem: FitProblem, x: Tensor, model: Any, sensor: Any, times: Any, experiment: str | None
) -> tuple[Tensor, Tensor]:
    """Readings (...) of a model at coordinates x (p,), and their derivatives (..., p), as the
    problem takes derivatives.
    """
    read = _reader(problem, model, sensor, times, experiment)
    parameters, m = problem.parameters, problem.parameters.model

    def readings(x: Tensor) -> Tensor:
        nuisance = x.new_zeros(len(x), len(problem.basis))  # of which the model knows nothing
        return read(parameters.transform.theta(torch.cat((x, nuisance), -1)))

    with torch.no_grad():
        y = readings(x[None, :m])[0]
        if not torch.isfinite(y).all():
            raise ValueError(
                "a model that fails at the fit, or is not finite there, was given to predict; one "
                "that answers is wanted"
            )

        def flat(x: Tensor) -> Tensor:
            return readings(x).reshape(len(x), -1)

        if problem.method == "forward":
            J = forward(flat, x[None, :m])[1][0]
        else:
            bounds = (end[..., :m] for end in parameters.bounds(x[None]))
            J = difference(
                flat, x[None, :m], problem.steps(x[None])[:, :m], *bounds, y.flatten()[None]
            )[1][0]
    return y, torch.nn.functional.pad(J, (0, len(x) - m)).reshape(*y.shape, len(x))


def _reader(
    problem: FitProblem, model: Any, sensor: Any, times: Any, experiment: str | None
) -> Callable[[Tensor], Tensor]:
    """theta (N, p) -> readings (N, ...), NaN of samples that failed."""
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
        y, status = with_status(model(problem.parameters.given(theta, experiment)), len(theta))
        if isinstance(y, Solution):
            if sensor is None:
                raise ValueError(
                    "a model that gave a Solution was given to predict without a sensor; sensor= "
                    "of tb.sensors is wanted"
                )
            status = y.status if status is None else torch.where(status == 0, y.status, status)
            y = observe(y, sensor, y.t if times is None else times).movedim(0, 1)
        elif sensor is not None or times is not None:
            raise ValueError(
                "a sensor or times were given to predict with a model that gave a "
                f"{type(y).__name__}; one that gives a Solution is wanted"
            )
        if not isinstance(y, Tensor) or not y.ndim or len(y) != len(theta):
            given = (
                f"a tensor {tuple(y.shape)}" if isinstance(y, Tensor) else f"a {type(y).__name__}"
            )
            raise ValueError(
                f"a model that gave {given} for {len(theta)} samples was given to predict; a "
                f"tensor ({len(theta)}, ...) or a Solution is wanted"
            )
        return (
            y
            if status is None
            else torch.where((status == 0).reshape(-1, *[1] * (y.ndim - 1)), y, torch.nan)
        )

    return read
