"""State: the beam at one instant (nodal form), and the views through which every form is read."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from . import quaternions as quat
from .checks import broadcast
from .motion import GAP, INCREMENT, Carrying


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


class TensorFields:
    """What a frozen dataclass of tensors can do as a whole: every field is treated alike."""

    def map(self, function: Any, *others: Any) -> Any:
        """The same kind of object with `function` applied field by field."""
        values = {f.name: tuple(getattr(x, f.name) for x in (self, *others)) for f in fields(self)}
        return replace(self, **{name: function(*x) for name, x in values.items() if x[0] is not None})

    def __getitem__(self, index: Any) -> Any:
        """Index the first axes of every field: `states[-1]` of a trajectory is its last state."""
        return self.map(lambda x: x[index])

    def where(self, mask: Tensor, other: Any) -> Any:
        """Fields of this one where mask (...) holds, of `other` elsewhere."""
        return self.map(lambda a, b: torch.where(mask[(...,) + (None,) * (a.ndim - mask.ndim)], a, b), other)

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
    """What every form's state at one instant shows: its nodes by `node(index)`, its tip, its support."""

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


OWN_AXES = dict(work=0, defect=0, t=0, status=0, frame=1, internal=1)  # of a state's fields, behind the batch's; 2 elsewhere


@dataclass(frozen=True)
class State(Instant):
    """The beam at one instant. Leading axes are batch axes (time first in a trajectory).

    position  (..., N+1, 3) m, frame a
    rotation  (..., N+1, 4) unit quaternion, section axes -> frame a
    velocity  (..., N+1, 3) m/s, absolute, frame a
    spin      (..., N+1, 3) rad/s, absolute angular velocity Omega in section axes (frame B)
    stress    (..., N, 6) [F1 F2 F3 M1 M2 M3] N and N m, frame B: of an equilibrium; after an implicit step its mean over
              that step
    reaction  (..., K, 6) load of each support on the beam, by node, force N and moment N m, frame a: of an equilibrium; after
              an implicit step its mean over that step
    work      (...) J, done by the loads and by supports that move since the start
    defect    (...) J, gained by the time integration itself since the start; kept where `conserve` asks for it, else 0
    t         (...) s
    status    (...) int: 0 = success; anything else names the failure, see `torchbeam.newton.STATUS`. A failed sample
              keeps its last good state.
    frame     (..., 4) unit quaternion, frame a -> inertial axes; None where frame a does not turn
    internal  (..., z) internal states of user loads, one after the other; None without
    """

    position: Tensor
    rotation: Tensor
    velocity: Tensor
    spin: Tensor
    stress: Tensor
    reaction: Tensor
    work: Tensor
    defect: Tensor
    t: Tensor
    status: Tensor
    frame: Tensor | None = field(default=None, kw_only=True)
    internal: Tensor | None = field(default=None, kw_only=True)

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
        """Of the scene's supports, by their place in `scene.supports`."""
        load = self.reaction[..., support, :]
        return Reaction(load[..., :3], load[..., 3:])

    def where(self, mask: Tensor, other: State) -> State:
        """Fields of this one where mask (...) holds, of `other` elsewhere, whichever fields have the batch axes."""
        held = {f.name: (getattr(self, f.name), getattr(other, f.name)) for f in fields(self)}
        return replace(self, **{name: torch.where(mask[(...,) + (None,) * OWN_AXES.get(name, 2)], *both)
                                for name, both in held.items() if both[0] is not None})

    @property
    def batch_shape(self) -> torch.Size:
        return torch.broadcast_shapes(*(getattr(self, n).shape[:-2] for n in ("position", "rotation", "velocity", "spin")))

    def level(self) -> State:
        """The same with the batch axes of all in every field, whichever field was given more of them."""
        shape = self.batch_shape
        values = {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) is not None}
        return replace(self, **{n: x.expand((*shape, *x.shape[x.ndim - OWN_AXES.get(n, 2):])) for n, x in values.items()})


def fitting(state: Any, scene: Any) -> State:
    """`state`, to start from; ValueError where it is not one of the nodal form, of the scene's mesh and dtype."""
    if not isinstance(state, State):
        raise ValueError(f"initial of type {type(state).__name__} was given; the nodal form wants a torchbeam.State")
    if state.position.shape[-2] != scene.beam.count + 1:
        raise ValueError(f"initial with {state.position.shape[-2]} nodes was given; the beam has {scene.beam.count + 1}")
    if state.position.dtype != scene.dtype:
        raise ValueError(f"initial of {state.position.dtype} meets a scene of {scene.dtype}; one dtype is wanted")
    broadcast("a scene and an initial state", scene.batch_shape, state.batch_shape)
    return state


def rest(scene: Any, batch_shape: tuple[int, ...] | None = None, t: float = 0.0) -> State:
    """The scene's beam undeformed and at rest in frame a, with the scene's batch axes (or those given). Supports that move are
    where they are at the time t, and move.
    """
    shape = torch.Size(scene.batch_shape if batch_shape is None else batch_shape)
    beam = scene.beam
    nodes = beam.count + 1
    zero = beam.nodes.new_zeros(())
    sizes = [e.internal for e in scene.loads if getattr(e, "internal", 0)]
    state = State(
        position=beam.nodes.expand(*shape, nodes, 3),
        rotation=beam.frames.expand(*shape, nodes, 4),
        velocity=zero.expand(*shape, nodes, 3),
        spin=zero.expand(*shape, nodes, 3),
        stress=zero.expand(*shape, nodes - 1, 6),
        reaction=zero.expand(*shape, len(scene.supports), 6),
        work=zero.expand(shape),
        defect=zero.expand(shape),
        t=torch.full_like(zero, t).expand(shape),
        status=torch.zeros(shape, dtype=torch.long, device=zero.device),
        frame=orientation(scene, shape),
        internal=zero.expand(*shape, sum(sizes)) if sizes else None,
    )
    return _carried(state, Carrying(scene)).level() if scene.carried else state


def turning(scene: Any) -> bool:
    """Whether frame a turns."""
    return scene.frame is not None and scene.frame.angular_velocity is not None


def orientation(scene: Any, shape: tuple[int, ...]) -> Tensor | None:
    """Of frame a at t = 0, (*shape, 4); None where it does not turn."""
    return quat.identity(shape, scene.beam.nodes.dtype, scene.beam.nodes.device) if turning(scene) else None


def completed(state: State, scene: Any) -> State:
    """With an orientation of frame a and internal states of loads, where the scene wants them and the state has none. Raises
    ValueError where it has others.
    """
    if state.frame is not None and not turning(scene):
        raise ValueError("a state whose frame has turned was given for a scene whose frame does not turn; one of a scene with "
                         "such a frame is wanted")
    if turning(scene) and state.frame is None:
        state = replace(state, frame=orientation(scene, state.batch_shape))
    sizes = sum(getattr(load, "internal", 0) for load in scene.loads)
    if state.internal is not None and state.internal.shape[-1] != sizes:
        raise ValueError(f"a state with {state.internal.shape[-1]} internal states was given; the scene's loads have {sizes}")
    if sizes and state.internal is None:
        state = replace(state, internal=state.position.new_zeros(*state.batch_shape, sizes))
    return state


def _carried(state: State, carrying: Carrying) -> State:
    """A state at rest in frame a, in absolute velocities, its supports where they are then and with the motion they have."""
    t = state.t.flatten()[0]
    v, omega = (None if x is None else x[..., None, :] for x in carrying.frame(t))
    position, rotation, velocity, spin = state.position, state.rotation, state.velocity, state.spin
    for support in carrying.scene.supports:
        if support.moves:
            place, turn = carrying.pose(support, t)
            position = put(position, support.node, place)
            rotation = put(rotation, support.node, turn)
    if omega is not None:
        velocity = velocity + torch.linalg.cross(*torch.broadcast_tensors(omega, position))
        spin = spin + quat.rotate(quat.conjugate(rotation), omega)
    velocity = velocity if v is None else velocity + v
    for support in carrying.scene.supports:
        if support.clamp and support.moves:
            motion = carrying.absolute(support, t, torch.full_like(t, GAP / INCREMENT))
            velocity, spin = put(velocity, support.node, motion[0]), put(spin, support.node, motion[1])
    return replace(state, position=position, rotation=rotation, velocity=velocity, spin=spin)


def put(x: Tensor, node: int, value: Tensor) -> Tensor:
    """x (..., N+1, n) with the row of a node replaced by value (..., n)."""
    at = torch.zeros(x.shape[-2], 1, dtype=torch.bool, device=x.device)
    at[node] = True
    return torch.where(at, value[..., None, :], x)


torch.serialization.add_safe_globals([State])
