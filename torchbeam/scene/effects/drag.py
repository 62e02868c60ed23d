"""Drag and added mass of a slender body in a fluid."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import function as check_function
from ...core.declared import optional
from ...core.functions_of_time import at_time, taken
from ...core.leaves import leaf, with_values
from ...core.validation import Value
from ...math.quaternions import skew
from ...math.shapes import broadcast_shapes
from .load_point import (
    ACCELERATION,
    POSITION,
    ROTATION,
    VELOCITY,
    LoadEffect,
    LoadPoint,
    Wrench,
    jacobians,
)
from .values import Input, Inputs, load_value, value_at
from .wind import WindField, in_frame


def _flow(name: str, value: Any) -> Any:
    if isinstance(value, WindField):
        return value
    if callable(value):
        return check_function(name, value, "position", "t")
    return load_value(name, value)


@dataclass(frozen=True)
class Drag(LoadEffect):
    """Quadratic fluid drag per unit length, across and along the axis, and added mass.

        f = -1/2 rho d (C_n |v_n| v_n + pi C_t |v_t| v_t) - C_a rho pi d^2/4 a_n,
        v = velocity - flow

    (Morison et al. 1950; across and along the axis after Taylor 1952.)

    The component v_t is along the section's x axis, the normal of the deformed cross-section; v_n
    is across it. The acceleration a_n is across it too, so the flow must be uniform and steady if
    there is an added mass. The beam's axis deviates from that normal by the shear strain. The angle
    is small unless the beam is soft in shear; by it v_t and v_n mix.

    Args:
        density: (...) kg/m^3 of the fluid
        diameter: (...) m: width across the flow, pi d the wetted circumference
        normal, tangential: (...) C_n and C_t; a smooth circular cylinder has C_n near 1.2 below and
            0.4 above the drag crisis
        flow: m/s: (..., 3) or an Input of size 3, uniform, in inertial axes, as Gravity's g; a
            `Wind`, `Gust`, `Turbulence`, `WindTable`, or a sum of them; or function(position, t)
            -> (..., sites, 3), both in frame a; None = still
        added_mass: (...) C_a of the fluid that moves along; a circular cylinder in potential flow
            has 1. None or 0: none
        on: name of a beam of a structure; None = all

    The fluid's inertia is a load: its work is in `energy.work`, and `energy.kinetic` is the beam's
    alone.

    Raises:
        ValueError: for a negative density, diameter or coefficient. For an added mass in a flow
            that is a function or an Input, whose own acceleration would push as well.

    Examples:
        >>> swim = tb.Scene(beam, [tb.Drag(density=1000.0, diameter=0.03, flow=(0, 0, 0.5))])
        >>> tb.equilibrium(swim).tip.position[2] > 0  # bent by the stream
        tensor(True)
    """

    density: Value = leaf(0, nonnegative=True)
    diameter: Value = leaf(0, nonnegative=True)
    normal: Value = leaf(0, default=1.2, nonnegative=True)
    tangential: Value = leaf(0, default=0.0, nonnegative=True)
    flow: Value | Input | WindField | Callable[[Tensor, Tensor], Tensor] | None = leaf(
        lambda drag: None if callable(drag.flow) else 1, default=None, check=_flow
    )
    added_mass: Value | None = leaf(0, default=None, check=optional)
    on: str | None = field(default=None, kw_only=True)

    by_place = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.carries and (self.by_position or isinstance(self.flow, Input)):
            raise ValueError(
                "Drag with an added mass in a flow that is a function or an Input was given; with "
                "an added mass the flow is uniform and steady"
            )

    @property
    def by_position(self) -> bool:
        """Whether the flow differs from place to place."""
        return callable(self.flow) or isinstance(self.flow, WindField)

    @property
    def carries(self) -> bool:
        """Whether fluid moves along."""
        return self.added_mass is not None

    @property
    def added(self) -> Tensor:
        """(..., 1, 1) kg/m, mass of fluid that moves with the beam across its axis."""
        return (self.added_mass * self.density * self.diameter**2 * (math.pi / 4))[..., None, None]

    def in_free_vibration(self) -> LoadEffect | None:
        return with_values(self, flow=None) if self.carries else None

    @property
    def conservative(self) -> bool:
        return self.flow is None

    @property
    def wants_axes(self) -> bool:
        return self.flow is not None and not callable(self.flow)

    @property
    def depends(self) -> frozenset[str]:
        more = {POSITION: self.by_position, ACCELERATION: self.carries}
        return frozenset({ROTATION, VELOCITY, *(name for name, read in more.items() if read)})

    def wrench(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Wrench:
        axis, u, across = self._parts(point, t, inputs)
        normal, tangential = self._factors()
        force = normal * norm(across) * across + tangential * u.abs() * u * axis
        if point.acceleration is None or not self.carries:
            return force, None
        a = point.acceleration
        return force - self.added * (a - (a * axis).sum(-1, keepdim=True) * axis), None

    def tangent(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        """With e the axis, P = e e^T and u = v.e:

        d(|v_n| v_n) = (|v_n| I + v_n v_n^T/|v_n|) d(v_n),    d(v_n) = (I - P) dv - (e v^T + u I) de
        d(|u| u e) = 2 |u| P dv + |u| (2 e v^T + u I) de,    de = spin x e
        d(a_n) = (I - P) da - (e a^T + (a.e) I) de
        """
        axis, u, across = self._parts(point, t, inputs)
        normal, tangential = (c[..., None] for c in self._factors())
        eye = torch.eye(3, dtype=axis.dtype, device=axis.device)
        size = norm(across)
        unit = across / torch.where(size > 0, size, torch.ones_like(size))
        grow = normal * (size[..., None] * eye + outer(across, unit))
        along = 2 * tangential * u.abs()[..., None]
        by_axis = outer(axis, u * axis + across) + u[..., None] * eye  # -d(v_n)/de
        turn = (
            along / 2 * (u[..., None] * eye + 2 * outer(axis, u * axis + across)) - grow @ by_axis
        ) @ -skew(axis)
        P = outer(axis, axis)
        by_velocity = grow @ (eye - P) + along * P
        derivatives = {ROTATION: turn, VELOCITY: by_velocity}
        if self.carries:
            added, a = self.added[..., None], point.acceleration
            derivatives[ACCELERATION] = -added * (eye - P)
            if a is not None:
                along_a = (a * axis).sum(-1, keepdim=True)[..., None]
                by_axis = added * (outer(axis, a) + along_a * eye)
                derivatives[ROTATION] = turn + by_axis @ -skew(axis)
        if self.by_position:
            at = point.position.expand(*broadcast_shapes(point.position.shape, axis.shape))

            def flow(x: Tensor) -> Tensor:
                return torch.broadcast_tensors(self._flow(replace(point, position=x), t), x)[0]

            (slope,) = jacobians(flow, at)
            derivatives[POSITION] = -by_velocity @ slope
        return {name: torch.cat((d, torch.zeros_like(d)), -2) for name, d in derivatives.items()}

    def _flow(self, point: LoadPoint, t: Tensor) -> Tensor:
        """(..., sites, 3) m/s, frame a, of a flow that differs from place to place."""
        if isinstance(self.flow, WindField):
            return in_frame(self.flow.velocity, point, t)
        what, x = "a flow function's value", point.position
        return at_time(lambda now: taken(what, self.flow(x, now), x, 3), t, axes=2)

    def _factors(self) -> tuple[Tensor, Tensor]:
        """-1/2 rho d C_n and -1/2 rho d pi C_t, (..., 1, 1)."""
        pressure = -self.density * self.diameter
        both = pressure * self.normal / 2, pressure * self.tangential * (math.pi / 2)
        return tuple(v[..., None, None] for v in both)

    def _parts(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> tuple[Tensor, Tensor, Tensor]:
        """The axis (..., 3), the relative velocity along it (..., 1) and across it (..., 3)."""
        axis, v = point.R[..., :, 0], point.velocity
        if self.by_position:
            v = v - self._flow(point, t)
        elif self.flow is not None:
            flow = value_at(self.flow, t, inputs, point.R)
            v = v - point.from_inertial(flow)[..., None, :]
        u = (v * axis).sum(-1, keepdim=True)
        return axis, u, v - u * axis


def norm(v: Tensor) -> Tensor:
    """|v| (..., 1), with derivative 0 at v = 0."""
    square = v.square().sum(-1, keepdim=True)
    some = square > 0
    root = torch.where(some, square, torch.ones_like(square)).sqrt()
    return torch.where(some, root, torch.zeros_like(square))


def outer(x: Tensor, y: Tensor) -> Tensor:
    """x y^T"""
    return x[..., :, None] * y[..., None, :]
