"""State of the beam at one instant (nodal form), and the views common to all forms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.functions_of_time import rate_along, shared
from ..core.leaves import Tree, leaf, map_leaves
from ..core.summary import kind, lines, point, span, statuses
from ..core.validation import Value, as_tensor, axis_last, broadcast, finite
from ..math import quaternions as quat
from ..scene.beam import axes_of_nodes, orthonormal
from ..scene.curve import carried_axes
from ..scene.prescribed_motion import PrescribedMotion


class Point(NamedTuple):
    """One node. All in frame a: position (..., 3) m, velocity (..., 3) m/s, rotation (..., 3, 3) section axes -> a,
    spin (..., 3) rad/s.
    """

    position: Tensor
    velocity: Tensor
    rotation: Tensor
    spin: Tensor


class Reaction(NamedTuple):
    """Load of a support on the beam, frame a: force (..., 3) N, moment (..., 3) N m."""

    force: Tensor
    moment: Tensor


class TensorFields(Tree):
    """Operations on all fields of a frozen dataclass of tensors alike."""

    def map(self, function: Any, *others: Any) -> Any:
        """The same kind of object with `function` applied field by field."""
        return map_leaves(lambda value, axes, *theirs: function(value, *theirs), self, *others)

    def __getitem__(self, index: Any) -> Any:
        """Index the first axes of every field: `states[-1]` of a trajectory is its last state."""
        return self.map(lambda x: x[index])

    def where(self, mask: Tensor, other: Any) -> Any:
        """Fields of this one where mask (...) holds, of `other` elsewhere."""
        return map_leaves(lambda a, axes, b: torch.where(mask[(...,) + (None,) * axes], a, b), self, other)

    def clone(self) -> Any:
        return self.map(torch.clone)

    def detach(self) -> Any:
        return self.map(torch.detach)

    def to(self, *args: Any, **kwargs: Any) -> Any:
        return self.map(lambda x: x.to(*args, **kwargs))

    @classmethod
    def stack(cls, states: list) -> Any:
        """States in time order -> one object whose fields have time as their first axis."""
        return states[0].map(lambda *x: torch.stack(torch.broadcast_tensors(*x)), *states[1:])


class Instant(TensorFields):
    """Views common to the states of all forms: nodes, tip, load of the support."""

    def __repr__(self) -> str:
        return lines(type(self).__name__, f"t = {span(self.t)} s", f"{self.nodes.shape[-2]} nodes",
                     f"tip at {point(self.nodes[..., -1, :])} m", statuses(self.status), kind(self.batch_shape, self.nodes))

    @property
    def tip(self) -> Point:
        return self.node(-1)

    @property
    def nodes(self) -> Tensor:
        """(..., N+1, 3) m, frame a."""
        return self.position

    @property
    def root(self) -> Reaction:
        """Of the first support: the clamp at node 0, where the scene does not say otherwise."""
        return Reaction(self.reaction[..., :3], self.reaction[..., 3:])


@dataclass(frozen=True, repr=False)
class State(Instant):
    """The beam at one instant. Leading axes are batch axes (time first in a trajectory).

    position  (..., N+1, 3) m, frame a
    rotation  (..., N+1, 4) unit quaternion w x y z, scalar first, section axes -> frame a; `axes` are the same as matrices
    velocity  (..., N+1, 3) m/s, absolute, frame a
    spin      (..., N+1, 3) rad/s, absolute angular velocity Omega in section axes (frame B)
    stress    (..., N, 6) [F1 F2 F3 M1 M2 M3] N and N m, frame B: of an equilibrium; after an implicit step its mean over
              that step
    reaction  (..., K, 6) load of each support on the beam, by node, force N and moment N m, frame a: of an equilibrium; after
              an implicit step its mean over that step
    work      (...) J, done by the loads and by supports that move since the start
    defect    (...) J, gained by the time integration itself since the start; kept where `conserve` asks for it, else 0
    t         (...) s
    status    (...) int: 0 = success; anything else names the failure, see `torchbeam.core.status.STATUS`. A failed sample
              keeps its last good state.
    frame     (..., 4) unit quaternion w x y z, frame a -> inertial axes; None where frame a does not turn
    internal  (..., z) internal states of user loads, one load after the other, those of a load along the beam node by node;
              None without
    """

    position: Tensor = leaf(2)
    rotation: Tensor = leaf(2)
    velocity: Tensor = leaf(2)
    spin: Tensor = leaf(2)
    stress: Tensor = leaf(2)
    reaction: Tensor = leaf(2)
    work: Tensor = leaf(0)
    defect: Tensor = leaf(0)
    t: Tensor = leaf(0)
    status: Tensor = leaf(0)
    frame: Tensor | None = leaf(1, default=None, kw_only=True)
    internal: Tensor | None = leaf(1, default=None, kw_only=True)

    @classmethod
    def from_nodes(cls, scene: Any, nodes: Value, frames: Value | None = None, *, twist: Any = None,
                   velocity: Value | None = None, spin: Value | None = None, t: float = 0.0) -> State:
        """The scene's beam bent into a curve, to start a motion or an equilibrium from.

        nodes     (..., N+1, 3) m, frame a
        frames    section axes as columns, frame a: (..., N+1, 3, 3) of the nodes, or (..., N, 3, 3) of the elements (those of
                  the nodes are then half way, as in `Beam.from_nodes`). None = those that the beam has, carried to the curve
                  without twist: parallel transport by second-order tangents, from a root that turns no more than its tangent
                  asks for. The undeformed nodes give the undeformed axes
        twist     rad by which the axes are turned about the curve beside that: a number (...) at the tip, growing evenly from
                  none at the root; or a function of s (..., N+1) m that gives (..., N+1)
        velocity  (..., N+1, 3) m/s, absolute, frame a. None = at rest in frame a
        spin      (..., N+1, 3) rad/s, absolute, section axes. None = as the axes follow the nodes, where those have a velocity
                  and `frames` were not given; else at rest in frame a
        t         s, when what supports hold is where they have it

        The axes that supports hold are those of the supports, unless `frames` were given; nodes that supports hold are to be
        given where they are. Stress and reactions are zero: a motion finds them, an equilibrium starts without. Differentiable
        and batched.

        Raises ValueError for other shapes, frames that are no rotations, frames with a twist, or a curve that turns back.
        """
        return _from_nodes(scene, nodes, frames, twist, velocity, spin, t)

    @property
    def axes(self) -> Tensor:
        """(..., N+1, 3, 3): section axes of the nodes as columns, frame a."""
        return quat.matrix(self.rotation)

    @property
    def element_axes(self) -> Tensor:
        """(..., N, 3, 3): axes of the elements as columns, frame a, half way between those of their nodes: frame B, in which
        the stress is given.
        """
        return quat.matrix(quat.half_way(self.rotation[..., :-1, :], self.rotation[..., 1:, :]))

    def at(self, t: Tensor) -> State:
        """The same state at another time, its work counted from there and its failures forgotten."""
        return replace(self, t=torch.zeros_like(self.t) + t, work=torch.zeros_like(self.work),
                       defect=torch.zeros_like(self.defect), status=torch.zeros_like(self.status))

    def node(self, index: int) -> Point:
        """One node's motion, in frame a."""
        q = self.rotation[..., index, :]
        return Point(self.position[..., index, :], self.velocity[..., index, :], quat.matrix(q),
                     quat.rotate(q, self.spin[..., index, :]))

    @property
    def root(self) -> Reaction:
        """Of the first support: the clamp at node 0, where the scene does not say otherwise."""
        if self.reaction.shape[-2] == 0:
            raise ValueError("the load of a support was asked for; the beam has none")
        return self.reaction_of(0)

    def reaction_of(self, support: int) -> Reaction:
        """Load of a support, by its index in `scene.supports`."""
        load = self.reaction[..., support, :]
        return Reaction(load[..., :3], load[..., 3:])

    @property
    def batch_shape(self) -> torch.Size:
        return torch.broadcast_shapes(*(getattr(self, n).shape[:-2] for n in ("position", "rotation", "velocity", "spin")))

    def broadcast(self) -> State:
        """The same with the common batch axes in every field."""
        shape = self.batch_shape
        return map_leaves(lambda x, axes: x.expand((*shape, *x.shape[x.ndim - axes:])), self)


def check_state(state: Any, scene: Any, name: str = "initial") -> State:
    """`state`, to start from; ValueError where it is not one of the nodal form, of the scene's mesh and dtype."""
    of_mesh(state, scene.beam.count + 1, scene.dtype, name)
    broadcast("a scene and an initial state", scene.batch_shape, state.batch_shape)
    return state


def of_mesh(state: Any, nodes: int, dtype: torch.dtype, name: str) -> State:
    """`state`; ValueError where it is not one of the nodal form with so many nodes, of that dtype."""
    if not isinstance(state, State):
        raise ValueError(f"{name} of type {type(state).__name__} was given; the nodal form wants a torchbeam.State")
    if state.position.shape[-2] != nodes:
        raise ValueError(f"{name} with {state.position.shape[-2]} nodes was given; the beam has {nodes}")
    if state.position.dtype != dtype:
        raise ValueError(f"{name} of {state.position.dtype} meets a scene of {dtype}; one dtype is wanted")
    return state


def rest(scene: Any, batch_shape: tuple[int, ...] | None = None, t: float | Tensor = 0.0) -> State:
    """The scene's beam undeformed and at rest in frame a, with the scene's batch axes (or those given). What supports hold is
    where they have it at the time t s (0-dim, or one of each sample), and moves with them.
    """
    beam = scene.beam
    nodes = beam.count + 1
    zero = beam.nodes.new_zeros(())
    states = sum(scene.internal_states)
    time = torch.as_tensor(t, dtype=zero.dtype, device=zero.device)
    shape = torch.broadcast_shapes(scene.batch_shape, time.shape) if batch_shape is None else torch.Size(batch_shape)
    state = State(
        position=beam.nodes.expand(*shape, nodes, 3),
        rotation=beam.frames.expand(*shape, nodes, 4),
        velocity=zero.expand(*shape, nodes, 3),
        spin=zero.expand(*shape, nodes, 3),
        stress=zero.expand(*shape, nodes - 1, 6),
        reaction=zero.expand(*shape, len(scene.supports), 6),
        work=zero.expand(shape),
        defect=zero.expand(shape),
        t=time.expand(shape),
        status=torch.zeros(shape, dtype=torch.long, device=zero.device),
        frame=orientation(scene, shape),
        internal=zero.expand(*shape, states) if states else None,
    )
    if not scene.has_prescribed_motion and not any(s.displaced for s in scene.supports):
        return state
    prescribed_motion = PrescribedMotion(scene)
    return _at_rest(_at_supports(state, prescribed_motion), prescribed_motion).broadcast()


def _from_nodes(scene: Any, nodes: Value, frames: Value | None, twist: Any, velocity: Value | None, spin: Value | None,
                t: float) -> State:
    """`State.from_nodes`"""
    beam, still = scene.beam, rest(scene, t=t)

    def given(name: str, value: Value) -> Tensor:
        value = finite(name, axis_last(name, as_tensor(value, scene.dtype, scene.device), 3))
        if value.ndim < 2 or value.shape[-2] != beam.count + 1:
            raise ValueError(f"{name} of shape {tuple(value.shape)} were given; (..., {beam.count + 1}, 3) is wanted")
        return value

    nodes = given("nodes", nodes)
    if frames is not None:
        if twist is not None:
            raise ValueError("frames and a twist were given; one of them is wanted")
        frames = quat.from_matrix(orthonormal(as_tensor(frames, scene.dtype, scene.device), beam.count + 1, beam.count))
        rotation = frames if frames.shape[-2] == beam.count + 1 else axes_of_nodes(frames)
    else:
        s = pad(beam.length.cumsum(-1), (1, 0))
        if callable(twist):
            twist = as_tensor(twist(s), scene.dtype, scene.device)
            if twist.shape[-1:] != s.shape[-1:]:
                raise ValueError(f"a twist of shape {tuple(twist.shape)} was given; (..., {beam.count + 1}) is wanted")
        elif twist is not None:
            twist = as_tensor(twist, scene.dtype, scene.device)[..., None] * s / s[..., -1:]

        def axes(nodes: Tensor) -> Tensor:
            q = carried_axes(beam.frames, beam.nodes, nodes, beam.length, twist)
            for support in scene.supports:
                at = support.node
                q = set_node(q, at, held_rotation(q[..., at, :], still.rotation[..., at, :], support))
            return q

        rotation = axes(nodes)
    prescribed_motion, state = PrescribedMotion(scene), replace(still, position=nodes, rotation=rotation).broadcast()
    state = _at_rest(state, prescribed_motion).broadcast()
    if velocity is not None:
        velocity = given("velocity", velocity)
        if spin is None and frames is None:
            relative = velocity - _with_frame(state, prescribed_motion)[0]
            q, rate = rate_along(axes, (nodes + 0 * relative,), (relative + 0 * nodes,))
            state = replace(state, spin=state.spin + 2 * quat.multiply(quat.conjugate(q), rate)[..., 1:])
        state = replace(state, velocity=velocity)
    return (state if spin is None else replace(state, spin=given("spin", spin))).broadcast()


def turning(scene: Any) -> bool:
    """Whether frame a turns."""
    return scene.frame is not None and scene.frame.angular_velocity is not None


def orientation(scene: Any, shape: tuple[int, ...]) -> Tensor | None:
    """Of frame a at t = 0, (*shape, 4); None where it does not turn."""
    return quat.identity(shape, scene.beam.nodes.dtype, scene.beam.nodes.device) if turning(scene) else None


def with_optional_fields(state: State, scene: Any) -> State:
    """With an orientation of frame a and internal states of loads, where the scene wants them and the state has none. Raises
    ValueError where it has others.
    """
    if state.frame is not None and not turning(scene):
        raise ValueError("a state whose frame has turned was given for a scene whose frame does not turn; one of a scene with "
                         "such a frame is wanted")
    if turning(scene) and state.frame is None:
        state = replace(state, frame=orientation(scene, state.batch_shape))
    sizes = sum(scene.internal_states)
    if state.internal is not None and state.internal.shape[-1] != sizes:
        raise ValueError(f"a state with {state.internal.shape[-1]} internal states was given; the scene's loads have {sizes}")
    if sizes and state.internal is None:
        state = replace(state, internal=state.position.new_zeros(*state.batch_shape, sizes))
    return state


def _at_supports(state: State, prescribed_motion: PrescribedMotion) -> State:
    """With the supports where they are then."""
    position, rotation = state.position, state.rotation
    for support in prescribed_motion.scene.supports:
        if support.displaced:
            place, turn = prescribed_motion.pose(support, shared(state.t))
            position = _put_held(position, support, place)
            rotation = set_node(rotation, support.node, turn)
    return replace(state, position=position, rotation=rotation)


def _at_rest(state: State, prescribed_motion: PrescribedMotion) -> State:
    """At rest in frame a, in absolute velocities, its supports with the motion they have then."""
    t = shared(state.t)
    velocity, spin = _with_frame(state, prescribed_motion)
    for support in prescribed_motion.scene.supports:
        if support.moves:
            motion = prescribed_motion.absolute(support, t)
            velocity = _put_held(velocity, support, motion[0])
            spin = spin if support.turn is None else set_node(spin, support.node, motion[1])
    return replace(state, velocity=velocity, spin=spin)


def _with_frame(state: State, prescribed_motion: PrescribedMotion) -> tuple[Tensor, Tensor]:
    """Velocity and spin (..., N+1, 3) of what stands in frame a."""
    v, omega = (None if x is None else x[..., None, :] for x in prescribed_motion.frame(shared(state.t)))
    velocity = torch.zeros_like(state.position)
    spin = torch.zeros_like(velocity)
    if omega is not None:
        velocity = velocity + torch.linalg.cross(*torch.broadcast_tensors(omega, state.position))
        spin = spin + quat.rotate(quat.conjugate(state.rotation), omega)
    return velocity if v is None else velocity + v, spin


def held_rotation(q: Tensor, at: Tensor, support: Any) -> Tensor:
    """The rotation q (..., 4) of a node with what its support holds as in `at` (..., 4)."""
    if not support.rotation:
        return q
    if len(support.rotation) == 3:
        return at.expand_as(q + at)
    free = at.new_tensor([1.0] + [float(not held) for held in support.held[3:]])
    return quat.multiply(quat.normalize(quat.multiply(q, quat.conjugate(at)) * free), at)


def _put_held(x: Tensor, support: Any, value: Tensor) -> Tensor:
    """`put`, of the components whose position is held."""
    at = support.node
    return set_node(x, at, torch.where(torch.tensor(support.held[:3], device=x.device), value, x[..., at, :]))


def set_node(x: Tensor, node: int, value: Tensor) -> Tensor:
    """x (..., N+1, n) with the row of a node replaced by value (..., n)."""
    at = torch.zeros(x.shape[-2], 1, dtype=torch.bool, device=x.device)
    at[node] = True
    return torch.where(at, value[..., None, :], x)


torch.serialization.add_safe_globals([State])
