"""Sensors of contact: what a beam and an obstacle do to each other at the instant of a state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.arguments import place
from ..core.functions_of_time import shared
from ..nodal.conditions import conditions
from ..nodal.element_loads import at_points, load_point, point_weights
from ..nodal.loads import Nodes, load_points
from ..nodal.touching import PartContact
from ..nodal.touching_forces import of_nodes
from ..nodal.touching_pairs import PairMotion
from ..scene.effects.contact import Touch
from ..scene.effects.contact_terms import ContactTerms
from ..scene.effects.self_contact import SelfContact
from ..state.state import State
from .sensor import XYZ, OfScene


class TouchingPoints(NamedTuple):
    """Points of a contact: the length (..., n, 1) m that each stands for, 1 of a body; what it does
    there; meets (..., n, 3) m: where the surface is. Of two parts n pairs, whose place along the
    part is `place` (n), of `count`; None = each is its own.
    """

    measure: Tensor
    touch: Touch
    meets: Tensor
    place: Tensor | None
    count: int

    @property
    def force(self) -> Tensor:
        """(..., n, 3) N on the first part."""
        force = self.touch.pressure * self.touch.normal
        return self.measure * (force if self.touch.rub is None else force + self.touch.rub)

    @property
    def rows(self) -> Tensor:
        """(..., count, 7) by place: where it is, with the piece that is nearest; force; gap."""
        force, gap = self.force, self.touch.gap
        rows = torch.cat(torch.broadcast_tensors(self.meets, force), -1)
        rows = torch.cat((rows, gap.expand(*rows.shape[:-1], 1)), -1)
        if self.place is None:
            return rows
        each = []
        for k in range(self.count):
            of_contact = rows[..., self.place == k, :]
            if not of_contact.shape[-2]:  # it may touch nothing
                none = rows.new_zeros(*rows.shape[:-2], 7)
                each.append(torch.cat((none[..., :6], none[..., 6:] + torch.inf), -1))
                continue
            nearest = of_contact[..., 6:].argmin(-2, keepdim=True)
            at = of_contact.gather(-2, nearest.expand(*of_contact.shape[:-2], 1, 7))[..., 0, :]
            each.append(torch.cat((at[..., :3], of_contact[..., 3:6].sum(-2), at[..., 6:]), -1))
        return torch.stack(each, -2)


@dataclass(frozen=True, eq=False, repr=False)
class OfContact(OfScene):
    """Base of these sensors.

    contact  its place among the contacts of the scene

    Raises ValueError for a scene without such a contact, or a state of another form.
    """

    contact: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        place("contact", self.contact, len(self._contacts), "a scene has contacts")

    @property
    def _contacts(self) -> list[ContactTerms]:
        return [effect for effect in self.scene.effects if isinstance(effect, ContactTerms)]

    @property
    def _law(self) -> ContactTerms:
        return self._contacts[self.contact]

    @property
    def _touching(self) -> list[PartContact]:
        """Of two parts: the places of either that may touch the other."""
        number = next(k for k, pair in enumerate(self.scene.pairs) if pair is self._law)
        return [
            part_contact for part_contact in self.model.touching.each if part_contact.pair == number
        ]

    def _places(self, state: State, skin: float = 0.0) -> list[TouchingPoints]:
        """What it does at its points, and where, on each part of a structure along which it acts;
        of two parts at those that are within a skin m of where forces begin. Raises ValueError for
        a state of another form.
        """
        nodes, model, law = self.nodes(state), self.model, self._law
        if law.kind == "pair":
            return self._of_pair(nodes, skin)
        now = conditions(model, shared(state.t), {}, loads=(law,))
        if law.between_nodes:
            at = [
                (point_weights(model, acting), acting.load, load_point(model, acting, nodes, now))
                for acting in (at_points(model, acting) for acting in now.between)
            ]
        else:
            at = [
                (nodes.spin.new_ones(1, 1), acting.load, acting.load.of_body(point))
                for acting, point in load_points(model, nodes, now, now.loads)
            ]
        touched = []
        for measure, load, point in at:
            touch = load.touch(point)
            meets = point.position
            if load.radius is not None:
                meets = meets - load.radii * touch.normal
            touched.append(TouchingPoints(measure, touch, meets, None, touch.gap.shape[-2]))
        return touched

    def _of_pair(self, nodes: Nodes, skin: float) -> list[TouchingPoints]:
        """Of two parts: at places of both, on the first."""
        space, touches = self.model.space, []
        motion = PairMotion(
            space.public_position(nodes.position),
            None,
            space.public_vector(nodes.velocity),
            space.public_spin(nodes.spin),
            axes=(space.axes(nodes.rotation),),
        )
        for part_contact in self._touching:
            near = part_contact.nearby(motion, skin)
            pairs = part_contact.pairs(near)
            found = pairs.closest_point(pairs.points(of_nodes(near.nodes, motion)))
            gap = torch.where(found.measure > 0, found.gap, torch.inf)
            sense = 1.0 if part_contact.first else -1.0
            rub = None if found.rub is None else sense * found.rub
            touch = Touch(gap, sense * found.u, found.pressure, found.slip, rub)
            touching_points = pairs.own[..., None] * motion.position[..., near.nodes[:, :3], :]
            meets = touching_points.sum(-2) - pairs.radii[..., :1] * found.u
            count = part_contact.places.shares.shape[-2]
            touches.append(TouchingPoints(found.measure, touch, meets, near.point, count))
        return touches

    def _means(
        self, state: State, of: Callable[[Touch, Tensor], tuple[Tensor, ...]]
    ) -> list[Tensor]:
        """(...) N that presses in all, and means by it of what a function says of points."""
        sums = []
        for measure, touch, *_ in self._places(state):
            force = (measure * touch.pressure)[..., 0]
            sums.append(torch.stack([force, *(force * x for x in of(touch, force))], -1).sum(-2))
        total, *weighted = sum(sums[1:], sums[0]).unbind(-1)
        whole = torch.where(total > 0, total, torch.ones_like(total))
        return [total, *(x / whole for x in weighted)]

    def _forces(self, state: State) -> Tensor:
        """(..., points, 3) N on the beam, frame a."""
        return torch.cat([place.force for place in self._places(state)], -2)


@dataclass(frozen=True, eq=False, repr=False)
class ContactForce(OfContact):
    """Force (..., 3) N of an obstacle on the beam, or of the second part on the first, frame a.

    Friction is included. It is the law's at the instant of the state: after an implicit step at its
    end, where friction that sticks may alternate. At the mean of two states, `a.map(lambda x, y: (x
    + y) / 2, b)`, it is that of the midpoint step between them.

    Raises:
        ValueError: for a SelfContact, whose forces sum up to zero.

    Examples:
        >>> floor = tb.Contact(tb.Plane((0, 0, -0.1), (0, 0, 1)), thickness=0.01, force=100.0)
        >>> lying = tb.Scene(beam, [tb.Gravity((0, 0, -9.81)), floor])
        >>> force = tb.sensors.ContactForce(lying)(tb.equilibrium(lying))
        >>> force[2] > 0  # N, of the floor on the beam
        tensor(True)
    """

    name: ClassVar[str] = "contact force"
    unit: ClassVar[str] = "N"
    labels: ClassVar[tuple[str, ...]] = XYZ

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self._law, SelfContact):
            raise ValueError(
                "a SelfContact was given to ContactForce, whose forces sum up to nothing; "
                "ContactGap or ContactSlip is wanted"
            )

    def read(self, state: Any) -> Tensor:
        return self._forces(state).sum(-2)


@dataclass(frozen=True, eq=False, repr=False)
class ContactForces(OfContact):
    """Force (..., N, 3) N of an obstacle on each of the N elements along which it acts, frame a.

    Friction is included.

    Raises:
        ValueError: for a contact of two parts, of a body or of a node.

    Examples:
        >>> floor = tb.Contact(tb.Plane((0, 0, -0.1), (0, 0, 1)), thickness=0.01, force=100.0)
        >>> lying = tb.Scene(beam, [tb.Gravity((0, 0, -9.81)), floor])
        >>> tb.sensors.ContactForces(lying)(tb.rest(lying)).shape  # N, by element
        torch.Size([4, 3])
    """

    name: ClassVar[str] = "contact forces"
    unit: ClassVar[str] = "N"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self._law.between_nodes:
            raise ValueError(
                f"a {self._law.called} of two parts, a body or a node was given to ContactForces; "
                "one of a beam with an obstacle is wanted"
            )

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(f"{axis} of element {e}" for e in range(self.shape[0]) for axis in XYZ)

    @property
    def shape(self) -> tuple[int, ...]:
        return (sum(self.scene.beam.element_counts(self._law)), 3)

    def read(self, state: Any) -> Tensor:
        return self._forces(state).unflatten(-2, (-1, self._law.points)).sum(-2)


@dataclass(frozen=True, eq=False, repr=False)
class ContactGap(OfContact):
    """Smallest gap (..., 1) m between the surfaces in contact, at the points of its contact.

    The surfaces are the beam's and the obstacle's, or those of two parts. They begin to touch when
    the gap falls below the thickness.

    Examples:
        >>> floor = tb.Contact(tb.Plane((0, 0, -0.1), (0, 0, 1)), thickness=0.01, force=100.0)
        >>> tb.sensors.ContactGap(tb.Scene(beam, [floor]))(tb.rest(scene))  # m, the smallest
        tensor([0.1000])
    """

    name: ClassVar[str] = "contact gap"
    unit: ClassVar[str] = "m"
    labels: ClassVar[tuple[str, ...]] = ("gap",)

    def read(self, state: Any) -> Tensor:
        places = self._places(state, torch.inf)
        gaps = torch.cat([place.touch.gap[..., 0] for place in places], -1)
        return pad(gaps, (0, 1), value=torch.inf).amin(-1, keepdim=True)  # of what never touches


@dataclass(frozen=True, eq=False, repr=False)
class ContactPressure(OfContact):
    """Total pressing force (N), whatever its direction, and mean gap (m) weighted by it, (..., 2).

    In a beam that touches itself each pair of places counts once. 0 if nothing touches.

    Examples:
        >>> floor = tb.Contact(tb.Plane((0, 0, -0.1), (0, 0, 1)), thickness=0.01, force=100.0)
        >>> lying = tb.Scene(beam, [tb.Gravity((0, 0, -9.81)), floor])
        >>> pressure = tb.sensors.ContactPressure(lying)(tb.equilibrium(lying))
        >>> bool(0.2 < pressure[0] < 0.21), bool(pressure[1] < 0.01)  # N; m, of the thickness
        (True, True)
    """

    name: ClassVar[str] = "contact pressure"
    unit: ClassVar[str] = "N, m"
    labels: ClassVar[tuple[str, ...]] = ("force", "gap")

    def read(self, state: Any) -> Tensor:
        def gap(touch: Touch, force: Tensor) -> tuple[Tensor]:
            return (torch.where(force > 0, touch.gap[..., 0], torch.zeros_like(force)),)

        return torch.stack(self._means(state, gap), -1)


@dataclass(frozen=True, eq=False, repr=False)
class ContactSlip(OfContact):
    """Slip of a contact with friction: mean speed (m/s), and share of the pressure that sticks,
    (..., 2).

    The speed is weighted by pressure. A place sticks below the slip speed. 0 if nothing touches.

    Examples:
        >>> floor = tb.Contact(
        ...     tb.Plane((0, 0, -0.1), (0, 0, 1)),
        ...     thickness=0.01,
        ...     force=100.0,
        ...     friction=0.3,
        ...     slip_speed=0.01,
        ... )
        >>> lying = tb.Scene(beam, [tb.Gravity((0, 0, -9.81)), floor])
        >>> tb.sensors.ContactSlip(lying)(tb.rest(lying)).shape  # mean slip m/s, share that sticks
        torch.Size([2])
    """

    name: ClassVar[str] = "contact slip"
    unit: ClassVar[str] = "m/s, 1"
    labels: ClassVar[tuple[str, ...]] = ("speed", "sticking")

    def read(self, state: Any) -> Tensor:
        def slip(touch: Touch, force: Tensor) -> tuple[Tensor, Tensor]:
            if touch.slip is None:
                raise ValueError(
                    "a contact without friction was given to ContactSlip; one with it is wanted"
                )
            speed = torch.linalg.vector_norm(touch.slip, dim=-1)
            return speed, speed < self._law.slip_speed[..., None]

        return torch.stack(self._means(state, slip)[1:], -1)


@dataclass(frozen=True, eq=False, repr=False)
class ContactPoints(OfContact):
    """Place, force and gap at each place of a contact, (..., n, 7).

    The first three numbers are the surface's place (x, y, z in m). The next three are the force
    there (N) on the beam or the first part. The last is the gap (m) to the nearest surface, inf if
    nothing is across. Places of an obstacle are the points of each element, of a body its own or
    its corners. Of two beams they are places along the first, then along the second, with half of
    the force on each. Forces sum up to `ContactForce`.

    Examples:
        >>> floor = tb.Contact(tb.Plane((0, 0, -0.1), (0, 0, 1)), thickness=0.01, force=100.0)
        >>> lying = tb.Scene(beam, [tb.Gravity((0, 0, -9.81)), floor])
        >>> points = tb.sensors.ContactPoints(lying)(tb.equilibrium(lying))
        >>> points.shape  # two of each of four elements
        torch.Size([8, 7])
        >>> points[-1, 3:6].norm() > 0, points[-1, 6] < 0.01  # N, m
        (tensor(True), tensor(True))
    """

    name: ClassVar[str] = "contact points"
    unit: ClassVar[str] = "m, N"

    @property
    def labels(self) -> tuple[str, ...]:
        columns = *XYZ, *(f"force {axis}" for axis in XYZ), "gap"
        return tuple(f"{name} at place {k}" for k in range(self.shape[0]) for name in columns)

    @property
    def shape(self) -> tuple[int, ...]:
        law = self._law
        if law.kind == "pair":
            return (sum(part_contact.places.shares.shape[-2] for part_contact in self._touching), 7)
        if law.between_nodes:
            return (sum(self.scene.beam.element_counts(law)) * law.points, 7)
        return (1 if law.corners is None else law.corners.shape[-2], 7)

    def read(self, state: Any) -> Tensor:
        return torch.cat([place.rows for place in self._places(state, torch.inf)], -2)
