"""Loads at the nodes, and how they change as the nodes move."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..math import quaternions as quat
from ..scene.effects import Inputs, LoadPoint
from ..scene.effects.load_point import (
    ACCELERATION,
    ANGULAR_ACCELERATION,
    INERTIAL,
    INTERNAL,
    POSITION,
    ROTATION,
    SPIN,
    VELOCITY,
    derivatives,
    together,
)
from .model import Model

ANGULAR = (ROTATION, SPIN, ANGULAR_ACCELERATION)
AT_NODES = ("position", "rotation", "velocity", "spin", "acceleration", "angular_acceleration")  # of the fields of `Nodes`


class Nodes(NamedTuple):
    """How the nodes stand and move at one instant, in the space's coordinates.

    position (..., N+1, p) m;  rotation (..., N+1, ...);  velocity (..., N+1, p) m/s and spin (..., N+1, s) rad/s: absolute,
    in frame a
    frame     (..., ...) frame a -> inertial axes; None = it does not turn
    internal  (..., z) of user loads; dt (...) s of the step in whose middle this is; None without
    acceleration  (..., N+1, p) m/s^2 and angular_acceleration (..., N+1, s) rad/s^2, absolute, frame a; None = not known, or
              read by no load
    """

    position: Tensor
    rotation: Tensor
    velocity: Tensor | None = None
    spin: Tensor | None = None
    frame: Tensor | None = None
    internal: Tensor | None = None
    dt: Tensor | None = None
    acceleration: Tensor | None = None
    angular_acceleration: Tensor | None = None


STEADY = 1e9  # s: so long a step takes internal states to where they rest


# Derivatives by the move (displacement, spin) that the tangent is taken by, frame a, of the motions that it changes: "velocity"
# (..., N+1, p, p) by the displacement, "spin" (..., N+1, s, s) by the spin, "acceleration" (..., N+1, p, p or w) by the
# displacement, or by both, "angular_acceleration" (..., N+1, s, s) by the spin.
MotionJacobian = dict[str, Tensor]
STAYS: MotionJacobian = {}
CHANGING = (VELOCITY, SPIN, ACCELERATION, ANGULAR_ACCELERATION)


def motion_jacobian(derivatives: Any, read: frozenset[str]) -> MotionJacobian:
    """Of the motions that loads read, from an object that knows the derivatives by name."""
    return {name: getattr(derivatives, name) for name in CHANGING if name in read}


def external(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs, loads: tuple[Any, ...] | None = None) -> Tensor | float:
    """Loads, all of the scene's unless given, summed at nodes: (..., N+1, w) force N and moment N m, frame a; 0.0 where there
    is none.
    """
    total = 0.0
    for load, site in _sites(model, nodes, t, model.scene.loads if loads is None else loads):
        total = total + model.space.project(_spread(model, load, load.wrench(site, t, inputs)))
    return total


def tangent(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs, loads: tuple[Any, ...], by: MotionJacobian = STAYS
            ) -> Tensor | float:
    """Derivative of `external` by the nodes' moves, (..., N+1, w, w); 0.0 where there is none.
    """
    total = 0.0
    for load, site in _sites(model, nodes, t, loads):
        for name, block in load.tangent(site, t, inputs).items():
            if _moved(model, name, by):
                total = total + _chained(model, name, _placed(model, load, name, block), by)
    return total


def _moved(model: Model, name: str, by: MotionJacobian) -> bool:
    """Whether what loads see by that name changes with the nodes' moves."""
    return name in by or name == POSITION or (name == ROTATION and model.space.turns)


def _chained(model: Model, name: str, block: Tensor, by: MotionJacobian) -> Tensor:
    """A derivative (..., m, w) by the motion `name` as one by the moves."""
    p = model.space.position
    if name not in by:
        return block
    if name in ANGULAR:
        return pad(block[..., p:] @ by[name], (p, 0))
    block = block[..., :p] @ by[name]
    return pad(block, (0, model.space.unknowns - block.shape[-1]))


def added_mass(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs) -> Tensor | float:
    """Mass (..., N+1, w, w) that loads add by their derivative by the accelerations; 0.0 where there is none."""
    total, loads = 0.0, tuple(load for load in model.scene.loads if model.depends_on(load).intersection(INERTIAL))
    for load, site in _sites(model, nodes, t, loads):
        found = load.tangent(site, t, inputs)
        for name in INERTIAL:
            if name in found:
                total = total - _placed(model, load, name, found[name])
    return total


def _placed(model: Model, load: Any, name: str, block: Tensor) -> Tensor:
    """A load's derivative (..., 6, 3) at its sites -> (..., N+1, w, w)."""
    block = model.space.project_map(pad(block, (3, 0) if name in ANGULAR else (0, 3)))
    if load.node is None:
        return model.tributary_length[..., None] * block
    at, last = load.node % (model.count + 1), model.count
    return pad(block[..., None, :, :], (0, 0, 0, 0, at, last - at))


def internal(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs, shape: tuple[int, ...]) -> Tensor | None:
    """Internal states of user loads in equilibrium, (*shape, z); None where there are none."""
    found = [_flat(load, load.advance(site, site.internal, t, inputs, site.dt))
             for load, site in _sites(model, nodes, t, _remembering(model))]
    return _joined([z.expand(*shape, z.shape[-1]) for z in found]) if found else None


def advanced(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs) -> Tensor | None:
    """The same at the end of a step in whose middle the nodes are."""
    found = [_flat(load, 2 * load.advance(site, site.internal, t, inputs, site.dt) - site.internal)
             for load, site in _sites(model, nodes, t, _remembering(model))]
    return _joined(found) if found else None


def advanced_rates(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs) -> Tensor:
    """Rates (..., z) of the internal states."""
    return _joined([_flat(load, load.rates(site, site.internal, t, inputs))
                    for load, site in _sites(model, nodes, t, _remembering(model))])


class Lags(NamedTuple):
    """Small motions of the internal states z of loads, z' = G z + H q + H_v q' + H_a q'', and the load L z on the nodes, by all
    moves q of the nodes (w (N+1)): L (..., w (N+1), Z), G (..., Z, Z), H, H_v, H_a (..., Z, w (N+1)).
    """

    L: Tensor
    G: Tensor
    H: Tensor
    H_v: Tensor
    H_a: Tensor


def lags(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs, still: MotionJacobian, moved: MotionJacobian) -> Lags | None:
    """Derivatives of rates and loads where the internal states are `nodes.internal`; None where there are none. `still` has the
    derivatives of the nodes' motion by their moves, `moved` those by moves and their rates.
    """
    space, rows = model.space, []
    for load, site in _sites(model, nodes, t, _remembering(model)):
        by = load.rates_tangent(site, t, inputs)
        L = derivatives(lambda at, load=load: together(load.wrench(at, t, inputs), at.R), site, (INTERNAL,))[INTERNAL]
        L, G = space.project(L.mT).mT, by.pop(INTERNAL)
        by = {name: space.project(pad(block, (3, 0) if name in ANGULAR else (0, 3))) for name, block in by.items()}
        zero = torch.zeros_like(space.project(G.new_zeros(*G.shape[:-1], 6)))

        def total(way: MotionJacobian, by: dict[str, Tensor] = by, zero: Tensor = zero) -> Tensor:
            return sum((_chained(model, name, block, way) for name, block in by.items() if _moved(model, name, way)), zero)

        H = total(still)
        H = H, total(moved) - H, sum((by[name] for name in INERTIAL if name in by), zero)
        if load.node is None:
            eye = torch.eye(model.count + 1, dtype=G.dtype, device=G.device)[:, None, :, None]
            L, G, *H = ((x[..., None, :] * eye).flatten(-4, -3).flatten(-2)
                        for x in (model.tributary_length[..., None] * L, G, *H))
        else:
            at, w = load.node % (model.count + 1), space.unknowns
            around = at * w, (model.count - at) * w
            L, *H = pad(L, (0, 0, *around)), *(pad(x, around) for x in H)
        rows.append((L, G, *H))
    if not rows:
        return None
    shape = torch.broadcast_shapes(*(x.shape[:-2] for row in rows for x in row))
    rows, at, states = [[x.expand(*shape, *x.shape[-2:]) for x in row] for row in rows], 0, model.internal_states
    G = []
    for row in rows:
        G.append(pad(row[1], (at, states - at - row[1].shape[-1])))
        at += row[1].shape[-1]
    L, _, *H = zip(*rows, strict=True)
    return Lags(torch.cat(L, -1), torch.cat(G, -2), *(torch.cat(x, -2) for x in H))


def _joined(parts: list[Tensor]) -> Tensor:
    shape = torch.broadcast_shapes(*(x.shape[:-1] for x in parts))
    return torch.cat([x.expand(*shape, x.shape[-1]) for x in parts], -1)


def _remembering(model: Model) -> tuple[Any, ...]:
    """Loads with internal states."""
    return tuple(load for load, size in zip(model.scene.loads, model.scene.internal_states, strict=True) if size)


def _flat(load: Any, z: Tensor) -> Tensor:
    """A load's internal states in one row."""
    return z if load.node is not None else z.flatten(-2)


def internal_slices(model: Model) -> dict[int, slice]:
    """Where the internal states of each load are among those of all, by the load's id."""
    found, at = {}, 0
    for load, size in zip(model.scene.loads, model.scene.internal_states, strict=True):
        if size:
            found[id(load)] = slice(at, at + size)
            at += size
    return found


def _sites(model: Model, nodes: Nodes, t: Tensor, loads: tuple[Any, ...]) -> Iterator[tuple[Any, LoadPoint]]:
    space, places = model.space, internal_slices(model)
    for load in loads:
        reads = model.depends_on(load)
        mine = places.get(id(load))
        own = {}
        if reads:
            place = nodes if load.node is None else nodes._replace(**{
                name: x if x is None else x[..., load.node, :] for name, x in nodes._asdict().items() if name in AT_NODES})
            still = torch.zeros_like(place.position)
            spin = torch.zeros_like(place.position[..., :space.spin]) if place.spin is None else place.spin
            moving = space.site(place.position, still if place.velocity is None else place.velocity, spin)
            own = {name: x for name, x in zip((POSITION, VELOCITY, SPIN), moving, strict=True) if name in reads}
            if ACCELERATION in reads and place.acceleration is not None:
                own[ACCELERATION] = space.site(place.position, place.acceleration, spin)[1]
            if ANGULAR_ACCELERATION in reads and place.angular_acceleration is not None:
                own[ANGULAR_ACCELERATION] = space.site(place.position, still, place.angular_acceleration)[2]
        R = space.axes(nodes.rotation, load.node)
        if mine is not None:
            z = None if nodes.internal is None else nodes.internal[..., mine]
            own |= dict(internal=z if z is None or load.node is not None else z.unflatten(-1, (-1, load.internal)), dt=nodes.dt)
        if load.node is None:
            own |= dict(mass=model.section_mass, s=model.s, elements=model.count)
        if nodes.frame is not None:
            own["axes"] = quat.matrix(space.public_frame(nodes.frame)).mT
        if load.wants_support:
            own["support"] = model.prescribed_motion.root_pose(t)
        yield load, LoadPoint(R, **own)


def _spread(model: Model, load: Any, wrench: tuple[Tensor | None, Tensor | None]) -> Tensor:
    """A load's force and moment at the nodes: (..., N+1, 6)."""
    force, moment = wrench
    there = force if force is not None else moment
    zero = torch.zeros_like(there)
    both = torch.cat(torch.broadcast_tensors(zero if force is None else force, zero if moment is None else moment), -1)
    if load.node is None:
        return model.tributary_length * both
    at, last = load.node % (model.count + 1), model.count
    return pad(both[..., None, :], (0, 0, at, last - at))
