"""Base of all sensors, and of those that ask what a scene's effects do at the instant of a state;
components of a reading, and stacks of sensors.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..core.arguments import instance, is_integer, listed
from ..core.declared import check_fields
from ..core.leaves import option
from ..core.validation import axis_last, shown
from ..math.shapes import stacked
from ..nodal.coordinates.spatial import Spatial
from ..nodal.discretise import discretise
from ..nodal.loads import Nodes
from ..nodal.model import Model
from ..nodal.moves import remembered
from ..scene.parts import part_of
from ..scene.scene import Scene
from ..state.state_check import of_mesh

XYZ = ("x", "y", "z")


class Sensor:
    """Base of all sensors.

    A subclass has `name`, `unit`, `labels` and `read(state)`, and `shape` if its reading is no
    vector. A dataclass may declare checks of its fields, see `leaf`.

    Attributes:
        on: name of the part of a structure that it is on; None = the whole state is read
        of_part: whether `on` has to name a part of a structure
        transforms_as: "point" or "vector", if the reading is a point or vector in the axes of frame
            a, which a `SensorFrame` turns. None = other axes, or no vector

    Examples:
        >>> class Reach(tb.sensors.Sensor):
        ...     name, unit, labels = "reach", "m", ("reach",)
        ...
        ...     def read(self, state):
        ...         return state.tip.position.norm(dim=-1, keepdim=True)
        >>> Reach()(solution.state)[-1]  # as any other sensor
        tensor([0.9947])
    """

    name: str
    unit: str
    labels: tuple[str, ...]
    on: str | None = None
    of_part: ClassVar[bool] = False
    transforms_as: str | None = None
    called: ClassVar[str] = ""
    in_words: ClassVar[str] = "{1}"  # what sentences call a field

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def shape(self) -> tuple[int, ...]:
        return (len(self.labels),)

    @property
    def size(self) -> int:
        return math.prod(self.shape)

    def __call__(self, state: Any) -> Tensor:
        """(..., *shape). Raises ValueError for what is no state, or has no such node or element."""
        if not hasattr(state, "position"):
            raise ValueError(
                f"{type(state).__name__} was given to a sensor; a state is wanted (of a "
                "solution: solution.state)"
            )
        return self.read(self.seen(state))

    def seen(self, state: Any) -> Any:
        """Part of a state that the sensor reads. Raises ValueError where it has no such part."""
        if self.of_part and self.on is None and (parts := getattr(state, "parts", ())):
            names = ", ".join(repr(part.name) for part in parts)
            raise ValueError(
                f"{self.name} of a structure was asked for; a sensor with on = one of {names} is "
                "wanted"
            )
        return state if self.on is None else part_of_state(state, self.on)

    @property
    def _prefix(self) -> str:
        """The part's name, to begin that of the sensor with."""
        return "" if self.on is None else f"{self.on} "

    def read(self, state: Any) -> Tensor:
        raise NotImplementedError

    def flat(self, state: Any) -> Tensor:
        """The reading as a vector, (..., size)."""
        reading, axes = self(state), len(self.shape)
        return reading if axes == 1 else reading.flatten(-axes)

    def __getitem__(self, which: int | str | slice) -> Component:
        """Some of the numbers, by place, slice or label; always with a last axis."""
        return Component(self, which)

    __iter__ = None  # indexed by labels, and no sequence

    def __repr__(self) -> str:
        return f"{self.name} [{', '.join(self.labels)}] {self.unit}"


def part_of_state(state: Any, name: str) -> Any:
    """The state of a part of a structure. Raises ValueError where there is none such."""
    part_of(getattr(state, "parts", ()), name)
    return state.part(name)


class OfSensor(Sensor):
    """Base of what reads another sensor, its field `of`, otherwise."""

    name = property(lambda self: self.of.name)
    unit = property(lambda self: self.of.unit)


@dataclass(frozen=True, eq=False, repr=False)
class Component(OfSensor):
    """Some numbers of another sensor's reading: `sensor[which]`.

    Examples:
        >>> tb.sensors.TipPosition()["z"](solution.state)[-1]  # m, one component of a sensor
        tensor([0.2189])
    """

    of: Sensor
    which: int | str | slice
    places: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        if not isinstance(self.of, Sensor):
            raise ValueError(f"{shown(self.of)} was given to Component; a sensor is wanted")
        labels, which = self.of.labels, self.which
        if isinstance(which, str):
            if which not in labels:
                raise ValueError(
                    f"the label {which!r} was given; {self.of.name} has {', '.join(labels)}"
                )
            places = (labels.index(which),)
        elif isinstance(which, slice):
            try:
                places = tuple(range(len(labels))[which])
            except (TypeError, ValueError):  # by words, or in steps of 0
                places = ()
            if not places:
                raise ValueError(
                    f"the components {which} were given, none of the {len(labels)} of "
                    f"{self.of.name}; one or more are wanted"
                )
        elif is_integer(which) and -len(labels) <= which < len(labels):
            places = (which % len(labels),)
        else:
            raise ValueError(
                f"the component {shown(which)} was given; {self.of.name} has {len(labels)}: "
                f"{', '.join(labels)}"
            )
        object.__setattr__(self, "places", places)

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(self.of.labels[i] for i in self.places)

    def read(self, state: Any) -> Tensor:
        reading, places = self.of.flat(state), self.places
        step = places[1] - places[0] if len(places) > 1 else 1
        if places and step > 0 and places == tuple(range(places[0], places[-1] + 1, step)):
            return reading[..., places[0] : places[-1] + 1 : step]
        return torch.stack([reading[..., i] for i in places], -1)


@dataclass(frozen=True, eq=False, repr=False)
class Stack(Sensor):
    """Several sensors as one vector, in their order; `split` takes such a vector apart.

    Examples:
        >>> both = tb.sensors.Stack(
        ...     (tb.sensors.TipPosition(), tb.sensors.Gauge(0.05, beam, z=0.001))
        ... )
        >>> both(solution.state).shape, both.labels[-1]
        (torch.Size([6, 4]), 'gauge at 0.05 m strain')
    """

    sensors: Iterable[Sensor]
    name: ClassVar[str] = "sensors"

    def __post_init__(self) -> None:
        object.__setattr__(self, "sensors", listed(self.sensors))
        if not self.sensors:
            raise ValueError("no sensors were given to Stack; at least one is wanted")
        for sensor in self.sensors:
            if not isinstance(sensor, Sensor):
                raise ValueError(f"{shown(sensor)} was given to Stack; sensors are wanted")
        object.__setattr__(self, "vectors", all(len(sensor.shape) == 1 for sensor in self.sensors))

    @property
    def unit(self) -> str:
        return ", ".join(dict.fromkeys(s.unit for s in self.sensors))

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(f"{s.name} {label}" for s in self.sensors for label in s.labels)

    def read(self, state: Any) -> Tensor:
        readings = (s(state) if self.vectors else s.flat(state) for s in self.sensors)
        return stacked(*readings, axis=-1)

    def split(self, vector: Tensor) -> tuple[Tensor, ...]:
        """(..., size) -> each sensor's reading (..., *shape)."""
        parts = axis_last("vector", vector, self.size).split([s.size for s in self.sensors], -1)
        return tuple(p.unflatten(-1, s.shape) for p, s in zip(parts, self.sensors, strict=True))


check_scene = partial(instance, wanted=Scene)


@dataclass(frozen=True, eq=False, repr=False)
class OfScene(Sensor):
    """scene  whose effects they are; `nodes` raises ValueError for a state of another form."""

    scene: Scene = option(check_scene, name="a scene")
    model: Model = field(init=False, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "model", discretise(self.scene))

    def nodes(self, state: Any) -> Nodes:
        """How its nodes move, as loads see them."""
        state = of_mesh(state, self.scene, f"{type(self).__name__}: a state")
        return nodes_of(self.model.space, self.model.space.to_reduced(state))


def nodes_of(space: Spatial, state: Any) -> Nodes:
    """The same of a state in the coordinates of a space."""
    spin = space.to_frame(state.rotation, state.spin)
    motion = state.position, state.rotation, state.velocity, spin
    return Nodes(*motion, state.frame, remembered(state))
