"""What a contact has where it was given no thickness, or neither force nor stiffness: by radius,
weight and stiffness of what touches.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ...core.leaves import constant, with_values
from ...core.validation import concrete
from ..parts import part_of
from .contact_terms import ContactTerms, thinnest
from .gravity import Gravity

SHARE = 10  # of a radius: the thickness
TIMES = 4  # what presses at rest: the force, so that the gap is half of the thickness
BENT = 16  # EI/L^3 a length bends a beam as far as it is long


def with_defaults(effects: tuple[Any, ...], beam: Any) -> tuple[Any, ...]:
    """Effects whose contacts have all numbers. Raises ValueError where nothing says them."""
    return tuple(
        _whole(effect, beam, effects) if isinstance(effect, ContactTerms) else effect
        for effect in effects
    )


def _whole(contact: ContactTerms, beam: Any, effects: tuple[Any, ...]) -> ContactTerms:
    known = {name: getattr(contact, name) is not None for name in ("thickness", "force")}
    known["force"] = known["force"] or contact.stiffness is not None
    missing = tuple(name for name in known if name in contact.follows or not known[name])
    if not missing:
        return contact
    node = getattr(contact, "node", None)
    node = getattr(node, "given", node)  # a scene has a row in place of (name, number)
    names = [name for name in (contact.on, contact.partner) if name is not None]
    names = [node[0]] if isinstance(node, tuple) else names
    parts = [part_of(beam.parts, name) for name in names] or beam.parts
    bodies = [part for part in parts if part.body and names]
    beams = {p.name: beam.part(p.name) for p in parts if not p.body} if beam.parts else {None: beam}
    values = {}
    if "thickness" in missing:
        values["thickness"] = _length(contact, [*beams.values()]) / SHARE
    if "force" in missing:
        shaped = contact.partner is not None and any(beam.surface(body.name) for body in bodies)
        if bodies and not shaped:  # in N
            masses = {mass.node: mass.mass for mass in beam.masses}
            loads = [_gravity(effects, b.name) * masses[b.first_node] for b in bodies]
        else:
            loads = [
                (_gravity(effects, name) * beam.mass[..., 0, 0].mean(-1) + BENT * _bending(beam))
                * (1.0 if node is None else beam.length.sum(-1))  # in N
                for name, beam in beams.items()
            ]
        values["force"] = TIMES * _largest(loads)
    for name, value in values.items():
        if concrete(~(value.detach() > 0)).any():
            why = "radius or stiffness" if name == "thickness" else "weight or bending stiffness"
            raise ValueError(
                f"{contact.called} without a {name} was given where no {why} says one; a number "
                "is wanted"
            )
    return with_values(contact, follows=missing, **values)


def _length(contact: Any, beams: list[Any]) -> Tensor:
    """(...) m: the smallest radius; without one that of a round section of the beams' stiffness."""
    radii = [thinnest(r) for r in (contact.radius, contact.other_radius) if r is not None]
    if getattr(contact, "corners", None) is not None:
        reach = torch.linalg.vector_norm(contact.corners, dim=-1).amin(-1)
        radii = [radii[0] + reach]
    if not radii:
        radii = [
            2 * (beam.compliance[..., 0, 0].mean(-1) / _flexibility(beam)).sqrt() for beam in beams
        ]
    return -_largest([-radius for radius in radii]) if radii else torch.zeros(())


def _bending(beam: Any) -> Tensor:
    """EI/L^3 (...) N/m, about the softer axis; 0 of what does not bend."""
    soft = _flexibility(beam)
    there = soft > 0
    stiff = 1 / torch.where(there, soft, 1.0)
    return torch.where(there, stiff, 0.0) / beam.length.sum(-1) ** 3


def _flexibility(beam: Any) -> Tensor:
    """1/EI (...), about the softer axis, the mean along the beam."""
    return beam.compliance.diagonal(dim1=-2, dim2=-1)[..., 4:].mean(-2).amax(-1)


def _gravity(effects: tuple[Any, ...], name: str | None) -> Any:
    """|g| (...) m/s^2 that acts on a part, of numbers."""
    g = [
        effect.g
        for effect in effects
        if isinstance(effect, Gravity) and effect.on in (None, name) and constant(effect)
    ]
    return torch.linalg.vector_norm(sum(g), dim=-1) if g else 0.0


def _largest(values: list[Tensor]) -> Tensor:
    return torch.stack(torch.broadcast_tensors(*values)).amax(0) if values else torch.zeros(())
