"""SensorFrame: the axes in which instruments read, against those of the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from ..core.validation import Value, as_tensor, axis_last, common_dtype, finite, rotations, shown
from ..math import quaternions as quat
from .sensor import Component, OfSensor, Sensor, Stack

FIELDS = ("origin", "tilt")  # that may be parameters


@dataclass(frozen=True, eq=False)
class SensorFrame:
    """A rigid transform from frame a, the model's axes, to the axes of an instrument.

    A point x is read as R^T (x - origin), a vector (displacement, velocity, spin, acceleration) as
    R^T v, with R = rotation exp(tilt).

    Args:
        origin: (..., 3) m, frame a, of the sensors' frame; or the name of a parameter (3,)
        rotation: (..., 3, 3), the intended axes of the sensors as columns, frame a; None = frame
            a's axes
        tilt: (..., 3) rad, a rotation vector in the sensors' axes, the deviation from the intended
            axes; or the name of a parameter (3,)

    A tilt is identified from gravity and the beam, which are not given in the sensors' axes. An
    origin is distinguished from the `point` of a marker only as far as its section turns.

    Raises:
        ValueError: for a matrix that is no rotation, or names that are no text.

    Examples:
        >>> mocap = tb.SensorFrame(rotation=[[0, 0, 1.0], [1, 0, 0], [0, 1, 0]], tilt="tilt")
        >>> seen = mocap.of(tb.sensors.TipPosition(), {"tilt": torch.zeros(3)})
        >>> seen(solution.state)[-1]  # m, the beam's x is the third
        tensor([0.0000, 0.2189, 0.9703])
    """

    origin: Value | str = (0.0, 0.0, 0.0)
    rotation: Value | None = None
    tilt: Value | str | None = None

    def __post_init__(self) -> None:
        for name in FIELDS:
            value = getattr(self, name)
            if value is not None and not isinstance(value, str):
                value = as_tensor(value, *common_dtype(value))
                object.__setattr__(self, name, finite(name, axis_last(name, value, 3)))
        if self.rotation is not None:
            rotation = as_tensor(self.rotation, *common_dtype(self.rotation))
            object.__setattr__(self, "rotation", rotations("rotation", rotation))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that it needs."""
        return tuple(v for v in (self.origin, self.tilt) if isinstance(v, str))

    def of(self, sensor: Sensor, parameters: Mapping[str, Tensor] | None = None) -> Sensor:
        """The sensor as it reads in these axes, with `parameters` (..., 3) by name."""
        named = {n: getattr(self, n) for n in FIELDS if isinstance(getattr(self, n), str)}
        if named:
            values = parameters or {}
            return replace(self, **{n: values[name] for n, name in named.items()}).of(sensor)
        if isinstance(sensor, Component):
            return Component(self.of(sensor.of), sensor.which)
        if isinstance(sensor, Stack):
            return Stack([self.of(part) for part in sensor.sensors])
        kind = getattr(sensor, "transforms_as", None)
        if kind is None:
            raise ValueError(
                f"a SensorFrame was given with {shown(sensor)}, whose reading is no point or "
                "vector of frame a; tb.sensors.Position, NodeVelocity, ... are wanted"
            )
        return _InFrame(sensor, self, kind)


@dataclass(frozen=True, eq=False, repr=False)
class _InFrame(OfSensor):
    """A sensor's reading in the axes of a frame whose numbers are all known."""

    of: Sensor
    frame: SensorFrame
    kind: str

    labels = property(lambda self: self.of.labels)

    def read(self, state: Any) -> Tensor:
        reading, frame = self.of(state), self.frame
        if self.kind == "point":
            reading = reading - frame.origin.to(reading)
        if frame.rotation is not None:
            reading = (frame.rotation.to(reading).mT @ reading[..., None])[..., 0]
        if frame.tilt is None:
            return reading
        return quat.rotate(quat.exponential(-frame.tilt.to(reading)), reading)
