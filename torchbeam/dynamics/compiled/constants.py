"""Constants of a chain as rows: one of each node, one of each element, and what all have in common."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ...core.leaves import Tree, detached, functions, leaf, map_leaves, own_leaves, with_values
from ...nodal.constitutive_law import ElasticLaw
from ...nodal.coordinates.linearised import LinearElement, Small
from ...nodal.coordinates.planar import Plane
from ...nodal.loads import Nodes, advanced, external
from ...nodal.model import Model
from ...scene.effects import Inputs
from ...scene.effects.values import value_at
from ...state.state import rest


@dataclass(frozen=True)
class NodeConstants(Tree):
    """Rows of nodes. mass, J, offset: see `LumpedMass`, `RotaryInertia`, `Lever`, None = absent; slide, turn: see
    `Constraints`; section_mass, tributary_length: see `Model`; s (..., N+1) m; dead (..., N+1, w) loads that depend on no
    motion, None = none; frames, R: see `Small`, None in other coordinates; loads: those of the loads of `Common`
    that have values by place, rows in each of their leaves, None in the place of the others.
    """

    mass: Tensor = leaf(2)
    J: Tensor | None = leaf(3)
    offset: Tensor | None = leaf(2)
    slide: Tensor = leaf(2)
    turn: Tensor = leaf(2)
    section_mass: Tensor = leaf(3)
    tributary_length: Tensor = leaf(2)
    s: Tensor = leaf(1)
    dead: Tensor | None = leaf(2)
    frames: Tensor | None = leaf(2)
    R: Tensor | None = leaf(3)
    loads: tuple[Any, ...]


@dataclass(frozen=True)
class ElementConstants(Tree):
    """Rows of elements. C: the law's stiffness in the tangent of this step; coupling: see `HalfConsistentMass`; eigenstrain
    (..., N, k), None = none; linear: None but for small rotations.
    """

    length: Tensor = leaf(2)
    reference: Tensor = leaf(2)
    law: ElasticLaw
    C: Tensor = leaf(3)
    coupling: Tensor | None = leaf(2)
    eigenstrain: Tensor | None = leaf(2)
    linear: LinearElement | None


@dataclass(frozen=True)
class SupportPose(Tree):
    """`Pose` of the root's support, each field a leaf."""

    position: Tensor = leaf(1)
    R: Tensor = leaf(2)
    velocity: Tensor = leaf(1)
    spin: Tensor = leaf(1)


@dataclass(frozen=True)
class Common(Tree):
    """One of all nodes: dt and t (...) s of the step and of its middle, loads that depend on the motion or remember (None in
    the place of those of `NodeConstants`), inputs, the place of a plane, where a root's support stands; of frame a, in the
    middle of the step, its velocity and angular velocity (..., 3) and its orientation, see `State.frame`, None = at rest.
    """

    dt: Tensor = leaf(0)
    t: Tensor = leaf(0)
    loads: tuple[Any, ...]
    inputs: Inputs = leaf(1)
    place: Tensor | None = leaf(0)
    support: SupportPose | None
    velocity: Tensor | None = leaf(1)
    angular_velocity: Tensor | None = leaf(1)
    frame: Tensor | None = leaf(1)


@dataclass(frozen=True)
class SupportConstants(Tree):
    """Rows of supports at the end of the step: position (..., S, 3) m and quaternion (..., S, 4) of those that move, velocity
    (..., S, 3) m/s, absolute, frame a, and spin (..., S, 3) rad/s, absolute, section axes, of clamps; zeros of the others.
    """

    position: Tensor = leaf(2)
    rotation: Tensor = leaf(2)
    velocity: Tensor = leaf(2)
    spin: Tensor = leaf(2)


class Constants:
    """Of a model's steps: what holds for all of them is kept."""

    def __init__(self, model: Model) -> None:
        space, inertia, constraints, small = model.space, model.inertia, model.constraints, isinstance(model.space, Small)
        self.model = model
        still = space.to_reduced(rest(model.scene, ()))
        self.still = Nodes(still.position, still.rotation)
        self.nodes = NodeConstants(
            inertia.mass, getattr(inertia.rotary, "J", None), getattr(inertia.offset, "x", None), constraints.slide,
            constraints.turn, model.section_mass, model.tributary_length, model.s, None,
            *((space.frames, space.R) if small else (None, None)), ())
        self.elements = ElementConstants(
            model.length, model.reference, model.law, model.law.C, getattr(inertia.translational, "coupling", None), None,
            space.element if small else None)
        self.loads = acting_loads(model)
        self.dead = tuple(load for load in model.scene.loads if load not in self.loads)
        self.wants_support = any(load.wants_support for load in self.loads)

    def at(self, dt: Tensor, t: Tensor, inputs: Inputs, frame: Tensor | None = None
           ) -> tuple[NodeConstants, ElementConstants, Common]:
        """Of steps of dt (...) with loads as at t (...), which broadcast with the batch of the model; frame: that of frame
        a then, None = it does not turn.
        """
        model = self.model
        dead = external(model, self.still._replace(frame=frame), t, inputs, self.dead) if self.dead else None
        own = model.eigenstrain(t, inputs) if model.scene.eigenstrains else None
        support = SupportPose(*model.prescribed_motion.root_pose(t)) if self.wants_support else None
        rows = tuple(load.at_sites(model.s, t, inputs, model.count) for load in self.loads)
        loads = tuple(_resolved(load, t, inputs, model) if row is None else None
                      for load, row in zip(self.loads, rows, strict=True))
        place = model.space.place if isinstance(model.space, Plane) else None
        elements = replace(self.elements, C=model.tangent_stiffness(dt.detach()), eigenstrain=own)
        common = Common(dt, t, loads, inputs, place, support, *model.prescribed_motion.frame(t), frame)
        return replace(self.nodes, dead=dead, loads=rows), elements, common

    def supports(self, end: Tensor) -> SupportConstants | None:
        """At the time `end` (...) of a step; None where nothing moves them."""
        model = self.model
        if not (model.scene.has_prescribed_motion and model.scene.supports):
            return None
        motion, like = model.prescribed_motion, model.length
        none = {"pose": (like.new_zeros(3), like.new_zeros(4)), "absolute": (like.new_zeros(3),) * 2}
        found = [(*(motion.pose(one, end) if one.moves else none["pose"]),
                  *(motion.absolute(one, end) if one.clamp else none["absolute"])) for one in model.scene.supports]
        return SupportConstants(*(torch.stack(torch.broadcast_tensors(*rows), -2) for rows in zip(*found, strict=True)))

    def orientations(self, start: Tensor | None, dt: Tensor, t: Tensor) -> tuple[Tensor | None, Tensor | None]:
        """Of frame a in the middle and at the end of K steps of dt (K, ...) with the middles t, from `start` (...), in the
        space's coordinates, (K, ..., q); None where it does not turn.
        """
        if start is None:
            return None, None
        space, frame = self.model.space, self.model.frame(t)
        turns, half = (frame.orientation(space.identity(start[..., 1:]), part * dt) for part in (1.0, 0.5))
        size = 1
        while size < len(turns):  # each is that of all steps up to its own
            turns = torch.cat((turns[:size], space.multiply(turns[:-size], turns[size:])))
            size *= 2
        end = space.multiply(start, turns)
        begin = torch.cat((start.expand(1, *end.shape[1:]), end[:-1]))
        return space.multiply(begin, half), end

    def internal_rows(self, internal: Tensor) -> Tensor:
        """Internal states (..., z) of a state as rows of nodes (..., N+1, Z): of each load in turn, zeros where it does not
        act.
        """
        nodes, found, at = self.model.count + 1, [], 0
        for load in self.loads:
            size = load.internal_states(self.model.scene.beam)
            own = internal[..., at:at + size]
            at += size
            if size:
                j = 0 if load.node is None else load.node % nodes
                rows = own.unflatten(-1, (-1, load.internal))
                found.append(rows if load.node is None else pad(rows, (0, 0, j, nodes - 1 - j)))
        return torch.cat(found, -1)

    def of_rows(self, rows: Tensor) -> Tensor:
        """The inverse."""
        remembering = [load for load in self.loads if load.internal]
        parts = zip(remembering, rows.split([load.internal for load in remembering], -1), strict=True)
        return torch.cat([own.flatten(-2) if load.node is None else own[..., load.node, :] for load, own in parts], -1)

    def closures(self, trees: tuple[Any, ...]) -> tuple[Any, ...]:
        """Loads (..., N+1, w) by functions of the motion, of the beam undeformed and at rest, and their internal states, whose
        gradient is that of what these functions close over.
        """
        nodes, _, common, *_ = map(detached, trees)
        loads = (row or load for row, load in zip(nodes.loads, common.loads, strict=True))
        model = detached(self.model)
        model = with_values(model, scene=with_values(model.scene, effects=tuple(load for load in loads if functions(load))))
        position, rotation = (x.detach() for x in self.still[:2])
        zero, turn = torch.zeros_like(position), torch.zeros_like(position[..., :model.space.spin])
        still = Nodes(position, rotation, zero, turn, common.frame, position.new_zeros(model.internal_states), common.dt, zero,
                      turn)
        return external(model, still, common.t, common.inputs), advanced(model, still, common.t, common.inputs)


def acting_loads(model: Model) -> tuple[Any, ...]:
    """Loads that depend on the motion, or have internal states."""
    loads = zip(model.scene.loads, model.scene.internal_states, strict=True)
    return tuple(load for load, states in loads if states or model.depends_on(load))


def _resolved(load: Any, t: Tensor, inputs: Inputs, model: Model) -> Any:
    """A load whose functions of t are the values at t."""
    found = {one.name: value_at(one.value, t, inputs, model.length) for one in own_leaves(load)
             if one.axes == 1 and callable(one.value)}
    return with_values(load, **found) if found else load


def flattened(tree: Any) -> list[tuple[Tensor, int]]:
    """The tensors of a tree, each with its number of own axes, in the order of `filled`."""
    found: list[tuple[Tensor, int]] = []

    def visit(x: Any, axes: int | None) -> Any:
        if isinstance(x, Tensor):
            found.append((x, axes))
        return x

    map_leaves(visit, tree)
    return found


def filled(tree: Any, value: Callable[[int], Tensor]) -> Any:
    """The tree with value(k) in the place of its k-th tensor."""
    count = -1

    def put(x: Any, axes: int | None) -> Any:
        nonlocal count
        if not isinstance(x, Tensor):
            return x
        count += 1
        return value(count)

    return map_leaves(put, tree)
