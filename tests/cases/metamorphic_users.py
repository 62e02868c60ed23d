"""How effects are split, and loads as a user would write them: `EFFECTS` has a row for each."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb
from tests.cases.metamorphic_parts import NotHere, Parts, each
from tests.cases.metamorphic_similarity import quantities, tensor


def _inputs(of: Any) -> dict[str, int]:
    return {
        v.name: v.size for name in quantities(of) if isinstance(v := getattr(of, name), tb.Input)
    }


def _at(value: Any, t: Tensor, named: dict[str, Tensor]) -> Tensor | None:
    if isinstance(value, tb.Input):
        return named[value.name]
    return (
        None if value is None else tensor(value(t)) if callable(value) else torch.as_tensor(value)
    )


def _user_given(e: Any, parts: Parts) -> Any:
    """A force and a moment at a node or along the beam."""
    line = isinstance(e, tb.LineLoad)
    if line and any(isinstance(getattr(e, name), tb.PerElement) for name in ("force", "moment")):
        raise NotHere

    def function(position, rotation, velocity, spin, t, **named):
        def told(value: Any) -> Tensor | None:
            if isinstance(value, tb.Along):
                w = value.function(named["s"], t)
            else:
                w = _at(value, t, named)
                w = (
                    w[..., None, :]
                    if line and w is not None and not isinstance(value, tb.Input)
                    else w
                )
            return w if w is None or not e.follower else (rotation @ w[..., None])[..., 0]

        return told(e.force), told(e.moment)

    of = (("rotation",) if e.follower else ()) + (("s",) if line else ())
    return tb.Load(function, node=None if line else e.node, inputs=_inputs(e), of=of)


def _plain_mass(parts: Parts) -> None:
    """Mass per length on the axis, the same along the beam, and no bodies."""
    if (
        parts["beam"].offset
        or parts["beam"].mass.shape[-3] != 1
        or any(isinstance(e, tb.PointMass) for e in parts["effects"])
    ):
        raise NotHere


def _inertial(parts: Parts) -> None:
    if parts["frame"] is not None and parts["frame"].angular_velocity is not None:
        raise NotHere


def _user_gravity(e: Any, parts: Parts) -> Any:
    _plain_mass(parts), _inertial(parts)
    m = parts["beam"].mass[..., 0, 0, 0]

    def function(position, rotation, velocity, spin, t, **named):
        g = _at(e.g, t, named)
        g = g if isinstance(e.g, tb.Input) else g[..., None, :]
        return m[..., None, None] * g, None

    return tb.Load(function, node=None, inputs=_inputs(e), of=())


def _user_mass_damping(e: Any, parts: Parts) -> Any:
    _plain_mass(parts)
    m, J = parts["beam"].mass[..., 0, 0, 0], parts["beam"].mass[..., 0, 3:, 3:]
    alpha = torch.as_tensor(e.alpha)

    def function(position, rotation, velocity, spin, t):
        back = J[..., None, :, :] @ (rotation.mT @ spin[..., None])
        return -(alpha * m)[..., None, None] * velocity, -alpha[..., None, None] * (
            rotation @ back
        )[..., 0]

    return tb.Load(function, node=None)


def _user_drag(e: Any, parts: Parts) -> Any:
    if e.added_mass is not None or isinstance(e.flow, tb.Input):
        raise NotHere
    if e.flow is not None and not callable(e.flow):
        _inertial(parts)
    rho, d, normal, tangential = (
        torch.as_tensor(v)[..., None, None] for v in (e.density, e.diameter, e.normal, e.tangential)
    )

    def size(v):
        return torch.where(
            (s := v.square().sum(-1, keepdim=True)) > 0, s, torch.ones_like(s)
        ).sqrt() * (s > 0)

    def function(position, rotation, velocity, spin, t):
        v = velocity
        if e.flow is not None:
            v = v - (
                tensor(e.flow(position, t))
                if callable(e.flow)
                else torch.as_tensor(e.flow)[..., None, :]
            )
        axis = rotation[..., :, 0]
        along = (v * axis).sum(-1, keepdim=True) * axis
        across = v - along
        return -rho * d / 2 * (
            normal * size(across) * across + math.pi * tangential * size(along) * along
        ), None

    return tb.Load(function, node=None)


def _user_spring(e: Any, parts: Parts) -> Any:
    if e.damped and (parts["frame"] is not None or callable(e.to)):
        raise NotHere
    k, length, c = (
        torch.as_tensor(0.0 if v is None else v)[..., None]
        for v in (e.stiffness, e.length, e.damping)
    )

    def function(position, rotation, velocity, spin, t, **named):
        d = position - _at(e.to, t, named)
        if e.linear:
            return -k * d - c * velocity, None
        r = d.square().sum(-1, keepdim=True).sqrt()
        return -(k * (r - length) + c * (d * velocity).sum(-1, keepdim=True) / r) * d / r, None

    return tb.Load(function, node=e.node, inputs=_inputs(e))


# fmt: off
# what of an effect is halved for half of it, () = it cannot be split; and the user's load that does
# the same, None = what it cannot do, or is one already
EFFECTS: dict[type, tuple[tuple[str, ...], Callable[[Any, Parts], Any] | None]] = {
    tb.TipLoad: (("force", "moment"), _user_given),
    tb.PointLoad: (("force", "moment"), _user_given),
    tb.LineLoad: (("force", "moment"), _user_given),
    tb.Gravity: (("g",), _user_gravity),
    tb.Damping: ((), None),
    tb.Viscoelastic: ((), None),
    tb.MassDamping: (("alpha",), _user_mass_damping),
    tb.Drag: (("density",), _user_drag),
    tb.StripAir: (("density",), None),
    tb.PointMass: (("mass", "inertia"), None),
    tb.Actuation: (("curvature", "strain"), None),
    tb.Spring: (("stiffness", "damping"), _user_spring),
    tb.RootSpring: (("stiffness", "damping"), None),
    tb.Contact: (("force", "stiffness"), None),
    tb.SelfContact: (("force", "stiffness"), None),
    tb.Load: (("function",), None),
    tb.Tendon: (("tension", "stiffness"), None),
}
# fmt: on


def as_user(parts: Parts) -> Parts:
    """Whatever can be, a user's function of the motion."""

    def changed(e: Any) -> Any:
        make = EFFECTS[type(e)][1]
        try:
            return e if make is None else make(e, parts)
        except NotHere:
            return e

    return each(changed)(parts)


def nodal_loads(parts: Parts) -> Parts:
    """A dead line load of order 1 elements as the loads of nodes that get half of each element
    beside them.
    """
    beam = parts["beam"]
    if beam.order != 1 or beam.linked_interpolation:
        raise NotHere
    half = beam.length / 2
    none = torch.zeros_like(half[..., :1])
    share_of = torch.cat((half, none), -1) + torch.cat((none, half), -1)

    def at(value: Any, n: int) -> Any:
        if value is None or isinstance(value, tb.Input | tb.PerElement | tb.Along):
            raise NotHere
        return (
            (lambda t: share_of[..., n, None] * tensor(value(t)))
            if callable(value)
            else (share_of[..., n, None] * torch.as_tensor(value))
        )

    found = []
    for e in parts["effects"]:
        placed = tb.Input | tb.PerElement | tb.Along
        if isinstance(e, tb.LineLoad) and not any(
            isinstance(v, placed) for v in (e.force, e.moment)
        ):
            given = {name: v for name in ("force", "moment") if (v := getattr(e, name)) is not None}
            found += [
                tb.PointLoad(
                    node=n, follower=e.follower, **{name: at(v, n) for name, v in given.items()}
                )
                for n in range(beam.station_count + 1)
            ]
        else:
            found.append(e)
    if len(found) == len(parts["effects"]):
        raise NotHere
    return {**parts, "effects": tuple(found)}
