"""Local problem: the house's own step, `MidpointProblem`, on a chain that is one node alone, or one element and its nodes,
without mass. An element knows what mass its nodes share; a node its inertia and its loads.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ...core.derivatives import cached
from ...core.leaves import leaf, own_leaves, with_values
from ...nodal.assembly import Assembly
from ...nodal.constraints import Constraints
from ...nodal.coordinates.linearised import Small
from ...nodal.coordinates.planar import Plane
from ...nodal.inertia import Inertia
from ...nodal.lever import Lever, NoLever
from ...nodal.mass import LumpedMass, SharedMass
from ...nodal.model import Model
from ...nodal.rotary import NoRotaryInertia, RotaryInertia
from ...scene.effects import Pose, TipLoad
from ...solvers.compiled.trace import NotTraceable
from ...state.state import State
from ...topology.chain import Chain
from ..midpoint import MidpointProblem, MidpointUnknowns
from .chain_constants import Common, ElementConstants, NodeConstants, SupportConstants, filled, flattened
from .kinds import SIDES, ElementKind, EndKind, NodeKind, SupportKind

Fields = dict[str, Tensor]
NODE = ("position", "rotation", "velocity", "spin")  # of a state
INTERNAL = "internal"


class LocalSupport(NamedTuple):
    """A support of a local chain's node."""

    node: int
    kind: SupportKind
    at: SupportConstants

    moves = property(lambda self: self.kind.moves)
    clamp = property(lambda self: self.kind.clamp)


class LocalMotion(NamedTuple):
    """Prescribed motion, as it is at the time of the problem: see `PrescribedMotion`."""

    root: Pose | None
    velocity: Tensor | None
    angular_velocity: Tensor | None
    orientation: Tensor | None

    def frame(self, t: Tensor) -> tuple[Tensor | None, Tensor | None]:
        return self.velocity, self.angular_velocity

    def root_pose(self, t: Tensor) -> Pose | None:
        return self.root

    def pose(self, support: LocalSupport, t: Tensor) -> tuple[Tensor, Tensor]:
        return support.at.position, support.at.rotation

    def absolute(self, support: LocalSupport, t: Tensor) -> tuple[Tensor, Tensor]:
        return support.at.velocity, support.at.spin


@dataclass(frozen=True)
class LocalScene:
    """What a model of one node or element asks of its scene."""

    beam: Any
    loads: tuple[Any, ...] = ()
    supports: tuple[LocalSupport, ...] = ()
    eigenstrains: tuple[Any, ...] = ()

    @property
    def has_prescribed_motion(self) -> bool:
        return bool(self.supports)

    @property
    def internal_states(self) -> tuple[int, ...]:
        return tuple(load.internal for load in self.loads)


@dataclass(frozen=True)
class LocalModel(Model):
    """A model of one node or element, for which what depends on all of the chain, or on time, is given: C of the tangent, the
    eigenstrain, the arclength of the nodes, what is prescribed.
    """

    C: Tensor | None = leaf(3)
    own: Tensor | float = leaf(2)
    arclength: Tensor = leaf(1)
    motion: LocalMotion

    s = property(lambda self: self.arclength)
    prescribed_motion = property(lambda self: self.motion)

    def orientation(self, t: Tensor) -> Tensor | None:
        return self.motion.orientation

    def eigenstrain(self, t: Tensor, inputs: dict[str, Tensor]) -> Tensor | float:
        return self.own

    def tangent_stiffness(self, dt: Tensor | None = None) -> Tensor | None:
        return self.C


@dataclass(frozen=True)
class LocalProblem(MidpointProblem):
    """A step from `start`, whose orientation of frame a is that of the middle of the step."""

    @cached
    def _frame_middle(self) -> Tensor | None:
        return self.start.frame


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

    def of_node(self, fields: Fields, kind: NodeKind) -> tuple[MidpointProblem, MidpointUnknowns]:
        rows = filled(self.nodes, lambda k: fields[f"node.{k}"][None])
        common = self._common(fields)
        loads = acting_loads(kind, rows.loads, common.loads)
        if any(one.batch for one in common.captured):
            loads = tuple(map(_of_one_sample, loads))
        given = {name: fields[name][None] for name in (*self.NODE, "u", "m") if name in fields}
        if INTERNAL in self.state:
            parts = fields[INTERNAL].split(self.internal)
            given[INTERNAL] = torch.cat([parts[k] for k in kind.acting] or [fields[INTERNAL][:0]])
        supports = () if kind.support is None else (self._support(fields, "", 0, kind.support),)
        return self._problem(rows, None, common, loads, given, supports, _hinges(kind))

    def of_element(self, fields: Fields, kind: ElementKind) -> tuple[MidpointProblem, MidpointUnknowns]:
        def nodes(name: str) -> Tensor:
            return torch.stack([fields[f"{side}.{name}"] for side in self.sides])

        rows = filled(self.nodes, lambda k: nodes(f"node.{k}"))
        rows = replace(rows, mass=torch.zeros_like(rows.mass), J=None)
        given = {name: nodes(name) for name in (*self.NODE, "u", "m")}
        given |= {name: fields[name] for name in ("stress", *self.element_state)}
        supports = tuple(self._support(fields, f"{side}.", k, one.support)
                         for k, (side, one) in enumerate(zip(self.sides, kind, strict=True)) if one.support is not None)
        return self._problem(rows, self.element_constants(fields), self._common(fields), (), given, supports, _hinges(*kind))

    def element_constants(self, fields: Fields) -> ElementConstants:
        """Of one element."""
        return filled(self.elements, lambda k: fields[f"element.{k}"])

    def _support(self, fields: Fields, of: str, node: int, kind: SupportKind) -> LocalSupport:
        return LocalSupport(node, kind, filled(self.supports, lambda k: fields[f"{of}support.{k}"]))

    def _common(self, fields: Fields) -> Common:
        return filled(self.common, lambda k: fields[f"common.{k}"])

    def _problem(self, rows: NodeConstants, element: ElementConstants | None, common: Common, loads: tuple[Any, ...],
                 given: Fields, supports: tuple[LocalSupport, ...], hinges: tuple[tuple[int, tuple[float, ...]], ...]
                 ) -> tuple[MidpointProblem, MidpointUnknowns]:
        whole, space, position = self.model, self.model.space, given["position"]
        linear = None if element is None else element.linear
        space = (type(space)(rows.frames, rows.R, linear) if isinstance(space, Small)
                 else replace(space, place=common.place) if isinstance(space, Plane) else space)
        zero, none = position.new_zeros(()), position.new_zeros(0, space.strain)
        topology = Chain(self.order, 0 if element is None else 1)
        free = torch.ones(topology.node_count, space.unknowns, dtype=torch.bool)
        fixed = position.new_tensor([one.kind.fixed for one in supports]).reshape(-1, space.unknowns)
        hinges = tuple((node, position.new_tensor(axis)) for node, axis in hinges)
        constraints = Constraints(tuple(one.node for one in supports), fixed, free, topology.unknowns(free, position),
                                  rows.slide, rows.turn, hinges)
        if element is None:
            loads = (*dead_load(space, rows.dead), *loads)
        law, length, reference, C, own = (None,) * 5
        if element is not None:
            law, length, reference, C, own = (
                getattr(element, name) for name in ("law", "length", "reference", "C", "eigenstrain"))
        coupling = None if element is None else element.coupling
        inertia = Inertia(
            space, LumpedMass(topology, rows.mass) if coupling is None else SharedMass(
                topology, rows.mass, coupling, whole.inertia.translational.difference),
            NoRotaryInertia(space) if rows.J is None else RotaryInertia(space, rows.J),
            NoLever() if rows.offset is None else Lever(space, rows.offset))
        root = None if common.support is None else Pose(*vars(common.support).values())
        motion = LocalMotion(root, common.velocity, common.angular_velocity, common.frame)
        model = LocalModel(
            LocalScene(whole.scene.beam, loads, supports), space, topology, constraints, inertia, length, reference, law,
            rows.section_mass, rows.tributary_length, C=C, own=0.0 if own is None else own,
            arclength=rows.s, motion=motion)
        stress = given.get("stress", none)
        start = State(*(given[name] for name in NODE), stress, position.new_zeros(0, space.unknowns), zero, zero, zero, zero,
                      frame=common.frame, internal=given.get(INTERNAL))
        return self._stepping(model, start, common, given), self.UNKNOWNS(given.get("u"), given.get("m"), stress)

    def _stepping(self, model: LocalModel, start: State, common: Common, given: Fields) -> MidpointProblem:
        return LocalProblem(model, start, common.dt, common.t, common.inputs)


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


DEAD = TipLoad(force=torch.zeros(3), moment=torch.zeros(3))


def dead_load(space: Any, wrench: Tensor | None) -> tuple[Any, ...]:
    """The load of a node whose wrench (1, w) depends on no motion, None = there is none."""
    if wrench is None:
        return ()
    force, moment = space.embed(wrench[0]).split(3, -1)
    return (filled(DEAD, lambda k: (force, moment)[k]),)


def acting_loads(kind: NodeKind, rows: tuple[Any, ...], loads: tuple[Any, ...]) -> tuple[Any, ...]:
    """Loads of a node, for a chain that is this node alone; see `Common`."""
    return tuple(_at_only_node(rows[k] or loads[k]) for k in kind.acting)


def _hinges(*nodes: NodeKind | EndKind) -> tuple[tuple[int, tuple[float, ...]], ...]:
    """Node and axis of each."""
    return tuple((k, one.hinge) for k, one in enumerate(nodes) if one.hinge is not None)


def _at_only_node(load: Any) -> Any:
    """A load at a node, for a chain that is this node alone."""
    return load if vars(load).get("node") is None else with_values(load, node=-1)
