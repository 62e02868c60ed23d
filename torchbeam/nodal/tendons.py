"""Tendons on nodes: an eyelet is fixed in the axes of its node, p = r + R a. With the mean of the
axes at both ends of a step its lever is mean(R) a, so that a rope's force does the same work at the
node as at the eyelet, see `joints`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.leaves import leaf
from ..math.quaternions import cross, skew
from ..math.shapes import stacked
from ..scene.effects.values import Inputs, scalar_at
from ..topology.framework import Framework
from ..topology.places import added
from .between_nodes import BetweenNodes, NodeMotion, Placed, Rates, Told
from .coordinates.spatial import Spatial
from .joint_motion import end_moves
from .rope import Rope, RopeStep, Stretches


class Eyelets(NamedTuple):
    """Points (..., E, 3) m, frame a, and their levers from the nodes; zero on the ground."""

    p: Tensor
    lever: Tensor

    def mean(self, other: Eyelets) -> Eyelets:
        return Eyelets((self.p + other.p) / 2, (self.lever + other.lever) / 2)


@dataclass(frozen=True)
class Tendons(BetweenNodes):
    """All tendons of a scene, with E eyelets, one tendon after the other.

    sizes   how many eyelets each has
    nodes   of each eyelet its node, None = the ground
    arms    (..., E, 3) m, in the node's axes, or in frame a on the ground
    moves   (w, 6): displacement and spin in space of a node's moves
    """

    space: Spatial
    framework: Framework
    ropes: tuple[Rope, ...]
    sizes: tuple[int, ...]
    nodes: tuple[int | None, ...]
    arms: Tensor = leaf(2)
    moves: Tensor = leaf(2)

    present = True

    @property
    def has_friction(self) -> bool:
        return any(rope.friction is not None for rope in self.ropes)

    dissipative = has_friction

    @property
    def _coupled(self) -> bool:
        """Whether a tension follows from where the rope is."""
        return self.dissipative or any(rope.stiffness is not None for rope in self.ropes)

    @property
    def smooth(self) -> bool:
        return not self.dissipative

    @property
    def stretches(self) -> tuple[tuple[int, int], ...]:
        """Of each between two eyelets the number of its tendon, and that of its first eyelet."""
        parts = enumerate(self._parts)
        return tuple((k, e) for k, part in parts for e in range(part.start, part.stop - 1))

    @property
    def ties(self) -> tuple[tuple[int, ...], ...]:
        """The nodes of each tendon."""
        every = (self.nodes[part] for part in self._parts)
        return tuple(tuple(node for node in nodes if node is not None) for nodes in every)

    def eyelets(self, position: Tensor, rotation: Tensor) -> Eyelets:
        """From nodes, in the space's coordinates."""
        at = self._at
        R = self.space.axes(rotation[..., at, :])
        lever = (R @ self.arms[..., None])[..., 0]
        lever = torch.where(self._ground(lever), 0.0, lever)
        r = self.space.public_position(position[..., at, :])
        return Eyelets(torch.where(self._ground(r), self.arms, r + lever), lever)

    def balance(
        self, nodes: Tensor, gap: Tensor, stress: Tensor, motion: NodeMotion
    ) -> tuple[Tensor, Tensor]:
        return self.loaded(nodes, motion.placed(self.eyelets), motion.now.tendons), gap

    def loaded(self, nodes: Tensor, motion: Placed, drives: Tensor) -> Tensor:
        """The nodes' balances (..., nodes, w), with the forces of these; drives: see `values`."""
        steps = zip(self.ropes, self.steps(motion, drives), strict=True)
        force = torch.cat([rope.forces(step) for rope, step in steps], -2)
        wrench = self.wrench(motion.acting.lever, force)
        at = tuple(node for tie in self.ties for node in tie)
        return added(nodes, at, -wrench[..., self._own, :], nodes.shape[-2], 1)

    def wrench(self, lever: Tensor, force: Tensor) -> Tensor:
        """(..., n, w) on nodes, of forces (..., n, 3) at eyelets."""
        moment = cross(lever, force)
        return torch.cat((force.expand_as(moment), moment), -1) @ self.moves.mT

    def matrix(self, matrix: Any, stress: Tensor, motion: NodeMotion) -> Any:
        blocks = self.blocks(motion.placed(self.eyelets), motion.now.tendons)
        return matrix.tied_too(self.ties, blocks)

    def blocks(self, motion: Placed, drives: Tensor) -> Tensor:
        """(..., n, w, w) of all pairs of the nodes of each tendon."""
        spin, half, rate = None, motion.of.half_turns(), motion.of.rate
        if half is not None:
            spin = end_moves(half[..., self._at, :, :], self.space.dims.position)
        blocks, steps = [], self.steps(motion, drives)
        for rope, step, part in zip(self.ropes, steps, self._parts, strict=True):
            acting, after = rope.tangent(step)
            there = [k for k, node in enumerate(self.nodes[part]) if node is not None]
            at = [part.start + k for k in there]
            by = (acting + rate * after).transpose(-3, -2)  # (..., m, m, 3, 3)
            by = by[..., there, :, :, :][..., there, :, :]
            force, lever = rope.forces(step)[..., there, :], motion.acting.lever[..., at, :]
            block = self._blocks(by, force, lever, motion.end.lever[..., at, :])
            block = block if spin is None else block @ spin[..., None, at, :, :]
            blocks.append(block.flatten(-4, -3))
        return stacked(*blocks, axis=-3)

    def telling(self, motion: NodeMotion) -> Told:
        if motion.dt is None or not self.dissipative:
            return {}
        rows, steps = [], self.steps(motion.placed(self.eyelets), motion.now.tendons)
        for rope, step in zip(self.ropes, steps, strict=True):
            none = torch.zeros_like(step.after[..., :2])
            if rope.friction is not None and none.shape[-2] > 2:
                told_here = rope.grips(step, Stretches.of(step)).told
                none = pad(told_here, (0, 0, 1, 1))
            rows.append(none)
        return {"tendons": torch.cat(rows, -2)}

    def values(self, scene: Any, t: Tensor, inputs: Inputs, end: Tensor) -> Tensor:
        """(..., K, 1): the tension N or length m that is given; (..., K, 2) at start and end of the
        step, where a length is a function of t.
        """

        def value(tendon: Any, rope: Rope, of_length: Tensor) -> Tensor:
            lengths = tendon.tension is None
            given, at = (tendon.length, of_length) if lengths else (tendon.tension, t)
            if given is None:
                return rope.drawn
            return scalar_at("what is given of a Tendon", given, at, inputs, self.arms)

        winched = any(callable(tendon.length) for tendon in scene.tendons)
        pairs = [*zip(scene.tendons, self.ropes, strict=True)]
        values = [value(*x, at) for x in pairs for at in ((2 * t - end, end) if winched else (t,))]
        return torch.stack(torch.broadcast_tensors(*values), -1).unflatten(-1, (len(pairs), -1))

    def finished(
        self, fields: dict[str, Any], motion: NodeMotion, before: Any, moving: Rates | None
    ) -> dict[str, Any]:
        placed, rows, done, work = motion.placed(self.eyelets), [], 0.0, fields.get("work")
        steps = self.steps(placed, motion.now.tendons)
        for k, (rope, step) in enumerate(zip(self.ropes, steps, strict=True)):
            T, lengths = rope.readings(step)
            rows.append(torch.stack((T[..., 0], T[..., -1], lengths[..., 1, :].sum(-1)), -1))
            if work is not None:
                change = lengths[..., 1, :] - self.lengths_before(placed, k)
                last = None if before is None else before.tendons[..., k, :1]
                done = done - (mean_tension(T, last) * change).sum(-1)
        fields = fields | {"tendons": torch.stack(torch.broadcast_tensors(*rows), -2)}
        return fields if work is None else fields | {"work": work + done}

    def steps(self, motion: Placed, drives: Tensor) -> tuple[RopeStep, ...]:
        """What each rope is asked for."""
        of, steps = motion.of, []
        over = of.dt is not None and motion.start is not None
        rates = self._rates(motion) if over and self.dissipative else None
        way = self.way(motion) if over and self._coupled else None
        told = of.told.get("tendons")
        for k, (rope, part) in enumerate(zip(self.ropes, self._parts, strict=True)):
            steps.append(
                RopeStep(
                    motion.acting.p[..., part, :],
                    motion.end.p[..., part, :],
                    motion.start.p[..., part, :] if over else None,
                    rope.raised(drives[..., k, :], of.share),
                    of.dt,
                    None if rates is None else rates[..., part, :],
                    None if way is None else way[..., part, :],
                    None if told is None else told[..., part, :][..., 1:-1, :],
                )
            )
        return tuple(steps)

    def lengths_before(self, motion: Placed, k: int) -> Tensor:
        """(..., n) m of the stretches of rope k before the step."""
        points = motion.start.p[..., self._parts[k], :]
        return torch.linalg.vector_norm(points.diff(dim=-2), dim=-1)

    def _rates(self, motion: Placed) -> Tensor:
        """(..., E, 3) m/s of the eyelets before the step, as seen in frame a."""
        moves = torch.cat([x[..., self._at, :] for x in motion.of.moving()], -1) @ self.moves
        velocity, spin = moves.split(3, -1)
        turned = cross(spin, motion.start.lever)
        return torch.where(self._ground(velocity), 0.0, velocity + turned)

    def way(self, motion: Placed) -> Tensor:
        """(..., E, 3) m by which the eyelets move over the step."""
        way = self.space.public_vector(motion.of.path()[..., self._at, :])
        turned = motion.end.lever - motion.start.lever
        return torch.where(self._ground(way), 0.0, way + turned)

    def _blocks(self, by: Tensor, force: Tensor, lever: Tensor, end: Tensor) -> Tensor:
        """(..., m, m, w, w) of a rope: derivative of less the wrenches on nodes by the moves of
        nodes, from that of the forces by the eyelets (..., m, m, 3, 3); lever, end: where forces
        act, and after the step.
        """
        eye = torch.eye(3, dtype=by.dtype, device=by.device)
        to_node = torch.cat((eye.expand(*lever.shape, 3), skew(lever)), -2)  # (..., m, 6, 3)
        of_node = torch.cat((eye.expand(*end.shape, 3), -skew(end)), -1)  # (..., m, 3, 6)
        whole = to_node[..., :, None, :, :] @ by @ of_node[..., None, :, :, :]
        turned = pad(skew(force) @ skew(end), (3, 0, 3, 0))  # levers turn with the nodes
        same = torch.eye(end.shape[-2], dtype=by.dtype, device=by.device)[..., None, None]
        whole = whole + same * turned[..., :, None, :, :]
        return -(self.moves @ whole @ self.moves.mT)

    def _ground(self, like: Tensor) -> Tensor:
        """(E, 1) bool"""
        return torch.tensor([node is None for node in self.nodes], device=like.device)[:, None]

    @property
    def _parts(self) -> list[slice]:
        """The eyelets of each tendon."""
        ends = [*accumulate(self.sizes)]
        return [slice(end - m, end) for end, m in zip(ends, self.sizes, strict=True)]

    @property
    def _at(self) -> list[int]:
        """The node of each eyelet; 0 for the ground."""
        return [node or 0 for node in self.nodes]

    @property
    def _own(self) -> list[int]:
        """The eyelets on nodes, in the order of `ties`."""
        return [k for k, node in enumerate(self.nodes) if node is not None]


def mean_tension(tension: Tensor, before: Tensor | None) -> Tensor:
    """By which a tendon does its work over a step; before: at its start, None = it is a mean."""
    return tension if before is None else (tension + before) / 2


def tendons_of(scene: Any, space: Spatial, topology: Any) -> BetweenNodes:
    """Of a scene."""
    if not scene.tendons:
        return BetweenNodes()
    eyelets = [eyelet for tendon in scene.tendons for eyelet in tendon.eyelets]
    eye = torch.eye(space.unknowns, dtype=scene.dtype, device=scene.device)
    return Tendons(
        space=space,
        framework=topology,
        ropes=tuple(
            Rope(
                tendon.length_at(scene.beam.nodes, scene.beam.frames),
                tendon.stiffness,
                tendon.friction,
                tendon.slip_speed,
            )
            for tendon in scene.tendons
        ),
        sizes=tuple(len(tendon.eyelets) for tendon in scene.tendons),
        nodes=tuple(None if x.node is None else int(x.node) for x in eyelets),
        arms=torch.stack(torch.broadcast_tensors(*(x.point for x in eyelets)), -2),
        moves=space.embed(eye),
    )
