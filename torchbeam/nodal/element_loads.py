"""Loads between nodes: at some Gauss points of each element, by its nodes' motion there, which is
interpolated as their places are. Each gives an element's nodes their shares, and its tangent blocks
between them. Elements do not mix.

With N_a of node a and the weight w (m) of a point, and f its wrench per length:

    load of node a = sum of w N_a f        block of a and b = sum of w N_a N_b df
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..math.element_shapes import SHAPES, gauss_points
from ..math.element_shapes import point_weights as weights_at
from ..math.shapes import stacked
from ..scene.effects import Contact, LoadPoint
from ..scene.effects.load_point import POSITION, SPIN, VELOCITY
from ..scene.stations import Table
from ..topology.protocols import Blocks, Matrix
from . import interactions
from .acting import ActingLoad
from .between_nodes import Told
from .conditions import Conditions
from .loads import STAYS, MotionJacobian, Nodes, chained, external, wrench, wrench_blocks
from .loads import load_point as place_of
from .rows import Rows
from .sample_check import check_samples


def element_loads(rows: Rows, nodes: Nodes, now: Conditions) -> tuple[Tensor, ...]:
    """Force N and moment N m (..., N, w), frame a, on each node of all elements."""
    total = 0.0
    for acting, point in _points(rows, nodes, now):
        weights, shares = point_weights(rows, acting), _shares(rows, acting)
        f = weights * wrench(rows.space, acting.load, point, now.t, now.inputs)
        forces = shares.mT @ f.unflatten(-2, (-1, len(shares)))  # (..., N, nodes, w)
        total = total + _padded(rows, acting, forces, 2)
    return total.unbind(-2)


def element_blocks(rows: Rows, nodes: Nodes, now: Conditions, by: MotionJacobian = STAYS) -> Blocks:
    """Derivative of `element_loads` by the moves of the elements' nodes, which change their motion
    as `by` says: (..., N, w, w) by row and column.
    """
    count = rows.space.interpolation.order + 1
    total = [[0.0] * count for _ in range(count)]
    for acting, point in _points(rows, nodes, now):
        weights, shares = point_weights(rows, acting)[..., None], _shares(rows, acting)
        blocks = wrench_blocks(rows.space, acting.load, point, now.t, now.inputs, by)
        for b in range(count):
            ways = {name: _of_node(rows, acting, x, b) for name, x in by.items()}
            by_b = sum(chained(rows.space, name, x, ways) for name, x in blocks.items())
            by_b = (weights * by_b).unflatten(-3, (-1, len(shares)))
            for a in range(count):
                share = (shares[:, a] * shares[:, b])[:, None, None]
                total[a][b] = total[a][b] + _padded(rows, acting, (share * by_b).sum(-3), 2)
    return tuple(map(tuple, total))


def element_matrix(
    rows: Rows, nodes: Nodes, now: Conditions, by: MotionJacobian = STAYS
) -> Matrix | None:
    """`element_blocks` of the nodes that they connect; None where no such loads act."""
    return rows.topology.matrix(element_blocks(rows, nodes, now, by)) if now.between else None


def at_nodes(rows: Rows, nodes: Nodes, now: Conditions) -> Tensor | float:
    """`element_loads` summed at nodes (..., N+1, w); 0.0 where none act."""
    return rows.topology.scatter(element_loads(rows, nodes, now)) if now.between else 0.0


def all_loads(rows: Rows, nodes: Nodes, now: Conditions) -> Tensor | float:
    """The same with the loads that act at nodes."""
    total = external(rows, nodes, now)
    total = total + at_nodes(rows, nodes, now) if now.between else total
    return interactions.at_nodes(rows.space, nodes, now, total)


def telling(rows: Rows, nodes: Nodes, now: Conditions) -> Told:
    """What points where surfaces rub tell the next iteration."""
    points = _points(rows, nodes, now)
    each = [act.load.telling(point) for act, point in points if act.load.rubs]
    return {"elements": stacked(*each)} if each else {}


def forgotten(rows: Rows, told: Told, way: Way, now: Conditions) -> Told:
    """The same, but of elements that are `far` nothing."""
    if "elements" not in told:
        return told
    away = far(rows, way, now)
    each = [
        away[..., _elements(rows, act)].repeat_interleave(act.load.points, -1)
        for act in now.between
        if act.load.rubs
    ]
    return {**told, "elements": torch.where(torch.cat(each, -1)[..., None], 0.0, told["elements"])}


class Way(NamedTuple):
    """Straight ways of nodes over a step of dt (...) s: by `half` (..., N+1, p) m on either side of
    the `middle` (..., N+1, p) m, in the space's coordinates; None = they rest.
    """

    middle: Tensor
    half: Tensor | None = None
    dt: Tensor | None = None


def far(rows: Rows, way: Way, now: Conditions) -> Tensor:
    """(..., elements) bool: where none of these loads does anything, wherever nodes are on their
    way: by the squares of how far an element's points are from its centre, and of how far they
    move. The shares of nodes in a point have squares that sum up to 1 at most.
    """
    each = []
    for acting in now.between:
        load, corners = acting.load.at_its_widest, _corners(rows, acting, way.middle)
        centre, spread = _hull(corners)
        x = rows.space.public_position(centre)
        if way.half is not None:
            moves = _corners(rows, acting, way.half)
            shifts = [part.square().sum(-1) for part in moves]
            carried = [load.carried(rows.space.public_position(part), way.dt) for part in corners]
            shifts += [2 * part.square().sum(-1) for part in carried if part is not None]
            share = 1 if len(shifts) == len(moves) else 2
            spread = spread + share * sum(shifts[1:], shifts[0])
        each.append(_padded(rows, acting, ~load.idle(x, 2 * spread), 0))
    return ~torch.stack(torch.broadcast_tensors(*each)).any(0)


def _hull(corners: tuple[Tensor, ...]) -> tuple[Tensor, Tensor]:
    """Centre (..., N, p) m of elements, and the square (..., N) m^2 of how far from it their points
    are at most.
    """
    first, *middle, last = corners
    if middle:
        return middle[0], sum((x - middle[0]).square().sum(-1) for x in (first, last))
    half = (last - first) / 2
    return first + half, half.square().sum(-1)


def passed_through(rows: Rows, way: Way, now: Conditions) -> Tensor:
    """(...) bool: whether that way leads a point through something that it is to touch."""
    each = []
    for acting in now.between:
        x = rows.space.public_position(_at_points(rows, acting, way.middle))
        half = rows.space.public_vector(_at_points(rows, acting, way.half))
        each.append(at_points(rows, acting).load.passed_through(x, half, way.dt).any(-1))
    return torch.stack(torch.broadcast_tensors(*each)).any(0)


def body_passed_through(rows: Rows, way: Way, now: Conditions) -> Tensor | None:
    """The same of bodies, single nodes; None where none touches an obstacle."""
    each = []
    for acting in now.moving:
        if isinstance(acting.load, Contact):
            x = rows.space.public_position(way.middle[..., acting.node, :])
            half = rows.space.public_vector(way.half[..., acting.node, :])
            x, half = x[..., None, :], half[..., None, :]
            each.append(acting.load.passed_through(x, half, way.dt)[..., 0])
    return torch.stack(torch.broadcast_tensors(*each)).any(0) if each else None


def body_near(rows: Rows, way: Way, now: Conditions) -> Tensor | None:
    """(...) bool: whether bodies may press on obstacles, wherever they are on their way; None where
    none touches one.
    """
    each = []
    for acting in now.moving:
        if isinstance(acting.load, Contact):
            load, place = acting.load, way.middle[..., acting.node, None, :]
            x = rows.space.public_position(place)
            shifts = [way.half[..., acting.node, None, :], load.carried(x, way.dt)]
            reach = [part.square().sum(-1) for part in shifts if part is not None]
            if load.corners is not None:
                reach.append(load.corners.square().sum(-1).amax(-1, keepdim=True))
            each.append(~load.idle(x, len(reach) * sum(reach))[..., 0])
    return torch.stack(torch.broadcast_tensors(*each)).any(0) if each else None


def at_points(rows: Rows, acting: ActingLoad) -> ActingLoad:
    """With the numbers that the load has at the points of the elements along which it acts."""
    if not isinstance(acting.load.radius, Table):
        return acting
    s = _at_points(rows, acting, rows.s[..., None])[..., 0]
    return acting._replace(load=acting.load.at_points(s))


def load_point(
    rows: Rows, acting: ActingLoad, nodes: Nodes, now: Conditions, told: Tensor | None = None
) -> LoadPoint:
    """The points (..., points, 3) of the elements along which a load acts, one after the other."""
    read = {name: getattr(nodes, name) for name in (POSITION, VELOCITY, SPIN)}
    at = {
        name: _at_points(rows, acting, x)
        for name, x in read.items()
        if name in acting.reads and x is not None
    }
    position = at[POSITION]
    axes = torch.eye(3, dtype=position.dtype, device=position.device)
    return place_of(
        rows.space,
        acting.load,
        acting.reads,
        Nodes(**at, rotation=None, axes=axes.expand(*position.shape[:-1], 3, 3)),
        dt=nodes.dt if acting.load.wants_step else None,
        frame=now.velocities if acting.load.wants_frame else (None, None),
        told=told,
    )


def _points(rows: Rows, nodes: Nodes, now: Conditions) -> Iterator[tuple[ActingLoad, LoadPoint]]:
    told, row = nodes.told.get("elements"), 0
    for acting in now.between:
        told_here = None
        if acting.load.rubs and told is not None:
            elements = range(rows.topology.element_count)[_elements(rows, acting)]
            told_here = told.narrow(-2, row, count := len(elements) * acting.load.points)
            row += count
        point = load_point(rows, acting, nodes, now, told_here)
        check_samples(acting, point, now.t, now.inputs)
        yield at_points(rows, acting), point


def _corners(rows: Rows, acting: ActingLoad, x: Tensor) -> tuple[Tensor, ...]:
    """Values (..., N+1, *) at nodes -> those of each of the elements' nodes (..., N, *)."""
    return tuple(part[..., _elements(rows, acting), :] for part in rows.topology.gather(x))


def _at_points(rows: Rows, acting: ActingLoad, x: Tensor) -> Tensor:
    """Values (..., N+1, *) at nodes -> (..., points, *)."""
    corners = torch.stack(_corners(rows, acting, x), -2)
    return (_shares(rows, acting) @ corners).flatten(-3, -2)


def _of_node(rows: Rows, acting: ActingLoad, x: Tensor, b: int) -> Tensor:
    """Derivatives (..., N+1 or 1, *, *) of nodes' motions -> those of node b of the elements, at
    each of their points (..., points or 1, *, *).
    """
    if x.shape[-3] == 1:
        return x
    of_elements = rows.topology.gather(x, 2)[b][..., _elements(rows, acting), :, :]
    return of_elements.repeat_interleave(acting.load.points, -3)


def _shares(rows: Rows, acting: ActingLoad) -> Tensor:
    """N_a (points, nodes) of one element."""
    x, _ = gauss_points(acting.load.points)
    return SHAPES[rows.space.interpolation.order].values(x).to(rows.length)


def point_weights(rows: Rows, acting: ActingLoad) -> Tensor:
    """(..., points, 1) m, see `element_shapes.point_weights`."""
    length = rows.length if acting.node is None else rows.length[..., acting.node, :]
    order = rows.space.interpolation.order
    return weights_at(order, length[..., 0], acting.load.points).flatten(-2)[..., None]


def _elements(rows: Rows, acting: ActingLoad) -> slice:
    """Those along which a load acts."""
    order, stations = rows.space.interpolation.order, acting.node
    return (
        slice(None) if stations is None else slice(stations.start // order, stations.stop // order)
    )


def _padded(rows: Rows, acting: ActingLoad, x: Tensor, axes: int) -> Tensor:
    """What some elements have (..., n, *), with zeros for the others."""
    if acting.node is None:
        return x
    some, count = _elements(rows, acting), rows.topology.element_count
    return pad(x, (0, 0) * axes + (some.start, count - some.stop))
