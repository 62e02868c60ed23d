"""Sensors along the beam: strain, curvature, a gauge on a fibre, stress."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..core.arguments import is_integer
from ..core.validation import Value, as_tensor, concrete, finite, refusal, shown
from ..core.warning import warn
from ..math.shapes import broadcast_shapes
from ..nodal.assembly import Assembly
from ..nodal.coordinates.selection import coordinates
from ..nodal.coordinates.spatial import Spatial
from ..nodal.element_compliance import without_residual_bending
from ..scene.beam import Beam
from ..scene.scene import Scene
from ..scene.stations import STATIONS
from ..state.rest_shape import RestShape
from ..state.state import State
from ..topology.framework import Framework
from .sensor import Sensor

FAR = 100.0  # radii of gyration, at which no gauge sits


@dataclass(frozen=True, eq=False, repr=False)
class _Along(Sensor):
    """A sensor of elements. At an arc length it follows the straight line through the values at the
    middles of the two elements beside it (those of the first or last two, prolonged, near an end):
    second order, as the elements are. In elements of order 2 it follows the line through their own
    two stations, where the values are best.

    station  (...) m, arc length from the root at rest, 0 to the beam's length; may be batched and
             carry gradient
    beam     the `Beam`; or its `Scene`, which alone tells of small displacements (`small=True`):
             strains are then linear in these, where those of the beam hold the squares of rotations
    on       name of the beam, in a structure, whose `Scene` is then given as the beam
    element  in place of a station: the index of an element, whose own value (best at its middle) is
             read; of order 2 the mean of its two

    Raises ValueError for both or neither, a station beyond the beam, or an element that does not
    exist; and where it is called, for a state of another dtype, or of a beam of another shape at
    rest.
    """

    on: str | None = field(default=None, kw_only=True)
    of_part = True

    station: Value | None = None
    beam: Beam | Scene | None = None
    element: int | None = None
    weights: Tensor | None = field(default=None, init=False)
    space: Spatial | None = field(default=None, init=False)
    known: RestShape | None = field(default=None, init=False)
    what: ClassVar[str]

    def __post_init__(self) -> None:
        if (self.station is None) == (self.element is None):
            raise ValueError(
                f"station = {shown(self.station)} and element = {shown(self.element)} were given; "
                "one of them is wanted"
            )
        scene = self.beam
        if isinstance(scene, Scene):
            if scene.beam.parts:
                scene = Scene(scene.beam.part(self.on), small=scene.small)
            object.__setattr__(self, "beam", scene.beam)
        if not isinstance(self.beam, Beam):
            raise refusal(f"a beam of type {type(self.beam).__name__}", "the torchbeam.Beam")
        small = getattr(scene, "small", False)
        object.__setattr__(self, "space", coordinates(self.beam, self.beam.topology, None, small))
        if self.element is not None:
            N = self.beam.element_count
            if not is_integer(self.element) or not -N <= self.element < N:
                raise ValueError(
                    f"element = {shown(self.element)} was given; the beam has the elements 0 to "
                    f"{N - 1}"
                )
        else:
            length = self.beam.length
            station = finite("station", as_tensor(self.station, length.dtype, length.device))
            weights = station_weights(station, length, self.beam.order)
            vars(self).update(station=station, weights=weights)

    @property
    def name(self) -> str:
        s = self.station
        if s is None:
            where = f"in element {self.element}"
        else:
            where = f"at {tuple(s.shape)} stations" if s.ndim else f"at {s.item():g} m"
        return f"{self._prefix}{self.what} {where}"

    def __call__(self, state: Any) -> Tensor:
        seen = self.seen(state)
        position = getattr(seen, "position", None)
        if position is not None and self.beam.node_count != position.shape[-2]:
            raise ValueError(
                f"a state with {position.shape[-2]} nodes was given; the sensor's beam has "
                f"{self.beam.node_count}"
            )
        self._refuse_another(getattr(seen, "rest_shape", None))
        dtype = self.beam.nodes.dtype
        if position is None or position.dtype == dtype:
            return super().__call__(state)
        return super().__call__(state.to(dtype)).to(position.dtype)

    def _refuse_another(self, shape: RestShape | None) -> None:
        """ValueError for the rest shape of another beam."""
        of_beam = RestShape.of(self.beam)
        if shape is None or of_beam is None or shape is of_beam or shape is self.known:
            return
        off = shape.differs(of_beam)
        if off is not None:
            raise ValueError(
                f"a state of another beam was given to the sensor {self.name!r}, whose shape at "
                f"rest differs from that of the sensor's beam {off}; a sensor of the state's own "
                "beam is wanted"
            )
        object.__setattr__(self, "known", shape)

    def of_elements(self, state: Any) -> Tensor:
        """(..., N, size)"""
        raise NotImplementedError

    def read(self, state: Any) -> Tensor:
        values = self.of_elements(state)
        if self.weights is not None:
            return (self.weights[..., None, :] @ values)[..., 0, :]
        values = values.unflatten(-2, (-1, self.beam.order)).mean(-2)
        return values[..., self.element, :]


def _within(station: Tensor, length: Tensor) -> None:
    """ValueError for a station beyond the beam."""
    end = length.sum(-1)
    beyond = concrete((station < 0) | (station > end * (1 + 1e-6)))
    if beyond.any():
        station, end = concrete(station.detach()), concrete(end)
        raise ValueError(
            f"station = {station.flatten().tolist()[:4]} m was given for a beam of "
            f"{end.max().item():g} m; places from 0 to that are wanted"
        )


def station_weights(station: Tensor, length: Tensor, order: int) -> Tensor:
    """(..., stations): what those of elements of this order, standing for a length (..., stations)
    m each, count for at places (...) m: see `_Along`.
    """
    _within(station, length)
    if length.shape[-1] == 1:
        return torch.ones_like(station)[..., None]
    stations = STATIONS[order]
    return _on_lines(station, stations.places(length), *stations.lines(length))


def _on_lines(station: Tensor, places: Tensor, ends: Tensor, step: int) -> Tensor:
    """(..., n): what values at `places` (..., n) m count for at stations (...) m on straight lines
    between `ends` (..., m) m, each through two of the places, that of the next line through those
    `step` further on.
    """
    shape, n = broadcast_shapes(station.shape, places.shape[:-1]), places.shape[-1]
    at, places = station.expand(shape)[..., None], places.expand(*shape, n)
    ends = ends.expand(*shape, ends.shape[-1])
    k = step * torch.searchsorted(ends.detach().contiguous(), at.detach().contiguous())
    a, b = places.gather(-1, k), places.gather(-1, k + 1)
    share, number = (at - a) / (b - a), torch.arange(n, device=k.device)
    return torch.where(number == k, 1 - share, 0.0) + torch.where(number == k + 1, share, 0.0)


@dataclass(frozen=True, eq=False, repr=False)
class _Strains(_Along):
    """From the kinematics: the strain of the positions and rotations at that instant, less that of
    the beam at rest. (Not from the stress, which after an implicit step is a mean over the step and
    holds damping.) Section axes.
    """

    reference: Tensor | None = field(default=None, init=False)
    part: ClassVar[slice]

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "reference", self._strain(self.beam.nodes, self.beam.frames))

    def _strain(self, position: Tensor, rotation: Tensor) -> Tensor:
        length, p, space = self.beam.length[..., None], self.beam.order, self.space
        i = None if self.element is None else p * (self.element % self.beam.element_count)
        if i is not None and space.turns:  # that element alone
            position, rotation = position[..., i : i + p + 1, :], rotation[..., i : i + p + 1, :]
            length = length[..., i : i + p, :]
        rotation = space.to_reduced_rotation(rotation)
        topology = self.beam.topology if i is None or not space.turns else Framework(p, (1,))
        assembly = Assembly(topology, space.interpolation, space.dims.position)
        strain = space.strains(
            space.kinematics(*assembly.poses(position, rotation), length), length
        )
        return strain if i is None or space.turns else strain[..., i : i + p, :]

    def read(self, state: Any) -> Tensor:
        if not isinstance(state, State):  # a mixed form holds its own
            return super().read(state)
        N = self.beam.station_count
        at = slice(None) if self.element is None else slice(self.element % N, self.element % N + 1)
        values = self._strain(state.position, state.rotation) - self.reference
        values = without_residual_bending(self.beam, values, at)
        if self.weights is None:
            return self.of(values.mean(-2))
        return self.of((self.weights[..., None, :] @ values)[..., 0, :])

    def of_elements(self, state: Any) -> Tensor:
        return self.of(state.strain)

    def of(self, strains: Tensor) -> Tensor:
        """(..., 6) -> what is read of it."""
        return strains[..., self.part]


@dataclass(frozen=True, eq=False, repr=False)
class Strain(_Strains):
    """Strain gamma (..., 3) of the reference axis: extension, and shear along y and z, section
    axes.

    It follows from the kinematics, see `_Strains`. station, beam, element: where, see `_Along`.

    Examples:
        >>> tb.sensors.Strain(0.05, beam)(solution.state).shape  # extension, two shears
        torch.Size([6, 3])
    """

    what = "strain"
    unit = "1"
    labels = ("extension", "shear y", "shear z")
    part = slice(0, 3)


@dataclass(frozen=True, eq=False, repr=False)
class Curvature(_Strains):
    """Curvature kappa (..., 3) 1/m: twist, and bending about y and about z, section axes.

    It follows from the kinematics, see `_Strains`. station, beam, element: where, see `_Along`.

    Examples:
        >>> tb.sensors.Curvature(0.0, beam)(solution.state)[-1]  # 1/m, at the root
        tensor([ 0.0000, -0.6134,  0.0000])
    """

    what = "curvature"
    unit = "1/m"
    labels = ("twist", "bending y", "bending z")
    part = slice(3, 6)


@dataclass(frozen=True, eq=False, repr=False)
class Gauge(_Strains):
    """Reading (..., 1) of a strain gauge along the beam, on the fibre at (y, z) m of the section.

    It is gamma1 + z kappa2 - y kappa3 and follows from the kinematics, see `_Strains`. station,
    beam, element: where, see `_Along`. A RuntimeWarning tells of millimetres given as metres.

    Examples:
        >>> gauge = tb.sensors.Gauge(0.05, beam, z=0.001)  # 5 cm from the root, on the upper side
        >>> gauge(solution.state)[-1]  # m/m
        tensor([-0.0006])
    """

    y: Value = 0.0
    z: Value = 0.0
    what = "gauge"
    unit = "1"
    labels = ("strain",)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("y", "z"):
            value = as_tensor(getattr(self, name), self.beam.length.dtype, self.beam.length.device)
            object.__setattr__(self, name, finite(name, value))
        S = concrete(self.beam.compliance.detach()).diagonal(dim1=-2, dim2=-1)
        for name, k in (("y", 5), ("z", 4)):
            gyration = (S[..., 0] / S[..., k]).sqrt()  # m, of stiffness
            gyration = gyration[(gyration > 0) & gyration.isfinite()]
            off = concrete(getattr(self, name).detach()).abs().flatten()
            if gyration.numel() and (off > FAR * gyration.amax()).any():
                warn(
                    f"{name} = {off.amax().item():g} m was given for a gauge, on a section with a "
                    f"radius of gyration of {gyration.amax().item():.2g} m; metres are wanted"
                )

    def of(self, strains: Tensor) -> Tensor:
        y, z = self.y[..., None], self.z[..., None]
        return strains[..., :1] + z * strains[..., 4:5] - y * strains[..., 5:]


@dataclass(frozen=True, eq=False, repr=False)
class Stress(_Along):
    """Stress resultants (..., 6) N and N m, section axes, as the state has them.

    After an implicit step they are means over the step, damping included. station, beam, element:
    where, see `_Along`.

    Examples:
        >>> tb.sensors.Stress(0.05, beam)(tb.equilibrium(scene))  # N and N m, in section axes
        tensor([ 0.1428,  0.0000,  2.0168,  0.0000, -1.6973,  0.0000])
    """

    what = "stress"
    unit = "N, N m"
    labels = ("F1", "F2", "F3", "M1", "M2", "M3")

    def of_elements(self, state: Any) -> Tensor:
        return state.stress if isinstance(state, State) else torch.cat((state.F, state.M), -1)
