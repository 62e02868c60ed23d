"""Local problem: the house's own step, `MidpointProblem`, on a chain that is one node alone, or one element between two nodes
without mass. An element knows the coupling of the half-consistent mass; a node its inertia and its loads.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ...core.leaves import leaf
from ...nodal.constraints import Constraints
from ...nodal.coordinates.linearised import Small
from ...nodal.coordinates.planar import Plane
from ...nodal.frame import FixedFrame
from ...nodal.inertia import Inertia
from ...nodal.lever import Lever, NoLever
from ...nodal.mass import HalfConsistentMass, LumpedMass
from ...nodal.model import Model
from ...nodal.rotary import NoRotaryInertia, RotaryInertia
from ...scene.effects import Pose, TipLoad
from ...state.state import State
from ..midpoint import MidpointProblem, MidpointUnknowns
from .constants import Common, ElementConstants, NodeConstants, filled

Fields = dict[str, Tensor]
NODE = ("position", "rotation", "velocity", "spin")  # of a state


class NodeKind(NamedTuple):
    """What a node has beside what all have: numbers of the loads in `common.loads` that act there; the axis of its hinge, a
    mask in frame a, None = no hinge.
    """

    acting: tuple[int, ...] = ()
    hinge: tuple[float, ...] | None = None


def node_kinds(model: Model, loads: tuple[Any, ...]) -> list[NodeKind]:
    """Of all nodes, on which these loads act."""
    nodes = model.count + 1
    hinges = {node: tuple(axis.tolist()) for node, axis in model.constraints.hinges}
    return [NodeKind(tuple(k for k, load in enumerate(loads) if load.node is None or load.node % nodes == j), hinges.get(j))
            for j in range(nodes)]


@dataclass(frozen=True)
class LocalScene:
    """What a model of one node or element asks of its scene."""

    beam: Any
    loads: tuple[Any, ...] = ()
    has_prescribed_motion: bool = False
    eigenstrains: tuple[Any, ...] = ()
    supports: tuple[Any, ...] = ()
    frame: None = None

    @property
    def internal_states(self) -> tuple[int, ...]:
        return (0,) * len(self.loads)


@dataclass(frozen=True)
class LocalModel(Model):
    """A model of one node or element, for which what depends on all of the chain, or on time, is given: C of the tangent, the
    eigenstrain, the arclength of the nodes, the pose of a root's support.
    """

    elements: int
    C: Tensor | None = leaf(3)
    own: Tensor | float = leaf(2)
    arclength: Tensor = leaf(1)
    pose: Pose | None

    count = property(lambda self: self.elements)
    s = property(lambda self: self.arclength)
    prescribed_motion = property(lambda self: self)

    def frame(self, t: Tensor) -> FixedFrame:
        return FixedFrame(self.space)

    def root_pose(self, t: Tensor) -> Pose | None:
        return self.pose

    def eigenstrain(self, t: Tensor, inputs: dict[str, Tensor]) -> Tensor | float:
        return self.own

    def tangent_stiffness(self, dt: Tensor | None = None) -> Tensor | None:
        return self.C


@dataclass(frozen=True)
class LocalProblems:
    """Of a model's nodes and elements; the trees say which fields exist, their values do not matter."""

    model: Model
    nodes: NodeConstants
    elements: ElementConstants
    common: Common

    def of_node(self, fields: Fields, kind: NodeKind) -> tuple[MidpointProblem, MidpointUnknowns]:
        rows = filled(self.nodes, lambda k: fields[f"node.{k}"][None])
        common = self._common(fields)
        loads = tuple(_at_only_node(common.loads[k]) for k in kind.acting)
        given = {name: fields[name][None] for name in (*NODE, "u", "m") if name in fields}
        return self._problem(rows, None, common, loads, given, kind.hinge)

    def of_element(self, fields: Fields) -> tuple[MidpointProblem, MidpointUnknowns]:
        def ends(name: str) -> Tensor:
            return torch.stack((fields[f"i.{name}"], fields[f"j.{name}"]))

        rows = filled(self.nodes, lambda k: ends(f"node.{k}"))
        rows = replace(rows, mass=torch.zeros_like(rows.mass), J=None)
        element = filled(self.elements, lambda k: fields[f"element.{k}"][None])
        given = {name: ends(name) for name in (*NODE, "u", "m")} | {"stress": fields["stress"][None]}
        return self._problem(rows, element, self._common(fields), (), given)

    def _common(self, fields: Fields) -> Common:
        return filled(self.common, lambda k: fields[f"common.{k}"])

    def _problem(self, rows: NodeConstants, element: ElementConstants | None, common: Common, loads: tuple[Any, ...],
                 given: Fields, hinge: tuple[float, ...] | None = None) -> tuple[MidpointProblem, MidpointUnknowns]:
        whole, space, position = self.model, self.model.space, given["position"]
        linear = None if element is None else element.linear
        space = (Small(rows.frames, rows.R, linear) if isinstance(space, Small)
                 else replace(space, place=common.place) if isinstance(space, Plane) else space)
        zero, none = position.new_zeros(()), position.new_zeros(0, space.strain)
        count = 0 if element is None else 1
        free = torch.ones(count + 1, space.unknowns, dtype=torch.bool)
        constraints = Constraints((), 0, position.new_zeros(0, space.unknowns), free, None, rows.slide, rows.turn,
                                  () if hinge is None else ((0, position.new_tensor(hinge)),))
        if rows.dead is not None and element is None:
            force, moment = space.embed(rows.dead[0]).split(3, -1)
            loads = (filled(DEAD, lambda k: (force, moment)[k]), *loads)
        law, length, reference, C, own = (None,) * 5
        if element is not None:
            law, length, reference, C, own = (
                getattr(element, name) for name in ("law", "length", "reference", "C", "eigenstrain"))
        coupling = None if element is None else element.coupling
        inertia = Inertia(
            space, LumpedMass(rows.mass) if coupling is None else HalfConsistentMass(rows.mass, coupling),
            NoRotaryInertia(space) if rows.J is None else RotaryInertia(space, rows.J),
            NoLever() if rows.offset is None else Lever(space, rows.offset))
        pose = None if common.support is None else Pose(*vars(common.support).values())
        model = LocalModel(
            LocalScene(whole.scene.beam, loads), space, constraints, inertia, length, reference, law, rows.section_mass,
            rows.tributary_length, elements=count, C=C, own=0.0 if own is None else own, arclength=rows.s, pose=pose)
        stress = given.get("stress", none)
        start = State(*(given[name] for name in NODE), stress, position.new_zeros(0, space.unknowns), zero, zero, zero, zero)
        problem = MidpointProblem(model, start, common.dt, common.t, common.inputs)
        return problem, MidpointUnknowns(given.get("u"), given.get("m"), stress)


DEAD = TipLoad(force=torch.zeros(3), moment=torch.zeros(3))


def _at_only_node(load: Any) -> Any:
    """A load at a node, for a chain that is this node alone."""
    if vars(load).get("node") is None:
        return load
    load = copy(load)
    object.__setattr__(load, "node", -1)
    return load
