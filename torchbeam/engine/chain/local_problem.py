"""Local problem: the house's own step, `MidpointProblem`, of the rows of one node alone, or of one
element and its nodes, without mass. An element knows what mass its nodes share; a node its inertia
and its loads.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from ...core.derivatives import cached
from ...equations.balance_problem import BalanceProblem
from ...equations.midpoint import MidpointProblem, MidpointUnknowns
from ...equations.step_problem import StepProblem
from ...nodal.acting import acting
from ...nodal.assembly import Assembly
from ...nodal.conditions import Conditions, SupportConditions
from ...nodal.coordinates.planar import Planar
from ...nodal.frame import frame_of
from ...nodal.model import Model
from ...nodal.rows import ElementRows, Held, NodeRows, Rows
from ...scene.effects import Pose
from ...state.state import State
from ...topology.framework import Framework
from .chain_constants import (
    Common,
    CommonConditions,
    ElementConstants,
    NodeConditions,
    NodeConstants,
    Trees,
    filled,
    flattened,
    of_row,
)
from .own_batch import of_one_sample
from .row_kinds import BetweenKind, ElementKind, EndKind, NodeKind, SupportKind
from .sorts import SIDES

Fields = dict[str, Tensor]
NODE = ("position", "rotation", "velocity", "spin")  # of a state
INTERNAL = "internal"
INELASTIC = "inelastic"


class Ends(NamedTuple):
    """Nodes that something lies between: rows, their fields, what they share, conditions."""

    rows: Rows
    values: Fields
    common: Common
    now: Conditions


@dataclass(frozen=True)
class LocalProblems:
    """Of a model's nodes and elements; the trees say which fields exist, their values do not
    matter.

    A node's internal states are those of all loads that have some, one after the other, whichever
    act there.
    """

    model: Model
    trees: Trees

    @property
    def order(self) -> int:
        """Of the elements: an element has as many stations, and one node more."""
        return self.model.space.order

    @cached
    def element_assembly(self) -> Assembly:
        """Of one element."""
        space = self.model.space
        return Assembly(Framework(self.order, (1,)), space.interpolation, space.dims.position)

    @property
    def sides(self) -> tuple[str, ...]:
        """What an element's nodes are called."""
        return SIDES[self.order]

    @property
    def element_rows(self) -> list[int]:
        """How many rows each of the constants of elements has for one element: of most one a
        station.
        """
        return [
            1 if x is self.trees.element.rows.coupling else self.order
            for x, _ in flattened(self.trees.element)
        ]

    @property
    def internal(self) -> tuple[int, ...]:
        """How many internal states each of the loads has at a node."""
        return tuple(
            of_row(row, load).internal
            for row, load in zip(
                self.trees.node.now.loads, self.trees.common.now.loads, strict=True
            )
        )

    NODE = NODE
    SAMPLE: ClassVar[tuple[str, ...]] = ()  # fields of a sample that the problem asks for
    UNKNOWNS = MidpointUnknowns
    INSTANT = MidpointProblem.INSTANT  # of the step: when loads are taken
    OVER_STEP: ClassVar[bool] = True  # whether tendons' forces are over a step, not at an instant

    @property
    def options(self) -> tuple[Any, ...]:
        """Of the method, as far as code depends on them."""
        return ()

    @property
    def state(self) -> tuple[str, ...]:
        """Fields of a node's state."""
        return (*self.NODE, INTERNAL) if any(self.internal) else self.NODE

    @property
    def sample_state(self) -> tuple[str, ...]:
        """Fields of the state that are the sample's."""
        return ("work",)

    @property
    def element_ends(self) -> tuple[str, ...]:
        """What `finish_element` gives, if it is there: an element at the end of the step."""
        return self.element_state

    @property
    def element_state(self) -> tuple[str, ...]:
        """Fields of an element's state, beside its stress."""
        return () if self.trees.element.rows.law.arms is None else (INELASTIC,)

    def of_node(self, fields: Fields, kind: NodeKind) -> tuple[BalanceProblem, Any]:
        """The problem of one node, and its unknowns."""
        nodes, common = self._of_node(fields), self.common_of(fields)
        values = {name: fields[name][None] for name in (*self.NODE, "u", "m") if name in fields}
        values |= {name: fields[name] for name in self.SAMPLE if name in fields}
        if INTERNAL in self.state:
            parts = fields[INTERNAL].split(self.internal)
            values[INTERNAL] = torch.cat([parts[k] for k in kind.acting] or [fields[INTERNAL][:0]])
        supports = () if kind.support is None else (self._support(fields, "", 0, kind.support),)
        rows = self._rows(nodes.rows, None, common, supports, _hinges(kind))
        now = self.conditions(rows, kind, nodes.now, common, common.now, None, supports)
        return self.problem(rows, None, common, values, now)

    def _of_node(self, fields: Fields) -> NodeConstants:
        return filled(self.trees.node, lambda k: fields[f"node.{k}"][None])

    def of_element(
        self, fields: Fields, kind: ElementKind, between: bool = False
    ) -> tuple[BalanceProblem, Any]:
        """The same of one element; between: with the loads that act between its nodes."""

        def nodes(name: str) -> Tensor:
            return torch.stack([fields[f"{side}.{name}"] for side in self.sides])

        ends = filled(self.trees.node.rows, lambda k: nodes(f"node.{k}"))  # they come first
        ends = replace(ends, mass=torch.zeros_like(ends.mass), J=None)
        values = {
            name: nodes(name)
            for name in (*self.NODE, "u", "m")
            if f"{self.sides[0]}.{name}" in fields
        }
        values |= {name: fields[name] for name in ("stress", *self.element_state, *self.SAMPLE)}
        supports = tuple(
            self._support(fields, f"{side}.", k, end.support)
            for k, (side, end) in enumerate(zip(self.sides, kind.ends, strict=True))
            if end.support is not None
        )
        element, common = self.element_constants(fields), self.common_of(fields)
        rows = self._rows(ends, element.rows, common, supports, _hinges(*kind.ends))
        now = self.conditions(rows, None, None, common, common.now, element.eigenstrain, supports)
        now = self._with_between(rows, now, common.now, kind) if between else now
        return self.problem(rows, element, common, values, now)

    def of_ends(self, fields: Fields, kind: BetweenKind, topology: Framework) -> Ends:
        """The nodes at the ends of what lies between those of a topology."""
        nodes = filled(self.trees.node.rows, lambda k: _ends(fields, kind, f"node.{k}"))
        values = {
            name: _ends(fields, kind, name)
            for name in (*self.NODE, "u", "m")
            if f"{kind.sides[0]}.{name}" in fields
        }
        values |= {name: fields[name] for name in self.SAMPLE}
        there = [end for end in kind.ends if end is not None]
        ends = [(k, *end) for k, end in enumerate(zip(kind.sides, there, strict=True))]
        supports = tuple(
            self._support(fields, f"{side}.", k, end.support)
            for k, side, end in ends
            if end.support is not None
        )
        common, hinges = self.common_of(fields), _hinges(*(end for *_, end in ends))
        rows = self._rows(nodes, None, common, supports, hinges, topology)
        now = self.conditions(rows, None, None, common, common.now, None, supports)
        return Ends(rows, values, common, now)

    def _with_between(
        self, rows: Rows, now: Conditions, shared: CommonConditions, kind: ElementKind
    ) -> Conditions:
        """Conditions with the loads that act between the nodes of an element."""
        loads = tuple(shared.loads[k] for k in kind.loads)
        return replace(now, between=acting(rows, loads, (0,) * len(loads)))

    def element_constants(self, fields: Fields) -> ElementConstants:
        """Of one element."""
        return filled(self.trees.element, lambda k: fields[f"element.{k}"])

    def _support(self, fields: Fields, of: str, node: int, kind: SupportKind) -> SupportConditions:
        at = filled(self.trees.support, lambda k: fields[f"{of}support.{k}"])
        return SupportConditions(
            node,
            at.position.new_tensor(kind.fixed),
            (at.position, at.rotation) if kind.moves else None,
            (at.velocity, at.spin) if kind.clamp else None,
        )

    def common_of(self, fields: Fields) -> Common:
        return filled(self.trees.common, lambda k: fields[f"common.{k}"])

    def _rows(
        self,
        nodes: NodeRows,
        element: ElementRows | None,
        common: Common,
        supports: tuple[SupportConditions, ...],
        hinges: tuple[tuple[int, tuple[float, ...]], ...],
        topology: Framework | None = None,
    ) -> Rows:
        space = self.model.space
        space = replace(space, place=common.place) if isinstance(space, Planar) else space
        held = Held(
            tuple(support.node for support in supports),
            tuple(support.fixed for support in supports),
            tuple((node, nodes.mass.new_tensor(axis)) for node, axis in hinges),
        )
        return Rows.of(
            space,
            nodes,
            element,
            held,
            getattr(self.model.inertia.translational, "difference", None),
            topology,
        )

    def conditions(
        self,
        rows: Rows,
        kind: NodeKind | None,
        nodes: NodeConditions | None,
        common: Common,
        shared: CommonConditions,
        eigenstrain: Tensor | None,
        supports: tuple[SupportConditions, ...],
    ) -> Conditions:
        """Of a node of a kind, or of an element (None): on that no loads act."""
        velocities = common.velocity, common.angular_velocity
        root = None if shared.support is None else Pose(*vars(shared.support).values())
        loads, dead = (
            ((), None)
            if nodes is None
            else (acting_loads(kind, nodes.loads, shared.loads), nodes.dead)
        )
        if any(captured.batch for captured in common.captured):
            loads = tuple(map(of_one_sample, loads))
        return Conditions(
            common.t,
            common.inputs,
            frame_of(rows.space, *velocities),
            velocities,
            acting(rows, loads, tuple(load.internal for load in loads), 0),
            0.0 if dead is None else dead,
            0.0 if eigenstrain is None else eigenstrain,
            supports,
            root,
            common.frame,
            self.model.scene.beam.element_count,
        )

    def problem(
        self,
        rows: Rows,
        element: ElementConstants | None,
        common: Common,
        values: Fields,
        now: Conditions,
    ) -> tuple[BalanceProblem, Any]:
        stress = values.get("stress", values["position"].new_zeros(0, rows.space.dims.strain))
        return self._solved(
            rows, common, {**values, "stress": stress}, now, None if element is None else element.C
        )

    def _solved(
        self, rows: Rows, common: Common, values: Fields, now: Conditions, C: Tensor | None
    ) -> tuple[BalanceProblem, Any]:
        """The problem of rows under conditions, and its unknowns."""
        position, stress = values["position"], values["stress"]
        zero = position.new_zeros(())
        start = State(
            *(values[name] for name in NODE),
            values.get("last_stress", stress),
            position.new_zeros(len(now.supports), rows.space.unknowns),
            zero,
            zero,
            zero,
            zero,
            frame=common.frame,
            internal=values.get(INTERNAL),
            joints=values.get("joints"),
            memory=values.get("memory"),
            inelastic=values.get(INELASTIC),
        )
        x = self.UNKNOWNS(values.get("u"), values.get("m"), stress)
        step = common.dt, common.t, common.inputs
        return self._over(rows, start, values, *step, known=now, stiffness=C), x

    def _over(
        self, rows: Rows, start: State, values: Fields, *step: Any, **known: Any
    ) -> StepProblem:
        """The problem of a step: dt, t and inputs."""
        return MidpointProblem(rows, start, *step, **known)


def told_to(problem: StepProblem, sort: str, fields: Fields) -> StepProblem:
    """With what the last iteration has told points of a sort, where it is given: see `Told`."""
    return problem.after({sort: fields["told"]}) if "told" in fields else problem


def far_fields(far: Tensor) -> Fields:
    """Whether forces between nodes do nothing, 1 or 0, and the opposite."""
    return {"far": far, "near": 1 - far}


def acting_loads(kind: NodeKind, rows: tuple[Any, ...], loads: tuple[Any, ...]) -> tuple[Any, ...]:
    """Loads of a node; see `Common`."""
    return tuple(of_row(rows[k], loads[k]) for k in kind.acting)


def _ends(fields: Fields, kind: BetweenKind, name: str) -> Tensor:
    """Of the nodes at the ends of what is between them."""
    return torch.stack([fields[f"{side}.{name}"] for side in kind.sides])


def _hinges(*nodes: NodeKind | EndKind) -> tuple[tuple[int, tuple[float, ...]], ...]:
    """Node and axis of each."""
    return tuple((k, node.hinge) for k, node in enumerate(nodes) if node.hinge is not None)
