"""The same scene in other words: each function here takes the parts of a scene and gives those of one that is to do the same.

`SHARES`, `ZEROS` and `USERS` have a row for every effect: how it is split, what none of it is, and the user's load that does what
it does.
"""

from __future__ import annotations

import copy
import functools
import math
import types
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import torch
from metamorphic_similarity import _tensor, quantities
from torch import Tensor

import torchbeam as tb
from torchbeam.math import quaternions as quat

Parts = dict[str, Any]


class NotHere(Exception):
    """The scene has nothing that could be said so."""


def times(k: float, value: Any) -> Any:
    """k times whatever may be a load's value, or what a user's function answers."""
    if value is None or isinstance(value, Tensor | np.ndarray | float | int):
        return value if value is None else k * value
    if isinstance(value, tb.Input):
        raise NotHere
    if isinstance(value, tb.PerElement):
        return tb.PerElement(times(k, value.value))
    if isinstance(value, tb.Along):
        return tb.Along(times(k, value.function))
    if callable(value):
        return lambda *arguments, **named: times(k, value(*arguments, **named))
    return type(value)(times(k, v) for v in value)


SHARES: dict[type, tuple[str, ...]] = {  # what of an effect is halved for half of it; (): it cannot be split
    tb.TipLoad: ("force", "moment"), tb.PointLoad: ("force", "moment"), tb.LineLoad: ("force", "moment"), tb.Gravity: ("g",),
    tb.Damping: (), tb.MassDamping: ("alpha",), tb.Drag: ("density",), tb.PointMass: ("mass", "inertia"),
    tb.Actuation: ("curvature", "strain"), tb.Spring: ("stiffness", "damping"), tb.RootSpring: ("stiffness", "damping"),
    tb.Load: ("function",),
}


def share(effect: Any, k: float) -> Any:
    names = SHARES[type(effect)]
    if not names or getattr(effect, "internal", 0):
        raise NotHere
    return replace(effect, **{name: times(k, getattr(effect, name)) for name in names})


def halved(parts: Parts) -> Parts:
    """Every effect that can be is two, of 0.3 and 0.7 of it."""
    found, split = [], False
    for effect in parts["effects"]:
        try:
            found += [share(effect, 0.3), share(effect, 0.7)]
            split = True
        except NotHere:
            found.append(effect)
    if not split:
        raise NotHere
    return {**parts, "effects": tuple(found)}


ZEROS: dict[type, Callable[[Any], Any]] = {  # of what zero is: a number, or a tensor, which may carry gradient
    tb.TipLoad: lambda o: tb.TipLoad(force=(o, o, o), moment=(o, o, o)),
    tb.PointLoad: lambda o: tb.PointLoad(1, force=(o, o, o), follower=True),
    tb.LineLoad: lambda o: tb.LineLoad(force=(o, o, o), moment=(o, o, o)),
    tb.Gravity: lambda o: tb.Gravity((o, o, o)),
    tb.Damping: lambda o: tb.Damping(o),
    tb.MassDamping: lambda o: tb.MassDamping(o),
    tb.Drag: lambda o: tb.Drag(o, 0.1, flow=(1.0, 0.0, 0.0)),
    tb.PointMass: lambda o: tb.PointMass(o, inertia=(o, o, o)),
    tb.Actuation: lambda o: tb.Actuation(curvature=(o, o, o), strain=(o, o, o)),
    tb.Spring: lambda o: tb.Spring(-1, o, (0.3, 0.0, 0.0), length=0.1, damping=o),
    tb.RootSpring: None,  # of no stiffness it frees the root
    tb.Load: lambda o: tb.Load(lambda r, R, v, w, t: (o * r, o * w), node=None),
}


def with_zero(kind: type, tensor: bool) -> Callable[[Parts], Parts]:
    def added(parts: Parts) -> Parts:
        if kind is tb.Damping and any(isinstance(e, tb.Damping) for e in parts["effects"]):
            raise NotHere
        return {**parts, "effects": (*parts["effects"], ZEROS[kind](torch.zeros(()) if tensor else 0.0))}
    return added


def reversed_effects(parts: Parts) -> Parts:
    if len(parts["effects"]) < 2 or sum(getattr(e, "internal", 0) > 0 for e in parts["effects"]) > 1:
        raise NotHere
    return {**parts, "effects": parts["effects"][::-1]}


def each(change: Callable[[Any], Any]) -> Callable[[Parts], Parts]:
    """`change(part)` of every effect, support, frame and root: something else, or the same."""
    def changed(parts: Parts) -> Parts:
        new = {name: tuple(map(change, parts[name])) if isinstance(parts[name], tuple) else parts[name] and change(parts[name])
               for name in ("effects", "supports", "frame", "root")}
        if all(a is b for name in new for a, b in zip(_listed(new[name]), _listed(parts[name]), strict=True)):
            raise NotHere
        return {**parts, **new}
    return changed


def _listed(x: Any) -> tuple:
    return x if isinstance(x, tuple) else (x,)


MAY_BE_FUNCTIONS = ("force", "moment", "g", "curvature", "strain", "displacement", "rotation", "turn", "velocity",
                    "angular_velocity", "to")


def _valued(change: Callable[[Any], Any], only: tuple[str, ...] = MAY_BE_FUNCTIONS) -> Callable[[Any], Any]:
    """Of an object, the values that may be functions of t changed."""
    def changed(of: Any) -> Any:
        new = {}
        for name in quantities(of):
            value = getattr(of, name)
            if name in only and value is not None and (other := change(value)) is not value:
                new[name] = other
        return replace(of, **new) if new else of
    return changed


def _function(value: Any) -> Any:
    if callable(value) or isinstance(value, tb.Input | tb.PerElement):
        return value
    held = torch.as_tensor(value)
    return lambda t: held


def _history(value: Any) -> Any:
    if callable(value) or isinstance(value, tb.Input | tb.PerElement):
        return value
    held = torch.as_tensor(value)
    return tb.History(torch.tensor([-1e3, 0.2, 1e3]), torch.stack((held, held, held), -2))


def _tuple(value: Any) -> Any:
    if callable(value) or isinstance(value, tb.Input | tb.PerElement):
        return value
    held = torch.as_tensor(value)
    return lambda t: (held[..., 0], held[..., 1], held[..., 2])


def _along(of: Any) -> Any:
    """A line load's numbers as a function of s, or for each element."""
    if not isinstance(of, tb.LineLoad):
        return of

    def along(value: Any) -> Any:
        if callable(value) and not isinstance(value, tb.PerElement | tb.Along):
            return tb.Along(lambda s, t: _tensor(value(t))[..., None, :] + 0 * s[..., None])
        if callable(value) or isinstance(value, tb.Input | tb.PerElement | tb.Along):
            return value
        held = torch.as_tensor(value)
        return tb.Along(lambda s, t: held[..., None, :] + 0 * s[..., None])
    return _valued(along)(of)


def _per_element(parts: Parts) -> Parts:
    def of_each(value: Any) -> Any:
        if isinstance(value, tb.Input | tb.PerElement | tb.Along):
            return value
        N = parts["beam"].element_count
        if callable(value):
            return tb.PerElement(lambda t: _tensor(value(t))[..., None, :].expand(*_tensor(value(t)).shape[:-1], N, 3))
        held = torch.as_tensor(value)
        return tb.PerElement(held[..., None, :].expand(*held.shape[:-1], N, 3))
    return each(lambda e: _valued(of_each)(e) if isinstance(e, tb.LineLoad | tb.Actuation) else e)(parts)


def _tip_as_point(parts: Parts) -> Parts:
    last = parts["beam"].count
    return each(lambda e: tb.PointLoad(node=last, force=e.force, moment=e.moment, follower=e.follower) if isinstance(e, tb.TipLoad) else e)(parts)


def _inputs(of: Any) -> dict[str, int]:
    return {v.name: v.size for name in quantities(of) if isinstance(v := getattr(of, name), tb.Input)}


def _at(value: Any, t: Tensor, named: dict[str, Tensor]) -> Tensor | None:
    if isinstance(value, tb.Input):
        return named[value.name]
    return None if value is None else _tensor(value(t)) if callable(value) else torch.as_tensor(value)


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
                w = w[..., None, :] if line and w is not None and not isinstance(value, tb.Input) else w
            return w if w is None or not e.follower else (rotation @ w[..., None])[..., 0]
        return told(e.force), told(e.moment)
    of = (("rotation",) if e.follower else ()) + (("s",) if line else ())
    return tb.Load(function, node=None if line else e.node, inputs=_inputs(e), of=of)


def _plain_mass(parts: Parts) -> None:
    """Mass per length on the axis, the same along the beam, and no bodies."""
    if parts["beam"].offset or parts["beam"].mass.shape[-3] != 1 or any(isinstance(e, tb.PointMass) for e in parts["effects"]):
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
    m, J, alpha = parts["beam"].mass[..., 0, 0, 0], parts["beam"].mass[..., 0, 3:, 3:], torch.as_tensor(e.alpha)

    def function(position, rotation, velocity, spin, t):
        back = J[..., None, :, :] @ (rotation.mT @ spin[..., None])
        return -(alpha * m)[..., None, None] * velocity, -alpha[..., None, None] * (rotation @ back)[..., 0]
    return tb.Load(function, node=None)


def _user_drag(e: Any, parts: Parts) -> Any:
    if isinstance(e.added_mass, Tensor) or np.any(e.added_mass):
        raise NotHere
    if e.flow is not None and not callable(e.flow):
        _inertial(parts)
    rho, d, normal, tangential = (torch.as_tensor(v)[..., None, None] for v in (e.density, e.diameter, e.normal, e.tangential))

    def size(v):
        return torch.where((s := v.square().sum(-1, keepdim=True)) > 0, s, torch.ones_like(s)).sqrt() * (s > 0)

    def function(position, rotation, velocity, spin, t):
        v = velocity
        if e.flow is not None:
            v = v - (_tensor(e.flow(position, t)) if callable(e.flow) else torch.as_tensor(e.flow)[..., None, :])
        axis = rotation[..., :, 0]
        along = (v * axis).sum(-1, keepdim=True) * axis
        across = v - along
        return -rho * d / 2 * (normal * size(across) * across + math.pi * tangential * size(along) * along), None
    return tb.Load(function, node=None)


def _user_spring(e: Any, parts: Parts) -> Any:
    if e.damped and (parts["frame"] is not None or callable(e.to)):
        raise NotHere
    k, length, c = (torch.as_tensor(v)[..., None] for v in (e.stiffness, e.length, e.damping))

    def function(position, rotation, velocity, spin, t, **named):
        d = position - _at(e.to, t, named)
        if e.linear:
            return -k * d - c * velocity, None
        r = d.square().sum(-1, keepdim=True).sqrt()
        return -(k * (r - length) + c * (d * velocity).sum(-1, keepdim=True) / r) * d / r, None
    return tb.Load(function, node=e.node, inputs=_inputs(e))


USERS: dict[type, Callable[[Any, Parts], Any] | None] = {  # None: what a user's load cannot do, or is one already
    tb.TipLoad: _user_given, tb.PointLoad: _user_given, tb.LineLoad: _user_given, tb.Gravity: _user_gravity, tb.Damping: None,
    tb.MassDamping: _user_mass_damping, tb.Drag: _user_drag, tb.PointMass: None, tb.Actuation: None, tb.Spring: _user_spring,
    tb.RootSpring: None, tb.Load: None,
}


def as_user(parts: Parts) -> Parts:
    """Whatever can be, a user's function of the motion."""
    def changed(e: Any) -> Any:
        make = USERS.get(type(e))
        try:
            return e if make is None else make(e, parts)
        except NotHere:
            return e
    return each(changed)(parts)


def nodal_loads(parts: Parts) -> Parts:
    """A dead line load of order 1 elements as the loads of nodes that get half of each element beside them."""
    beam = parts["beam"]
    if beam.order != 1 or beam.linked_interpolation:
        raise NotHere
    half = beam.length / 2
    none = torch.zeros_like(half[..., :1])
    share_of = torch.cat((half, none), -1) + torch.cat((none, half), -1)

    def at(value: Any, n: int) -> Any:
        if value is None or isinstance(value, tb.Input | tb.PerElement | tb.Along):
            raise NotHere
        return (lambda t: share_of[..., n, None] * _tensor(value(t))) if callable(value) else (
            share_of[..., n, None] * torch.as_tensor(value))

    found = []
    for e in parts["effects"]:
        if isinstance(e, tb.LineLoad) and not any(isinstance(v, tb.Input | tb.PerElement | tb.Along) for v in (e.force, e.moment)):
            given = {name: v for name in ("force", "moment") if (v := getattr(e, name)) is not None}
            found += [tb.PointLoad(node=n, follower=e.follower, **{name: at(v, n) for name, v in given.items()})
                      for n in range(beam.count + 1)]
        else:
            found.append(e)
    if len(found) == len(parts["effects"]):
        raise NotHere
    return {**parts, "effects": tuple(found)}


def supports_said(parts: Parts) -> Parts:
    """The clamp that is there by default, and its motion, as a support, counted from the other end."""
    if parts["supports"] is not None:
        if not parts["supports"]:
            raise NotHere
        count = parts["beam"].count + 1
        turned = [replace(s, node=s.node + count if s.node < 0 else s.node - count) for s in parts["supports"]]
        return {**parts, "supports": tuple(turned[::-1])}
    if any(isinstance(e, tb.RootSpring) for e in parts["effects"]):
        raise NotHere
    root = parts["root"]
    clamp = tb.Support(0) if root is None else tb.Support(0, displacement=root.displacement, turn=root.rotation)
    return {**parts, "supports": (clamp,), "root": None}


def in_space(parts: Parts) -> Parts:
    """A plane scene without saying that it is one."""
    if parts["plane"] is None:
        raise NotHere
    return {**parts, "plane": None}


def beam_again(parts: Parts) -> Parts:
    """The beam from its nodes and element axes, where they have all of it."""
    beam = parts["beam"]
    chord = beam.nodes.diff(dim=-2)
    along = (torch.linalg.vector_norm(chord, dim=-1) - beam.length).abs().max() < 1e-12 * beam.length.max()
    axes = quat.matrix(beam.elements)
    if beam.order != 1 or not along or not (axes[..., :, 0] * beam.length[..., None] - chord).abs().max() < 1e-12:
        raise NotHere
    S, mass = beam.compliance, beam.mass
    one = S.shape[-3] == 1
    section = (tb.Section(S[..., 0, :, :], mass[..., 0, :, :]) if one else
               [tb.Section(S[..., i, :, :], mass[..., min(i, mass.shape[-3] - 1), :, :]) for i in range(beam.count)])
    made = tb.Beam.from_nodes(beam.nodes, section, axes)
    if beam.curved and not (quat.matrix(made.frames) - quat.matrix(beam.frames)).abs().max() < 1e-12:
        raise NotHere
    return {**parts, "beam": made.linked() if beam.linked_interpolation else made}


def sections_again(parts: Parts) -> Parts:
    """Each element its section, where all have one."""
    beam = parts["beam"]
    if beam.compliance.shape[-3] != 1 or beam.mass.shape[-3] != 1:
        raise NotHere
    N = beam.count
    return {**parts, "beam": replace(beam, compliance=beam.compliance.expand(*beam.compliance.shape[:-3], N, 6, 6).clone(),
                                     mass=beam.mass.expand(*beam.mass.shape[:-3], N, 6, 6).clone())}


def replaced(parts: Parts) -> Parts:
    """Every object by `dataclasses.replace` of nothing."""
    def again(of: Any) -> Any:
        return replace(of)
    scene = replace(tb.Scene(**parts))
    new = {f.name: getattr(scene, f.name) for f in fields(tb.Scene)}
    return {**new, "beam": replace(new["beam"])}


def copied(parts: Parts) -> Parts:
    return {f.name: getattr(copy.copy(tb.Scene(**parts)), f.name) for f in fields(tb.Scene)}


class _Factor:
    """A user's object with a number."""

    def __init__(self, function: Callable, k: float) -> None:
        self.function, self.k = function, k

    def __call__(self, *a: Any, **named: Any) -> Any:
        return times(self.k, self.function(*a, **named))

    def method(self, *a: Any, **named: Any) -> Any:
        return times(self.k, self.function(*a, **named))


def _with_default(f: Callable, k: float) -> Callable:
    def function(*a: Any, k: float = k, **named: Any) -> Any:
        return times(k, f(*a, **named))
    return function


def _nested(f: Callable, k: float) -> Callable:
    def inner(*a: Any, **named: Any) -> Any:
        return times(k, f(*a, **named))

    def outer(*a: Any, **named: Any) -> Any:
        return inner(*a, **named)
    return outer


SHELF = types.SimpleNamespace(k=1.0)


def _on_shelf(f: Callable, k: float) -> Callable:
    SHELF.k = k
    return lambda *a, **named: times(SHELF.k, f(*a, **named))


def _partial(f: Callable, k: float) -> Callable:
    return functools.partial(lambda number, *a, **named: times(number, f(*a, **named)), k)


def _in_list(f: Callable, k: float) -> Callable:
    held = [0.0, k]
    return lambda *a, **named: times(held[1], f(*a, **named))


def _in_dict(f: Callable, k: float) -> Callable:
    held = {"gain": k}
    return lambda *a, **named: times(held["gain"], f(*a, **named))


def _in_tensor(f: Callable, k: float) -> Callable:
    held = torch.tensor(k)
    return lambda *a, **named: times(1.0, [None if w is None else held * w for w in _listed(f(*a, **named))]
                                     if isinstance(f(*a, **named), tuple) else held * _tensor(f(*a, **named)))


HOLDERS: dict[str, Callable[[Callable, float], Callable]] = {  # where the number of a user's function may be
    "closure": lambda f, k: lambda *a, **named: times(k, f(*a, **named)), "default": _with_default, "partial": _partial,
    "method": lambda f, k: _Factor(f, k).method, "object": _Factor, "nested": _nested, "list": _in_list, "dict": _in_dict,
    "module": _on_shelf, "tensor": _in_tensor,
}


def numbered(parts: Parts, holder: str, k: float) -> Parts:
    """Every function in a scene k times what it is, by the same code whatever k."""
    hold = HOLDERS[holder]

    def changed(of: Any) -> Any:
        if isinstance(of, tb.Load):
            return replace(of, function=hold(of.function, k), **({} if of.rate is None else {"rate": hold(of.rate, k)}))
        new = {}
        for name in quantities(of):
            value = getattr(of, name)
            if isinstance(value, tb.Along):
                new[name] = tb.Along(hold(value.function, k))
            elif isinstance(value, tb.PerElement):
                if callable(value.value):
                    new[name] = tb.PerElement(hold(value.value, k))
            elif callable(value) and name != "moving":
                new[name] = hold(value, k)
        return replace(of, **new) if new else of
    return each(changed)(parts)


WORDS: dict[str, Callable[[Parts], Parts]] = {
    "effects in another order": reversed_effects,
    "effects in two parts": halved,
    "values as functions": each(_valued(_function)),
    "values as functions with components": each(_valued(_tuple)),
    "values as histories": each(_valued(_history, ("force", "moment"))),
    "line loads along": each(_along),
    "line loads of elements": _per_element,
    "line loads at nodes": nodal_loads,
    "tip loads as point loads": _tip_as_point,
    "loads by the user": as_user,
    "supports said": supports_said,
    "in space": in_space,
    "beam from nodes": beam_again,
    "sections of elements": sections_again,
    "by replace": replaced,
    "copied": copied,
    **{f"no {kind.__name__} as a {'tensor' if tensor else 'number'}": with_zero(kind, tensor)
       for kind, make in ZEROS.items() if make for tensor in (False, True)},
}


