"""Interactions: wrenches on several nodes at once, see `scene.effects.interaction`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.leaves import leaf
from ..math.quaternions import matrix as axes_of
from ..math.shapes import stacked
from ..scene.effects.load_point import OWN, POSITION, ROTATION, LoadPoint
from ..topology.places import added
from .acting import ActingLoad
from .between_nodes import BetweenNodes, NodeMotion, Rates
from .conditions import Conditions
from .coordinates.spatial import Spatial
from .loads import MotionJacobian, Nodes, chained, changes, load_point, wrench, wrench_by
from .multipliers import Multipliers
from .sample_check import check_samples


class Inner(NamedTuple):
    """What interactions have beside nodes: rows (..., C, w) whose first ones are own unknowns of
    those that have some, and what each remembers (..., I, m), None = nothing yet; dt (...) s.
    """

    own: Tensor | None = None
    memory: Tensor | None = None
    dt: Tensor | None = None


def points(
    space: Spatial, nodes: Nodes, now: Conditions, inner: Inner, constrained: bool | None = None
) -> Iterator[tuple[ActingLoad, LoadPoint]]:
    """Each with its nodes; constrained: of those with own unknowns, or of those without."""
    row = 0
    for k, acting in enumerate(now.interactions):
        at, place, load = list(acting.node), {"dt": inner.dt}, acting.load
        unknowns_row, row = row, row + bool(load.unknowns)
        if constrained not in (None, bool(load.unknowns)):
            continue
        if nodes.frame is not None:
            place["axes"] = axes_of(space.public_frame(nodes.frame)).mT
        if load.unknowns:
            place["own"] = inner.own[..., unknowns_row, : load.unknowns]
        if load.memory:
            memory = nodes.position.new_zeros(k + 1, load.memory)
            memory = memory if inner.memory is None else inner.memory
            place["internal"] = memory[..., k, : load.memory]
        of_nodes = nodes.of(at, acting.reads)
        point = load_point(space.of_nodes(at), acting.load, acting.reads, of_nodes, **place)
        check_samples(acting, point, now.t, now.inputs)
        yield acting, point


def at_nodes(
    space: Spatial,
    nodes: Nodes,
    now: Conditions,
    total: Tensor | float = 0.0,
    inner: Inner | None = None,
    constrained: bool = False,
    share: Callable[[Any], Tensor | None] | None = None,
) -> Tensor | float:
    """The sum of their forces and moments (..., N+1, w), added to a total; 0.0 where there is none.
    constrained: of those with own unknowns; share: (...) of each that acts, None = all.
    """
    for acting, point in points(space, nodes, now, inner or Inner(), constrained):
        of_nodes = space.of_nodes(list(acting.node))
        push = wrench(of_nodes, acting.load, point, now.t, now.inputs)
        part = None if share is None else share(acting.load)
        push = push if part is None else part[..., None, None] * push
        total = total + added(None, acting.node, push, nodes.position.shape[-2], 1)
    return total


def blocks(
    space: Spatial,
    nodes: Nodes,
    now: Conditions,
    by: MotionJacobian,
    inner: Inner,
    constrained: bool = False,
) -> Iterator[tuple[tuple[int, ...], Any, Tensor | float, dict[str, Tensor]]]:
    """The nodes of each, itself, the derivative (..., n, n, w, w) of its wrenches by their moves,
    which change their motion as `by` says, and all its derivatives; constrained: of those with own
    unknowns.
    """
    for acting, point in points(space, nodes, now, inner, constrained):
        at, total = list(acting.node), 0.0
        of_node = space.of_nodes(at)
        of_nodes = {
            name: (x[..., at, :, :] if x.shape[-3] > 1 else x)[..., None, :, :, :]
            for name, x in by.items()
        }
        tangent = acting.load.tangent(point, now.t, now.inputs)
        for name, block in tangent.items():
            if changes(of_node, name, by):
                part = wrench_by(of_node, name, block.transpose(-3, -2))
                total = total + chained(of_node, name, part, of_nodes)
        yield acting.node, acting.load, total, tangent


@dataclass(frozen=True)
class Couplings(BetweenNodes):
    """All interactions of a scene, which are those of its conditions. Unknowns of their own are the
    last rows of multipliers, one of C each, of which those are there that `held` (C, w) has as 1.

    size (...) m of the whole
    """

    space: Spatial
    held: Tensor | None = leaf(2, default=None)
    size: Tensor | None = leaf(0, default=None)

    present = True

    @property
    def count(self) -> int:
        return 0 if self.held is None else len(self.held)

    @property
    def multipliers(self) -> Multipliers:
        return Multipliers() if self.held is None else Multipliers(self.held, self.size)

    def inner(self, stress: Tensor | None, motion: NodeMotion) -> Inner:
        """Own unknowns are of the stress, None = there are none."""
        unknowns = stress
        if stress is not None:
            unknowns = stress.narrow(-2, stress.shape[-2] - self.count, self.count)
        return Inner(unknowns, None if motion.state is None else motion.state.memory, motion.dt)

    def balance(
        self, nodes: Tensor, gap: Tensor, stress: Tensor, motion: NodeMotion
    ) -> tuple[Tensor, Tensor]:
        now, seen = motion.now, motion.nodes(motion.now.reads)
        inner = self.inner(stress, motion)
        nodes = nodes - at_nodes(self.space, seen, now, inner=inner, share=motion.share_of)
        if not self.count:
            return nodes, gap
        nodes = nodes - at_nodes(self.space, seen, now, inner=inner, constrained=True)
        rows = [
            self._padded(act.load.residual(point, now.t, now.inputs))
            for act, point in points(self.space, _ends(motion, seen), now, inner, True)
        ]
        return nodes, stacked(gap, *(row[..., None, :] for row in rows))

    def matrix(self, matrix: Any, stress: Tensor, motion: NodeMotion) -> Any:
        def less(load: Any) -> Tensor | float:
            share = motion.share_of(load)
            return -1.0 if share is None else -share[..., None, None, None]

        inner = self.inner(stress, motion)
        matrix = self._tied(matrix, motion, motion.by(motion.now.reads), less, inner)
        if not self.count:
            return matrix
        first = matrix.framework.node_count + (0 if matrix.held is None else len(matrix.held))
        held = self.held if matrix.held is None else torch.cat((matrix.held, self.held))
        ties, parts = zip(*self._constraints(motion, inner), strict=True)
        ties = tuple((*nodes, first + k) for k, nodes in enumerate(ties))
        return matrix.tied_too(ties, stacked(*parts, axis=-3), held)

    def _constraints(
        self, motion: NodeMotion, inner: Inner
    ) -> Iterator[tuple[tuple[int, ...], Tensor]]:
        """Of each with unknowns its nodes, and blocks (..., (n + 1)^2, w, w) of the balances of
        these and its own residual.
        """
        now, seen = motion.now, motion.nodes(motion.now.reads)
        whole = blocks(self.space, seen, now, motion.by(now.reads), inner, True)
        at_end = points(self.space, _ends(motion, seen), now, inner, True)
        for k, ((nodes, load, block, by), (_, point)) in enumerate(zip(whole, at_end, strict=True)):
            of_node = self.space.of_nodes(list(nodes))
            pull = self._padded(of_node.project(by[OWN].mT), -2).mT
            if not isinstance(block, Tensor):
                block = pull.new_zeros(len(nodes), *pull.shape[-3:])
            tangent = load.residual_tangent(point, now.t, now.inputs)
            closing = self._padded(self._by_moves(motion, nodes, tangent), -3).transpose(-3, -2)
            alone = self._padded(self._padded(tangent[OWN]), -2)
            alone = alone + torch.diag_embed(1 - self.held[k])
            rows = stacked(-block, -pull[..., None, :, :], axis=-3)
            last = stacked(closing, alone[..., None, :, :], axis=-3)
            yield nodes, stacked(rows, last[..., None, :, :, :], axis=-4).flatten(-4, -3)

    def _by_moves(
        self, motion: NodeMotion, nodes: tuple[int, ...], tangent: dict[str, Tensor]
    ) -> Tensor:
        """(..., unknowns, n, w) of a residual, from that by places and turns at the end."""
        of_node, half = self.space.of_nodes(list(nodes)), motion.half_turns()
        none = tangent[OWN].new_zeros(tangent[OWN].shape[-1], len(nodes), 3)
        by_place = of_node.project_vector(tangent.get(POSITION, none))
        by_turn = of_node.project_spin(tangent.get(ROTATION, none))
        if not self.space.turns:
            by_turn = torch.zeros_like(by_turn)
        elif half is not None:
            at = half[..., nodes, :, :] if half.shape[-3] > 1 else half
            by_turn = torch.einsum("...uns,...nsk->...unk", by_turn, at)
        return motion.rate * stacked(by_place.mT, by_turn.mT, axis=-2).mT

    def _padded(self, x: Tensor, axis: int = -1) -> Tensor:
        """With zeros up to w."""
        return pad(x, (0, 0) * (-1 - axis) + (0, self.space.unknowns - x.shape[axis]))

    def damping(self, matrix: Callable[[], Any], motion: NodeMotion) -> Any:
        moved = motion.moved(motion.now.reads)
        if not any(act.reads.intersection(moved) for act in motion.now.interactions):
            return None
        inner = self.inner(None, motion)
        damped = self._tied(matrix(), motion, moved, lambda load: -1.0, inner)
        return self._tied(damped, motion, motion.by(motion.now.reads), lambda load: 1.0, inner)

    def finished(
        self, fields: dict[str, Any], motion: NodeMotion, before: Any, moving: Rates | None
    ) -> dict[str, Any]:
        now, seen = motion.now, motion.nodes(motion.now.reads)
        size = max((act.load.memory for act in now.interactions), default=0)
        if not size:
            return fields
        inner, rows = self.inner(fields["stress"], motion), []
        ends = seen._replace(position=motion.after[0], rotation=motion.after[1], axes=None)
        for act, point in points(self.space, ends, now, inner):
            load, row = act.load, motion.after[0].new_zeros(size)
            if load.memory:
                row = load.remember(point, now.t, now.inputs)
                row = pad(row, (0, size - load.memory))
            rows.append(row[..., None, :])
        return fields | {"memory": stacked(*rows)}

    def _tied(
        self,
        matrix: Any,
        motion: NodeMotion,
        by: MotionJacobian,
        share: Callable[[Any], Tensor | float],
        inner: Inner,
    ) -> Any:
        """A matrix of balances with a share of their blocks, which is taken from balances."""
        now = motion.now
        for nodes, load, block, _ in blocks(self.space, motion.nodes(now.reads), now, by, inner):
            if isinstance(block, Tensor):
                matrix = matrix.tied_too((nodes,), share(load) * block.flatten(-4, -3))
        return matrix


def couplings_of(scene: Any, space: Spatial) -> BetweenNodes:
    """Those of a scene. Raises ValueError for one with more unknowns than a node has."""
    if not scene.interactions:
        return BetweenNodes()
    w, like = space.unknowns, scene.beam.nodes
    counts = [interaction.unknowns for interaction in scene.interactions if interaction.unknowns]
    if not counts:
        return Couplings(space)
    if max(counts) > w:
        raise ValueError(
            f"an interaction with {max(counts)} unknowns was given in a plane; at most {w} are "
            "wanted"
        )
    held = like.new_tensor([[float(k < count) for k in range(w)] for count in counts])
    size = scene.beam.extent.detach()
    return Couplings(space, held, torch.where(size > 0, size, 1.0))


def _ends(motion: NodeMotion, seen: Nodes) -> Nodes:
    """Nodes where motions end, of which their places and turns alone are known."""
    return Nodes(*motion.after, frame=seen.frame)
