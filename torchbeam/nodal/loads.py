"""Loads at the nodes, and how they change as the nodes move."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..math import quaternions as quat
from ..math.shapes import broadcast_shapes
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
from .coordinates.spatial import Space
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

    def of(self, node: int, reads: frozenset[str]) -> Nodes:
        """Of one, (..., *): its rotation, and what a load reads."""
        known = {name: getattr(self, name) for name in AT_NODES if name == ROTATION or name in reads}
        return self._replace(**{name: x[..., node, :] for name, x in known.items() if x is not None})


STEADY = 1e9  # s: so long a step takes internal states to where they rest


# Derivatives by the move (displacement, spin) that the tangent is taken by, frame a, of the motions that it changes: "velocity"
# (..., N+1 or 1, p, p) by the displacement, "spin" (..., N+1, s, s) by the spin, "acceleration" (..., N+1, p, p or w) by the
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
    for load, point in _points(model, nodes, t, model.scene.loads if loads is None else loads):
        total = total + _spread(model, load, wrench(model.space, load, point, t, inputs), 1)
    return total


def tangent(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs, loads: tuple[Any, ...], by: MotionJacobian = STAYS
            ) -> Tensor | float:
    """Derivative of `external` by the nodes' moves, (..., N+1, w, w); 0.0 where there is none."""
    total = 0.0
    for load, point in _points(model, nodes, t, loads):
        found = wrench_tangent(model.space, load, point, t, inputs, _of_node(load, by))
        total = total if isinstance(found, float) else total + _spread(model, load, found, 2)
    return total


def added_mass(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs) -> Tensor | float:
    """Mass (..., N+1, w, w) that loads add by their derivative by the accelerations; 0.0 where there is none."""
    total, loads = 0.0, tuple(load for load in model.scene.loads if model.depends_on(load).intersection(INERTIAL))
    for load, point in _points(model, nodes, t, loads):
        blocks = load.tangent(point, t, inputs)
        mass = sum(_block(model.space, name, blocks[name]) for name in INERTIAL if name in blocks)
        total = total - _spread(model, load, mass, 2)
    return total


# One load on one node, or on any number of them along the beam, each by itself


def load_point(space: Space, load: Any, reads: frozenset[str], nodes: Nodes, **place: Any) -> LoadPoint:
    """Where a load acts that reads these motions: on one node (..., p), or along the beam on nodes (..., n, p); place: fields
    of `LoadPoint` beside the motion.
    """
    public = {POSITION: space.public_position, VELOCITY: space.public_vector, SPIN: space.public_spin,
              ACCELERATION: space.public_vector, ANGULAR_ACCELERATION: space.public_spin}
    motion = {name: to(getattr(nodes, name)) for name, to in public.items()
              if name in reads and getattr(nodes, name) is not None}
    return LoadPoint(space.axes(nodes.rotation), **motion, **place)


def wrench(space: Space, load: Any, point: LoadPoint, t: Tensor, inputs: Inputs) -> Tensor:
    """[force; moment] (..., w), frame a; along the beam (..., n, w) per length."""
    return space.project(together(load.wrench(point, t, inputs), point.R))


def wrench_tangent(space: Space, load: Any, point: LoadPoint, t: Tensor, inputs: Inputs, by: MotionJacobian) -> Tensor | float:
    """Derivative of `wrench` by the moves of the same nodes, (..., w, w); 0.0 where there is none."""
    blocks = {name: block for name, block in load.tangent(point, t, inputs).items() if _moved(space, name, by)}
    return sum((_chained(space, name, _block(space, name, block), by) for name, block in blocks.items()), 0.0)


def _of_node(load: Any, by: MotionJacobian) -> MotionJacobian:
    """Of the node that a load acts on, without an axis of nodes; along the beam as it is."""
    if load.node is None:
        return by
    return {name: x[..., load.node if x.shape[-3] > 1 else 0, :, :] for name, x in by.items()}


def _moved(space: Space, name: str, by: MotionJacobian) -> bool:
    """Whether what loads see by that name changes with the nodes' moves."""
    return name in by or name == POSITION or (name == ROTATION and space.turns)


def _chained(space: Space, name: str, block: Tensor, by: MotionJacobian) -> Tensor:
    """A derivative (..., m, w) by the motion `name` as one by the moves."""
    p = space.position
    if name not in by:
        return block
    if name in ANGULAR:
        return pad(block[..., p:] @ by[name], (p, 0))
    block = block[..., :p] @ by[name]
    return pad(block, (0, space.unknowns - block.shape[-1]))


def _block(space: Space, name: str, block: Tensor) -> Tensor:
    """A load's derivative (..., 6, 3) by the motion `name`, as (..., w, w)."""
    return space.project_map(pad(block, (3, 0) if name in ANGULAR else (0, 3)))


def internal(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs, shape: tuple[int, ...]) -> Tensor | None:
    """Internal states of user loads in equilibrium, (*shape, z); None where there are none."""
    found = [_flat(load, load.advance(point, point.internal, t, inputs, point.dt))
             for load, point in _points(model, nodes, t, _remembering(model))]
    return _joined([z.expand(*shape, z.shape[-1]) for z in found]) if found else None


def advanced(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs) -> Tensor | None:
    """The same at the end of a step in whose middle the nodes are."""
    found = [_flat(load, 2 * load.advance(point, point.internal, t, inputs, point.dt) - point.internal)
             for load, point in _points(model, nodes, t, _remembering(model))]
    return _joined(found) if found else None


def advanced_rates(model: Model, nodes: Nodes, t: Tensor, inputs: Inputs) -> Tensor:
    """Rates (..., z) of the internal states."""
    return _joined([_flat(load, load.rates(point, point.internal, t, inputs))
                    for load, point in _points(model, nodes, t, _remembering(model))])


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
    for load, point in _points(model, nodes, t, _remembering(model)):
        by = load.rates_tangent(point, t, inputs)
        L = derivatives(lambda at, load=load: together(load.wrench(at, t, inputs), at.R), point, (INTERNAL,))[INTERNAL]
        L, G = space.project(L.mT).mT, by.pop(INTERNAL)
        by = {name: space.project(pad(block, (3, 0) if name in ANGULAR else (0, 3))) for name, block in by.items()}
        zero = torch.zeros_like(space.project(G.new_zeros(*G.shape[:-1], 6)))

        def total(way: MotionJacobian, by: dict[str, Tensor] = by, zero: Tensor = zero) -> Tensor:
            return sum((_chained(space, name, block, way) for name, block in by.items() if _moved(space, name, way)), zero)

        H = total(_of_node(load, still))
        H = H, total(_of_node(load, moved)) - H, sum((by[name] for name in INERTIAL if name in by), zero)
        if load.node is None:
            eye = torch.eye(model.node_count, dtype=G.dtype, device=G.device)[:, None, :, None]
            L, G, *H = ((x[..., None, :] * eye).flatten(-4, -3).flatten(-2)
                        for x in (model.tributary_length[..., None] * L, G, *H))
        else:
            at, w = load.node % model.node_count, space.unknowns
            around = at * w, (model.node_count - 1 - at) * w
            L, *H = pad(L, (0, 0, *around)), *(pad(x, around) for x in H)
        rows.append((L, G, *H))
    if not rows:
        return None
    shape = broadcast_shapes(*(x.shape[:-2] for row in rows for x in row))
    rows, at, states = [[x.expand(*shape, *x.shape[-2:]) for x in row] for row in rows], 0, model.internal_states
    G = []
    for row in rows:
        G.append(pad(row[1], (at, states - at - row[1].shape[-1])))
        at += row[1].shape[-1]
    L, _, *H = zip(*rows, strict=True)
    return Lags(torch.cat(L, -1), torch.cat(G, -2), *(torch.cat(x, -2) for x in H))


def _joined(parts: list[Tensor]) -> Tensor:
    shape = broadcast_shapes(*(x.shape[:-1] for x in parts))
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


def _points(model: Model, nodes: Nodes, t: Tensor, loads: tuple[Any, ...]) -> Iterator[tuple[Any, LoadPoint]]:
    places = internal_slices(model)
    for load in loads:
        reads = model.depends_on(load)
        if load.node is None:
            place = dict(mass=model.section_mass, s=model.s, elements=model.scene.beam.element_count)
            space, at = model.space, nodes
        else:
            space, at, place = model.space.of_nodes(load.node), nodes.of(load.node, reads), {}
        if id(load) in places and nodes.internal is not None:
            z = nodes.internal[..., places[id(load)]]
            place["internal"] = z if load.node is not None else z.unflatten(-1, (-1, load.internal))
        if id(load) in places:
            place["dt"] = nodes.dt
        if nodes.frame is not None:
            place["axes"] = quat.matrix(model.space.public_frame(nodes.frame)).mT
        if load.wants_support:
            place["support"] = model.prescribed_motion.root_pose(t)
        if load.wants_frame:
            place["frame"] = model.prescribed_motion.frame(t)
        yield load, load_point(space, load, reads, at, **place)


def _spread(model: Model, load: Any, x: Tensor, axes: int) -> Tensor:
    """What a load brings, per length or on its node (..., *), on all nodes (..., N+1, *)."""
    if load.node is None:
        return model.tributary_length[(..., *(None,) * (axes - 1))] * x
    at, last = load.node % model.node_count, model.node_count - 1
    return pad(x.unsqueeze(-1 - axes), (0, 0) * axes + (at, last - at))
