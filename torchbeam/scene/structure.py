"""Structure: beams and bodies as one set of rows, beams one after the other, then bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..core.leaves import bound, leaves, with_values
from ..core.summary import kind, lines, point, span
from ..core.validation import broadcast, common_dtype, refusal, shown
from ..math import quaternions as quat
from ..math.shapes import stacked
from ..topology.framework import Framework
from .beam import Beam
from .body import Body
from .effects.effect import Effect
from .effects.obstacle import Obstacle
from .effects.point_mass import PointMass
from .parts import FLAGS, Part, Row, Span, part_of, row_of
from .taper import residual_bending

# of the tensors of a `Beam`
AXES = dict(nodes=2, frames=2, elements=2, length=1, compliance=3, mass=3, taper=4, mass_taper=3)
TAPERS = ("taper", "mass_taper")  # which a beam may have none of


@dataclass(frozen=True, repr=False)
class Structure(Beam):
    """Beams and bodies as what the physics takes a beam for: what has an axis of nodes, elements or
    stations in a `Beam` has here those of all beams one after the other; nodes and frames then have
    a row for each body. rigid, coupled, offset, rotary, curved: whether any beam is.

    parts   what belongs to whom
    masses  of the bodies, on their nodes; surfaces: theirs, None = a body has none
    joined  rows that joints connect, in the order of the scene's: (row of a, row of b), None = the
            ground
    """

    parts: tuple[Part, ...] = ()
    masses: tuple[PointMass, ...] = ()
    surfaces: tuple[Obstacle | None, ...] = ()
    joined: tuple[tuple[int | None, int | None], ...] = ()

    @classmethod
    def of(cls, given: dict[str, Beam | Body]) -> Structure:
        """Raises ValueError for a part without a name, one that is neither beam nor body, none at
        all, and beams of different orders, dtypes or devices, or some of which are linked.
        """
        beams, bodies = _sorted(given)
        first = next(iter(beams.values()), None)
        dtype, device = common_dtype(*(leaf.value for leaf in leaves(list(given.values()))))
        for name in ("order", "linked_interpolation"):
            if len({getattr(beam, name) for beam in beams.values()}) > 1:
                linked = "linked interpolation beside others without"
                raise ValueError(
                    f"beams of {'different orders' if name == 'order' else linked} were given; all "
                    "alike are wanted in one structure"
                )
        bodies = {name: bound(body, dtype, device) for name, body in bodies.items()}
        names = [name for name in AXES if any(_has(beam, name) for beam in beams.values())]
        names += [name for name in AXES if name not in names and name not in TAPERS]
        by_name = {name: [_own(beam, name) for beam in beams.values()] for name in names}
        by_name["nodes"] += [body.position[..., None, :] for body in bodies.values()]
        by_name["frames"] += [body.frame[..., None, :] for body in bodies.values()]
        tensors = {
            name: _joined(parts, AXES[name], dtype, device) for name, parts in by_name.items()
        }
        parts, node, station = [], 0, 0
        for name, beam in beams.items():
            has, count = tuple(getattr(beam, flag) for flag in FLAGS), beam.station_count
            parts.append(Part(name, node, beam.node_count, station, count, has))
            node, station = node + beam.node_count, station + count
        masses = []
        for name, body in bodies.items():
            parts.append(Part(name, node, 1, station))
            masses.append(PointMass(body.mass, body.inertia, node=Row(node, name)))
            node += 1
        rigid = zip((False,) * 6, *(beam.rigid for beam in beams.values()), strict=True)
        flags = {name: any(getattr(beam, name) for beam in beams.values()) for name in FLAGS[1:]}
        return cls(
            **tensors,
            **flags,
            rigid=tuple(map(any, rigid)),
            order=1 if first is None else first.order,
            linked_interpolation=first is not None and first.linked_interpolation,
            parts=tuple(parts),
            masses=tuple(masses),
            surfaces=tuple(body.surface for body in bodies.values()),
        )

    def __repr__(self) -> str:
        return lines("Structure", *self.words(), kind(self.batch_shape, self.nodes))

    def words(self) -> list[str]:
        """Each part in a line."""
        return [self._line(part) for part in self.parts]

    def loops(self, supported: tuple[int, ...]) -> int:
        """How many closed loops joints and supports make of the parts, and of the ground."""
        place = [self.parts.index(self.part_at(row)) for row in range(self.node_count)]
        place.append(len(self.parts))
        edges = [*self.joined, *((node, None) for node in supported)]
        edges = [tuple(place[-1 if node is None else node] for node in pair) for pair in edges]
        roots = list(range(len(self.parts) + 1))

        def root(k: int) -> int:
            return k if roots[k] == k else root(roots[k])

        closed = 0
        for a, b in edges:
            closed += root(a) == root(b)
            roots[root(a)] = root(b)
        return closed

    def _line(self, part: Part) -> str:
        if part.body:
            at = next(mass for mass in self.masses if mass.node == part.first_node)
            shape, place = self.surface(part.name), point(self.nodes[..., part.first_node, :])
            text = f"{part.name!r}: a body of {span(at.mass)} kg at {place} m"
            return text if shape is None else f"{text}, a {shape.called}"
        return f"{part.name!r}: {self.part(part.name)!r}"

    @property
    def topology(self) -> Framework:
        """Which nodes the elements lie between, and which joints connect."""
        chains = tuple(part.station_count // self.order for part in self.beams)
        return Framework(self.order, chains, len(self.masses), self.joined)

    @property
    def beams(self) -> tuple[Part, ...]:
        return tuple(part for part in self.parts if not part.body)

    @property
    def axes(self) -> Tensor:
        """(..., nodes, 3, 3) of the nodes, columns, frame a."""
        return quat.matrix(self.frames)

    @property
    def size(self) -> Tensor:
        """(...) m: how much of beams there is, and how far its nodes are apart."""
        return self.size_with(self.nodes[..., :0, :])

    def size_with(self, places: Tensor) -> Tensor:
        """`size`, with other places (..., n, 3) m beside the nodes."""
        points = stacked(places, self.nodes)
        return self.length.sum(-1) + torch.linalg.vector_norm(
            points.amax(-2) - points.amin(-2), dim=-1
        )

    @property
    def extent(self) -> Tensor:
        """(...) m: `size`, or how far a body's mass is from its centre, if more; 1 m of a point."""
        spread = [
            (mass.inertia.diagonal(dim1=-2, dim2=-1).sum(-1) / (2 * mass.mass)).sqrt()
            for mass in self.masses
            if mass.inertia is not None
        ]
        extent = torch.stack(torch.broadcast_tensors(self.size, *spread)).amax(0)
        return torch.where(extent > 0, extent, 1.0)

    def part_at(self, row: int) -> Part:
        """The part that a node belongs to."""
        return next(part for part in self.parts if part.nodes.start <= row < part.nodes.stop)

    def surface(self, name: str) -> Obstacle | None:
        """The surface of the body of that name, in its axes; None = it has none."""
        bodies = [part.name for part in self.parts if part.body]
        return self.surfaces[bodies.index(name)] if name in bodies else None

    def part(self, name: str) -> Beam:
        """The beam of that name by itself."""
        part = part_of(self.parts, name)
        rows = {}
        for name, axes in AXES.items():
            if not _has(self, name):
                continue
            places = part.nodes if name in ("nodes", "frames") else part.stations
            rows[name] = getattr(self, name)[(..., places, *(slice(None),) * (axes - 1))]
        has = dict(zip(FLAGS, part.declared, strict=True))
        return Beam(**rows, **has, order=self.order, linked_interpolation=self.linked_interpolation)

    def station_axes(self, frames: Tensor) -> Tensor:
        each = ((self.part(part.name), part.nodes) for part in self.beams)
        axes = [part.station_axes(frames[..., nodes, :]) for part, nodes in each]
        return torch.cat(axes, -2) if axes else frames[..., :0, :]

    def row(self, node: Any, name: str = "node") -> Row:
        return row_of(self.parts, node, name)

    def named(self, on: str | None, effect: Effect) -> None:
        if on is not None:
            part = part_of(self.parts, on)
            if part.body and not effect.by_mass:
                raise refusal(f"{effect.called} with on = {on!r}", "that is a body, and a beam")

    def spans(self, effect: Effect) -> tuple[Span, ...] | None:
        if effect.on is not None:
            return (self._span(part_of(self.parts, effect.on)),)
        if effect.by_place:
            return tuple(map(self._span, self.beams))
        if effect.by_mass or not self.masses:
            return None
        nodes = slice(0, self.node_count - len(self.masses))
        return (Span(nodes, slice(0, self.station_count), self.element_count),)

    def _span(self, part: Part) -> Span:
        return Span(part.nodes, part.stations, part.station_count // self.order)


def unstressed(beam: Beam) -> Beam:
    """With all that says where a beam is, and its mass, and nothing that it resists by."""
    return with_values(beam, compliance=beam.mass[..., :0], taper=None, rigid=(), coupled=False)


def _sorted(given: dict[str, Beam | Body]) -> tuple[dict[str, Beam], dict[str, Body]]:
    """(beams, bodies)"""
    for name, part in given.items():
        if not isinstance(name, str) or not name:
            raise refusal(f"a part with the name {shown(name)}", "text")
        if isinstance(part, Structure) or not isinstance(part, (Beam, Body)):
            raise refusal(
                f"{name!r} of type {type(part).__name__}", "a torchbeam.Beam or torchbeam.Body"
            )
    if not given:
        raise refusal("no parts", "a beam or a body", were=True)
    return tuple(
        {name: part for name, part in given.items() if isinstance(part, wanted)}
        for wanted in (Beam, Body)
    )


def _has(beam: Beam, name: str) -> bool:
    return getattr(beam, name) is not None


def _own(beam: Beam, name: str) -> Tensor:
    """A beam's tensor, with a row for each station."""
    x, axes = getattr(beam, name), AXES[name]
    if x is None:  # of a beam among others that taper
        x = residual_bending(beam.compliance, beam.length) if name == "taper" else beam.mass
        x = torch.stack((0 * x, x), -3) if name == "taper" else 0 * x
    if name in ("nodes", "frames") or x.shape[-axes] != 1:
        return x
    return x.expand(*x.shape[:-axes], beam.station_count, *x.shape[x.ndim - axes + 1 :])


def _joined(parts: Sequence[Tensor], axes: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Rows of several, of common batch axes, one after the other."""
    if not parts:
        return torch.zeros(0, *{1: (), 2: (4,), 3: (6, 6)}[axes], dtype=dtype, device=device)
    shape = broadcast("the parts of a structure", *(x.shape[:-axes] for x in parts))
    return torch.cat([x.expand(*shape, *x.shape[x.ndim - axes :]) for x in parts], -axes)
