"""Interactions: wrenches on several nodes at once, see `scene.effects.interaction`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from ..math.quaternions import matrix as axes_of
from ..scene.effects.load_point import LoadPoint
from ..topology.places import added
from .acting import ActingLoad
from .between_nodes import BetweenNodes, NodeMotion
from .conditions import Conditions
from .coordinates.spatial import Spatial
from .loads import MotionJacobian, Nodes, chained, changes, load_point, wrench, wrench_by
from .sample_check import check_samples, tried


def points(space: Spatial, nodes: Nodes, now: Conditions) -> Iterator[tuple[ActingLoad, LoadPoint]]:
    """Each with its nodes."""
    for acting in now.interactions:
        at, place = list(acting.node), {}
        if nodes.frame is not None:
            place["axes"] = axes_of(space.public_frame(nodes.frame)).mT
        of_nodes = nodes.of(at, acting.reads)
        point = load_point(space.of_nodes(at), acting.load, acting.reads, of_nodes, **place)
        if acting.functions and not tried(acting.functions):
            check_samples(acting.load, point, now.t, now.inputs)
        yield acting, point


def wrenches(
    space: Spatial, nodes: Nodes, now: Conditions
) -> Iterator[tuple[tuple[int, ...], Tensor]]:
    """The nodes of each, and its force and moment (..., n, w) on them."""
    for acting, point in points(space, nodes, now):
        own = space.of_nodes(list(acting.node))
        yield acting.node, wrench(own, acting.load, point, now.t, now.inputs)


def at_nodes(
    space: Spatial, nodes: Nodes, now: Conditions, total: Tensor | float = 0.0
) -> Tensor | float:
    """Their sum (..., N+1, w), added to a total; 0.0 where there is none."""
    for own, push in wrenches(space, nodes, now):
        total = total + added(None, own, push, nodes.position.shape[-2], 1)
    return total


def blocks(
    space: Spatial, nodes: Nodes, now: Conditions, by: MotionJacobian
) -> Iterator[tuple[tuple[int, ...], Tensor]]:
    """The nodes of each, and the derivative (..., n, n, w, w) of its wrenches by their moves, which
    change their motion as `by` says.
    """
    for acting, point in points(space, nodes, now):
        at, total = list(acting.node), 0.0
        of_node = space.of_nodes(at)
        of_nodes = {
            name: (x[..., at, :, :] if x.shape[-3] > 1 else x)[..., None, :, :, :]
            for name, x in by.items()
        }
        for name, block in acting.load.tangent(point, now.t, now.inputs).items():
            if changes(of_node, name, by):
                own = wrench_by(of_node, name, block.transpose(-3, -2))
                total = total + chained(of_node, name, own, of_nodes)
        yield acting.node, total


@dataclass(frozen=True)
class Couplings(BetweenNodes):
    """All interactions of a scene, which are those of its conditions."""

    space: Spatial

    present = True

    def balance(
        self, nodes: Tensor, gap: Tensor, stress: Tensor, motion: NodeMotion
    ) -> tuple[Tensor, Tensor]:
        whole = at_nodes(self.space, motion.nodes(motion.now.reads), motion.now)
        return nodes - motion.raised(whole), gap

    def matrix(self, matrix: Any, stress: Tensor, motion: NodeMotion) -> Any:
        share = 1.0 if motion.share is None else motion.share[..., None, None, None]
        return self._tied(matrix, motion, motion.by(motion.now.reads), -share)

    def damping(self, matrix: Callable[[], Any], motion: NodeMotion) -> Any:
        moved = motion.moved(motion.now.reads)
        if not any(act.reads.intersection(moved) for act in motion.now.interactions):
            return None
        own = self._tied(matrix(), motion, moved, -1.0)
        return self._tied(own, motion, motion.by(motion.now.reads), 1.0)

    def _tied(
        self, matrix: Any, motion: NodeMotion, by: MotionJacobian, share: Tensor | float
    ) -> Any:
        """A matrix of balances with a share of their blocks, which is taken from balances."""
        now = motion.now
        for own, block in blocks(self.space, motion.nodes(now.reads), now, by):
            if isinstance(block, Tensor):
                matrix = matrix.tied_too((own,), share * block.flatten(-4, -3))
        return matrix
