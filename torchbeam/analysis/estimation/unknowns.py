"""Unknowns: what a filter estimates beside the motion, how it goes on by itself, and which numbers
of the whole vector each is.

x = [z; parameters; offsets of readings; forces; readings on their way]
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.distributions import LogNormal, Normal

from ...core.arguments import function, instance, number
from ...core.validation import as_tensor, positive, refusal, shown
from ...math.shapes import broadcast_shapes
from ...scene.scene import Scene
from ..identification.parameter import Parameter
from ..identification.parameters import Parameters
from .instruments import of_each

UNSEEN = 0.98  # of its first deviation: a parameter of which the readings have said nothing


class Slopes(NamedTuple):
    """Derivatives by motion z (..., r, n), parameters (..., r, p) and inputs (..., r, inputs)."""

    motion: Tensor
    parameters: Tensor
    inputs: Tensor

    def rows(self, which: slice) -> Slopes:
        return Slopes(*(slope[..., which, :] for slope in self))


@dataclass(frozen=True)
class Unknowns:
    """Unknown parameters, offsets and forces, each with a first deviation.

    parameters  `Parameters`, or None; their coordinates are searched
    names    of all that is estimated beside z, in the order of x
    start    (k,) of x behind z;  deviation (k,) at first
    stays    (k,) share that is left of each after an interval;  added (k,) deviation of what comes
             on top of it in an interval
    biased   readings that have an offset;  forced (inputs,) bool: columns of the inputs that are
             estimated;  white (inputs,) deviation of those that are new in each interval
    """

    parameters: Parameters | None
    names: tuple[str, ...]
    start: Tensor
    deviation: Tensor
    stays: Tensor
    added: Tensor
    biased: Tensor
    forced: Tensor
    white: Tensor

    @classmethod
    def of(
        cls,
        parameters: Mapping[str, Any] | None,
        walk: Mapping[str, Any] | None,
        bias: Any,
        labels: tuple[str, ...],
        process: Mapping[str, Any] | None,
        inputs: dict[str, int],
        dt: float,
        like: Tensor,
    ) -> Unknowns:
        """Raises ValueError for what is of another form, negative, or of no such name."""
        known = Parameters.of(parameters, False, None, None, (), like) if parameters else None
        names: list[str] = [] if known is None else list(known.names)
        p = len(names)
        deviation = _deviations(known, like) if known is not None else like.new_zeros(0)
        steps = like.new_zeros(p)
        for name, value in by_name("walk", walk).items():
            places = [e.place for e in known.entries if e.name == name] if known else []
            if not places:
                raise refusal(f"walk of {name!r}", f"one of {', '.join(names) or 'no parameter'}")
            steps[places[0]] = math.sqrt(dt) * _size(f"walk of {name!r}", value, like)
        offsets = of_each("bias", _size("bias", bias, like), len(labels), like)
        biased = (offsets > 0).nonzero()[:, 0]
        names += [f"offset of {labels[i]}" for i in biased.tolist()]
        forced, white, stays, amounts = [], [], [], []
        process = by_name("process", process)
        if lost := set(process) - set(inputs):
            raise ValueError(
                f"process of {', '.join(map(repr, sorted(lost)))} was given; names of inputs of "
                f"the scene ({', '.join(map(repr, inputs)) or 'it has none'}) are wanted"
            )
        for name, size in inputs.items():
            amount, time = _process(name, process.get(name, 0.0))
            amount = of_each(f"process of {name!r}", _size("process", amount, like), size, like)
            lasts = time > 0
            forced += [bool(a) and lasts for a in amount.tolist()]
            white.append(torch.zeros_like(amount) if lasts else amount)
            for i in range(size if lasts else 0):
                if amount[i] > 0:
                    names.append(name if size == 1 else f"{name}[{i}]")
                    stays.append(math.exp(-dt / time))
                    amounts.append(amount[i].item())
        stay, amount = like.new_tensor(stays), like.new_tensor(amounts)
        fixed = like.new_ones(p + len(biased))
        none = like.new_zeros(len(biased))
        coordinates = like.new_zeros(0) if known is None else known.x[0].to(like)
        start = torch.cat((coordinates, none, torch.zeros_like(stay)))
        deviation = torch.cat((deviation, offsets[biased], amount))
        added = torch.cat((steps, none, amount * (1 - stay**2).sqrt()))
        acts = torch.tensor(forced, dtype=torch.bool, device=like.device)
        fresh, stay = torch.cat(white) if white else like.new_zeros(0), torch.cat((fixed, stay))
        return cls(known, tuple(names), start, deviation, stay, added, biased, acts, fresh)

    @property
    def of_model(self) -> int:
        return 0 if self.parameters is None else len(self.parameters.names)

    def acting(self, x: Tensor, inputs: Tensor) -> Tensor:
        """Inputs (..., inputs) with the forces among the unknowns x (..., k)."""
        forces = x[..., len(self.names) - int(self.forced.sum()) :]
        lead = broadcast_shapes(forces.shape[:-1], inputs.shape[:-1])
        return inputs.expand(*lead, -1).index_add(
            -1, self.forced.nonzero()[:, 0], forces.expand(*lead, -1)
        )

    def with_offsets(self, readings: Tensor, x: Tensor) -> Tensor:
        """Readings (..., m) with the offsets among the unknowns x (..., k)."""
        offsets = x[..., self.of_model : self.of_model + len(self.biased)]
        lead = broadcast_shapes(offsets.shape[:-1], readings.shape[:-1])
        return readings.expand(*lead, -1).index_add(-1, self.biased, offsets.expand(*lead, -1))

    def by(self, slopes: Slopes) -> Tensor:
        """(..., r, n + k + white ones): by z, the unknowns, and a deviation of each new force."""
        white = self.white > 0
        offsets = slopes.parameters.new_zeros(*slopes.parameters.shape[:-1], len(self.biased))
        fresh = slopes.inputs[..., white] * self.white[white]
        return torch.cat(
            (slopes.motion, slopes.parameters, offsets, slopes.inputs[..., self.forced], fresh), -1
        )

    def theta(self, x: Tensor) -> Tensor:
        """Parameters (..., p) of their coordinates, the first of x (..., k)."""
        return self.parameters.transform.theta(x[..., : self.of_model])

    def given(self, coordinates: Tensor) -> dict[str, Tensor]:
        """What a scene takes: name -> (..., *shape) of coordinates (..., p)."""
        theta = self.theta(coordinates)
        return {
            e.name: theta[..., e.place].reshape((*theta.shape[:-1], *e.shape))
            for e in self.parameters.entries
        }

    def unseen(self, deviation: Tensor) -> tuple[str, ...]:
        """Names of what the readings have said nothing of, in any sample; deviation (..., k)."""
        share = torch.atleast_2d(deviation / self.deviation).flatten(0, -2)
        unseen = (share > UNSEEN).any(0) & (self.deviation > 0) & (self.added == 0)
        return tuple(n for n, lost in zip(self.names, unseen.tolist(), strict=True) if lost)


def _size(name: str, value: Any, like: Tensor) -> Tensor:
    return positive(name, as_tensor(value, like.dtype, like.device), zero=True)


def _process(name: str, value: Any) -> tuple[Any, float]:
    """Deviation of a force, and the time (s) over which it changes; 0 = new in each interval."""
    if not (isinstance(value, tuple) and len(value) == 2):
        return value, 0.0
    time = number(f"the time of process {name!r}", value[1], infinite=True)
    if not time > 0:
        raise refusal(f"process of {name!r} over {time:g} s", "a time")
    return value[0], time


def by_name(argument: str, value: Any) -> Mapping[str, Any]:
    """What an argument says of each name; None = of none."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise refusal(f"{argument} = {shown(value)}", "a mapping name -> value")
    return value


def with_priors(parameters: Mapping[str, Any] | None) -> dict[str, Parameter]:
    """Each as a `Parameter` with a prior; (mean, deviation) is a normal one."""
    found = {}
    for name, one in by_name("parameters", parameters).items():
        if isinstance(one, tuple) and len(one) == 2:
            mean, deviation = (as_tensor(x, torch.float64) for x in one)
            one = Parameter(
                mean, prior=Normal(mean, positive(f"the deviation of {name}", deviation))
            )
        if not isinstance(one, Parameter) or one.prior is None:
            raise refusal(
                f"parameters[{name!r}] = {shown(one)}",
                "(mean, deviation), or a tb.Parameter with a prior,",
            )
        found[name] = one
    return found


def mean_scene(scene: Any, parameters: Mapping[str, Any]) -> Scene:
    """That of the parameters' means."""
    if isinstance(scene, Scene):
        if parameters:
            raise ValueError(
                "parameters were given beside a Scene; a function parameters -> Scene is wanted"
            )
        return scene
    if callable(scene) and not parameters:
        raise refusal(
            "a function of parameters without parameters=", "parameters=, or the Scene itself,"
        )
    if not callable(scene):
        raise refusal(f"scene = {shown(scene)}", "a Scene, or a function of `parameters`,")
    means = {name: one.start for name, one in parameters.items()}
    made = function("scene", scene, "parameters")(means)
    return instance("what scene gives", made, Scene)


def _deviations(known: Parameters, like: Tensor) -> Tensor:
    """(p,) of the coordinates, by the priors."""
    parts, slope = [], known.transform.slope(known.x[0])
    for e in known.entries:
        log = known.transform.log[e.place]
        if isinstance(e.prior, LogNormal) and bool(log.all()):
            spread = e.prior.scale
        else:
            spread = torch.as_tensor(e.prior.stddev).to(slope) / slope[e.place].reshape(e.shape)
        parts.append(torch.as_tensor(spread).to(like).expand(e.shape).reshape(e.size))
    return torch.cat(parts)


def rows_of(name: str, value: Any, readings: Tensor) -> Any:
    """What is given of each of the readings (K, ..., m); None = nothing."""
    if value is None:
        return [None] * len(readings)
    value = as_tensor(value, readings.dtype, readings.device)
    if not value.ndim or len(value) != len(readings):
        raise refusal(
            f"{name} of shape {tuple(value.shape)}", f"{len(readings)} rows, as readings,"
        )
    return value
