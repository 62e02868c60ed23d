"""Sensors of an environment: `torchbeam.sensors` objects with the scales and bounds by which their
readings are observed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import broadcast_shapes, shown
from torchbeam.extend import quaternions as quat
from torchbeam.sensors import Curvature, NodePosition, NodeVelocity, Sensor, Stack

from .parameters import numbers

NAMES = ("tip", "middle", "gauges", "full")
HIGH = {"displacement": 2, "velocity": 20, "curvature": 40, "rotation": np.pi, "spin": 200}
PLANES = {None: slice(0, 3), "xy": slice(0, 2), "xz": slice(0, 3, 2)}  # components of vectors
NORMAL = {"xy": 2, "xz": 1}


def turns(rotation: Tensor, plane: str | None) -> tuple[slice, slice]:
    """Components of rotations and of bending, in section axes rotation (..., N+1, 4): in a plane
    those about its normal.
    """
    if plane is None:
        return slice(0, 3), slice(1, 3)
    axes = quat.matrix(rotation.detach().reshape(-1, *rotation.shape[-2:])[0, -1])
    about = int(axes[NORMAL[plane]].abs().argmax())
    return (slice(about, about + 1),) * 2


@dataclass(frozen=True, eq=False, repr=False)
class SinceStart(Sensor):
    """The reading of another sensor less that of the state `start`."""

    of: Sensor
    start: tb.State

    def __post_init__(self) -> None:
        for name in ("name", "unit", "labels", "shape"):
            object.__setattr__(self, name, getattr(self.of, name))
        object.__setattr__(self, "first", self.of(self.start))

    shape = ()

    def read(self, state: Any) -> Tensor:
        return self.of(state) - self.first


@dataclass(frozen=True, eq=False, repr=False)
class NodeMotions(Sensor):
    """Of every node but node 0, node by node: displacement (m) since `start`, velocity (m/s),
    rotation vector (rad) since then and spin (rad/s), both in section axes: (..., 12 N); or the
    components of them that change in a plane.
    """

    start: tb.State
    plane: str | None = None
    name = "node motions"
    unit = "m, m/s, rad, rad/s"

    @property
    def labels(self) -> tuple[str, ...]:
        vector, (turn, _) = PLANES[self.plane], turns(self.start.rotation, self.plane)
        parts = (("displacement", vector), ("velocity", vector), ("rotation", turn), ("spin", turn))
        return tuple(
            f"node {i} {what} {axis}"
            for i in range(1, self.start.position.shape[-2])
            for what, part in parts
            for axis in "xyz"[part]
        )

    def read(self, state: Any) -> Tensor:
        start = self.start
        vector, (turn, _) = PLANES[self.plane], turns(start.rotation, self.plane)
        moved = (state.position - start.position)[..., 1:, vector]
        turned = quat.logarithm(
            quat.multiply(quat.conjugate(start.rotation[..., 1:, :]), state.rotation[..., 1:, :])
        )
        turned = turned[..., turn]
        rates = (
            state.velocity[..., 1:, vector].expand_as(moved),
            state.spin[..., 1:, turn].expand_as(turned),
        )
        return torch.cat((moved, rates[0], turned, rates[1]), -1).flatten(-2)


@dataclass(frozen=True)
class Observed:
    """A sensor in an observation: reading / scale, clipped to [-high, high].

    Args:
        sensor: a `torchbeam.sensors` object; or, for readings relative to the start of an episode,
            a function of the start state that returns one
        scale: of one unit of the observation, in the sensor's unit: a number, or one for each
            number of the reading
        high: bound, likewise

    Examples:
        >>> def angle(start):  # of the tip about y
        ...     return tb.sensors.NodeRotation(-1)[1]
        >>> sensors = ("tip", envs.Observed(angle, 1.0, 3.2))
        >>> env = envs.TipReachVectorEnv(2, elements=2, sensors=sensors)
        >>> env.observation_space.shape
        (2, 12)
    """

    sensor: Sensor | Callable[[tb.State], Sensor]
    scale: float | Sequence[float] = 1.0
    high: float | Sequence[float] = 10.0

    def __post_init__(self) -> None:
        if not callable(self.sensor):
            raise ValueError(f"sensor = {shown(self.sensor)} was given; a sensor is wanted")
        for name in ("scale", "high"):
            value = numbers(name, getattr(self, name))
            if not (value > 0).all():
                given = shown(getattr(self, name))
                raise ValueError(f"{name} = {given} was given; positive numbers are wanted")

    def at(self, start: tb.State) -> Sensor:
        return self.sensor if isinstance(self.sensor, Sensor) else self.sensor(start)


class Observer:
    """Observation of the beam: the readings of `Observed` sensors, in the order given, over their
    scales.

    parts  `Observed`, or (`Observed`, kind of each number) with scales that depend on the sub-env
    start  a state that episodes start in, for the sizes

    high   (o,) bounds;  scale (o,), or (num_envs, o) where beams differ;  tip  slice of the tip's
           displacement since the start
    within, None where it is not observed
    """

    def __init__(self, parts: Sequence[tuple[Observed, str]], start: tb.State) -> None:
        self.parts = tuple(part for part, _ in parts)
        sizes = [part.at(start).size for part in self.parts]
        like, lead = start.position, []
        for part, size in zip(self.parts, sizes, strict=True):
            scale = torch.as_tensor(part.scale, dtype=like.dtype, device=like.device)
            lead.append(scale.expand(*scale.shape[:-1], size) if scale.ndim else scale.expand(size))
        shape = broadcast_shapes(*(x.shape[:-1] for x in lead))
        self.scale = torch.cat([x.expand(*shape, x.shape[-1]) for x in lead], -1)
        self.high = np.concatenate(
            [np.broadcast_to(part.high, size) for part, size in zip(self.parts, sizes, strict=True)]
        )
        if (
            not (np.isfinite(self.high) & (self.high > 0)).all()
            or not (torch.isfinite(self.scale) & (self.scale > 0)).all()
        ):
            raise ValueError(
                "a scale or a bound of an Observed sensor that is not positive and finite was given"
            )
        self.high = self.high.astype(np.float32)
        places = np.cumsum([0, *sizes]).tolist()
        self.tip = next(
            (slice(places[i], places[i + 1]) for i, (_, kind) in enumerate(parts) if kind == "tip"),
            None,
        )
        full = next((i for i, (_, kind) in enumerate(parts) if kind == "full"), None)
        if self.tip is None and full is not None:
            nodes = start.position.shape[-2] - 1
            per = sizes[full] // nodes
            d = per // 4 if per == 12 else 2
            self.tip = slice(places[full + 1] - per, places[full + 1] - per + d)
        self._bound: tuple[tb.State | None, bool, Stack | None] = None, False, None

    def sensors(self, start: tb.State) -> Stack:
        """The sensors of episodes that start there: called with a state they give readings (..., o)
        in their own units.
        """
        graph = torch.is_grad_enabled()
        # what was bound without a graph has none
        if self._bound[0] is not start or (graph and not self._bound[1]):
            self._bound = start, graph, Stack([part.at(start) for part in self.parts])
        return self._bound[2]

    def read(self, beam: tb.State, start: tb.State, scale: Tensor | None = None) -> Tensor:
        """(n, o): beam and start with the batch (n,); scale: the rows of `self.scale` that belong
        to them.
        """
        return self.sensors(start)(beam) / (self.scale if scale is None else scale)


def observed_parts(
    names: Sequence[str | Observed], beam: tb.Beam, plane: str | None, length: float, omega: Tensor
) -> list[tuple[Observed, str]]:
    """`Observed` sensors, and their kinds, of the names that a configuration gives; d = 3
    components, or the 2 of `plane`.

    tip     displacement of the tip since the start (d), over the length L; its velocity (d), over L
            omega
    middle  the same of node elements // 2
    gauges  bending curvature (about y and z; in a plane about its normal) of the first element and
            of element elements // 2, since the start, times L: a strain gauge's reading is that
            over L, times its distance from the axis
    full    of every node but the clamped one, node by node: displacement (d) and velocity (d) as
            above, rotation vector since the start in section axes (3, or 1 in a plane), spin
            (likewise) over omega

    beam, length (m), omega (rad/s; (1,) or (num_envs, 1)): of the usual beam.
    """
    vector, (turn, bending) = PLANES[plane], turns(beam.frames, plane)
    d, r = (len(range(*part.indices(3))) for part in (vector, turn))
    speed = length * omega

    def point(row: int, kind: str) -> list[tuple[Observed, str]]:
        node = _node(beam, row)
        return [
            (Observed(partial(_displacement, node, vector), length, HIGH["displacement"]), kind),
            (
                Observed(
                    _part(NodeVelocity(node), vector),
                    speed.expand(*speed.shape[:-1], d),
                    HIGH["velocity"],
                ),
                "",
            ),
        ]

    def gauge(element: int) -> tuple[Observed, str]:
        sensor = _curvature(beam, element)[bending]
        return Observed(partial(SinceStart, sensor), 1 / length, HIGH["curvature"]), ""

    parts: list[tuple[Observed, str]] = []
    for name in names:
        if isinstance(name, Observed):
            parts.append((name, ""))
        elif name in ("tip", "middle"):
            parts += point(-1 if name == "tip" else beam.station_count // 2, name)
        elif name == "gauges":
            parts += [gauge(0), gauge(beam.station_count // 2)]
        else:
            each = [*d * ["displacement"], *d * ["velocity"], *r * ["rotation"], *r * ["spin"]]
            units = {
                "displacement": torch.full_like(omega, length),
                "velocity": speed,
                "rotation": torch.ones_like(omega),
                "spin": omega,
            }
            seen = beam.node_count - 1
            scale = torch.cat(seen * [units[kind] for kind in each], -1)
            high = seen * [HIGH[kind] for kind in each]
            parts.append((Observed(partial(NodeMotions, plane=plane), scale, high), "full"))
    return parts


def _displacement(node: Any, components: slice, start: tb.State) -> Sensor:
    """Of a node since the start."""
    return _part(NodePosition(node, reference=start), components)


def check_names(sensors: Any, form: str) -> tuple[str | Observed, ...]:
    """The sensors of a configuration as a tuple. ValueError for an unknown name, or for gauges and
    full with a form other than "nodal".
    """
    given = (sensors,) if isinstance(sensors, (str, Observed)) else sensors
    names = tuple(given) if isinstance(given, Sequence) else ()
    words = [s for s in names if not isinstance(s, Observed)]
    if not names or any(s not in NAMES for s in words) or len(set(words)) < len(words):
        raise ValueError(
            f"sensors = {shown(sensors)} was given; one or more of {', '.join(map(repr, NAMES))} "
            "or Observed sensors are wanted"
        )
    if form != "nodal" and set(words) & {"gauges", "full"}:
        raise ValueError(
            f"sensors = {shown(sensors)} with form = {shown(form)} was given; that form has 'tip' "
            "and 'middle'"
        )
    return names


def _node(beam: tb.Beam, row: int) -> int | tuple[str, int]:
    """What a sensor calls the node in a row: in a structure (name, number)."""
    if not beam.parts:
        return row
    part = beam.part_at(row % beam.node_count)
    return part.name, row % beam.node_count - part.first_node


def _curvature(beam: tb.Beam, row: int) -> Curvature:
    """Of the element in a row, in a structure of one of its beams."""
    for part in beam.parts:
        if 0 <= row - part.first_station < part.station_count:
            own, element = beam.part(part.name), row - part.first_station
            return Curvature(beam=own, element=element, on=part.name)
    return Curvature(beam=beam, element=row)


def _part(sensor: Sensor, components: slice) -> Sensor:
    """The sensor, or its components in a plane."""
    return sensor if components == slice(0, 3) else sensor[components]
