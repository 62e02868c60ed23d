"""Local problem: the house's own step, `MidpointProblem`, of the rows of one node alone, or of one element and its nodes,
without mass. An element knows what mass its nodes share; a node its inertia and its loads.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from ...core.derivatives import cached
from ...core.leaves import Tree, leaf, own_leaves, with_values
from ...equations.balance_problem import BalanceProblem
from ...equations.midpoint import MidpointProblem, MidpointUnknowns
from ...equations.step_problem import StepProblem
from ...nodal.assembly import Assembly
from ...nodal.conditions import Conditions, SupportConditions, acting
from ...nodal.constraints import Constraints
from ...nodal.coordinates.linearised import Small
from ...nodal.coordinates.planar import Plane
from ...nodal.frame import frame_of
from ...nodal.inertia import Inertia
from ...nodal.lever import Lever, NoLever
from ...nodal.mass import LumpedMass, SharedMass
from ...nodal.model import Model
from ...nodal.rotary import NoRotaryInertia, RotaryInertia
from ...nodal.rows import Rows
from ...scene.effects import Pose
from ...state.state import State
from ...topology.chain import Chain
from ..compiler.trace import NotTraceable
from .chain_constants import Common, ElementConstants, NodeConstants, SupportConstants, filled, flattened
from .node_kinds import SIDES, ElementKind, EndKind, NodeKind, SupportKind

Fields = dict[str, Tensor]
NODE = ("position", "rotation", "velocity", "spin")  # of a state
INTERNAL = "internal"


@dataclass(frozen=True)
class Given(Tree):
    """A problem of rows, under conditions that are given: stiffness is S^-1 of the tangent, None = there are no elements."""

    given: Conditions = field(kw_only=True)
    stiffness: Tensor | None = leaf(3, kw_only=True)

    conditions = property(lambda self: self.given)
    C = property(lambda self: self.stiffness)


@dataclass(frozen=True)
class LocalProblem(Given, MidpointProblem):
    """A step of one node, or of one element."""


@dataclass(frozen=True)
class LocalProblems:
    """Of a model's nodes and elements; the trees say which fields exist, their values do not matter. supports: None where
    nothing moves them.

    A node's internal states are those of all loads that have some, one after the other, whichever act there.
    """

    model: Model
    nodes: NodeConstants
    elements: ElementConstants
    common: Common
    supports: SupportConstants | None = None

    @property
    def order(self) -> int:
        """Of the elements: an element has as many stations, and one node more."""
        return self.model.scene.beam.order

    @cached
    def element_assembly(self) -> Assembly:
        """Of one element."""
        space = self.model.space
        return Assembly(Chain(self.order, 1), space.interpolation, space.position)

    @property
    def sides(self) -> tuple[str, ...]:
        """What an element's nodes are called."""
        return SIDES[self.order]

    @property
    def element_rows(self) -> list[int]:
        """How many rows each of the constants of elements has for one element: of most one a station."""
        return [1 if x is self.elements.coupling else self.order for x, _ in flattened(self.elements)]

    @property
    def internal(self) -> tuple[int, ...]:
        """How many internal states each of the loads has at a node."""
        return tuple((row or load).internal for row, load in zip(self.nodes.loads, self.common.loads, strict=True))

    NODE = NODE
    SAMPLE: ClassVar[tuple[str, ...]] = ()  # fields of a sample that the problem asks for
    UNKNOWNS = MidpointUnknowns
    INSTANT = MidpointProblem.INSTANT  # of the step: when loads are taken

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
        return ()

    def of_node(self, fields: Fields, kind: NodeKind) -> tuple[BalanceProblem, Any]:
        """The problem of one node, and its unknowns."""
        rows = filled(self.nodes, lambda k: fields[f"node.{k}"][None])
        common = self._common(fields)
        loads = acting_loads(kind, rows.loads, common.loads)
        if any(one.batch for one in common.captured):
            loads = tuple(map(_of_one_sample, loads))
        given = {name: fields[name][None] for name in (*self.NODE, "u", "m") if name in fields}
        given |= {name: fields[name] for name in self.SAMPLE if name in fields}
        if INTERNAL in self.state:
            parts = fields[INTERNAL].split(self.internal)
            given[INTERNAL] = torch.cat([parts[k] for k in kind.acting] or [fields[INTERNAL][:0]])
        supports = () if kind.support is None else (self._support(fields, "", 0, kind.support),)
        own = self._rows(rows, None, common, supports, _hinges(kind))
        return self._problem(own, None, common, given, self._conditions(own, common, loads, rows.dead, None, supports))

    def of_element(self, fields: Fields, kind: ElementKind) -> tuple[BalanceProblem, Any]:
        """The same of one element."""
        def nodes(name: str) -> Tensor:
            return torch.stack([fields[f"{side}.{name}"] for side in self.sides])

        rows = filled(self.nodes, lambda k: nodes(f"node.{k}"))
        rows = replace(rows, mass=torch.zeros_like(rows.mass), J=None)
        given = {name: nodes(name) for name in (*self.NODE, "u", "m") if f"{self.sides[0]}.{name}" in fields}
        given |= {name: fields[name] for name in ("stress", *self.element_state, *self.SAMPLE)}
        supports = tuple(self._support(fields, f"{side}.", k, one.support)
                         for k, (side, one) in enumerate(zip(self.sides, kind, strict=True)) if one.support is not None)
        element, common = self.element_constants(fields), self._common(fields)
        own = self._rows(rows, element, common, supports, _hinges(*kind))
        now = self._conditions(own, common, (), None, element.eigenstrain, supports)
        return self._problem(own, element, common, given, now)

    def element_constants(self, fields: Fields) -> ElementConstants:
        """Of one element."""
        return filled(self.elements, lambda k: fields[f"element.{k}"])

    def _support(self, fields: Fields, of: str, node: int, kind: SupportKind) -> SupportConditions:
        at = filled(self.supports, lambda k: fields[f"{of}support.{k}"])
        return SupportConditions(node, at.position.new_tensor(kind.fixed), (at.position, at.rotation) if kind.moves else None,
                                 (at.velocity, at.spin) if kind.clamp else None)

    def _common(self, fields: Fields) -> Common:
        return filled(self.common, lambda k: fields[f"common.{k}"])

    def _rows(self, nodes: NodeConstants, element: ElementConstants | None, common: Common,
              supports: tuple[SupportConditions, ...], hinges: tuple[tuple[int, tuple[float, ...]], ...]) -> Rows:
        space, like = self.model.space, nodes.mass
        linear, law, length, reference, coupling = (None,) * 5 if element is None else (
            getattr(element, name) for name in ("linear", "law", "length", "reference", "coupling"))
        space = (type(space)(nodes.frames, nodes.R, linear) if isinstance(space, Small)
                 else replace(space, place=common.place) if isinstance(space, Plane) else space)
        topology = Chain(self.order, 0 if element is None else 1)
        free = torch.ones(topology.node_count, space.unknowns, dtype=torch.bool)
        fixed = torch.stack([one.fixed for one in supports]) if supports else like.new_zeros(0, space.unknowns)
        constraints = Constraints(tuple(one.node for one in supports), fixed, free, topology.unknowns(free, like), nodes.slide,
                                  nodes.turn, tuple((node, like.new_tensor(axis)) for node, axis in hinges))
        mass = LumpedMass(topology, nodes.mass) if coupling is None else SharedMass(
            topology, nodes.mass, coupling, self.model.inertia.translational.difference)
        rotary = NoRotaryInertia(space) if nodes.J is None else RotaryInertia(space, nodes.J)
        inertia = Inertia(space, mass, rotary, NoLever() if nodes.offset is None else Lever(space, nodes.offset))
        return Rows(space, topology, constraints, inertia, length, reference, law, nodes.section_mass, nodes.tributary_length,
                    nodes.s)

    def _conditions(self, rows: Rows, common: Common, loads: tuple[Any, ...], dead: Tensor | None,
                    eigenstrain: Tensor | None, supports: tuple[SupportConditions, ...]) -> Conditions:
        velocities = common.velocity, common.angular_velocity
        root = None if common.support is None else Pose(*vars(common.support).values())
        return Conditions(
            common.t, common.inputs, frame_of(rows.space, *velocities), velocities,
            acting(rows, loads, tuple(load.internal for load in loads), 0), 0.0 if dead is None else dead,
            0.0 if eigenstrain is None else eigenstrain, supports, root, common.frame, self.model.scene.beam.element_count)

    def _problem(self, rows: Rows, element: ElementConstants | None, common: Common, given: Fields, now: Conditions
                 ) -> tuple[BalanceProblem, Any]:
        stress = given.get("stress", given["position"].new_zeros(0, rows.space.strain))
        return self._solved(rows, common, {**given, "stress": stress}, now, None if element is None else element.C)

    def _solved(self, rows: Rows, common: Common, given: Fields, now: Conditions, C: Tensor | None
                ) -> tuple[BalanceProblem, Any]:
        """The problem of rows under conditions, and its unknowns."""
        position, stress = given["position"], given["stress"]
        zero = position.new_zeros(())
        start = State(*(given[name] for name in NODE), stress, position.new_zeros(0, rows.space.unknowns), zero, zero, zero,
                      zero, frame=common.frame, internal=given.get(INTERNAL))
        x = self.UNKNOWNS(given.get("u"), given.get("m"), stress)
        return self._stepping(rows, start, common, given, now, C), x

    def _stepping(self, rows: Rows, start: State, common: Common, given: Fields, now: Conditions, C: Tensor | None
                  ) -> StepProblem:
        return LocalProblem(rows, start, common.dt, common.t, common.inputs, given=now, stiffness=C)


class OwnBatch(NotTraceable):
    """A function that closes over a batch, of this shape."""

    def __init__(self, batch: torch.Size) -> None:
        super().__init__(f"a function has a batch {tuple(batch)} of its own; values= of a tb.Load take one")
        self.batch = batch


def unbatched(found: Tensor, axes: int) -> Tensor:
    """What loads give one node, which has so many axes. Raises OwnBatch for more."""
    if found.ndim > axes:
        raise OwnBatch(found.shape[:-axes])
    return found


def _of_one_sample(load: Any) -> Any:
    """A load whose functions read tensors by sample, each a batch of one: without that batch's axes in what they return."""
    axes = 2 if vars(load).get("node") is None else 1

    def one(x: Any) -> Any:
        if isinstance(x, (tuple, list)):
            return tuple(map(one, x))
        while isinstance(x, Tensor) and x.ndim > axes and len(x) == 1:
            x = x[0]
        return x

    return with_values(load, **{own.name: lambda *args, f=own.value, **named: one(f(*args, **named))
                                for own in own_leaves(load) if own.axes is None and callable(own.value)})


def acting_loads(kind: NodeKind, rows: tuple[Any, ...], loads: tuple[Any, ...]) -> tuple[Any, ...]:
    """Loads of a node; see `Common`."""
    return tuple(rows[k] or loads[k] for k in kind.acting)


def _hinges(*nodes: NodeKind | EndKind) -> tuple[tuple[int, tuple[float, ...]], ...]:
    """Node and axis of each."""
    return tuple((k, one.hinge) for k, one in enumerate(nodes) if one.hinge is not None)
