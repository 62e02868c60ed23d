"""Instruments: what sensors show at the end of an interval, and with which noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import boolean, function, instance, listed
from ...core.validation import as_tensor, positive, refusal, shown
from ...math.shapes import stacked
from ...scene.scene import Scene
from ...sensors.sensor import Sensor
from ...state.state import State


@dataclass(frozen=True)
class Instruments:
    """sensors  one, several, or (scene, inputs) -> these
    labels   (m,) of the numbers that are read;  noise  (m,) deviation of each
    rates    (m,) bool: whether it is the mean rate over the interval that is read
    """

    sensors: Any
    labels: tuple[str, ...]
    noise: Tensor
    rates: Tensor

    @classmethod
    def of(
        cls, sensors: Any, noise: Any, rate: bool | Sequence[bool], scene: Scene, like: Tensor
    ) -> Instruments:
        """Raises ValueError for what is no sensor, and for noise or rates of another number."""
        each = _sensors(sensors, scene, still(scene))
        rates = [rate] * len(each) if isinstance(rate, bool) else listed(rate)
        if len(rates) != len(each):
            raise ValueError(
                f"rate = {shown(rate)} was given for {len(each)} sensors; one of each is wanted"
            )
        labels, rated = [], []
        for sensor, r in zip(each, rates, strict=True):
            own = sensor.labels if len(sensor.shape) == 1 else map(str, range(sensor.size))
            labels += [f"{'rate of ' * boolean('rate', r)}{sensor.name} {label}" for label in own]
            rated += [r] * sensor.size
        sigma = of_each("noise", noise, len(labels), like)
        return cls(
            sensors, tuple(labels), positive("noise", sigma), torch.tensor(rated).to(like.device)
        )

    @property
    def count(self) -> int:
        return len(self.labels)

    def now(self, scene: Scene, state: State, inputs: dict[str, Tensor]) -> Tensor:
        """(..., m): what the sensors read of a state, under inputs."""
        parts = [sensor.flat(state) for sensor in _sensors(self.sensors, scene, inputs)]
        return stacked(*parts, axis=-1)

    def at_rest(self, scene: Scene, state: State) -> Tensor:
        """(..., m): what is read of a state that has long been so."""
        return self.now(scene, state, still(scene)).where(~self.rates, 0.0)

    def after(
        self, scene: Scene, begin: State, end: State, inputs: dict[str, Tensor], duration: Tensor
    ) -> Tensor:
        """(..., m): what is read at the end of an interval of so many s."""
        readings = self.now(scene, end, inputs)
        if not self.rates.any():
            return readings
        return readings.where(~self.rates, (readings - self.now(scene, begin, inputs)) / duration)


def still(scene: Scene) -> dict[str, Tensor]:
    """Inputs that are zero."""
    return {name: scene.beam.nodes.new_zeros(size) for name, size in scene.inputs.items()}


def of_each(name: str, value: Any, count: int, like: Tensor) -> Tensor:
    """(count,) of one number or as many. Raises ValueError for another number of them."""
    value = as_tensor(value, like.dtype, like.device)
    if value.ndim > 1 or value.numel() not in (1, count):
        raise refusal(f"{name} of shape {tuple(value.shape)}", f"one number, or {count},")
    return value.expand(count)


def _sensors(given: Any, scene: Scene, inputs: dict[str, Tensor]) -> tuple[Sensor, ...]:
    if not isinstance(given, Sensor) and callable(given):
        given = function("sensors", given, "scene", "inputs")(scene, inputs)
    sensors = (given,) if isinstance(given, Sensor) else listed(given)
    for sensor in sensors:
        instance("a sensor", sensor, Sensor)
    if not sensors:
        raise refusal(f"sensors = {shown(given)}", "one or several")
    return sensors
