"""Sensors of joints: what `State.joint` reads, by the joint's place in the scene's list."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..core.arguments import place, whole
from ..state.instant import JointReading
from .sensor import Sensor


@dataclass(frozen=True, eq=False, repr=False)
class _OfJoint(Sensor):
    """joint: its place in `Scene(joints=...)`. ValueError for one that is not there."""

    joint: int

    def __post_init__(self) -> None:
        whole("joint", self.joint)

    def found(self, state: Any) -> JointReading:
        joints = getattr(state, "joint", ())
        return joints[place("joint", self.joint, len(joints), "there are the joints")]


@dataclass(frozen=True, eq=False, repr=False)
class _OfCoordinate(_OfJoint):
    """field: of a `JointReading`. ValueError for a joint without a coordinate, or with two."""

    field: ClassVar[str]

    def read(self, state: Any) -> Tensor:
        reading = self.found(state)
        x = getattr(reading, self.field)
        if x is None or x.ndim != reading.force.ndim - 1:
            have = "none" if x is None else "two"
            raise ValueError(
                f"the {self.name} was asked for, which has {have}; that of a Hinge or a Slider "
                "is wanted"
            )
        return x[..., None]


@dataclass(frozen=True, eq=False, repr=False)
class JointCoordinate(_OfCoordinate):
    """Angle rad of a hinge, counted over turns, or travel m of a slider (..., 1), zero as drawn."""

    field = "coordinate"
    name = property(lambda self: f"coordinate of joint {self.joint}")
    unit = "rad or m"
    labels = ("q",)


@dataclass(frozen=True, eq=False, repr=False)
class JointRate(_OfCoordinate):
    """Its rate (..., 1)."""

    field = "rate"
    name = property(lambda self: f"rate of joint {self.joint}")
    unit = "rad/s or m/s"
    labels = ("q'",)


@dataclass(frozen=True, eq=False, repr=False)
class JointLoad(_OfJoint):
    """Force and moment (..., 6) N and N m of a joint on its second part, at its point there, frame
    a.
    """

    name = property(lambda self: f"load of joint {self.joint}")
    unit = "N, N m"
    labels = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")

    def read(self, state: Any) -> Tensor:
        found = self.found(state)
        return torch.cat((found.force, found.moment), -1)
