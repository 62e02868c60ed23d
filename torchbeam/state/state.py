"""State: the beam at one instant in the nodal form; the beam at rest."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.arguments import batch, instance, instants, place
from ..core.leaves import leaf, map_leaves
from ..core.memory import check_memory
from ..core.validation import Value, broadcast
from ..math import quaternions as quat
from ..scene.parts import Part, one_beam, part_of, row_of
from ..scene.prescribed_motion import PrescribedMotion, orientation
from ..scene.scene import Scene
from .bent import bent
from .instant import READINGS, Instant, JointReading, Point, Reaction
from .reduced import AT_NODES, REMEMBERED
from .rest_shape import RestShape
from .supported_nodes import at_rest, at_supports


@dataclass(frozen=True, repr=False)
class State(Instant):
    """The beam at one instant. Leading axes are batch axes (time first in a trajectory).

    Args:
        position: (..., N+1, 3) m, frame a
        rotation: (..., N+1, 4) unit quaternion w x y z, scalar first, section axes -> frame a;
            `axes` are the same as matrices
        velocity: (..., N+1, 3) m/s, absolute, frame a
        spin: (..., N+1, 3) rad/s, absolute angular velocity Omega in section axes (frame B)
        stress: (..., N, 6), or (..., 2 N, 6) (see `Beam`): [F1 F2 F3 M1 M2 M3] N and N m, frame B.
            After an implicit step it is the mean over that step
        reaction: (..., K, 6) load of each support on the beam, in the order of `scene.supports`:
            force N and moment N m, frame a. After an implicit step it is the mean over that step
        work: (...) J, done by the loads and by supports that move since the start
        defect: (...) J, gained by the time integration itself since the start; kept where
            `conserve` asks for it, else 0
        t: (...) s
        status: (...) int: 0 = success; anything else names the failure, see
            `torchbeam.core.status.STATUS`. A failed sample keeps its last good state.
        frame: (..., 4) unit quaternion w x y z, frame a -> inertial axes, which coincide at t = 0;
            None where frame a does not turn
        internal: (..., z) internal states of user loads, load after load; a load along the beam has
            them node by node; None without
        joints: (..., J, 12 or more) of the joints of a structure, see `joint`; None without
        tendons: (..., K, 3) of the scene's tendons: tension N of the first stretch and of the last,
            length m; None without
        coordinates: which coordinates each joint has, see `Joint.coordinates`
        memory: (..., I, m) memory of the scene's interactions, in their order, filled with zeros;
            None = no memory
        inelastic: (..., N, 6 m) strains that the m arms of `Viscoelastic` have crept by, one arm
            after the other, in the order of the stress; None = nothing relaxes
        supports: nodes of the supports that `reaction` is of; None where the state was made without
            a scene
        parts: of a structure, whose nodes and stations stand one part after the other; see
            `__getitem__`
        joined: pairs of nodes that its joints connect, None = the ground; stress has a row for each
            behind those of the stations
        rest_shape: of its beam (`RestShape`), by which a sensor of another one is refused; None =
            not known

    Examples:
        >>> state = tb.equilibrium(scene)
        >>> state.tip.position, state.root.moment  # m, N m
        (tensor([0.9004, 0.0000, 0.3972]), tensor([0.0000, 1.8008, 0.0000]))
        >>> state.stress.shape  # elements; forces and moments
        torch.Size([4, 6])
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
    joints: Tensor | None = leaf(2, default=None, kw_only=True)
    tendons: Tensor | None = leaf(2, default=None, kw_only=True)
    memory: Tensor | None = leaf(2, default=None, kw_only=True)
    inelastic: Tensor | None = leaf(2, default=None, kw_only=True)
    supports: tuple[int, ...] | None = field(default=None, kw_only=True)
    parts: tuple[Part, ...] = field(default=(), kw_only=True)
    coordinates: tuple[tuple[int, ...], ...] = field(default=(), kw_only=True)
    joined: tuple[tuple[int | None, int | None], ...] = field(default=(), kw_only=True)
    rest_shape: RestShape | None = field(default=None, kw_only=True)

    @classmethod
    def from_nodes(
        cls,
        scene: Any,
        nodes: Value,
        frames: Value | None = None,
        *,
        twist: Any = None,
        velocity: Value | None = None,
        spin: Value | None = None,
        t: float = 0.0,
    ) -> State:
        """The scene's beam bent into a curve: a start for a motion or an equilibrium.

        Args:
            nodes: (..., N+1, 3) m, frame a
            frames: section axes as columns, frame a: (..., N+1, 3, 3) of the nodes, or (..., N, 3,
                3) of the elements (node axes are then half way, as in `Beam.from_nodes`). None =
                the beam's axes, carried to the curve without twist. Carrying is parallel transport
                by second-order tangents, from a root that turns only with its tangent. The
                undeformed nodes give the undeformed axes
            twist: rad, a further turn of the axes about the curve. A number (...) is the turn of
                the tip, which grows evenly from zero at the root. A function of s (..., N+1) m
                returns (..., N+1)
            velocity: (..., N+1, 3) m/s, absolute, frame a. None = at rest in frame a
            spin: (..., N+1, 3) rad/s, absolute, section axes. None = as the axes follow moving
                nodes, without `frames`; else at rest in frame a
            t: s, the time for the places of supports

        At supports the axes are the supports' own, unless `frames` are given. Nodes at supports
        must be given where these hold them. Stress and reactions are zero: a motion finds them, an
        equilibrium starts without. Differentiable and batched.

        Raises:
            ValueError: for other shapes, frames that are no rotations, frames with a twist, or a
                curve that turns back.
        """
        return bent(rest(scene, t=t), scene, nodes, frames, twist, velocity, spin)

    @property
    def node_count(self) -> int:
        return self.position.shape[-2]

    @property
    def stress_count(self) -> int:
        return self.stress.shape[-2]

    @property
    def axes(self) -> Tensor:
        """(..., N+1, 3, 3): section axes of the nodes as columns, frame a."""
        return quat.matrix(self.rotation)

    @property
    def element_axes(self) -> Tensor:
        """Axes of the elements as columns (..., N, 3, 3), frame a, half way between the axes of
        their nodes.

        This is frame B, in which the stress is given. Of elements of order 2 (..., 2 N, 3, 3),
        between neighbouring nodes; `Beam.station_axes` has the axes of the stress.
        """
        return quat.matrix(quat.half_way(self.rotation[..., :-1, :], self.rotation[..., 1:, :]))

    def at(self, t: float | Tensor) -> State:
        """The same state at another time; its work counts from there, its failures are gone."""
        zeros = {n: torch.zeros_like(getattr(self, n)) for n in ("work", "defect", "status")}
        return replace(self, t=torch.zeros_like(self.t) + instants("t", t, self.t), **zeros)

    def __getitem__(self, index: Any) -> Any:
        """By the name of a beam of a structure its state, as in a scene of its own (but that `work`
        and `defect` are those of all); by that of a body its motion, a `Point`; else some of the
        leading axes, as `Instant` has it.
        """
        if not isinstance(index, str):
            return super().__getitem__(index)
        part = part_of(self.parts, index)
        return self.row(part.first_node) if part.body else self.part(index)

    @property
    def joint(self) -> tuple[JointReading, ...]:
        """The joints of a structure, as an equilibrium or a step has left them."""
        each = enumerate(self.coordinates)
        return tuple(JointReading.of(self.joints[..., k, :], which) for k, which in each)

    def part(self, name: str) -> State:
        """The state of a beam or, a single node, of a body. Raises ValueError for neither."""
        part = part_of(self.parts, name)
        nodes = range(part.nodes.start, part.nodes.stop)
        held = [k for k, node in enumerate(self.supports or ()) if node in nodes]
        rows = {name: getattr(self, name)[..., part.nodes, :] for name in AT_NODES}
        rows["stress"] = self.stress[..., part.stations, :]
        rows["reaction"] = self.reaction[..., held, :]
        supports = tuple(self.supports[k] - part.first_node for k in held)
        shape = self.rest_shape and self.rest_shape.of_nodes(part.nodes)
        none = dict.fromkeys(REMEMBERED)
        if self.inelastic is not None:
            rows["inelastic"] = self.inelastic[..., part.stations, :]
            none.pop("inelastic")
        none |= dict.fromkeys(("parts", "coordinates", "joined"), ())
        return replace(self, **rows, **none, supports=supports, rest_shape=shape)

    def node(self, index: Any) -> Point:
        """The motion of one node, in frame a.

        It is counted from the root, -1 is the tip; in a structure (name, node), or the name of a
        body.

        Raises:
            ValueError: for a missing node.
        """
        if self.parts or isinstance(index, (str, tuple)):
            return self.row(row_of(self.parts, index))
        return self.row(place("node", index, self.position.shape[-2], "the beam has the nodes"))

    def row(self, index: int) -> Point:
        """The node that stands at this place among all."""
        index = place("index", index, self.position.shape[-2], "there are the nodes")
        q = self.rotation[..., index, :]
        return Point(
            self.position[..., index, :],
            self.velocity[..., index, :],
            lambda: quat.matrix(q),
            lambda: quat.rotate(q, self.spin[..., index, :]),
        )

    @property
    def tip(self) -> Point:
        """The motion of the last node."""
        one_beam(self.parts, "tip")
        return self.row(-1)

    @property
    def root(self) -> Reaction:
        """Of the support at node 0. Raises ValueError where there is none."""
        one_beam(self.parts, "root")
        nodes = range(self.reaction.shape[-2]) if self.supports is None else self.supports
        if 0 not in nodes:
            held = ", ".join(map(str, nodes))
            there = f"supports hold node {held} alone, and reaction_of(k) is their load"
            raise ValueError(
                "the load of the support at node 0 was asked for; "
                f"{there if held else 'the beam has no support'}"
            )
        return self.reaction_of(nodes.index(0))

    def reaction_of(self, support: Any) -> Reaction:
        """Load of support k of `scene.supports`, which are in the order given; in a structure also
        of the one at a node, (name, node) or a body's name. Raises ValueError where there is none.
        """
        if isinstance(support, (str, tuple)):
            row, held = row_of(self.parts, support, "support"), self.supports or ()
            if row not in held:
                raise ValueError(
                    f"support = {support!r} was given, a node that no support holds; a node that "
                    "one holds, or its place in supports=, is wanted"
                )
            support = held.index(row)
        k = place("support", support, self.reaction.shape[-2], "there are the supports")
        return Reaction(*self.reaction[..., k, :].split(3, -1))

    @property
    def batch_shape(self) -> torch.Size:
        moving = (self.position, self.rotation, self.velocity, self.spin)
        return broadcast("a state's fields", *[x.shape[:-2] for x in moving])

    def broadcast(self, shape: tuple[int, ...] | None = None) -> State:
        """The same with the common batch axes, or those given, in every field. Raises ValueError
        for axes that these do not broadcast to.
        """
        shape = self.batch_shape if shape is None else batch("shape", shape)
        if broadcast("a state and shape", self.batch_shape, shape) != shape:
            raise ValueError(
                f"shape = {tuple(shape)} was given for a state of {tuple(self.batch_shape)}; axes "
                "that it broadcasts to are wanted"
            )

        def expanded(x: Tensor, axes: int) -> Tensor:
            own = x.ndim - axes
            return x if x.shape[:own] == shape else x.expand((*shape, *x.shape[own:]))

        return map_leaves(expanded, self)


def plain(state: State) -> State:
    """What every method knows of a state."""
    return State(**{f.name: getattr(state, f.name) for f in fields(State)})


def rest(scene: Any, batch_shape: tuple[int, ...] | None = None, t: float | Tensor = 0.0) -> State:
    """The scene's beam undeformed and at rest in frame a.

    It has the scene's batch axes, or those given. At the time t s (0-dim, or one of each sample)
    supported nodes are where their supports are, and move with them. Free nodes are where the beam
    has them; `equilibrium` gives a start beside a displaced support. A frame that turns has turned
    since t = 0, when it coincides with the inertial axes.

    Raises:
        ValueError: for an object that is no scene, and for impossible batch axes or times.
        MemoryError: for more samples than there is memory for.

    Examples:
        >>> state = tb.rest(scene)
        >>> state.tip.position
        tensor([1., 0., 0.])
    """
    time = instants("t", t, instance("a scene", scene, Scene).beam.nodes)
    shape = broadcast("a scene and t", scene.batch_shape, time.shape)
    if batch_shape is not None:
        wanted = batch("batch_shape", batch_shape)
        if broadcast("batch_shape and t", wanted, time.shape) != wanted:
            raise ValueError(
                f"batch_shape = {tuple(wanted)} was given for t of shape {tuple(time.shape)}; one "
                "with its axes is wanted"
            )
        shape = wanted
    numbers = 13 * scene.beam.node_count + 6 * scene.stress_count
    size = shape.numel() * numbers * time.element_size()
    check_memory(f"a state of {shape.numel()} samples", size, "fewer are wanted")
    return resting(scene, shape, time, distinct=True)


def resting(scene: Any, shape: tuple[int, ...], time: Tensor, distinct: bool = False) -> State:
    """`rest` of these batch axes, at times that broadcast with them; distinct: each field is a
    tensor of its own, which the scene and the other fields do not share.
    """
    beam = scene.beam
    nodes, stresses = beam.node_count, scene.stress_count
    zero = beam.nodes.new_zeros(())
    states = sum(scene.internal_states)

    def wide(x: Tensor, *own: int) -> Tensor:
        wanted = (*shape, *own)
        return x if not distinct and x.shape == wanted else x.expand(wanted)

    still, none = wide(zero, nodes, 3), wide(zero)
    state = State(
        position=wide(beam.nodes, nodes, 3),
        rotation=wide(beam.frames, nodes, 4),
        velocity=still,
        spin=wide(still, nodes, 3),
        stress=wide(zero, stresses, 6),
        reaction=wide(zero, len(scene.supports), 6),
        work=none,
        defect=wide(none),
        t=wide(time),
        status=torch.zeros(shape, dtype=torch.long, device=zero.device),
        frame=orientation(scene, shape, time),
        internal=zero.expand(*shape, states) if states else None,
        **no_motion(scene, zero.expand(shape)),
        memory=no_memory(scene, zero.expand(shape)),
        inelastic=nothing_crept(scene, zero.expand(shape)),
        supports=supported(scene),
        parts=beam.parts,
        joined=beam.joined,
        rest_shape=RestShape.of(beam),
    )
    state = with_tendons(state, scene)
    if not scene.has_prescribed_motion and not any(s.displaced for s in scene.supports):
        return state
    prescribed_motion = PrescribedMotion(scene)
    return at_rest(at_supports(state, prescribed_motion), prescribed_motion).broadcast()


def no_memory(scene: Any, like: Tensor) -> Tensor | None:
    """What interactions of a scene keep before anything has moved, of the batch axes of `like`."""
    rows, size = scene.memory
    return like.new_zeros(*like.shape, rows, size) if size else None


def nothing_crept(scene: Any, like: Tensor) -> Tensor | None:
    """What sections remember where their stress has not relaxed, of the batch axes of `like`."""
    rows, size = scene.beam.station_count, 6 * scene.arms
    return like.new_zeros(1).expand(*like.shape, rows, size) if size else None


def no_motion(scene: Any, like: Tensor) -> dict[str, Any]:
    """Fields of a state whose joints stand as drawn, of the batch axes of `like`; or none."""
    if not scene.joints:
        return {}
    return {
        "joints": like.new_zeros(*like.shape, len(scene.joints), READINGS + scene.joint_memory),
        "coordinates": tuple(joint.coordinates for joint in scene.joints),
    }


def supported(scene: Any) -> tuple[int, ...]:
    """The nodes of a scene's supports."""
    return tuple(int(support.node) for support in scene.supports)


def with_tendons(state: State, scene: Any) -> State:
    """With the lengths of a scene's tendons, which no step or equilibrium has pulled yet."""
    if not scene.tendons:
        return replace(state, tendons=None)
    lengths = [tendon.length_at(state.position, state.rotation) for tendon in scene.tendons]
    lengths = torch.stack(torch.broadcast_tensors(*lengths), -1)[..., None]
    return replace(state, tendons=pad(lengths, (2, 0)))
