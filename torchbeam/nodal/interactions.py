"""Interactions: wrenches on several nodes at once, see `scene.effects.interaction`."""

from __future__ import annotations

from collections.abc import Iterator

from torch import Tensor

from ..math.quaternions import matrix as axes_of
from ..scene.effects.load_point import LoadPoint
from ..topology.places import added
from ..topology.protocols import Matrix
from .acting import ActingLoad
from .conditions import Conditions
from .loads import MotionJacobian, Nodes, chained, changes, load_point, wrench, wrench_by
from .rows import Rows
from .sample_check import check_samples, tried


def points(rows: Rows, nodes: Nodes, now: Conditions) -> Iterator[tuple[ActingLoad, LoadPoint]]:
    """Each with its nodes."""
    for acting in now.interactions:
        at, place = list(acting.node), {}
        if nodes.frame is not None:
            place["axes"] = axes_of(rows.space.public_frame(nodes.frame)).mT
        of_nodes = nodes.of(at, acting.reads)
        point = load_point(rows.space.of_nodes(at), acting.load, acting.reads, of_nodes, **place)
        if acting.functions and not tried(acting.functions):
            check_samples(acting.load, point, now.t, now.inputs)
        yield acting, point


def wrenches(rows: Rows, nodes: Nodes, now: Conditions) -> Iterator[tuple[tuple[int, ...], Tensor]]:
    """The nodes of each, and its force and moment (..., n, w) on them."""
    for acting, point in points(rows, nodes, now):
        space = rows.space.of_nodes(list(acting.node))
        yield acting.node, wrench(space, acting.load, point, now.t, now.inputs)


def at_nodes(
    rows: Rows, nodes: Nodes, now: Conditions, total: Tensor | float = 0.0
) -> Tensor | float:
    """Their sum (..., N+1, w), added to a total; 0.0 where there is none."""
    for own, push in wrenches(rows, nodes, now):
        total = total + added(None, own, push, rows.node_count, 1)
    return total


def blocks(
    rows: Rows, nodes: Nodes, now: Conditions, by: MotionJacobian
) -> Iterator[tuple[tuple[int, ...], Tensor]]:
    """The nodes of each, and the derivative (..., n, n, w, w) of its wrenches by their moves, which
    change their motion as `by` says.
    """
    for acting, point in points(rows, nodes, now):
        at, total = list(acting.node), 0.0
        space = rows.space.of_nodes(at)
        of_nodes = {
            name: (x[..., at, :, :] if x.shape[-3] > 1 else x)[..., None, :, :, :]
            for name, x in by.items()
        }
        for name, block in acting.load.tangent(point, now.t, now.inputs).items():
            if changes(space, name, by):
                own = wrench_by(space, name, block.transpose(-3, -2))
                total = total + chained(space, name, own, of_nodes)
        yield acting.node, total


def matrix(
    rows: Rows,
    nodes: Nodes,
    now: Conditions,
    by: MotionJacobian,
    matrix: Matrix,
    share: Tensor | float = -1.0,
) -> Matrix:
    """A matrix of balances with a share of that of these, which is taken from balances."""
    for own, block in blocks(rows, nodes, now, by):
        if isinstance(block, Tensor):
            matrix = matrix.tied_too((own,), share * block.flatten(-4, -3))
    return matrix
