"""Measurement: what an instrument recorded, with its noise, clock, gain, offset, drift and hum."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import boolean, choice, count, number
from ...core.summary import span
from ...core.validation import Value, as_tensor, common_dtype, finite, positive, refusal, shown
from ...sensors import Sensor
from ...sensors.observe import observe
from ...sensors.sensor_frame import SensorFrame
from ...state.state import State
from .losses import LOSSES
from .slow_baseline import SlowBaseline

NOISES = ("white", "ar1", "repeats", "blocks")
LEAST_BLOCKS = 6  # to know a deviation by
CLOCKS = ("delay", "clock")  # numbers, or names of parameters


@dataclass(frozen=True, eq=False)
class Measurement:
    """Values of an instrument with one or more channels.

    Args:
        values: (times, *channels) in the unit of the model's readings, or of any shape without
            times; NaN = missing. None = not yet measured, for `tb.design`: readings of the sensor
            are (times, size). `dataclasses.replace(measurement, values=...)` adds them later
        sigma: standard deviation of the noise, in that unit; it broadcasts with `values`: a number,
            or (channels,). None = unknown: estimated from the misfit, in common or for each channel
            (`noise` of `identify`)
        times: (times,) s by the instrument's clock, in any order
        sensor: of tb.sensors, or a function of states. The model may then return a `Solution`,
            which `tb.observe` reads, or without times an equilibrium `State` (N, ...)
        place: field of the sensor -> name of its parameter: {"station": "s", "point": "p"} of
            `tb.sensors.Position`
        frame: axes of the sensor; some of their numbers may be parameters
        rate: True: the values are the rate of the sensor; for a velocity, the acceleration
        delay: s, lag of the readings; or the name of its parameter
        clock: relative error of the clock, or the name of its parameter: while the clock counts t,
            (1 + clock) t pass
        offset: each channel adds a constant to the true value, a further parameter
        drift: each channel adds a straight line, per s, or per length of the series without times:
            a further parameter
        name: in sentences and pictures; None = the sensor's name
        noise: "white": independent from reading to reading. "ar1": an autoregression of first order
            along each channel. Its correlation rho between consecutive readings is estimated
            (rho^(dt/step) over dt, step the median). "repeats": each experiment repeats the others,
            two at least; deviations count experiments. "blocks": noise, or error of the model, with
            a correlation over time. Deviations count blocks of times, longer than this correlation
            (`interval` of method "laplace", `predict`). Without times they count places along the
            first axis (poses)
        loss: None = squares. "huber", "student": large residuals (outliers) have less weight:
            Huber's loss, or Student's with four degrees of freedom. Without sigma their scale is
            estimated
        baseline: function of times (times,) s that returns (times,), or (times, k) for k shapes.
            Each channel adds a multiple of each shape, a further parameter: for slow errors of a
            known shape, such as creep ln(1 + t/t_0). Or a `SlowBaseline`, for any smooth error
        hum: Hz, frequency of a wave that each channel adds, such as the mains: a number, or the
            name of its parameter, or several. Amplitudes of cosine and sine, from time 0 of the
            instrument's clock, are further parameters, which cost no evaluations
        gain: reading over true value, before offset, drift and hum: a number, or a number for each
            channel, or the name of its parameter. With an unknown force or amplitude, the data
            determine the product alone: the gain then needs a prior, from the data sheet

    Examples:
        >>> times = torch.linspace(0, 0.1, 6)
        >>> data = tb.Measurement(
        ...     solution.tip.position[..., 2:],
        ...     sigma=1e-4,
        ...     times=times,
        ...     sensor=tb.sensors.TipPosition()["z"],
        ... )
        >>> model = lambda p: tb.simulate(
        ...     tb.Scene(
        ...         beam,
        ...         [
        ...             tb.TipLoad(force=p["F"][..., None] * torch.tensor([0, 0, 1.0])),
        ...             tb.Damping(0.01),
        ...         ],
        ...     ),
        ...     times,
        ...     step=0.01,
        ... )
        >>> tb.identify(model, data, {"F": 1.5}).theta  # N
        tensor([2.0000])
    """

    values: Any = None
    sigma: Any = None
    times: Any = None
    sensor: Sensor | Callable[[Any], Tensor] | None = None
    rate: bool = False
    delay: Value | str = 0.0
    clock: Value | str = 0.0
    offset: bool = False
    drift: bool = False
    name: str | None = None
    fitted: int = 0
    place: Mapping[str, str] = field(default_factory=dict)
    frame: SensorFrame | None = None
    noise: str = "white"
    baseline: Callable[[Tensor], Tensor] | None = None
    loss: str | None = None
    hum: Any = ()
    gain: Value | str = 1.0

    def __post_init__(self) -> None:
        choice("noise", self.noise, NOISES)
        choice("loss", self.loss, LOSSES)
        if self.loss and self.noise in ("repeats", "blocks"):
            raise ValueError(
                f"loss={self.loss!r} was given with noise={self.noise!r}, whose blocks count "
                "squares; 'white' or 'ar1' is wanted"
            )
        given = self._unmeasured() if self.values is None else self.values
        if isinstance(given, Tensor) and given.is_complex():
            raise refusal(f"complex {self._of}", "real ones, as shape.real of modes,", were=True)
        dtype, device = common_dtype(given)
        values = as_tensor(given, dtype, device).detach()
        if values.isinf().any():
            raise ValueError(
                f"{self._of} hold infinite numbers; finite ones are wanted, and NaN where "
                "nothing was measured"
            )
        object.__setattr__(self, "values", values)
        for name in ("rate", "offset", "drift"):
            boolean(name, getattr(self, name))
        count("fitted", self.fitted, least=0)
        if self.sigma is not None:
            sigma = positive("sigma", as_tensor(self.sigma, dtype, device)).detach()
            try:
                sigma = sigma.expand(values.shape)
            except RuntimeError:
                raise ValueError(
                    f"sigma of shape {tuple(sigma.shape)} was given for {self._of} of shape "
                    f"{tuple(values.shape)}; one that broadcasts is wanted"
                ) from None
            object.__setattr__(self, "sigma", sigma)
        if self.times is not None:
            times = finite("times", as_tensor(self.times, dtype, device)).detach()
            if times.ndim != 1 or not values.ndim or len(times) != len(values):
                raise ValueError(
                    f"times of shape {tuple(times.shape)} were given for {self._of} of shape "
                    f"{tuple(values.shape)}; (times,) for values (times, ...) are wanted"
                )
            object.__setattr__(self, "times", times)
        if self.noise == "blocks" and (not values.ndim or len(values) < LEAST_BLOCKS):
            raise ValueError(
                f"noise='blocks' was given with {self._of} of shape {tuple(values.shape)}; "
                f"{LEAST_BLOCKS} times, or poses, at least are wanted"
            )
        at = torch.arange(len(values)) if self.times is None and values.ndim else self.times
        if self.noise == "ar1" and (at is None or len(at.unique()) < len(at)):
            raise ValueError(
                f"noise='ar1' was given with {self._of} "
                f"{'of one number' if at is None else 'of which two have one time'}; readings one "
                "after the other are wanted"
            )
        object.__setattr__(self, "hum", _frequencies(self.hum))
        for name, given in (("baseline", self.baseline is not None), ("hum", self.hum)):
            if given and self.times is None:
                raise ValueError(f"a {name} was given without times; times=(times,) are wanted")
        if self.drift and isinstance(self.baseline, SlowBaseline):
            raise ValueError(
                "drift=True was given beside a SlowBaseline, which has one; drift=False is wanted"
            )
        self._check_sensor()
        for name in CLOCKS:
            if not isinstance(value := getattr(self, name), str):
                object.__setattr__(self, name, finite(name, as_tensor(value, dtype, device)))
        if not isinstance(self.gain, str):
            object.__setattr__(self, "gain", self._known_gain(dtype, device))
        late = [n for n in CLOCKS if isinstance(v := getattr(self, n), str) or (v != 0).any()]
        if (self.sensor is None or self.times is None) and (late or self.rate):
            what = " and ".join([*late, *["rate"] * self.rate])
            raise ValueError(
                f"{what} was given to a Measurement without "
                f"{'a sensor' if self.sensor is None else 'times'}, by which a Solution is read; "
                f"{'sensor' if self.sensor is None else 'times'}=... is wanted"
            )

    def _unmeasured(self) -> Tensor:
        """NaN for each reading of the sensor."""
        if not isinstance(self.sensor, Sensor):
            raise refusal(
                "a Measurement without values, and without one of tb.sensors,", "either of them"
            )
        times = () if self.times is None else as_tensor(self.times, *common_dtype(self.times)).shape
        return torch.full((*times, self.sensor.size), torch.nan)

    def _known_gain(self, dtype: torch.dtype, device: torch.device) -> Tensor:
        """The gain that was given, one number or of the channels' shape."""
        gain = finite("gain", as_tensor(self.gain, dtype, device))
        if gain.shape not in ((), self.channels):
            raise ValueError(
                f"a gain of shape {tuple(gain.shape)} was given for {self._of} of shape "
                f"{tuple(self.values.shape)}; a number, or one for each channel "
                f"{tuple(self.channels)}, is wanted"
            )
        if (gain == 0).any():
            raise refusal("a gain of 0, which reads nothing,", "another")
        return gain

    def check_measured(self) -> None:
        """ValueError where nothing was measured."""
        if self.values.isnan().all():
            raise ValueError(
                f"{self._of} of {self.values.numel()} numbers, all NaN, were given; some that were "
                "measured are wanted"
            )

    def _check_sensor(self) -> None:
        """Place and frame fit the sensor."""
        if not isinstance(self.place, Mapping) or not all(
            isinstance(name, str) for pair in self.place.items() for name in pair
        ):
            raise refusal(
                f"place = {shown(self.place)}",
                "the name of a parameter by that of the sensor's field",
            )
        if not isinstance(self.frame, (SensorFrame, type(None))):
            raise refusal(f"frame = {shown(self.frame)}", "a torchbeam.SensorFrame")
        if not self.place and self.frame is None:
            return
        if not isinstance(self.sensor, Sensor):
            raise ValueError(
                f"place or frame were given with the sensor {shown(self.sensor)}; one of "
                "tb.sensors is wanted"
            )
        own = [f.name for f in fields(self.sensor) if f.init] if is_dataclass(self.sensor) else []
        if wrong := [f for f in self.place if f not in own]:
            raise ValueError(
                f"place of {shown(wrong[0])} was given; {self.sensor.name} has {', '.join(own)}"
            )

    @classmethod
    def of(cls, data: Any, sigma: Any) -> Measurement:
        """Of bare data, or as it is."""
        if isinstance(data, Measurement):
            if sigma is not None:
                raise ValueError(
                    "sigma was given beside a Measurement; Measurement(values, sigma=...) is wanted"
                )
            return data
        return cls(data, sigma)

    def __repr__(self) -> str:
        values, times = self.values, self.times
        over = "" if times is None else f" at {span(times)} s"
        read = span(values[~values.isnan()])
        return f"Measurement({self._of}: {tuple(values.shape)} numbers, {read}{over})"

    @property
    def _of(self) -> str:
        return "data" if self.name is None else f"data of {self.name!r}"

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of parameters that it wants."""
        named = (self.delay, self.clock, self.gain, *self.hum, *self.place.values())
        return (
            *(v for v in named if isinstance(v, str)),
            *(() if self.frame is None else self.frame.parameters),
        )

    @property
    def channels(self) -> torch.Size:
        """Their shape: that of the values behind times, or poses."""
        along = self.times is not None or self.values.ndim > 1
        return self.values.shape[1:] if along else torch.Size()

    @property
    def labels(self) -> tuple[str, ...]:
        """One for each channel."""
        channels = self.channels.numel()
        of = isinstance(self.sensor, Sensor) and self.sensor.size == channels
        name = self.name or (self.sensor.name if of else "")
        if channels == 1:
            return (name,)
        return tuple(
            f"{name} {label}".strip()
            for label in (self.sensor.labels if of else map(str, range(channels)))
        )

    def read(self, solution: Any, parameters: Mapping[str, Tensor] | None = None) -> Tensor:
        """Readings (N, *values.shape) of a solution of N samples, or of an equilibrium state (N,
        ...). `parameters` are (N, ...) by name, if delay, clock, gain, place or frame name any.

        Raises:
            ValueError: for a missing parameter, and a solution that does not fit.
        """
        if self.sensor is None or (self.times is None) is not isinstance(solution, State):
            raise ValueError(
                f"a model that gave a {type(solution).__name__} was given with data "
                f"{'without' if self.sensor is None else 'with'} a sensor and "
                f"{'without' if self.times is None else 'with'} times; "
                "tb.Measurement(values, times=..., sensor=...) is wanted for a Solution, "
                "tb.Measurement(values, sensor=...) for a State"
            )
        for name in self.parameters:
            if name not in self.hum and name not in (parameters or {}):
                raise ValueError(
                    f"read() of a Measurement with the parameter {name!r} was asked for without "
                    f"it; parameters={{{name!r}: (N, ...)}} is wanted"
                )
        if isinstance(solution, State):
            readings = self.sensor_of(parameters, solution.position.ndim - 3)(solution)
            return self.scaled(self._shaped(readings, readings.ndim - 1), parameters)
        delay, clock = (
            parameters[v] if isinstance(v, str) else v for v in (self.delay, self.clock)
        )
        times = self.times * (1 + clock) if not clock.ndim else self.times[:, None] * (1 + clock)
        sensor = self.sensor_of(parameters)
        readings = observe(solution, sensor, times, delay=delay, rate=self.rate)
        if readings.ndim < 2:
            raise refusal(
                "a model that gave a Solution without batch axes",
                "one sample for each row of theta",
            )
        return self.scaled(self._shaped(readings.movedim(0, 1), readings.ndim - 1), parameters)

    def scaled(self, readings: Tensor, parameters: Mapping[str, Tensor] | None) -> Tensor:
        """What is there (N, ..., *channels), times the gain. Raises ValueError for a parameter that
        has neither one number nor one for each channel, and for readings of other channels.
        """
        gain, channels = self.gain, self.channels
        if isinstance(gain, str):
            gain = parameters[gain]
            if gain[0].numel() != 1 and gain.shape[1:] != channels:
                raise refusal(
                    f"the gain {self.gain!r} of shape {tuple(gain.shape[1:])}",
                    f"one number, or one for each channel {tuple(channels)},",
                )
            own = gain.shape[1:] if gain[0].numel() > 1 else ()
            gain = gain.reshape(len(gain), *(1,) * (readings.ndim - 1 - len(own)), *own)
        else:
            own = gain.shape
        if own and readings.shape[readings.ndim - len(own) :] != channels:
            raise ValueError(
                f"a model that gave {tuple(readings.shape)} was given for channels "
                f"{tuple(channels)}, each with its gain; (N, ..., *channels) is wanted"
            )
        return readings * gain

    def _shaped(self, readings: Tensor, axes: int) -> Tensor:
        """Readings (N, ...) of the shape of the values, where they are as many."""
        if axes and readings[0].numel() == self.values.numel():
            return readings.reshape(len(readings), *self.values.shape)
        return readings

    def sensor_of(self, parameters: Mapping[str, Tensor] | None, axes: int = 0) -> Any:
        """The sensor at its place and in its frame, by parameters (N, ...), for states with so many
        axes behind that of the samples.
        """
        names = {*self.place.values(), *(() if self.frame is None else self.frame.parameters)}
        changes = {
            n: v.reshape(len(v), *(1,) * axes, *v.shape[1:])
            for n, v in (parameters or {}).items()
            if n in names
        }
        sensor = self.sensor
        if self.place:
            sensor = replace(sensor, **{f: changes[name] for f, name in self.place.items()})
        return sensor if self.frame is None else self.frame.of(sensor, changes)


def _frequencies(hum: Any) -> tuple[float | str, ...]:
    """Hz, or names of parameters, of what was given as hum."""
    every = tuple(hum) if isinstance(hum, (tuple, list)) else (hum,)
    for m in every:
        if not isinstance(m, str) and not 0 < number("hum", m) < math.inf:
            raise refusal(f"hum = {shown(m)}", "a positive frequency, Hz, or a parameter's name,")
    if len(set(every)) < len(every):
        raise refusal(f"hum = {shown(hum)}", "each frequency once")
    return every


def several(data: Any) -> bool:
    """Whether data of one experiment are a list with at least one `Measurement` in it."""
    return isinstance(data, (list, tuple)) and any(isinstance(item, Measurement) for item in data)


def each(data: Any) -> list[Any]:
    """Data of one experiment, one by one."""
    return list(data) if several(data) else [data]


def sigma_given(measurements: Iterable[Measurement]) -> bool:
    """Whether they have sigma. Raises ValueError where some have and others have not."""
    if len(known := {m.sigma is not None for m in measurements}) > 1:
        raise refusal("measurements with sigma and without", "all or none", were=True, are=True)
    return known == {True}
