"""Sensors of joints and tendons: what `State.joint` reads, what `State.tendons` holds, by their
places in the scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..core.arguments import place, whole
from ..core.leaves import option
from ..state.instant import JointReading
from .sensor import Sensor


@dataclass(frozen=True, eq=False, repr=False)
class _OfJoint(Sensor):
    """joint: its place in `Scene(joints=...)`. ValueError for one that is not there."""

    joint: int = option(whole)

    def reading(self, state: Any) -> JointReading:
        joints = getattr(state, "joint", ())
        return joints[place("joint", self.joint, len(joints), "there are the joints")]


@dataclass(frozen=True, eq=False, repr=False)
class _OfCoordinate(_OfJoint):
    """field: of a `JointReading`; component: which one of a joint that has several, counted from 0.
    ValueError for a joint without a coordinate, or with several, of which none is named.
    """

    field: ClassVar[str]

    component: int | None = option(whole, default=None)

    def read(self, state: Any) -> Tensor:
        reading = self.reading(state)
        x = getattr(reading, self.field)
        if x is not None:
            x = x[..., None] if x.ndim == reading.force.ndim - 1 else x
            count = x.shape[-1]
            if self.component is not None:
                k = place("component", self.component, count, "there are the coordinates")
                return x[..., k : k + 1]
            if count == 1:
                return x
        have, wanted = ("none", "a joint with one") if x is None else (x.shape[-1], "component=")
        raise ValueError(f"the {self.name} was asked for, which has {have}; {wanted} is wanted")


@dataclass(frozen=True, eq=False, repr=False)
class JointCoordinate(_OfCoordinate):
    """Coordinate of a joint (..., 1): angle rad of a hinge, counted over turns, or travel m of a
    slider.

    It is zero in the undeformed structure. Of joints with several coordinates it is one
    `component`, of a `Ball` a component of the rotation vector.

    Examples:
        >>> door = tb.Scene({"door": beam}, joints=[tb.Hinge(("door", 0), None, axis=(0, 0, 1))])
        >>> tb.sensors.JointCoordinate(0)(tb.rest(door))  # rad
        tensor([0.])
    """

    field = "coordinate"
    name = property(lambda self: f"coordinate of joint {self.joint}")
    unit = "rad or m"
    labels = ("q",)


@dataclass(frozen=True, eq=False, repr=False)
class JointRate(_OfCoordinate):
    """Rate of a joint's coordinate (..., 1): rad/s or m/s.

    Of a `Ball` it is a component of the spin of its parts against each other.

    Examples:
        >>> door = tb.Scene({"door": beam}, joints=[tb.Hinge(("door", 0), None, axis=(0, 0, 1))])
        >>> tb.sensors.JointRate(0)(tb.rest(door))  # rad/s
        tensor([0.])
    """

    field = "rate"
    name = property(lambda self: f"rate of joint {self.joint}")
    unit = "rad/s or m/s"
    labels = ("q'",)


@dataclass(frozen=True, eq=False, repr=False)
class JointLoad(_OfJoint):
    """Force and moment (..., 6) N and N m of a joint on its second part, at its point there, frame
    a.

    Examples:
        >>> door = tb.Scene({"door": beam}, joints=[tb.Hinge(("door", 0), None, axis=(0, 0, 1))])
        >>> tb.sensors.JointLoad(0)(tb.rest(door)).shape  # N, N m
        torch.Size([6])
    """

    name = property(lambda self: f"load of joint {self.joint}")
    unit = "N, N m"
    labels = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")

    def read(self, state: Any) -> Tensor:
        reading = self.reading(state)
        return torch.cat((reading.force, reading.moment), -1)


@dataclass(frozen=True, eq=False, repr=False)
class JointHysteresis(_OfJoint):
    """Memory (..., 2) of a joint's law: its variable, and the energy J that it has lost since the
    start.

    The variable of `ElastoPlastic` is the plastic rotation, rad, of a slider m; of `BoucWen` it is
    z. ValueError where no joint has such a law.

    Examples:
        >>> law = tb.ElastoPlastic(stiffness=100.0, yield_moment=2.0)
        >>> door = tb.Scene({"door": beam}, joints=[tb.Hinge(None, ("door", 0), hysteresis=law)])
        >>> tb.sensors.JointHysteresis(0)(tb.rest(door))  # rad, J
        tensor([0., 0.])
    """

    name = property(lambda self: f"hysteresis of joint {self.joint}")
    unit = "rad, m or 1, J"
    labels = ("variable", "lost")

    def read(self, state: Any) -> Tensor:
        memory = self.reading(state).memory
        if memory is None:
            raise ValueError(
                f"the {self.name} was asked for, whose scene has no law with memory; one of a "
                "joint with hysteresis= is wanted"
            )
        return memory


@dataclass(frozen=True, eq=False, repr=False)
class _OfTendon(Sensor):
    """tendon: its place among the scene's tendons. ValueError for one that is not there."""

    tendon: int = option(whole)

    def row(self, state: Any) -> Tensor:
        tendons = getattr(state, "tendons", None)
        count = 0 if tendons is None else tendons.shape[-2]
        return tendons[..., place("tendon", self.tendon, count, "there are the tendons"), :]


@dataclass(frozen=True, eq=False, repr=False)
class TendonTension(_OfTendon):
    """Tension (..., 2) N of a tendon's first stretch and of its last.

    Over a step it is the mean, with the effect of friction.

    Examples:
        >>> rope = tb.Tendon([(None, (0, 0, 0.05)), (-1, (0, 0, 0.05))], tension=1.0)
        >>> tb.sensors.TendonTension(0)(tb.equilibrium(tb.Scene(beam, [rope])))  # N
        tensor([1., 1.])
    """

    name = property(lambda self: f"tension of tendon {self.tendon}")
    unit = "N"
    labels = ("first", "last")

    def read(self, state: Any) -> Tensor:
        return self.row(state)[..., :2]


@dataclass(frozen=True, eq=False, repr=False)
class TendonLength(_OfTendon):
    """Length (..., 1) m of a tendon from its first eyelet to its last.

    Examples:
        >>> rope = tb.Tendon([(None, (0, 0, 0.05)), (-1, (0, 0, 0.05))], tension=1.0)
        >>> tb.sensors.TendonLength(0)(tb.rest(tb.Scene(beam, [rope])))  # m
        tensor([1.])
    """

    name = property(lambda self: f"length of tendon {self.tendon}")
    unit = "m"
    labels = ("length",)

    def read(self, state: Any) -> Tensor:
        return self.row(state)[..., 2:]
