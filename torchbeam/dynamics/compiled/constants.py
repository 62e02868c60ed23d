"""Constants of a chain as rows: one of each node, one of each element, and what all have in common."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ...core.leaves import Tree, constant, leaf, map_leaves, own_leaves, wants_gradient
from ...core.validation import concrete
from ...nodal.balance import same_law
from ...nodal.constitutive_law import ElasticLaw
from ...nodal.coordinates.linearised import LinearElement, Small
from ...nodal.coordinates.planar import Plane
from ...nodal.loads import Nodes, external
from ...nodal.model import Model
from ...scene.effects import Along, Effect, Input, Inputs, Pose
from ...scene.effects.values import value_at
from ...state.state import rest


@dataclass(frozen=True)
class NodeConstants(Tree):
    """Rows of nodes. mass, J, offset: see `LumpedMass`, `RotaryInertia`, `Lever`, None = absent; slide, turn: see
    `Constraints`; section_mass, tributary_length: see `Model`; s (..., N+1) m; dead (..., N+1, w) loads that depend on no
    motion, None = none; frames, R: see `Small`, None in other coordinates.
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
    """One of all nodes: dt and t (...) s of the step and of its middle, the loads that depend on the motion, inputs, the place
    of a plane, and where a root's support stands.
    """

    dt: Tensor = leaf(0)
    t: Tensor = leaf(0)
    loads: tuple[Any, ...]
    inputs: Inputs = leaf(1)
    place: Tensor | None = leaf(0)
    support: SupportPose | None


class Constants:
    """Of a model's steps, in two parts: trees of what holds for all of them, and values by name of what changes.

    loads  those that are evaluated natively: of the motion, and the library's own whose values are inputs
    asks   whether anything is evaluated at t in torch
    """

    def __init__(self, model: Model) -> None:
        space, inertia, constraints, small = model.space, model.inertia, model.constraints, isinstance(model.space, Small)
        self.model = model
        still = space.to_reduced(rest(model.scene, ()))
        self.still = Nodes(still.position, still.rotation)
        moving, dead = model.loads
        self.loads = (*moving, *(load for load in dead if _by_inputs(load)))
        self.given = tuple(load for load in dead if _given(load))
        self.asked = tuple(load for load in dead if not (_by_inputs(load) or _given(load)))
        self.nodes = NodeConstants(
            inertia.mass, getattr(inertia.rotary, "J", None), getattr(inertia.offset, "x", None), constraints.slide,
            constraints.turn, model.section_mass, model.tributary_length, model.s, None,
            *((space.frames, space.R) if small else (None, None)))
        self.elements = ElementConstants(
            model.length, model.reference, model.law, model.law.C, getattr(inertia.translational, "coupling", None), None,
            space.element if small else None)
        self.wants_support = any(load.wants_support for load in self.loads)
        self.given_eigenstrain = all(_given(effect) for effect in model.scene.eigenstrains)
        self.rests = not model.scene.has_prescribed_motion and model.scene.root is None
        self.of_time = {f"load {k} {one.name}": one.value for k, load in enumerate(self.loads) for one in own_leaves(load)
                        if one.axes == 1 and callable(one.value) and not isinstance(one.value, (Tensor, Along))}
        self.asks = bool(self.asked or not self.given_eigenstrain or (self.wants_support and not self.rests) or self.of_time)
        self._kept: dict[Any, Any] = {}

    def forget(self) -> None:
        """Take values afresh: a tensor that they were made from has been written to."""
        self._kept = {}

    @property
    def sources(self) -> list[Tensor]:
        """Tensors that values are made from, beside those of the model's own fields."""
        return [x for x, _ in flattened((self.given, self.model.scene.eigenstrains, self.model.law, self.model.inertia))]

    def changing(self, dt: Tensor, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        """Values by name for steps of dt (...) with loads as at t (...), which broadcast with the batch of the model."""
        model = self.model
        C, exact = self._tangent(dt)
        found = {"dt": dt, "t": t, "C": C, "exact": exact}
        if self.given or self.asked:
            dead = self._recorded("dead", self.given, lambda: external(model, self.still, t, inputs, self.given))
            found["dead"] = dead + external(model, self.still, t, inputs, self.asked) if self.asked else dead
        if model.scene.eigenstrains:
            found["eigenstrain"] = (
                self._recorded("eigenstrain", model.scene.eigenstrains, lambda: model.eigenstrain(t, inputs))
                if self.given_eigenstrain else model.eigenstrain(t, inputs))
        if self.wants_support:
            held = (model.scene.beam, model.scene.supports)
            pose = (self._recorded("support", held, lambda: model.prescribed_motion.root_pose(t)) if self.rests
                    else model.prescribed_motion.root_pose(t))
            found |= {f"support {name}": x for name, x in zip(pose._fields, pose, strict=True) if x is not None}
        for name, value in self.of_time.items():
            found[name] = value_at(value, t, inputs, model.scene.beam.nodes)
        for name, x in inputs.items():
            found[f"input {name}"] = x
        return found

    def at(self, dt: Tensor, t: Tensor, inputs: Inputs) -> tuple[NodeConstants, ElementConstants, Common]:
        """The trees at once."""
        return self.trees(self.changing(dt, t, inputs))

    def trees(self, values: dict[str, Tensor]) -> tuple[NodeConstants, ElementConstants, Common]:
        """The trees with the values that change."""
        loads = tuple(_with(load, {one.name: values[name] for one in own_leaves(load)
                                   if (name := f"load {k} {one.name}") in values}) for k, load in enumerate(self.loads))
        support = SupportPose(*(values.get(f"support {name}") for name in Pose._fields)) if self.wants_support else None
        place = self.model.space.place if isinstance(self.model.space, Plane) else None
        inputs = {name: values[f"input {name}"] for name in self.model.scene.inputs}
        return (replace(self.nodes, dead=values.get("dead")),
                replace(self.elements, C=values["C"], eigenstrain=values.get("eigenstrain")),
                Common(values["dt"], values["t"], loads, inputs, place, support))

    def moving_loads(self, t: Tensor, inputs: Inputs) -> Tensor:
        """Loads (..., N+1, w) that depend on the motion, of the beam undeformed and at rest."""
        position, turn = self.still.position, torch.zeros_like(self.still.position[..., :self.model.space.spin])
        nodes = self.still._replace(velocity=torch.zeros_like(position), spin=turn, acceleration=torch.zeros_like(position),
                                    angular_acceleration=turn)
        return external(self.model, nodes, t, inputs, self.model.loads[0])

    def _recorded(self, name: str, effects: tuple[Any, ...], value: Callable[[], Tensor]) -> Tensor:
        """A value that changes with nothing but what the effects hold: kept, unless a derivative by that is recorded."""
        if torch.is_grad_enabled() and wants_gradient(effects):
            return value()
        if name not in self._kept:
            self._kept[name] = value()
        return self._kept[name]

    def _tangent(self, dt: Tensor) -> tuple[Tensor, Tensor]:
        """C of the tangent, and whether it is the law's; that of the last dt (0-dim) is kept."""
        key = dt.item() if dt.ndim == 0 and dt is concrete(dt) else None
        found = self._kept.get("tangent")
        if found is None or key is None or found[0] != key:
            C = self.model.tangent_stiffness(dt.detach())
            found = self._kept["tangent"] = key, C, same_law(C, self.model.law.C).to(C)
        return found[1:]


def _given(effect: Any) -> bool:
    """Whether an effect is one of the library's with numbers alone."""
    return of_library(effect) and constant(effect)


def _by_inputs(load: Any) -> bool:
    """Whether a load is one of the library's, and holds inputs beside plain numbers."""
    values = [one.value for one in own_leaves(load) if one.value is not None]
    return (of_library(load) and any(isinstance(x, Input) for x in values)
            and all(isinstance(x, (Tensor, Input)) for x in values) and not load.inputs)


def of_library(effect: Any) -> bool:
    """Whether an effect's class is torchbeam's own."""
    return type(effect).__module__.startswith(f"{Effect.__module__.rpartition('.')[0]}.")


def _with(load: Any, values: dict[str, Tensor]) -> Any:
    """A load with these values in the place of functions of t."""
    if not values:
        return load
    load = copy(load)
    for name, value in values.items():
        object.__setattr__(load, name, value)
    return load


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
