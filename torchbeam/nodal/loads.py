"""Loads at the nodes, and how they change as the nodes move."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..math import quaternions as quat
from ..math.shapes import broadcast_shapes, stacked
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
from .acting import ActingLoad
from .between_nodes import NOTHING, Told
from .conditions import Conditions
from .coordinates.spatial import Spatial
from .rows import Rows
from .sample_check import check_samples

ANGULAR = (ROTATION, SPIN, ANGULAR_ACCELERATION)
# of the fields of `Nodes`
AT_NODES = ("position", "rotation", "velocity", "spin", "acceleration", "angular_acceleration")


class Nodes(NamedTuple):
    """How the nodes stand and move at one instant, in the space's coordinates.

    position (..., N+1, p) m;  rotation (..., N+1, ...);  velocity (..., N+1, p) m/s and spin
                               (..., N+1, s) rad/s: absolute,
    in frame a
    frame     (..., ...) frame a -> inertial axes; None = it does not turn
    internal  (..., z) of user loads; dt (...) s of the step in whose middle this is; None without
    acceleration  (..., N+1, p) m/s^2 and angular_acceleration (..., N+1, s) rad/s^2, absolute,
                  frame a; None = not known, or
              read by no load
    axes      (..., N+1, 3, 3) section axes -> frame a, where these are known; None = `rotation`
              tells
    told      by the last iteration
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
    axes: Tensor | None = None
    told: Told = NOTHING

    def of(self, node: int | slice, reads: frozenset[str]) -> Nodes:
        """Of one, (..., *), or of some: how they are turned, and what a load reads."""
        known = {
            name: getattr(self, name)
            for name in AT_NODES
            if name in reads or (name == ROTATION and self.axes is None)
        }
        known = {name: x[..., node, :] for name, x in known.items() if x is not None}
        axes = None if self.axes is None else self.axes[..., node, :, :]
        return self._replace(**known, axes=axes)


STEADY = 1e9  # s: so long a step takes internal states to where they rest


# Derivatives by the move (displacement, spin) that the tangent is taken by, frame a, of the motions
# that it changes: "velocity" (..., N+1 or 1, p, p) by the displacement, "spin" (..., N+1, s, s) by
# the spin, "acceleration" (..., N+1, p, p or w) by the displacement, or by both,
# "angular_acceleration" (..., N+1, s, s) by the spin.
MotionJacobian = dict[str, Tensor]
STAYS: MotionJacobian = {}
CHANGING = (VELOCITY, SPIN, ACCELERATION, ANGULAR_ACCELERATION)


def motion_jacobian(derivatives: Any, read: frozenset[str]) -> MotionJacobian:
    """Of the motions that loads read, from an object that knows the derivatives by name."""
    return {name: getattr(derivatives, name) for name in CHANGING if name in read}


def external(
    rows: Rows,
    nodes: Nodes,
    now: Conditions,
    loads: tuple[ActingLoad, ...] | None = None,
    total: Tensor | float = 0.0,
) -> Tensor | float:
    """Loads, all that act unless given, summed at nodes: (..., N+1, w) force N and moment N m,
    frame a; 0.0 where there is none. total: what they are added to.
    """
    for acting, point in load_points(rows, nodes, now, now.loads if loads is None else loads):
        total = total + _spread(
            rows, acting, wrench(rows.space, acting.load, point, now.t, now.inputs), 1
        )
    return total


def tangent(
    rows: Rows, nodes: Nodes, now: Conditions, by: MotionJacobian = STAYS
) -> Tensor | float:
    """Derivative of `external` by the nodes' moves, (..., N+1, w, w); 0.0 where there is none."""
    total = 0.0
    for acting, point in load_points(rows, nodes, now, now.moving):
        derivatives = wrench_tangent(
            rows.space, acting.load, point, now.t, now.inputs, _of_node(acting, by)
        )
        if not isinstance(derivatives, float):
            total = total + _spread(rows, acting, derivatives, 2)
    return total


def telling(rows: Rows, nodes: Nodes, now: Conditions) -> Told:
    """What bodies whose surfaces rub tell the next iteration."""
    points = load_points(rows, nodes, now, now.moving)
    each = [act.load.telling(point) for act, point in points if act.load.rubbing_points]
    return {"bodies": stacked(*each)} if each else {}


def added_mass(rows: Rows, nodes: Nodes, now: Conditions) -> Tensor | float:
    """Mass (..., N+1, w, w) that loads add by their derivative by accelerations; 0.0 = none."""
    total, loads = 0.0, tuple(acting for acting in now.loads if acting.reads.intersection(INERTIAL))
    for acting, point in load_points(rows, nodes, now, loads):
        blocks = acting.load.tangent(point, now.t, now.inputs)
        mass = sum(wrench_by(rows.space, name, blocks[name]) for name in INERTIAL if name in blocks)
        total = total - _spread(rows, acting, mass, 2)
    return total


# One load on one node, or on any number of them along the beam, each by itself


def load_point(
    space: Spatial, load: Any, reads: frozenset[str], nodes: Nodes, **place: Any
) -> LoadPoint:
    """Where a load acts that reads these motions: on one node (..., p), or along the beam on nodes
    (..., n, p); place: fields of `LoadPoint` beside the motion.
    """
    public = {
        POSITION: space.public_position,
        VELOCITY: space.public_vector,
        SPIN: space.public_spin,
        ACCELERATION: space.public_vector,
        ANGULAR_ACCELERATION: space.public_spin,
    }
    motion = {
        name: to(getattr(nodes, name))
        for name, to in public.items()
        if name in reads and getattr(nodes, name) is not None
    }
    axes = space.axes(nodes.rotation) if nodes.axes is None else nodes.axes
    return LoadPoint(axes, **motion, **place)


def wrench(space: Spatial, load: Any, point: LoadPoint, t: Tensor, inputs: Inputs) -> Tensor:
    """[force; moment] (..., w), frame a; along the beam (..., n, w) per length."""
    return space.project(together(load.wrench(point, t, inputs), point.R))


def wrench_tangent(
    space: Spatial, load: Any, point: LoadPoint, t: Tensor, inputs: Inputs, by: MotionJacobian
) -> Tensor | float:
    """Derivative of `wrench` by the moves of the same nodes, (..., w, w); 0.0 = none."""
    blocks = wrench_blocks(space, load, point, t, inputs, by)
    return _by_moves(space, blocks, by, 0.0)


def _by_moves(
    space: Spatial, blocks: dict[str, Tensor], by: MotionJacobian, zero: Tensor | float
) -> Tensor | float:
    """Derivatives by motions, by name, as one by the moves; `zero` where these change none."""
    moved = [name for name in blocks if changes(space, name, by)]
    return sum((chained(space, name, blocks[name], by) for name in moved), zero)


def wrench_blocks(
    space: Spatial, load: Any, point: LoadPoint, t: Tensor, inputs: Inputs, by: MotionJacobian
) -> dict[str, Tensor]:
    """Derivatives (..., w, w) of `wrench` by the motions, by name, that the moves change."""
    return {
        name: wrench_by(space, name, block)
        for name, block in load.tangent(point, t, inputs).items()
        if changes(space, name, by)
    }


def _of_node(acting: ActingLoad, by: MotionJacobian) -> MotionJacobian:
    """Of the node that a load acts on, without an axis of nodes; along the beam of its rows."""
    if acting.node is None:
        return by
    alike = slice(None) if acting.along else 0
    return {name: x[..., acting.node if x.shape[-3] > 1 else alike, :, :] for name, x in by.items()}


def changes(space: Spatial, name: str, by: MotionJacobian) -> bool:
    """Whether what loads see by that name changes with the nodes' moves."""
    return name in by or name == POSITION or (name == ROTATION and space.turns)


def chained(space: Spatial, name: str, block: Tensor, by: MotionJacobian) -> Tensor:
    """A derivative (..., m, w) by the motion `name` as one by the moves."""
    p = space.dims.position
    if name not in by:
        return block
    if name in ANGULAR:
        return pad(block[..., p:] @ by[name], (p, 0))
    block = block[..., :p] @ by[name]
    return pad(block, (0, space.unknowns - block.shape[-1]))


def wrench_by(space: Spatial, name: str, block: Tensor) -> Tensor:
    """A load's derivative (..., 6, 3) by the motion `name`, as (..., w, w)."""
    return space.project_map(_beside(name, block))


def _beside(name: str, block: Tensor) -> Tensor:
    """(..., 6) of derivatives (..., 3) by the motion `name`: of displacement and turn."""
    return pad(block, (3, 0) if name in ANGULAR else (0, 3))


def internal(rows: Rows, nodes: Nodes, now: Conditions, shape: tuple[int, ...]) -> Tensor | None:
    """Internal states of user loads in equilibrium, (*shape, z); None where there are none."""
    states = [
        _flat(acting, acting.load.advance(point, point.internal, now.t, now.inputs, point.dt))
        for acting, point in _remembering(rows, nodes, now)
    ]
    states = [z.expand(*shape, z.shape[-1]) for z in states]
    return stacked(*states, axis=-1) if states else None


def advanced(rows: Rows, nodes: Nodes, now: Conditions) -> Tensor | None:
    """The same at the end of a step in whose middle the nodes are."""
    states = [
        _flat(
            acting,
            2 * acting.load.advance(point, point.internal, now.t, now.inputs, point.dt)
            - point.internal,
        )
        for acting, point in _remembering(rows, nodes, now)
    ]
    return stacked(*states, axis=-1) if states else None


def advanced_rates(rows: Rows, nodes: Nodes, now: Conditions) -> Tensor:
    """Rates (..., z) of the internal states."""
    rates = (
        _flat(acting, acting.load.rates(point, point.internal, now.t, now.inputs))
        for acting, point in _remembering(rows, nodes, now)
    )
    return stacked(*rates, axis=-1)


class Lags(NamedTuple):
    """Small motions of the internal states z of loads, z' = G z + H q + H_v q' + H_a q'', and the
    load L z on the nodes, by all moves q of the nodes (w (N+1)): L (..., w (N+1), Z), G
    (..., Z, Z), H, H_v, H_a (..., Z, w (N+1)).
    """

    L: Tensor
    G: Tensor
    H: Tensor
    H_v: Tensor
    H_a: Tensor


def lags(
    rows: Rows, nodes: Nodes, now: Conditions, still: MotionJacobian, moved: MotionJacobian
) -> Lags | None:
    """Derivatives of rates and loads where the internal states are `nodes.internal`; None where
    there are none. `still` has the derivatives of the nodes' motion by their moves, `moved` those
    by moves and their rates.
    """
    space, parts = rows.space, []
    for acting, point in _remembering(rows, nodes, now):
        load, by = acting.load, acting.load.rates_tangent(point, now.t, now.inputs)
        L = derivatives(
            lambda at, load=load: together(load.wrench(at, now.t, now.inputs), at.R),
            point,
            (INTERNAL,),
        )[INTERNAL]
        L, G = space.project(L.mT).mT, by.pop(INTERNAL)
        by = {name: space.project(_beside(name, block)) for name, block in by.items()}
        zero = torch.zeros_like(space.project(G.new_zeros(*G.shape[:-1], 6)))

        H = _by_moves(space, by, _of_node(acting, still), zero)
        H_v = _by_moves(space, by, _of_node(acting, moved), zero) - H
        H = H, H_v, sum((by[name] for name in INERTIAL if name in by), zero)
        if acting.along:
            shares = _shares(rows, acting)
            eye = torch.eye(shares.shape[-2], dtype=G.dtype, device=G.device)[:, None, :, None]
            L, G, *H = (
                (x[..., None, :] * eye).flatten(-4, -3).flatten(-2)
                for x in (shares[..., None] * L, G, *H)
            )
        if acting.node is not None:
            around = tuple(space.unknowns * count for count in _around(acting, rows))
            L, *H = pad(L, (0, 0, *around)), *(pad(x, around) for x in H)
        parts.append((L, G, *H))
    if not parts:
        return None
    shape = broadcast_shapes(*(x.shape[:-2] for part in parts for x in part))
    parts, at = [[x.expand(*shape, *x.shape[-2:]) for x in part] for part in parts], 0
    states = nodes.internal.shape[-1]
    G = []
    for row in parts:
        G.append(pad(row[1], (at, states - at - row[1].shape[-1])))
        at += row[1].shape[-1]
    L, _, *H = zip(*parts, strict=True)
    return Lags(torch.cat(L, -1), torch.cat(G, -2), *(torch.cat(x, -2) for x in H))


def _remembering(
    rows: Rows, nodes: Nodes, now: Conditions
) -> Iterator[tuple[ActingLoad, LoadPoint]]:
    """Loads with internal states, and where they act."""
    loads = tuple(acting for acting in now.loads if acting.internal is not None)
    return load_points(rows, nodes, now, loads)


def _flat(acting: ActingLoad, z: Tensor) -> Tensor:
    """A load's internal states in one row."""
    return z.flatten(-2) if acting.along else z


def load_points(
    rows: Rows, nodes: Nodes, now: Conditions, loads: tuple[ActingLoad, ...]
) -> Iterator[tuple[ActingLoad, LoadPoint]]:
    row = 0
    for acting in loads:
        load, internal, place = acting.load, acting.internal is not None, {}
        space, at = (
            (rows.space, nodes)
            if acting.node is None
            else (rows.space.of_nodes(acting.node), nodes.of(acting.node, acting.reads))
        )
        if acting.node is None:
            place = dict(mass=rows.section_mass, s=rows.s, elements=now.elements)
        elif acting.along:
            place = dict(
                mass=rows.section_mass[..., acting.node, :, :],
                s=rows.s[..., acting.node],
                elements=acting.elements,
            )
        if internal and nodes.internal is not None:
            z = nodes.internal[..., acting.internal]
            place["internal"] = z.unflatten(-1, (-1, load.internal)) if acting.along else z
        if internal or load.wants_step:
            place["dt"] = nodes.dt
        if nodes.frame is not None:
            place["axes"] = quat.matrix(rows.space.public_frame(nodes.frame)).mT
        if load.wants_support:
            place["support"] = now.root
        if load.wants_frame:
            place["frame"] = now.velocities
        if load.rubbing_points and "bodies" in nodes.told:
            place["told"] = nodes.told["bodies"].narrow(-2, row, load.rubbing_points)
            row += load.rubbing_points
        point = load_point(space, load, acting.reads, at, **place)
        check_samples(acting, point, now.t, now.inputs)
        yield acting, point


def _spread(rows: Rows, acting: ActingLoad, x: Tensor, axes: int) -> Tensor:
    """What a load brings, per length or on its node (..., *), on all nodes (..., N+1, *)."""
    if acting.along:
        x = _shares(rows, acting)[(..., *(None,) * (axes - 1))] * x
        return x if acting.node is None else pad(x, (0, 0) * axes + _around(acting, rows))
    return pad(x.unsqueeze(-1 - axes), (0, 0) * axes + _around(acting, rows))


def _shares(rows: Rows, act: ActingLoad) -> Tensor:
    """Length (..., nodes, 1) m of the nodes along which a load acts."""
    return rows.tributary_length if act.node is None else rows.tributary_length[..., act.node, :]


def _around(act: ActingLoad, rows: Rows) -> tuple[int, int]:
    """How many nodes come before and after those that a load acts on."""
    first, end = (act.node.start, act.node.stop) if act.along else (act.node, act.node + 1)
    return first, rows.node_count - end
