"""Sensors of contact: what a beam and an obstacle do to each other at the instant of a state."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..core.arguments import instance, place
from ..core.functions_of_time import shared
from ..nodal.conditions import ActingLoad, conditions
from ..nodal.discretise import discretise
from ..nodal.element_loads import load_point, point_weights
from ..nodal.loads import Nodes
from ..nodal.model import Model
from ..scene.effects.contact import Contact, Touch
from ..scene.scene import Scene
from ..state.state import State
from .sensor import XYZ, Sensor


@dataclass(frozen=True, eq=False, repr=False)
class OfContact(Sensor):
    """Base of these sensors.

    contact  its place among the contacts of the scene

    Raises ValueError for a scene without such a contact, or a state of another form.
    """

    scene: Scene
    contact: int = 0
    model: Model = field(init=False)

    def __post_init__(self) -> None:
        instance("a scene", self.scene, Scene)
        count = len(self._contacts)
        place("contact", self.contact, count, "a scene has contacts")
        object.__setattr__(self, "model", discretise(self.scene))

    @property
    def _contacts(self) -> list[Contact]:
        return [load for load in self.scene.loads if isinstance(load, Contact)]

    def _acting(self, state: State) -> tuple[tuple[ActingLoad, Touch], ...]:
        """The contact, and what it does at its points, on each part of a structure along which it
        acts. Raises ValueError for a state of another form.
        """
        if not isinstance(state, State):
            raise ValueError(
                f"a {type(state).__name__} was given to {type(self).__name__}; a State of the "
                "nodal form is wanted"
            )
        model, t = self.model, shared(state.t)
        load = self._contacts[self.contact]
        state = model.space.to_reduced(state)
        spin = model.space.to_frame(state.rotation, state.spin)
        nodes = Nodes(state.position, state.rotation, state.velocity, spin, state.frame)
        now = conditions(model, t, {}, loads=(load,))
        return tuple(
            (acting, acting.load.touch(load_point(model, acting, nodes, now)))
            for acting in now.between
        )

    def _forces(self, state: State) -> Tensor:
        """(..., points, 3) N on the beam, frame a."""
        parts = []
        for acting, touch in self._acting(state):
            force = touch.pressure * touch.normal
            force = force if touch.rub is None else force + touch.rub
            parts.append(point_weights(self.model, acting) * force)
        return torch.cat(parts, -2)


@dataclass(frozen=True, eq=False, repr=False)
class ContactForce(OfContact):
    """Force (..., 3) N of an obstacle on the beam, frame a, friction included."""

    name: ClassVar[str] = "contact force"
    unit: ClassVar[str] = "N"
    labels: ClassVar[tuple[str, ...]] = XYZ

    def read(self, state: Any) -> Tensor:
        return self._forces(state).sum(-2)


@dataclass(frozen=True, eq=False, repr=False)
class ContactForces(OfContact):
    """The same on each of the N elements along which it acts, (..., N, 3)."""

    name: ClassVar[str] = "contact forces"
    unit: ClassVar[str] = "N"

    @property
    def labels(self) -> tuple[str, ...]:
        count = self.model.topology.element_count
        return tuple(f"{axis} of element {e}" for e in range(count) for axis in XYZ)

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.model.topology.element_count, 3)

    def read(self, state: Any) -> Tensor:
        points = self._contacts[self.contact].points
        return self._forces(state).unflatten(-2, (-1, points)).sum(-2)


@dataclass(frozen=True, eq=False, repr=False)
class ContactGap(OfContact):
    """Smallest gap (..., 1) m between the surfaces of the beam and of an obstacle, at the points of
    its contact: where it falls below the thickness, they begin to touch.
    """

    name: ClassVar[str] = "contact gap"
    unit: ClassVar[str] = "m"
    labels: ClassVar[tuple[str, ...]] = ("gap",)

    def read(self, state: Any) -> Tensor:
        gaps = torch.cat([touch.gap[..., 0] for _, touch in self._acting(state)], -1)
        return gaps.amin(-1, keepdim=True)


@dataclass(frozen=True, eq=False, repr=False)
class ContactSlip(OfContact):
    """Of a contact with friction: the mean speed (m/s) at which surfaces that touch slip, weighted
    by their pressure, and the share of the pressure that is on what sticks, below the slip speed
    (..., 2); 0 where nothing touches.
    """

    name: ClassVar[str] = "contact slip"
    unit: ClassVar[str] = "m/s, 1"
    labels: ClassVar[tuple[str, ...]] = ("speed", "sticking")

    def read(self, state: Any) -> Tensor:
        parts = []
        for acting, touch in self._acting(state):
            if touch.slip is None:
                raise ValueError(
                    "a contact without friction was given to ContactSlip; one with it is wanted"
                )
            force = (point_weights(self.model, acting) * touch.pressure)[..., 0]
            speed = torch.linalg.vector_norm(touch.slip, dim=-1)
            sticks = speed < acting.load.slip_speed[..., None]
            parts.append(torch.stack((force, force * speed, force * sticks), -1).sum(-2))
        total, *sums = sum(parts[1:], parts[0]).unbind(-1)
        whole = torch.where(total > 0, total, torch.ones_like(total))
        return torch.stack([part / whole for part in sums], -1)
