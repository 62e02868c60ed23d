"""The same scene in other words: each function here takes the parts of a scene and gives those of
one that is to do the same.

What none of an effect is stands in `cases.rows`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import torch

import torchbeam as tb
from cases.rows import ROWS, Row, double
from tests.cases.metamorphic_parts import NotHere, Parts, each, times
from tests.cases.metamorphic_similarity import quantities, tensor
from tests.cases.metamorphic_users import EFFECTS, as_user, nodal_loads
from torchbeam.extend import quaternions as quat


def share(effect: Any, k: float) -> Any:
    names = EFFECTS[type(effect)][0]
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


# by its class, the first row of what is absent at some value
ZEROS: dict[str, Row] = {}
for name, row in ROWS.items():
    if row.zero is not None:
        ZEROS.setdefault(re.split(r"\W", name)[0], row)


def with_zero(name: str, tensor: bool) -> Callable[[Parts], Parts]:
    """None of an effect beside the others; a tensor may carry gradient."""

    def added(parts: Parts) -> Parts:
        if name == "Damping" and any(isinstance(e, tb.Damping) for e in parts["effects"]):
            raise NotHere
        if any(isinstance(e, tb.Viscoelastic) for e in parts["effects"]) and name == "Viscoelastic":
            raise NotHere
        zero = ZEROS[name].zero
        none = ZEROS[name].make(double(zero) if tensor else zero, parts["beam"].element_count)
        return {**parts, "effects": (*parts["effects"], none)}

    return added


def reversed_effects(parts: Parts) -> Parts:
    if (
        len(parts["effects"]) < 2
        or sum(getattr(e, "internal", 0) > 0 for e in parts["effects"]) > 1
    ):
        raise NotHere
    return {**parts, "effects": parts["effects"][::-1]}


MAY_BE_FUNCTIONS = (
    "force", "moment", "g", "curvature", "strain", "displacement", "rotation", "turn", "velocity",
    "angular_velocity", "to",
)  # fmt: skip


def _valued(
    change: Callable[[Any], Any], only: tuple[str, ...] = MAY_BE_FUNCTIONS
) -> Callable[[Any], Any]:
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
            return tb.Along(lambda s, t: tensor(value(t))[..., None, :] + 0 * s[..., None])
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
            return tb.PerElement(
                lambda t: tensor(value(t))[..., None, :].expand(*tensor(value(t)).shape[:-1], N, 3)
            )
        held = torch.as_tensor(value)
        return tb.PerElement(held[..., None, :].expand(*held.shape[:-1], N, 3))

    return each(lambda e: _valued(of_each)(e) if isinstance(e, tb.LineLoad | tb.Actuation) else e)(
        parts
    )


def _tip_as_point(parts: Parts) -> Parts:
    last = parts["beam"].station_count

    def point(e: Any) -> Any:
        same = isinstance(e, tb.TipLoad)
        return (
            tb.PointLoad(node=last, force=e.force, moment=e.moment, follower=e.follower)
            if same
            else e
        )

    return each(point)(parts)


def supports_said(parts: Parts) -> Parts:
    """The clamp that is there by default, and its motion, as a support, counted from the other
    end.
    """
    if parts["supports"] is not None:
        if not parts["supports"]:
            raise NotHere
        count = parts["beam"].station_count + 1
        turned = [
            replace(s, node=s.node + count if s.node < 0 else s.node - count)
            for s in parts["supports"]
        ]
        return {**parts, "supports": tuple(turned)}  # in their order, which is that of reactions
    if any(isinstance(e, tb.RootSpring) for e in parts["effects"]):
        raise NotHere
    root = parts["root"]
    clamp = (
        tb.Support(0)
        if root is None
        else tb.Support(0, displacement=root.displacement, turn=root.rotation)
    )
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
    along = (
        torch.linalg.vector_norm(chord, dim=-1) - beam.length
    ).abs().max() < 1e-12 * beam.length.max()
    axes = quat.matrix(beam.elements)
    if (
        beam.order != 1
        or not along
        or not (axes[..., :, 0] * beam.length[..., None] - chord).abs().max() < 1e-12
    ):
        raise NotHere
    S, mass = beam.compliance, beam.mass
    one = S.shape[-3] == 1
    section = (
        tb.Section(S[..., 0, :, :], mass[..., 0, :, :])
        if one
        else [
            tb.Section(S[..., i, :, :], mass[..., min(i, mass.shape[-3] - 1), :, :])
            for i in range(beam.station_count)
        ]
    )
    made = tb.Beam.from_nodes(beam.nodes, section, axes)
    if (
        beam.curved
        and not (quat.matrix(made.frames) - quat.matrix(beam.frames)).abs().max() < 1e-12
    ):
        raise NotHere
    return {**parts, "beam": made.linked() if beam.linked_interpolation else made}


def beam_by_curvature(parts: Parts) -> Parts:
    """The beam as a curve, from the curvature that turns its axes from node to node."""
    beam = parts["beam"]
    turn, h = _turns(beam), beam.length
    axes, k = quat.matrix(beam.frames[..., 0, :]), turn / h[..., None]

    def curvature(s: torch.Tensor) -> torch.Tensor:  # at one place or two of each interval
        return k.repeat_interleave(s.shape[-1] // h.shape[-1], -2)

    made = tb.Beam.curve(
        h.sum(-1), beam.element_count,
        tb.Section(beam.compliance[..., 0, :, :], beam.mass[..., 0, :, :]), curvature,
        direction=axes[..., 0], up=axes[..., 2], root=beam.nodes[..., 0, :], order=beam.order,
    )  # fmt: skip
    fits = all(
        (getattr(made, name) - getattr(beam, name)).abs().max() < 1e-12 * h.max()
        for name in ("nodes", "length")
    )
    turned = quat.matrix(made.elements) - quat.matrix(beam.elements)
    if not fits or not turned.abs().max() < 1e-12:
        raise NotHere
    kept = ("compliance", "mass", "linked_interpolation")
    return {**parts, "beam": replace(made, **{name: getattr(beam, name) for name in kept})}


def rest_by_actuation(parts: Parts) -> Parts:
    """A straight beam that takes the shape at rest by itself: the difference of the two strains."""
    beam, plane = parts["beam"], parts["plane"]
    off_diagonal = beam.mass - torch.diag_embed(beam.mass.diagonal(dim1=-2, dim2=-1))
    if (
        beam.order != 1
        or beam.linked_interpolation
        or not beam.curved
        or plane is not None
        or parts["small"]
        or parts["supports"] is not None
        or off_diagonal.any()  # masses off the axis lie where elements are turned to
    ):
        raise NotHere
    h, e_1 = beam.length[..., None], torch.tensor([1.0, 0.0, 0.0])
    axes, turn = quat.matrix(beam.elements), _turns(beam)
    strain = (axes.mT @ (beam.nodes.diff(dim=-2) / h)[..., None])[..., 0] - e_1
    root, frame = beam.nodes[..., :1, :], beam.frames[..., :1, :]
    along = torch.nn.functional.pad(beam.length.cumsum(-1), (1, 0))[..., None]
    straight = replace(
        beam,
        nodes=root + along * quat.rotate(frame, e_1),
        frames=frame.expand(beam.frames.shape),
        elements=frame.expand(beam.elements.shape),
    )
    bent = tb.Actuation(curvature=tb.PerElement(turn / h), strain=tb.PerElement(strain))
    return {**parts, "beam": straight, "effects": (*parts["effects"], bent)}


def _turns(beam: tb.Beam) -> torch.Tensor:
    """By which section axes turn from node to node, rad, in section axes."""
    a, b = beam.frames[..., :-1, :], beam.frames[..., 1:, :]
    return quat.logarithm(quat.multiply(quat.conjugate(a), b))


def sections_again(parts: Parts) -> Parts:
    """Each element its section, where all have one."""
    beam = parts["beam"]
    if beam.compliance.shape[-3] != 1 or beam.mass.shape[-3] != 1:
        raise NotHere
    N = beam.station_count
    return {
        **parts,
        "beam": replace(
            beam,
            compliance=beam.compliance.expand(*beam.compliance.shape[:-3], N, 6, 6).clone(),
            mass=beam.mass.expand(*beam.mass.shape[:-3], N, 6, 6).clone(),
        ),
    }


def replaced(parts: Parts) -> Parts:
    """The scene, its beam and its effects by `dataclasses.replace` of nothing, after they were
    bound to tensors.
    """
    scene = tb.Scene(**parts)
    scene = replace(scene, beam=replace(scene.beam), effects=tuple(map(replace, scene.effects)))
    return {f.name: getattr(scene, f.name) for f in fields(tb.Scene)}


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
    "beam by curvature": beam_by_curvature,
    "rest shape by actuation": rest_by_actuation,
    "sections of elements": sections_again,
    "by replace": replaced,
    **{
        f"no {name} as a {'tensor' if tensor else 'number'}": with_zero(name, tensor)
        for name in ZEROS
        for tensor in (False, True)
    },
}
