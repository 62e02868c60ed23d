"""Constants of a chain as rows: one of each node, one of each element, and what all have in common."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from ...core.leaves import Tree, leaf, map_leaves
from ...nodal.constitutive_law import ElasticLaw
from ...nodal.coordinates.linearised import LinearElement, Small
from ...nodal.coordinates.planar import Plane
from ...nodal.inertia import Inertia
from ...nodal.loads import Nodes, external
from ...nodal.model import Model
from ...scene.effects import Inputs
from ...scene.effects.values import value_at
from ...state.state import rest


@dataclass(frozen=True)
class NodeConstants(Tree):
    """Rows of nodes. inertia: without its space and without coupling; slide, turn: see `Constraints`; section_mass,
    tributary_length: see `Model`; s (..., N+1) m; dead (..., N+1, w) loads that depend on no motion, None = none;
    frames, R: see `Small`, None in other coordinates.
    """

    inertia: Inertia
    slide: Tensor = leaf(2)
    turn: Tensor = leaf(2)
    section_mass: Tensor = leaf(3)
    tributary_length: Tensor = leaf(2)
    s: Tensor = leaf(1)
    dead: Tensor | None = leaf(2)
    frames: Tensor | None = leaf(2)
    R: Tensor | None = leaf(3)


@dataclass(frozen=True)
class ElementConstants(Tree):
    """Rows of elements. C: the law's stiffness in the tangent of this step; coupling: see `Inertia`; eigenstrain (..., N, k),
    None = none; linear: None but for small rotations.
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
    """One of all nodes: dt and t (...) s of the step and of its middle, the loads that depend on the motion, inputs, the place
    of a plane, and where a root's support stands.
    """

    dt: Tensor = leaf(0)
    t: Tensor = leaf(0)
    loads: tuple[Any, ...]
    inputs: Inputs = leaf(1)
    place: Tensor | None = leaf(0)
    support: SupportPose | None


def constants(model: Model, dt: Tensor, t: Tensor, inputs: Inputs) -> tuple[NodeConstants, ElementConstants, Common]:
    """Of a step of dt (...) with loads as at t (...), which broadcast with the batch of the model."""
    space, scene, inertia = model.space, model.scene, model.inertia
    still = space.to_reduced(rest(scene, ()))
    nodes = Nodes(still.position, still.rotation)
    dead = external(model, nodes, t, inputs, model.loads[1]) if model.loads[1] else None
    constraints, small = model.constraints, isinstance(space, Small)
    own = model.eigenstrain(t, inputs) if scene.eigenstrains else None
    rows = NodeConstants(
        replace(inertia, space=None, coupling=None), constraints.slide, constraints.turn, model.section_mass,
        model.tributary_length, model.s, dead, *((space.frames, space.R) if small else (None, None)))
    elements = ElementConstants(
        model.length, model.reference, model.law, model.tangent_stiffness(dt.detach()), inertia.coupling,
        own, space.element if small else None)
    loads = tuple(_resolved(load, t, inputs, model) for load in model.loads[0])
    wants_support = any(load.wants_support for load in loads)
    support = SupportPose(*model.prescribed_motion.root_pose(t)) if wants_support else None
    return rows, elements, Common(dt, t, loads, inputs, space.place if isinstance(space, Plane) else None, support)


def _resolved(load: Any, t: Tensor, inputs: Inputs, model: Model) -> Any:
    """A load whose functions of t are the values at t."""
    like = model.scene.beam.nodes

    def value(x: Any, axes: int | None) -> Any:
        return value_at(x, t, inputs, like) if callable(x) and not isinstance(x, Tensor) and axes == 1 else x

    return map_leaves(value, load)


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
