"""Experiments: models, and what was measured of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import function as check_function
from ...core.validation import concrete
from ...solvers.least_squares import OtherShape
from ...state.solution import Solution
from ...state.state import State
from .measurement import Measurement, each, several
from .parameters import Parameters
from .smoothness import SmoothnessRows

NO_DATA = "data of no experiment were given; one at least is wanted"
# theta -> y (N, ...), Solution, (y, status (N,)); or a tuple of y, one for each measurement
Model = Callable[[Any], Any]


@dataclass(frozen=True)
class Experiment:
    """A model and what was measured of it; `single`: its data were given as one."""

    name: str | None
    model: Model
    measurements: tuple[Measurement, ...]
    single: bool

    @property
    def measured(self) -> bool:
        """Whether its readings are data, and not rows of a prior."""
        return not isinstance(self.model, SmoothnessRows)

    def values(self, parameters: Parameters, theta: Tensor) -> Tensor:
        """Readings (N, numbers) of all its measurements, in a row; NaN of samples that failed."""
        given = parameters.given(theta, self.name)
        y, status = with_status(self.model(given), len(theta))
        named = given if isinstance(given, dict) else None
        if isinstance(y, (Solution, State)):
            status = status_of(y, status)
            parts = [m.read(y, named) for m in self.measurements]
        else:
            parts = [y] if self.single else y
            if unused := [m for m in self.measurements if m.sensor is not None]:
                name = f" ({unused[0].name!r})" if unused[0].name else ""
                raise OtherShape(
                    f"a model that gave a {type(y).__name__} was given with a Measurement that has "
                    f"a sensor{name}, by which a Solution or a State is read; a model that gives "
                    "one is wanted, or a Measurement without a sensor"
                )
        wanted = [(len(theta), *m.values.shape) for m in self.measurements]
        if not isinstance(parts, (list, tuple)) or not all(
            isinstance(part, Tensor) for part in parts
        ):
            raise OtherShape(
                f"a model that gave a {type(y).__name__} was given; a tensor "
                f"{wanted[0]}{'' if self.single else ' and so on, one for each measurement,'} or a "
                "Solution is wanted"
            )
        of = f"{len(theta)} samples" if parameters.by_name else f"theta {tuple(theta.shape)}"
        for part, shape in zip(parts, wanted, strict=False):
            if tuple(part.shape) != shape:
                raise OtherShape(
                    f"a model that gave {tuple(part.shape)} for {of} was given; {shape} is wanted"
                )
        if len(parts) != len(wanted):
            raise OtherShape(
                f"a model that gave {len(parts)} tensors was given for {len(wanted)} measurements"
            )
        parts = [  # a sensor has read with it
            m.scaled(part, named) if m.sensor is None else part
            for m, part in zip(self.measurements, parts, strict=True)
        ]
        values = torch.cat([part.reshape(len(theta), -1) for part in parts], -1).to(theta.dtype)
        if status is None or not (concrete(status) != 0).any():
            return values
        if tuple(status.shape) != (len(theta),):
            raise OtherShape(
                f"a model that gave a status {tuple(status.shape)} was given; ({len(theta)},) is "
                "wanted"
            )
        return torch.where((status == 0)[:, None], values, torch.nan)


def experiments_of(model: Any, data: Any, sigma: Any) -> tuple[Experiment, ...]:
    """Experiments of what `identify` was given: one model and data, or both by names."""
    if not isinstance(data, Mapping):
        if isinstance(model, Mapping):
            raise ValueError(
                "models by name were given with data without names; data by the same names are "
                "wanted"
            )
        return (_experiment(None, model, data, sigma),)
    if not data:
        raise ValueError(NO_DATA)
    if isinstance(model, Mapping) and set(model) != set(data):
        raise ValueError(
            f"models of {', '.join(map(str, model))} and data of {', '.join(map(str, data))} were "
            "given; the same names are wanted"
        )
    sigmas = sigma if isinstance(sigma, Mapping) else dict.fromkeys(data, sigma)
    if wrong := set(sigmas) - set(data):
        raise ValueError(
            f"sigma of {', '.join(map(str, wrong))} was given; there are data of "
            f"{', '.join(map(str, data))}"
        )
    models = model if isinstance(model, Mapping) else dict.fromkeys(data, model)
    return tuple(_experiment(n, models[n], data[n], sigmas.get(n)) for n in data)


def _experiment(name: str | None, model: Any, data: Any, sigma: Any) -> Experiment:
    check_function("a model", model, "theta")
    return Experiment(
        name, model, tuple(Measurement.of(d, sigma) for d in each(data)), not several(data)
    )


def status_of(y: Solution | State, status: Tensor | None) -> Tensor:
    """(N,) of a model's solution or state, and of what it said beside it."""
    own = y.status.flatten(1).amax(-1) if y.status.ndim > 1 else y.status
    return own if status is None else torch.where(status == 0, own, status)


def with_status(given: Any, samples: int) -> tuple[Any, Tensor | None]:
    """y and status of what a model gave."""
    if isinstance(given, tuple) and len(given) == 2 and not hasattr(given, "_fields"):
        y, status = given
        if isinstance(status, Tensor) and not status.is_floating_point():
            return y, status
    return given, None
