"""States in which a beam stands in what it may touch."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ..core.status import named
from ..core.validation import concrete
from ..scene.effects.contact import Contact
from ..state.state import State
from .conditions import conditions
from .element_loads import at_points, load_point
from .loads import Nodes, load_points
from .model import Model
from .touching_forces import of_nodes
from .touching_pairs import PairMotion


def refuse_penetration(model: Model, state: State, t: Tensor) -> None:
    """Raises ValueError where a state (public) at time t starts deeper in an obstacle than its
    contact is thick, or in another part, and is not to be pushed out: which samples, and the
    deepest of them, by how much and where.
    """
    touches = any(load.between_nodes or isinstance(load, Contact) for load in model.scene.loads)
    if not touches and not model.touching.present:
        return
    state = model.space.to_reduced(state)
    nodes = Nodes(state.position, state.rotation, state.velocity, state.spin)
    loads = tuple(load for load in model.scene.loads if load.between_nodes and not load.push_out)
    now = conditions(model, t, {}, loads=loads).between if loads else ()
    for acting in (at_points(model, acting) for acting in now):
        point = load_point(model, acting, nodes, conditions(model, t, {}, loads=()))
        load = acting.load

        def place(k: int, load: Any = load) -> str:
            return f"element {k // load.points} stands"

        _refuse(
            -load.gap(point.position)[..., 0],
            load.thickness[..., None],
            state.status,
            place,
            f"in the {load.obstacle.called} of a {load.called}",
        )
    bodies = tuple(load for load in model.scene.loads if isinstance(load, Contact))
    bodies = tuple(load for load in bodies if load.node is not None and not load.push_out)
    now = conditions(model, t, {}, loads=bodies) if bodies else None
    for acting, point in load_points(model, nodes, now, now.loads) if bodies else ():
        load = acting.load
        _refuse(
            -load.gap(load.of_body(point).position)[..., 0],
            load.thickness[..., None],
            state.status,
            lambda _, load=load: f"{load.on or load.node!r} stands",
            f"in the {load.obstacle.called} of a {load.called}",
        )
    motion = PairMotion(
        model.space.public_position(nodes.position), axes=(model.space.axes(nodes.rotation),)
    )
    for part_contact in model.touching.each if model.touching.present else ():
        law, near = part_contact.contact, part_contact.nearby(motion)
        if law.push_out or not len(near.point):
            continue
        pairs = part_contact.pairs(near)
        found = pairs.closest_point(pairs.points(of_nodes(near.nodes, motion)))
        radius, thick = pairs.radii_at(found.shares).sum(-1) / 2, law.thickness[..., None]
        _refuse(
            torch.where(found.measure > 0, -found.gap, -torch.inf)[..., 0],
            torch.where(radius > 0, torch.minimum(radius, thick), thick),
            state.status,
            lambda k, near=near: f"node {_node(model, int(near.nodes[k, 1]))} stands",
            f"in {_part(model, int(near.nodes[0, 4]))}, by a {law.called}",
        )


def _node(model: Model, row: int) -> str:
    beam = model.scene.beam
    if not beam.parts:
        return str(row)
    part = beam.part_at(row)
    return repr(part.name if part.body else (part.name, row - part.first_node))


def _part(model: Model, row: int) -> str:
    beam = model.scene.beam
    return repr(beam.part_at(row).name) if beam.parts else "the same beam"


def _refuse(
    depth: Tensor, most: Tensor, status: Tensor, place: Callable[[int], str], where: str
) -> None:
    """depth (..., points) m, of which `most` (..., 1) m is let be."""
    depth = concrete(depth.detach())
    deep = depth > concrete(most.detach())
    deep = deep & (concrete(status) == 0)[..., None]
    if not deep.any():
        return
    within = torch.where(deep, depth, -torch.inf)
    *sample, k = (within == within.max()).nonzero()[0].tolist()
    who = f" of {named(deep.any(-1))}" if sample else ""
    deepest = f" (sample {sample[0] if len(sample) == 1 else tuple(sample)})" if sample else ""
    raise ValueError(
        f"a start{who} was given in which {place(k)} {within.max().item():.3g} m deep {where}"
        f"{deepest}; one outside of it is wanted, or push_out=True"
    )
