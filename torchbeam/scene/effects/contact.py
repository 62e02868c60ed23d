"""`Contact` of a beam with an obstacle, or of two parts of a structure."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ...core.declared import parameter
from ...core.leaves import leaf, with_values
from ...core.validation import Value, concrete, refusal, shown
from ...math.quaternions import cross
from ..parts import Place, check_node, part_of
from ..stations import Table
from .contact_law import damped, leads_through, pressure, rubbing, telling
from .contact_terms import POINTS, AtPoints, ContactTerms, radius_value, widest
from .load_point import POSITION, ROTATION, SPIN, VELOCITY, LoadPoint, Wrench, at_instant
from .obstacle import Obstacle, each
from .obstacles import Plane
from .values import Inputs


class Touch(NamedTuple):
    """What a contact does at points (..., points, n): gap m to the surface; normal, out of the
    obstacle; pressure N/m; slip m/s of the surfaces, None = there is no friction; rub N/m, the
    force of friction on the beam, likewise.
    """

    gap: Tensor
    normal: Tensor
    pressure: Tensor
    slip: Tensor | None
    rub: Tensor | None


def _other_radius(name: str, value: Any) -> Any:
    """As a radius; the number 0 is not that of the other part."""
    return radius_value(name, value) if isinstance(value, Table) else parameter(name, value)


@dataclass(frozen=True)
class Contact(ContactTerms):
    """Contact of a beam with an obstacle, or of two parts of a structure, with or without friction.

    The force per length of the beam is

        p n - friction p s,    p = force (y/thickness)^2 (1 + ...),    y = thickness - gap

    with the gap between the surfaces, the normal n and the direction of slip s. The law begins at a
    gap of `thickness`. It reaches `force` where the surfaces meet, at gap 0, and rises linearly
    from there, by 2 force/thickness for each metre. At rest under a force per length q the gap is
    thickness (1 - (q/force)^(1/2)). Where q is above `force` it is -(q/force - 1) thickness/2.

    - `Contact(obstacle, ...)`: the beam, in a structure all beams;
    - `Contact("arm", obstacle, ...)`: one part of a structure;
    - `Contact("arm", "strut", ...)`: two beams, or a beam and a body;
    - `Contact(obstacle, node=-1, ...)`: one node of a beam, a ball of the radius. It is the round
      end of a rod that stands or pushes with its tip, where a force per length has no length.

    A body without a `surface` is a ball of the radius about its centre. Its forces are in N, not
    N/m, and so are those of a node. A body with a surface touches beams along them, balls, and
    planes in its corners. Each corner has this law, in N.

    Args:
        thickness: (...) m; None = a tenth of the smallest radius. Without a radius, of the radius
            of a round section with the beam's EI and EA
        force: (...) N/m, or N for bodies. None = four times the weight per length and 16 EI/L^3, of
            the heavier beam; for bodies four times the body's weight; for a node the beam's length
            times what the beam has. `describe` prints it
        stiffness: (...) N/m^2, or N/m for bodies and nodes, in place of `force`: 2 force/thickness
        radius: (...) m of the beam's surface; None or the number 0: its axis. Of a tapered beam a
            `Table` of the arc length from the root. Its surface is then the surface of balls about
            the axis, a cone of the half angle asin(dr/ds)
        other_radius: (...) m of the second part's, or a `Table`; None = the same
        friction: (...) mu of Coulomb's law; None or the number 0: none
        slip_speed: (...) m/s, needed with friction. Above it friction is mu p against the slip.
            Below it, under a share x of that, surfaces creep by slip_speed (1 - (1 - x)^(1/2))
        damping: (...) s: p is multiplied by a + (1 + a^2)^(1/2), a = damping (rate of
            approach)/thickness, which never pulls; None or the number 0: none
        points: number of places of an element at which surfaces may meet. A smaller thing can slip
            through between two of them. None = two Gauss points against obstacles; between beams
            equal parts, enough for the patch of two beams that cross. Bodies alone have none
        node: a node that touches the obstacle, in a structure (name of a beam, number). None: all
            along the beam. Beside a contact along the beam it counts once more where the beam
            lies: with both default forces each end of a stiff rod bears a third of the weight
        push_out: whether a motion may start inside the obstacle. The obstacle then pushes the beam
            out, with the energy of the contact there

    In a midpoint step the force is the difference of its potential over the difference of the gap.
    A rebound without friction and damping therefore keeps the energy. Friction uses slip and
    pressure in the middle of the step.

    Raises:
        ValueError: for an object that is no obstacle, a thickness or slip speed not above 0,
            negative numbers, or both force and stiffness. For a node with a part or a body's name,
            with a Table of radii or with `points`. For friction without a slip speed, or a radius
            without room in a tube. In a scene for missing parts, and where nothing gives the
            thickness or the force.

    Examples:
        >>> floor = tb.Contact(tb.Plane((0, 0, -0.1), (0, 0, 1)), thickness=0.01, force=100.0)
        >>> falling = tb.Scene(beam, [tb.Gravity((0, 0, -9.81)), floor])
        >>> tb.equilibrium(falling).tip.position[2]  # m, on the floor
        tensor(-0.0981)
    """

    obstacle: Obstacle | str | None = leaf(1)
    other: Obstacle | str | None = None
    other_radius: Value | Table | None = leaf(0, default=None, kw_only=True, check=_other_radius)
    on: str | None = field(default=None, kw_only=True)

    node: Place | None = field(default=None, kw_only=True)  # in a scene also of a body, its name

    # of a body in a scene, at which it acts in place of the centre, (..., K, 3) m, in its axes
    corners: Tensor | None = leaf(2, default=None, init=False)

    def __post_init__(self) -> None:
        other = self.other
        if isinstance(self.obstacle, str):  # then on, and obstacle or other, say it all
            both = (None, other) if isinstance(other, str) else (other, None)
            vars(self).update(on=self.obstacle, obstacle=both[0], other=both[1])
        elif other is not None and not (self.obstacle is None and isinstance(self.on, str)):
            raise ValueError(
                f"{shown(self.obstacle)} was given as the first of two; the name of a beam is "
                "wanted, and an obstacle"
            )
        if self.partner is None and not isinstance(self.obstacle, Obstacle):
            raise ValueError(
                f"{shown(self.obstacle)} was given as an obstacle; a Plane, Sphere, Cylinder, "
                "Capsule or Box is wanted"
            )
        if self.partner is not None and self.partner == self.on:
            raise refusal(f"Contact of {self.on!r} with itself", f"SelfContact({self.on!r})")
        if self.node is not None:
            self._check_node()
        super().__post_init__()
        if self.partner is None and self.other_radius is not None:
            raise ValueError(
                "Contact with an obstacle and an other_radius was given; the radius of a second "
                "part is wanted with its name"
            )
        room = None if self.obstacle is None else self.obstacle.room
        if room is not None and self.radius is not None:
            radius = torch.as_tensor(widest(self.radius))
            left = torch.as_tensor(room).detach() - radius.detach()
            if concrete(left <= 0).any():
                raise refusal(
                    "Contact with a radius of the beam's that has no room in the cylinder",
                    "a smaller one",
                )
        if self.points is None and self.between_nodes:
            vars(self).update(points=POINTS)

    def _check_node(self) -> None:
        place = getattr(self.node, "given", self.node)  # a scene has a row in place of a name
        check_node("node", place)
        if isinstance(self.on, str) and place == self.on:  # of a body
            return
        if self.on is not None:
            raise refusal(f"Contact of {shown(self.on)} with the node {place!r}", "one of them")
        if isinstance(place, str):
            raise refusal(f"Contact with node = {place!r}", f"Contact({place!r}, obstacle)")
        if isinstance(self.radius, Table):
            raise refusal("Contact of a node with a radius as a Table", "a number")
        if self.points is not None:
            raise refusal(f"Contact of a node with points = {shown(self.points)}", "None")

    @property
    def partner(self) -> str | None:
        """Name of the second part."""
        return self.other if isinstance(self.other, str) else None

    @property
    def between_nodes(self) -> bool:
        return self.partner is None and self.node is None

    @property
    def wants_step(self) -> bool:
        return self.partner is None

    def placed(self, beam: Any) -> Contact:
        parts = [part_of(beam.parts, name) for name in (self.on, self.partner) if name is not None]
        shapes = [beam.surface(part.name) if part.body else None for part in parts]
        radii = [self.radius, self.radius if self.other_radius is None else self.other_radius]
        for part, shape, radius in zip(parts, shapes, radii, strict=False):
            if part.body and shape is None and isinstance(radius, Table):
                raise refusal(
                    f"Contact of {part.name!r} with a radius as a Table",
                    "that is a body, and a number",
                )
        usual = (None, None if self.partner is not None else POINTS)
        if parts and all(part.body for part in parts) and self.points not in usual:
            raise refusal(
                f"Contact of {parts[0].name!r} with points = {shown(self.points)}",
                "None (a body touches as a ball, or in its corners)",
            )
        if any(shape is not None for shape in shapes):
            return self._of_surface(shapes)
        if self.partner is not None or self.on is None or not parts[0].body:
            return self
        return self._of_body(self.radius, None)

    def _of_surface(self, shapes: list[Obstacle | None]) -> Contact:
        """Of bodies that have surfaces (None = a part has none), whose radius is theirs. Raises
        ValueError for what cannot touch, and another radius.
        """
        names = [name for name in (self.on, self.partner) if name is not None]
        name = next(
            part_name for part_name, shape in zip(names, shapes, strict=True) if shape is not None
        )
        shape = shapes[names.index(name)]
        if None not in shapes and len(shapes) == 2:
            raise ValueError(
                f"Contact of {names[0]!r} and {names[1]!r}, both with surfaces, was given; a beam, "
                "or a body without one, is wanted as one of both"
            )
        solid = shape.in_body
        if self.partner is None and (not isinstance(self.obstacle, Plane) or solid.corners is None):
            raise ValueError(
                f"Contact of {name!r}, whose surface is a {shape.called}, with a "
                f"{self.obstacle.called} was given; a Sphere, Capsule or Box, and a Plane, are "
                "wanted"
            )
        which = "radius" if name == self.on else "other_radius"
        radius = getattr(self, which)
        known = self.partner is None and torch.is_tensor(radius)  # as a copy of it has it
        known = known and concrete(radius).tolist() == concrete(solid.radius).tolist()
        if radius is not None and self.corners is None and not known:
            raise refusal(f"Contact with the {which} of {name!r}, which has a surface,", "None")
        if self.partner is not None:
            return self
        return self._of_body(solid.radius, solid.corners)

    def _of_body(self, radius: Value | Table | None, corners: Tensor | None) -> Contact:
        """The contact of the body `on` as a scene has it."""
        return with_values(self, radius=radius, corners=corners, node=self.on, points=None)

    @property
    def moves(self) -> bool:
        """Whether the obstacle does."""
        obstacle = self.obstacle
        return obstacle is not None and not (obstacle.drift is None and obstacle.turning is None)

    @property
    def conservative(self) -> bool:
        return not self.rubs and not (self.lossy and self.moves)

    @property
    def depends(self) -> frozenset[str]:
        turns = (self.friction is not None and self.radius is not None) or self.corners is not None
        rotates = {ROTATION} if self.corners is not None else ()
        return frozenset({POSITION, VELOCITY, *({SPIN} if turns else ()), *rotates})

    @property
    def rubbing_points(self) -> int:
        count = 1 if self.corners is None else self.corners.shape[-2]
        return count if self.rubs and self.node is not None else 0

    def resolved(self, s: Tensor, t: Tensor, inputs: Inputs, elements: int) -> Contact:
        return at_instant(self, t, inputs, s, obstacle=at_instant(self.obstacle, t, inputs, s))

    def wrench(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Wrench:
        force, moment = self._wrenches(self.of_body(point))
        if self.node is None:
            return force, moment
        if self.corners is not None:
            turned = cross(self._arms(point), force)
            moment = turned if moment is None else moment + turned
        return force.sum(-2), None if moment is None else moment.sum(-2)

    def _wrenches(self, point: LoadPoint) -> Wrench:
        """(..., points, 3) at points, about these."""
        touch = self.touch(point)
        force = touch.pressure * touch.normal
        if touch.rub is None:
            return force, None
        if self.radius is None:
            return force + touch.rub, None
        arm = -self.radii * touch.normal
        return force + touch.rub, cross(arm, touch.rub)

    def of_body(self, point: LoadPoint) -> LoadPoint:
        """The one node of a body, or its corners, as several points; those of beams as they are."""
        if self.node is None:
            return point
        at = {name: getattr(point, name) for name in (POSITION, VELOCITY, SPIN)}
        at = {name: None if x is None else x[..., None, :] for name, x in at.items()}
        if self.corners is not None:
            arms = self._arms(point)
            at[POSITION] = at[POSITION] + arms
            if at[VELOCITY] is not None:
                at[VELOCITY] = at[VELOCITY] + cross(at[SPIN], arms)
        return replace(point, **at)

    def _arms(self, point: LoadPoint) -> Tensor:
        """(..., K, 3) m from a body's centre to its corners, frame a."""
        return self.corners @ point.R.mT

    def touch(self, point: LoadPoint) -> Touch:
        """What it does at points; its numbers are those of an instant (`resolved`)."""
        x, d = point.position, each(self.thickness)
        normal, v = self.obstacle.gradient(x), self.approach(point)
        y = d - self.gap(x)
        before, after = y, y
        if point.dt is not None:
            half = each(point.dt) / 2 * v
            before, after = d - self.gap(x - half), d - self.gap(x + half)
        p = pressure(before, after, d, each(self.slope))
        if self.damping is not None:
            p = p * damped(-(v * normal).sum(-1, keepdim=True) * each(self.damping) / d)
        if self.friction is None:
            return Touch(d - y, normal, p, None, None)
        slip = self.slip(point, normal)
        rub = -each(self.friction) * p * rubbing(slip, each(self.slip_speed), point.told)
        return Touch(d - y, normal, p, slip, rub)

    def telling(self, point: LoadPoint) -> Tensor:
        """(..., points, 6) what friction tells the next iteration, see `contact_law.telling`."""
        point = self.of_body(point)
        slip = self.slip(point, self.obstacle.gradient(point.position))
        return telling(slip, each(self.slip_speed), point.told)

    def idle(self, x: Tensor, reach: Tensor) -> Tensor:
        """(..., n) bool: whether nothing presses in balls about x (..., n, 3) m, of radii whose
        squares are reach (..., n) m^2.
        """
        room = (self.gap(x) - each(self.thickness))[..., 0]
        return (room > 0) & (room * room >= reach)

    def passed_through(self, x: Tensor, half: Tensor, dt: Tensor) -> Tensor:
        """(..., n) bool: whether the way of points, by `half` (..., n, 3) m on either side of x, in
        dt (...) s, leads through the obstacle.
        """
        carried = self.carried(x, dt)
        half = half if carried is None else half - carried
        return leads_through(self.gap, self.directions, x - half, x + half)

    def carried(self, x: Tensor, dt: Tensor) -> Tensor | None:
        """(..., n, 3) m by which the obstacle moves at x in half of a step; None = it stands."""
        moves = self.obstacle.velocity(x)
        return None if moves is None else each(dt) / 2 * moves

    def directions(self, x: Tensor) -> Tensor:
        """(..., n, 3) in which it pushes at points."""
        return self.obstacle.gradient(x)

    def gap(self, x: Tensor) -> Tensor:
        """(..., points, 1) m between surfaces, the beam's axis at x (..., points, 3)."""
        distance = self.obstacle.distance(x)
        return distance if self.radius is None else distance - self.radii

    @property
    def radii(self) -> Tensor:
        """(..., points or 1, 1) m, where there is a radius, see `at_points`."""
        radius = self.radius
        return radius.value[..., None] if isinstance(radius, AtPoints) else each(radius)

    def approach(self, point: LoadPoint) -> Tensor:
        """(..., points, 3) m/s of the beam's axis as seen from the obstacle, in frame a."""
        v, moves = _in_frame(point), self.obstacle.velocity(point.position)
        return v if moves is None else v - moves

    def slip(self, point: LoadPoint, normal: Tensor) -> Tensor:
        """(..., points, 3) m/s of the beam's surface along the obstacle's, at the former."""
        x, v = point.position, _in_frame(point)
        if self.radius is not None:
            spin, omega, arm = point.spin, point.frame[1], -self.radii * normal
            spin = spin if omega is None else spin - omega[..., None, :]
            x, v = x + arm, v + cross(spin, arm)
        moves = self.obstacle.surface_velocity(x)
        v = v if moves is None else v - moves
        return v - (v * normal).sum(-1, keepdim=True) * normal


def _in_frame(point: LoadPoint) -> Tensor:
    """Velocity (..., points, 3) as seen in frame a."""
    (origin, omega), v = point.frame, point.velocity
    v = v if origin is None else v - origin[..., None, :]
    return v if omega is None else v - cross(omega[..., None, :], point.position)
