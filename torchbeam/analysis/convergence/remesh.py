"""remesh: a scene of the same physics on another mesh."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from fractions import Fraction
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import boolean, instance
from ...core.arguments import count as check_count
from ...core.functions_of_time import taken
from ...core.leaves import own_leaves, with_values
from ...math.element_shapes import SHAPES
from ...scene.beam import Beam
from ...scene.beam_arguments import check_order
from ...scene.beam_recipe import recipe_of, remade, whole_parts
from ...scene.effects import Actuation, Eyelet, Load, PerElement
from ...scene.effects.effect import Effect
from ...scene.effects.interaction import Interaction
from ...scene.effects.tendon import Tendon
from ...scene.effects.values import AtSites, Input
from ...scene.scene import Scene


def remesh(
    scene: Scene, elements: int, *, order: int | None = None, linked: bool | None = None
) -> Scene:
    """A scene of the same physics on a mesh of `elements` elements. Differentiable.

    Args:
        order, linked: of the elements, see `Beam.straight` and `Beam.linked`; None = unchanged

    The beam is built again by its own constructor: functions of s are evaluated anew, tables are
    integrated anew. The elements of a beam through nodes, or of a modified copy, are divided.
    Loads, supports, masses and eyelets at nodes keep their arc lengths, where the new mesh needs
    nodes. A `Tendon.along` goes through the ends of the new elements, by cubics between its points.
    Values of single elements (`PerElement`, `Actuation.elements`, a `Load`'s values) pass to the
    parts of these elements.

    Raises:
        ValueError: for a new mesh without a node at such an arc length, an uneven division of
            elements with their own values, or a structure.

    Examples:
        >>> finer = tb.remesh(scene, 16, order=2)
        >>> finer.beam.node_count
        33
    """
    instance("a scene", scene, Scene)
    check_count("elements", elements)
    beam = _one_beam(scene)
    order = beam.order if order is None else check_order(order)
    if linked is None:
        linked = beam.linked_interpolation and not SHAPES[order].midside
    linked = boolean("linked", linked)
    fine = remade(beam, elements, order)
    fine = fine.linked() if linked else fine
    rows = _Rows(beam, elements, order)
    asked = scene.supports.given
    if asked is not None:
        asked = [with_values(support, node=rows(support.node)) for support in asked]
    effects = tuple(_moved(effect, rows) for effect in scene.effects)
    return replace(scene, beam=fine, effects=effects, supports=asked)


def least_elements(scene: Scene, nodes: Iterable[int] = ()) -> int:
    """The number of which those of all meshes that `remesh` can give are multiples: whatever acts
    at a node has one there, and so have these.
    """
    beam = _one_beam(scene)
    rows = beam.station_count
    places = [Fraction(node % beam.node_count, rows) for node in (*_nodes(scene), *nodes)]
    least = math.lcm(*(place.denominator for place in places))
    arguments = recipe.arguments if (recipe := recipe_of(beam)) else {}
    varies = beam.curved and "elements" not in arguments
    varies = varies or (beam.compliance.shape[-3] > 1 and not callable(arguments.get("section")))
    varies = varies or any(_by_element(effect) for effect in scene.effects)
    return math.lcm(least, beam.element_count) if varies else least


def _one_beam(scene: Scene) -> Beam:
    if scene.beam.parts:
        raise ValueError(
            "a structure was given to be meshed anew; a scene of one beam is wanted, or a function "
            "of the number of elements and their order that makes the scene"
        )
    return scene.beam


def rows_of(scene: Scene, fine: Scene) -> _Rows:
    """The rows of a scene's nodes in the same scene on another mesh."""
    return _Rows(_one_beam(scene), fine.beam.element_count, fine.beam.order)


class _Rows:
    """Places of a beam's nodes on a new mesh of it."""

    def __init__(self, beam: Beam, elements: int, order: int) -> None:
        self.beam, self.elements, self.order = beam, elements, order

    def __call__(self, node: int) -> int:
        """The new row of a node; of the root and the tip as they were counted."""
        if node in (0, -1):
            return node
        place = Fraction(node % self.beam.node_count, self.beam.station_count) * self.elements
        if place.denominator > 1:
            raise ValueError(
                f"{self.elements} elements were given for a beam with something at its node "
                f"{node}, where none of them ends; a multiple of {place.denominator} times "
                "as many is wanted"
            )
        return int(place) * self.order

    @property
    def parts(self) -> int:
        """How many elements each has become."""
        return whole_parts(self.beam, self.elements)


def _nodes(scene: Scene) -> Iterator[int]:
    """Of all that stands at a node."""
    yield from (support.node for support in scene.supports)
    for effect in scene.effects:
        if isinstance(effect, Tendon | Interaction):
            along = isinstance(effect, Tendon) and effect.is_along(scene.beam)
            yield from () if along else effect.nodes
        elif effect.node is not None:
            yield effect.node


def _by_element(effect: Effect) -> bool:
    """Whether an effect has values of single elements or nodes along the beam."""
    values = effect.values if isinstance(effect, Load) and effect.node is None else None
    return (
        getattr(effect, "elements", None) is not None
        or any(isinstance(leaf.value, (PerElement, AtSites)) for leaf in own_leaves(effect))
        or any(_count(value) > 1 for value in (values or {}).values())
    )


def _count(value: Any) -> int:
    return value.shape[-1] if isinstance(value, Tensor) and value.ndim else 1


def _moved(effect: Effect, rows: _Rows) -> Effect:
    """An effect at the places of the new mesh."""
    if isinstance(effect, Tendon) and effect.is_along(rows.beam):
        points = torch.stack(torch.broadcast_tensors(*(x.point for x in effect.eyelets)), -2)
        places = _cubic(points, rows.elements).unbind(-2)
        each = (Eyelet(rows.order * k, point, along=True) for k, point in enumerate(places))
        return with_values(effect, eyelets=tuple(each))
    if isinstance(effect, Tendon):
        eyelets = tuple(
            x if x.node is None else with_values(x, node=rows(int(x.node))) for x in effect.eyelets
        )
        return with_values(effect, eyelets=eyelets)
    if isinstance(effect, Interaction):
        return with_values(effect, nodes=tuple(map(rows, effect.nodes)))
    if effect.node is not None:
        row = rows(effect.node)
        return effect if row == effect.node else with_values(effect, node=row)
    if not _by_element(effect):
        return effect
    changed: dict[str, Any] = {
        leaf.name: _divided(leaf.value, rows.parts)
        for leaf in own_leaves(effect)
        if isinstance(leaf.value, (PerElement, AtSites))
    }
    if isinstance(effect, Actuation) and effect.elements is not None:
        elements = range(rows.beam.element_count)
        which = effect.elements
        chosen = elements[which] if isinstance(which, slice) else [elements[k] for k in which]
        changed["elements"] = tuple(
            rows.parts * k + part for k in chosen for part in range(rows.parts)
        )
    if isinstance(effect, Load):
        changed["values"] = {
            name: _along(value, rows) if _count(value) > 1 else value
            for name, value in effect.values.items()
        }
    return with_values(effect, **changed)


def _cubic(points: Tensor, elements: int) -> Tensor:
    """(..., elements + 1, 3) evenly along points (..., m, 3), by Lagrange's cubics through the four
    next to each; of fewer by what goes through all.
    """
    last = points.shape[-2] - 1
    size = min(4, last + 1)
    at = torch.arange(elements + 1, device=points.device) * last
    first = (at // elements - 1).clamp(0, last + 1 - size)
    u = at.to(points.dtype) / elements - first
    k = torch.arange(size, device=points.device)
    off = (u[:, None] - k)[:, None, :].expand(-1, size, -1)
    between = (k[:, None] - k).to(points.dtype)
    same = torch.eye(size, dtype=torch.bool, device=points.device)
    weight = (torch.where(same, 1.0, off) / torch.where(same, 1.0, between)).prod(-1)
    return (weight[..., None] * points[..., first[:, None] + k, :]).sum(-2)


def _divided(value: PerElement | AtSites, parts: int) -> PerElement:
    """Of each part what its element has."""
    if parts == 1:
        return value
    values = value.value
    if isinstance(value, AtSites) or isinstance(values, Input):
        raise ValueError(
            "a load by an Input of each element, or at its sites, was given to be meshed anew; "
            "numbers or a function of each element are wanted, or Along"
        )
    if callable(values):
        function: Callable[[Tensor], Tensor] = values
        return PerElement(
            lambda t: taken("a PerElement function's value", function(t), t).repeat_interleave(
                parts, -2
            )
        )
    return PerElement(torch.as_tensor(values).repeat_interleave(parts, -2))


def _along(value: Tensor, rows: _Rows) -> Tensor:
    """A `Load`'s values (..., N) of the elements as those of their parts; (..., nodes) of the nodes
    by straight lines between them.
    """
    if value.shape[-1] == rows.beam.element_count:
        return value.repeat_interleave(rows.parts, -1)
    before, now = value.shape[-1] - 1, rows.elements * rows.order
    at = before * torch.arange(now + 1, device=value.device)
    row = (at // now).clamp(max=before - 1)
    share = (at - now * row).to(value.dtype) / now
    return torch.lerp(value[..., row], value[..., row + 1], share)
