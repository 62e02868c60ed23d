"""Loads at the nodes, and how they change as the nodes move."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from .. import quaternions as quat
from ..effects import Inputs, Site
from ..effects.site import ACCELERATION, POSITION, ROTATION, SPIN, VELOCITY

if TYPE_CHECKING:
    from .model import Model


class Nodes(NamedTuple):
    """How the nodes stand and move at one instant, in the space's coordinates.

    position (..., N+1, p) m;  rotation (..., N+1, ...);  velocity (..., N+1, p) m/s and spin (..., N+1, s) rad/s: absolute,
    in frame a
    frame     (..., ...) frame a -> inertial axes; None = it does not turn
    internal  (..., z) of user loads; dt (...) s of the step in whose middle this is; None without
    acceleration  (..., N+1, p) m/s^2, absolute, frame a; None = not known, or read by no load
    """

    position: Tensor
    rotation: Tensor
    velocity: Tensor | None = None
    spin: Tensor | None = None
    frame: Tensor | None = None
    internal: Tensor | None = None
    dt: Tensor | None = None
    acceleration: Tensor | None = None


STEADY = 1e9  # s: so long a step takes internal states to where they rest


class Chain(NamedTuple):
    """Derivatives of velocity, spin and acceleration by the move (displacement, spin) that the tangent is taken by:
    (..., N+1, p, p), (..., N+1, s, s) and (..., N+1, p, p), frame a; None = the acceleration stays.
    """

    velocity: Tensor
    spin: Tensor
    acceleration: Tensor | None = None


def external(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs, loads: tuple[Any, ...]) -> Tensor | float:
    """Loads summed at nodes, (..., N+1, w) force N and moment N m, frame a; 0.0 where there is none."""
    total = 0.0
    for load, site in _sites(model, nodes, t, loads):
        total = total + model.space.part(_spread(model, load, load.wrench(site, t, inputs)))
    return total


def tangent(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs, loads: tuple[Any, ...], by: Chain | None = None
            ) -> Tensor | float:
    """Derivative of `external` by the nodes' moves, (..., N+1, w, w); 0.0 where there is none. Without `by`, velocity, spin
    and acceleration stay as they are.
    """
    total, p, s = 0.0, model.space.position, model.space.spin
    chain = {} if by is None else {VELOCITY: by.velocity, SPIN: by.spin, ACCELERATION: by.acceleration}
    for load, site in _sites(model, nodes, t, loads):
        for name, block in load.tangent(site, t, inputs).items():
            moved = chain.get(name)
            if (name in (VELOCITY, SPIN, ACCELERATION) and moved is None) or (name == ROTATION and not model.space.turns):
                continue
            block = _placed(model, load, name, block)
            if name == SPIN:
                block = pad(block[..., p:] @ moved, (p, 0))
            elif moved is not None:
                block = pad(block[..., :p] @ moved, (0, s))
            total = total + block
    return total


def added_mass(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs) -> Tensor | float:
    """Mass (..., N+1, w, w) that loads add by their derivative by the acceleration; 0.0 where there is none."""
    total, loads = 0.0, tuple(load for load in model.scene.loads if ACCELERATION in model.reads(load))
    for load, site in _sites(model, nodes, t, loads):
        total = total - _placed(model, load, ACCELERATION, load.tangent(site, t, inputs)[ACCELERATION])
    return total


def _placed(model: Model, load: Any, name: str, block: Tensor) -> Tensor:
    """A load's derivative (..., 6, 3) at its sites -> (..., N+1, w, w)."""
    block = model.space.part_of_map(pad(block, (3, 0) if name in (ROTATION, SPIN) else (0, 3)))
    if load.node is None:
        return model.share[..., None] * block
    at, last = load.node % (model.count + 1), model.count
    return pad(block[..., None, :, :], (0, 0, 0, 0, at, last - at))


def internal(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs, shape: tuple[int, ...]) -> Tensor | None:
    """Internal states of user loads in equilibrium, (*shape, z); None where there are none."""
    found = [load.advance(site, site.internal, t, inputs, site.dt)
             for load, site in _sites(model, nodes, t, model.scene.loads) if _size(load)]
    return _joined([z.expand(*shape, z.shape[-1]) for z in found]) if found else None


def advanced(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs) -> Tensor:
    """The same at the end of a step in whose middle the nodes are."""
    found = []
    for load, site in _sites(model, nodes, t, model.scene.loads):
        if _size(load):
            found.append(2 * load.advance(site, site.internal, t, inputs, site.dt) - site.internal)
    return _joined(found)


def advanced_rates(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs) -> Tensor:
    """Rates (..., z) of the internal states."""
    return _joined([load.rates(site, site.internal, t, inputs)
                    for load, site in _sites(model, nodes, t, model.scene.loads) if _size(load)])


def _joined(parts: list[Tensor]) -> Tensor:
    shape = torch.broadcast_shapes(*(x.shape[:-1] for x in parts))
    return torch.cat([x.expand(*shape, x.shape[-1]) for x in parts], -1)


def _size(load: Any) -> int:
    return getattr(load, "internal", 0)


def _starts(loads: tuple[Any, ...]) -> dict[int, int]:
    """Where each load's internal states begin among those of all."""
    starts, at = {}, 0
    for load in loads:
        starts[id(load)] = at
        at += _size(load)
    return starts


def _sites(model: Model, nodes: Nodes, t: Tensor, loads: tuple[Any, ...]) -> Iterator[tuple[Any, Site]]:
    space, starts = model.space, _starts(model.scene.loads)
    for load in loads:
        reads = model.reads(load)
        size = _size(load)
        own = {}
        if reads:
            place = nodes if load.node is None else Nodes(*(None if x is None else x[..., load.node, :] for x in (
                nodes.position, nodes.rotation, nodes.velocity, nodes.spin)))
            still = torch.zeros_like(place.position)
            spin = torch.zeros_like(place.position[..., :space.spin]) if place.spin is None else place.spin
            moving = space.site(place.position, still if place.velocity is None else place.velocity, spin)
            own = {name: x for name, x in zip((POSITION, VELOCITY, SPIN), moving, strict=True) if name in reads}
            if ACCELERATION in reads and nodes.acceleration is not None:
                a = nodes.acceleration if load.node is None else nodes.acceleration[..., load.node, :]
                own[ACCELERATION] = space.site(place.position, a, spin)[1]
        R = space.axes(nodes.rotation, load.node)
        if size:
            first = starts[id(load)]
            own |= dict(internal=None if nodes.internal is None else nodes.internal[..., first:first + size], dt=nodes.dt)
        if load.node is None:
            own |= dict(mass=model.section_mass, s=model.s)
        if nodes.frame is not None:
            own["axes"] = quat.matrix(space.public_frame(nodes.frame)).mT
        if load.wants_support:
            own["support"] = model.carrying.root_pose(t, nodes.dt if nodes.dt is not None else torch.ones_like(t))
        yield load, Site(R, **own)


def _spread(model: Model, load: Any, wrench: tuple[Tensor | None, Tensor | None]) -> Tensor:
    """A load's force and moment at the nodes: (..., N+1, 6)."""
    force, moment = wrench
    there = force if force is not None else moment
    zero = torch.zeros_like(there)
    both = torch.cat(torch.broadcast_tensors(zero if force is None else force, zero if moment is None else moment), -1)
    if load.node is None:
        return model.share * both
    at, last = load.node % (model.count + 1), model.count
    return pad(both[..., None, :], (0, 0, at, last - at))
