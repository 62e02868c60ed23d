"""Constants of a chain as rows: one of each node, one of each element, and what all have in common."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ...core.leaves import Tree, detached, leaf, map_leaves, own_leaves, with_values
from ...nodal.constitutive_law import ElasticLaw
from ...nodal.coordinates.linearised import LinearElement, Small
from ...nodal.coordinates.planar import Plane
from ...nodal.loads import Nodes, external
from ...nodal.model import Model
from ...scene.effects import Inputs
from ...scene.effects.values import value_at
from ...state.state import rest


@dataclass(frozen=True)
class NodeConstants(Tree):
    """Rows of nodes. mass, J, offset: see `LumpedMass`, `RotaryInertia`, `Lever`, None = absent; slide, turn: see
    `Constraints`; section_mass, tributary_length: see `Model`; s (..., N+1) m; dead (..., N+1, w) loads that depend on no
    motion, None = none; frames, R: see `Small`, None in other coordinates; loads: those of the loads that depend on the motion
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
    """One of all nodes: dt and t (...) s of the step and of its middle, the loads that depend on the motion (None in the place
    of those of `NodeConstants`), inputs, the place of a plane, and where a root's support stands.
    """

    dt: Tensor = leaf(0)
    t: Tensor = leaf(0)
    loads: tuple[Any, ...]
    inputs: Inputs = leaf(1)
    place: Tensor | None = leaf(0)
    support: SupportPose | None


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
        self.wants_support = any(load.wants_support for load in model.loads[0])

    def at(self, dt: Tensor, t: Tensor, inputs: Inputs) -> tuple[NodeConstants, ElementConstants, Common]:
        """Of steps of dt (...) with loads as at t (...), which broadcast with the batch of the model."""
        model = self.model
        dead = external(model, self.still, t, inputs, model.loads[1]) if model.loads[1] else None
        own = model.eigenstrain(t, inputs) if model.scene.eigenstrains else None
        support = SupportPose(*model.prescribed_motion.root_pose(t)) if self.wants_support else None
        rows = tuple(load.at_sites(model.s, t, inputs, model.count) for load in model.loads[0])
        loads = tuple(_resolved(load, t, inputs, model) if row is None else None
                      for load, row in zip(model.loads[0], rows, strict=True))
        place = model.space.place if isinstance(model.space, Plane) else None
        elements = replace(self.elements, C=model.tangent_stiffness(dt.detach()), eigenstrain=own)
        return replace(self.nodes, dead=dead, loads=rows), elements, Common(dt, t, loads, inputs, place, support)

    def closures(self, trees: tuple[Any, ...]) -> Tensor:
        """Loads (..., N+1, w) that depend on the motion, of the beam undeformed and at rest, whose gradient is that of what
        their functions close over.
        """
        nodes, _, common = map(detached, trees)
        loads = tuple(row or load for row, load in zip(nodes.loads, common.loads, strict=True))
        position, rotation = (x.detach() for x in self.still[:2])
        zero, turn = torch.zeros_like(position), torch.zeros_like(position[..., :self.model.space.spin])
        still = Nodes(position, rotation, zero, turn, acceleration=zero, angular_acceleration=turn)
        return external(detached(self.model), still, common.t, common.inputs, loads)


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
