"""Equilibrium of the nodal form: the balance of what stands still, or moves with a frame that moves
steadily.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import compress
from operator import not_
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import cached, no_derivatives
from ..core.leaves import leaf
from ..nodal import loads as external
from ..nodal.acting import ActingLoad
from ..nodal.balance import Residual
from ..nodal.between_nodes import NodeMotion
from ..nodal.conditions import Conditions, conditions
from ..nodal.coordinates.spatial import Spatial
from ..nodal.element_loads import Way
from ..nodal.frame import FixedFrame
from ..nodal.loads import STEADY, Nodes
from ..scene.effects import Inputs
from ..state.rest_shape import RestShape
from ..state.state import State
from ..state.state_check import with_optional_fields
from ..state.supported_nodes import set_node
from ..topology.protocols import Matrix, total
from .balance_problem import BalanceProblem
from .least_forces import least_forces
from .steady_motion import AtRest, SteadyRotation
from .step_element import ElementAtRest, ElementBalance


class Configuration(NamedTuple):
    """position (..., N+1, p) m, rotation (..., N+1, ...), stress (..., N, k) N and N m; reduced."""

    position: Tensor
    rotation: Tensor
    stress: Tensor

    @property
    def poses(self) -> tuple[tuple[Tensor, Tensor], ...]:
        """Position and rotation, for the elements."""
        return ((self.position, self.rotation),)


class Poses(NamedTuple):
    """position (..., S, 3) m and rotation (..., S, 4), quaternions, of supports in frame a."""

    position: Tensor
    rotation: Tensor


class Past(NamedTuple):
    """What is remembered when an equilibrium is looked for: `State.joints` (..., J, n) and
    `State.memory` (..., I, m), without rows where there is none.
    """

    joints: Tensor
    memory: Tensor

    @classmethod
    def of(cls, scene: Any, state: State | None) -> Past | None:
        """By a state; None where there is none, or nothing in a scene remembers."""
        if state is None or not (scene.joint_memory or scene.memory[1]):
            return None
        state = with_optional_fields(state, scene)
        none = state.position.new_zeros(*state.position.shape[:-2], 0, 0)
        return cls(*(none if x is None else x for x in (state.joints, state.memory)))


class Relief(NamedTuple):
    """What is out of balance where an equilibrium is looked for from: of nodes (..., N+1, w) N and
    N m, and strain (..., N, k), with the gaps of constraints behind; how much (..., 1, 1) of the
    loads acts; and by how much (..., J, w) joints' coordinates are off that are prescribed, None =
    none is: they are led, as sines of large angles in gaps tell another root.
    """

    nodes: Tensor
    strain: Tensor
    raised: Tensor
    coordinate: Tensor | None = None


@dataclass(frozen=True)
class SteadyProblem(BalanceProblem):
    """inertia + to_nodes(h B^T [F; M]) = load_factor * loads and S [F; M] = strain; `load_factor`
    (...) in [0, 1] steps the loads, the inertia of a moving frame, the strain that a beam takes by
    itself and the motion of its supports. With a relief all but the last act as far as that says,
    less (1 - load_factor) of what they lack in balance where they begin.

    internal  (..., z) of the loads, where they are held; None = where they come to rest
    near      (..., z) where the laws of these are linearised to find that, None = at zero; see
              `internal_states`
    begun     where supports are led from; None = from where the beam has their nodes
    relief    None = there is none
    past      None = nothing has been yet
    resisting whether what resists acts in full, see `LoadEffect.resists`; else it is a load too
    own_frame of each node, None = frame a
    """

    t: Tensor = leaf(0)
    inputs: Inputs = leaf(1)
    load_factor: Tensor = leaf(0)
    internal: Tensor | None = leaf(1, default=None, kw_only=True)
    near: Tensor | None = leaf(1, default=None, kw_only=True)
    begun: Poses | None = leaf(2, default=None, kw_only=True)
    relief: Relief | None = leaf(2, default=None, kw_only=True)
    past: Past | None = leaf(2, default=None, kw_only=True)
    resisting: bool = field(default=False, kw_only=True)
    own_frame: FixedFrame | None = field(default=None, kw_only=True)

    @cached
    def conditions(self) -> Conditions:
        """Of the instant; their eigenstrain is that of the whole load."""
        if self.known is not None:
            return self.known
        now = conditions(self.model, self.t, self.inputs)
        return replace(now, frame=self.frame, orientation=self.orientation)

    @cached
    def frame(self) -> FixedFrame:
        if self.known is not None:
            return self.known.frame
        return self.own_frame or self.model.frame(self.t)

    @property
    def support_factor(self) -> Tensor:
        """(...) how much of their motion supports have made."""
        return self.load_factor if self.relief is None else self.load_factor * self.raised

    @property
    def raised(self) -> Tensor:
        """(...) how much of the loads acts."""
        return self.load_factor if self.relief is None else self.relief.raised[..., 0, 0]

    @cached
    def acting(self) -> tuple[tuple[ActingLoad, ...], tuple[ActingLoad, ...]]:
        """Loads at nodes that are raised, and those that act in full."""
        loads = self.conditions.loads
        if not self.resisting:
            return loads, ()
        whole = [act.load.resists and bool(act.reads) for act in loads]
        return tuple(compress(loads, map(not_, whole))), tuple(compress(loads, whole))

    @cached
    def C(self) -> Tensor:
        return self.model.tangent_stiffness() if self.known is None else self.stiffness

    @cached
    def orientation(self) -> Tensor | None:
        """Of frame a, see `Model.orientation`."""
        return self.model.orientation(self.t) if self.known is None else self.known.orientation

    @cached
    def motion(self) -> AtRest:
        """Of the nodes, with frame a."""
        motion = SteadyRotation if self.frame.turns else AtRest
        return motion(self.model.inertia, self.frame)

    @cached
    def eigenstrain(self) -> Tensor | float:
        """What the beam bends by itself, as far as it is raised."""
        strain = self.conditions.eigenstrain
        return strain if isinstance(strain, float) else self.raised[..., None, None] * strain

    def update(self, x: Configuration, move: Tensor, dstress: Tensor) -> Configuration:
        space = self.model.space
        turn = move[..., space.dims.position :]
        turn = space.cayley(turn if space.turns else space.to_section(x.rotation, turn))
        rotation = space.normalize(space.multiply(turn, x.rotation))
        position = x.position + move[..., : space.dims.position]
        return Configuration(position, rotation, x.stress + dstress)

    @cached
    def least(self) -> tuple[Tensor, ...]:
        """See `least_forces`."""
        return least_forces(self.model, self.C, lambda: self.conditions)

    @cached
    def element(self) -> ElementAtRest:
        model = self.model
        return ElementAtRest(
            model.space, model.law, model.length, model.reference, self.eigenstrain
        )

    def under(self, factor: Tensor, load: str | None) -> SteadyProblem:
        """The same with a factor (...) of all loads, or of the input `load` beside others."""
        if load is None:
            return replace(self, load_factor=factor)
        inputs = {**self.inputs, load: factor[..., None] * self.inputs[load]}
        return replace(self, inputs=inputs, load_factor=torch.ones_like(factor))

    def relieved(self, x: Configuration) -> SteadyProblem:
        """The same with its loads from x on, where it is in balance at a load factor of 0."""
        with no_derivatives():
            nothing, off = x.position.new_zeros(1, 1), None
            raised = self.load_factor[..., None, None]
            begin = replace(self, load_factor=torch.zeros_like(self.load_factor))
            x, joints, wanted = begin.apply_supports(x), self.model.joints, self.joint_coordinate
            if wanted is not None:
                off = joints.coordinate(joints.pose(*x[:2]), wanted) - wanted
            begin = replace(begin, relief=Relief(nothing, nothing, raised, off))
            residual = begin.residual(x)[0]
        relief = Relief(residual.nodes, residual.strain, raised, off)
        return replace(self, load_factor=torch.ones_like(self.load_factor), relief=relief)

    @property
    def joint_coordinate(self) -> Tensor | None:
        """(..., J, w) m or rad, where joints' coordinates have to be; None = they are free."""
        wanted = self.conditions.joints.coordinate
        if wanted is None or self.relief is None:
            return wanted
        return wanted + (1 - self.load_factor[..., None, None]) * self.relief.coordinate

    def residual(self, x: Configuration) -> tuple[Residual, Any, ElementBalance, Any]:
        residual, *about = super().residual(x)
        if self.relief is None:
            return residual, *about
        left, (nodes, strain, *_) = 1 - self.load_factor[..., None, None], self.relief
        nodes, strain = residual.nodes - left * nodes, residual.strain - left * strain
        return residual._replace(nodes=nodes, strain=strain), *about

    def nodes(self, x: Configuration, reads: frozenset[str] | None = None) -> Nodes:
        velocity, spin = self.velocity(x)
        nodes = Nodes(
            x.position,
            x.rotation,
            velocity,
            spin,
            self.orientation,
            **self.frame.steady_acceleration(velocity),
        )
        sizes = self.conditions.internal_states
        if not sizes:
            return nodes
        if self.internal is not None:
            return nodes._replace(internal=self.internal)
        start = (
            x.position.new_zeros(*x.position.shape[:-2], sizes) if self.near is None else self.near
        )
        return nodes._replace(internal=start, dt=torch.full_like(self.t, STEADY))

    def holding(self, x: Configuration, internal: Tensor | None) -> SteadyProblem:
        """The same with loads' internal states held: at these, or (None) at rest at x."""
        if internal is None:
            internal = external.internal(
                self.model, self.nodes(x), self.conditions, x.position.shape[:-2]
            )
        elif internal.shape[-1] != self.model.internal_states:
            raise ValueError(
                f"a state with {internal.shape[-1]} internal states was given; the scene's loads "
                f"have {self.model.internal_states}"
            )
        return replace(self, internal=internal)

    def velocity(self, x: Configuration) -> tuple[Tensor, Tensor]:
        """Of nodes that move with frame a, and their spin, absolute, frame a."""
        spin = torch.zeros_like(x.position[..., : self.model.space.dims.spin])
        return self.frame.velocity(torch.zeros_like(x.position), x.position), self.frame.spin(spin)

    def load(self, x: Configuration) -> Tensor | float:
        """Loads less the inertia of nodes, as far as they are raised, (..., N+1, w); 0.0 = none."""
        at, (loads, whole) = (self.model, self.nodes(x), self.conditions), self.acting
        load = external.external(*at, loads, self.conditions.dead)
        load = self.motion.less(load, *x[:2])
        load = load if isinstance(load, float) else self.raised[..., None, None] * load
        return external.external(*at, whole, load)

    def motion_by(
        self, nodes: None, reads: frozenset[str] | None = None
    ) -> external.MotionJacobian:
        return self.frame.steady_jacobian()

    def load_tangent(self, x: Configuration) -> Matrix | None:
        """What that adds to the tangent; None = nothing."""
        model, raised = self.model, self.raised[..., None, None, None]
        inertia = self.motion.tangent(*x[:2])
        inertia = None if inertia is None else inertia.each(lambda block: raised * block)
        inertia = total(inertia, self.element_load_matrix(x))
        if not self.conditions.moving:
            return inertia
        nodes, by = self.nodes(x), self.motion_by(None)
        for loads, share in zip(self.acting, (-raised, -1.0), strict=True):
            tangent = external.tangent(model, nodes, replace(self.conditions, loads=loads), by)
            if not isinstance(tangent, float):
                inertia = total(model.topology.diagonal(share * tangent), inertia)
        return inertia

    def node_balance(self, x: Configuration) -> tuple[Configuration, None, Tensor | float]:
        """The loads are less the inertia."""
        return x, None, self.load(x)

    def node_tangent(self, kinematics: Configuration, inertia: None) -> tuple[None, Matrix | None]:
        return None, self.load_tangent(kinematics)

    def node_motion(self, kinematics: Configuration, nodes: None = None) -> NodeMotion:
        def moved(reads: frozenset[str]) -> external.MotionJacobian:
            eyes = (
                torch.eye(n, dtype=kinematics.position.dtype, device=kinematics.position.device)
                for n in (self.model.space.dims.position, self.model.space.dims.spin)
            )
            return self.frame.moving_jacobian(*(eye[None] for eye in eyes))

        now = self.conditions
        if self.relief is not None and self.relief.coordinate is not None:
            now = replace(now, joints=now.joints._replace(coordinate=self.joint_coordinate))
        return NodeMotion(
            now,
            lambda reads: self.nodes(kinematics, reads),
            lambda reads: self.motion_by(nodes, reads),
            kinematics[:2],
            share=self.raised,
            resisting=self.resisting,
            moved=moved,
            way=lambda: Way(kinematics.position),
            state=self.past,
        )

    def state(self, x: Configuration, reaction: Tensor, status: Tensor) -> State:
        """The public state of a solution: at rest in frame a."""
        model, space, shape = self.model, self.model.space, status.shape
        velocity, spin = self.velocity(x)
        zero, frame = torch.zeros_like(status, dtype=x.position.dtype), self.orientation
        fields, internal = {"stress": x.stress}, None
        if model.internal_states:
            internal = external.internal(model, self.nodes(x), self.conditions, shape)
        if model.interactions:
            fields = model.finished(fields, self.node_motion(x))
        return space.to_public(
            State(
                *x[:2],
                velocity=velocity,
                spin=space.to_section(x.rotation, spin),
                reaction=reaction,
                work=zero,
                defect=zero,
                t=self.t.expand(shape),
                status=status,
                frame=None if frame is None else frame.expand(*shape, frame.shape[-1]),
                internal=internal,
                inelastic=self._crept(x, shape),
                supports=model.constraints.nodes,
                parts=model.scene.beam.parts,
                rest_shape=RestShape.of(model.scene.beam),
                joined=model.scene.beam.joined,
                coordinates=tuple(joint.coordinates for joint in model.scene.joints),
                **fields,
            )
        )

    def _crept(self, x: Configuration, shape: torch.Size) -> Tensor | None:
        if self.model.law.arms is None:
            return None
        crept = self.model.crept_at_rest(*x[:2], self.eigenstrain)
        return None if crept is None else crept.expand(*shape, *crept.shape[-2:])

    def apply_supports(self, x: Configuration) -> Configuration:
        if self.known is not None:  # of rows, whose supports are where they have to be
            return x
        position, rotation, space = x.position, x.rotation, self.model.space
        share = self.support_factor[..., None]
        for k, (support, fixed) in enumerate(
            zip(self.model.scene.supports, self.model.constraints.fixed, strict=True)
        ):
            at = support.node
            start = None if self.begun is None else tuple(x[..., k, :] for x in self.begun)
            pose = self.model.prescribed_motion.pose(support, self.t, share, start)
            r, q = placed(
                space.of_nodes(at), fixed, pose, position[..., at, :], rotation[..., at, :]
            )
            position = set_node(position, at, r)
            rotation = rotation if q is None else set_node(rotation, at, q)
        for at, axis in self.model.constraints.hinges:
            node_space, beam = space.of_nodes(at), self.model.scene.beam
            _, q = node_space.pose(beam.nodes[..., at, :], beam.frames[..., at, :])
            rotation = set_node(rotation, at, node_space.hinged(rotation[..., at, :], q, axis))
        return Configuration(position, rotation, x.stress)


def placed(
    space: Spatial, fixed: Tensor, pose: tuple[Tensor, Tensor], position: Tensor, rotation: Tensor
) -> tuple[Tensor, Tensor | None]:
    """Position and rotation (None = as it is) of a node that a support has in a pose, as far as its
    freedoms are fixed (w).
    """
    r, q = space.pose(*pose)
    p = space.dims.position
    return torch.where(fixed[:p] > 0, r, position), q if bool(fixed[p:].all()) else None
