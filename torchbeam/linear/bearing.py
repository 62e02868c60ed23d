"""Bearings of rotors: which parts turn about one, and where its axis is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.arguments import listed, place
from ..core.leaves import Tree, leaf, with_values
from ..core.validation import concrete, refusal, shown
from ..equations.steady import Configuration
from ..nodal.discretise import discretise
from ..nodal.frame import TranslatingFrame, TurningFrame
from ..nodal.model import Model
from ..scene.ball import Ball
from ..scene.effects.drive import Drive
from ..scene.joint import Joint
from ..scene.joints import Cylindrical, Hinge
from ..scene.scene import Scene

ON_AXIS = 1e-6  # of the structure's size, and rad: a further bearing


class Axis(NamedTuple):
    """Of a bearing in frame a: point and direction (..., 3) m, 1."""

    point: Tensor
    direction: Tensor


@dataclass(frozen=True)
class Bearing(Tree):
    """A hinge about which a rotor spins, of a model in which it stands still.

    joint             its place among the scene's joints;  others: those of further bearings of the
                      rotor, on its axis
    support, hub      rows of the nodes that it joins; None = the ground
    rotor             (nodes,) bool, what spins
    damping           (...) N m s/rad of the hinge, where the rotor may turn in it beside its spin;
                      None = its speed is held;  drive: its law by the rate, None = it has none;
                      inertia: (...) kg m^2 of the hinge likewise
    point, direction  (..., 3) of its axis as drawn, frame a
    """

    model: Model
    joint: int
    others: tuple[int, ...]
    support: int | None
    hub: int
    rotor: Tensor = leaf(1)
    point: Tensor = leaf(1)
    direction: Tensor = leaf(1)
    damping: Tensor | None = leaf(0, default=None)
    drive: Drive | None = None
    inertia: Tensor | None = leaf(0, default=None)

    @classmethod
    def of(cls, scene: Scene, bearing: int | Sequence[int] | None, held: bool = True) -> Bearing:
        """Of a joint of the scene, and further ones; None = its only hinge. Raises ValueError where
        there is none, or they do not part what spins from what stands.
        """
        bearings = (None,) if bearing is None else listed(bearing)
        if not bearings:
            raise refusal(f"bearing = {shown(bearing)}", "the place of a hinge")
        at, *others = bearings
        at, others = _hinge(scene, at), tuple(_place(scene, k) for k in others)
        hinge = scene.joints[at]
        stands = dict.fromkeys(hinge.acts) | {"angle": 0.0}
        joints = [*scene.joints[:at], with_values(hinge, **stands), *scene.joints[at + 1 :]]
        scene = replace(scene, joints=joints)
        a, b = hinge.ends
        if b is None:
            raise refusal("a bearing whose second part is the ground", "a rotor as its second part")
        turning = _connected(scene, b, (at, *others))
        if a is not None and turning[a]:
            raise ValueError(
                "a bearing was given to campbell whose two parts are connected otherwise too; all "
                "bearings of the rotor are wanted, bearing=(0, 1)"
            )
        _refuse_held(scene, turning, (at, *others))
        rotor = torch.tensor(turning, device=scene.beam.nodes.device)
        point, _, axes = hinge.drawn(scene.beam)
        _refuse_in_plane(scene.plane, axes[..., 0])
        none = torch.zeros_like(point[..., 0])
        damping = None if held else none if hinge.damping is None else hinge.damping
        drive, inertia = (None, None) if held else (hinge.drive, hinge.inertia)
        drawn = (point, axes[..., 0], damping, drive, inertia)
        bearing = cls(discretise(scene), at, others, a, b, rotor, *drawn)
        for k in others:
            bearing.check_bearing(scene.joints[k])
        return bearing

    def check_bearing(self, joint: Joint) -> None:
        """ValueError for a further bearing that does not lie on the axis, or resists the spin."""
        beam = self.model.scene.beam
        point, _, axes = joint.drawn(beam)
        apart, along = point - self.point, axes[..., 0]
        off = torch.linalg.cross(*torch.broadcast_tensors(apart, self.direction))
        if not isinstance(joint, Ball):
            turned = torch.linalg.cross(*torch.broadcast_tensors(along, self.direction))
            off = off + beam.extent[..., None] * turned.abs()
        far = concrete(off.abs().amax(-1) > ON_AXIS * beam.extent).any()
        if not isinstance(joint, Ball | Cylindrical | Hinge) or joint.acts or far:
            raise ValueError(
                f"a {joint.called} was given to campbell as a further bearing; a Hinge, "
                "Cylindrical or Ball on the rotor's axis in which nothing acts is wanted"
            )

    def damper(self, speed: Tensor, t: Tensor) -> Tensor:
        """(...) N m s/rad that resists a change of the speed (...) rad/s, where it is not held."""
        if self.drive is None:
            return self.damping
        return self.damping - self.drive.by_rate(torch.zeros_like(speed), speed, t)

    def axis(self, x: Configuration) -> Axis:
        """Where the nodes stand at x."""
        if self.support is None:
            return Axis(self.point, self.direction)
        space, beam = self.model.space, self.model.scene.beam
        R = space.axes(x.rotation)[..., self.support, :, :] @ beam.axes[..., self.support, :, :].mT
        r = space.public_position(x.position)[..., self.support, :]
        lever = self.point - beam.nodes[..., self.support, :]
        lever, direction = ((R @ v[..., None])[..., 0] for v in (lever, self.direction))
        return Axis(r + lever, direction)

    def reduced(self, x: Configuration, point: Tensor) -> Tensor:
        """A point (..., 3) m of frame a in the space's coordinates (..., p)."""
        hub = self.model.space.public_position(x.position)[..., self.hub, :]
        return x.position[..., self.hub, :] + self.model.space.project_vector(point - hub)

    def frame(self, x: Configuration, speed: Tensor, axis: Axis) -> TurningFrame:
        """The frames of all nodes at a speed (...) rad/s."""
        space, mask = self.model.space, self.rotor[:, None]
        omega = space.project_spin(speed[..., None] * axis.direction)
        centre = self.reduced(x, axis.point)
        v = -(space.skew(omega) @ centre[..., None])[..., 0]
        v, omega = (torch.where(mask, y[..., None, :], 0.0) for y in (v, omega))
        return TurningFrame(space, TranslatingFrame(space, v), omega)


def _hinge(scene: Scene, bearing: int | None) -> int:
    """Which joint of a scene."""
    hinges = [k for k, joint in enumerate(scene.joints) if isinstance(joint, Hinge)]
    if bearing is None:
        if len(hinges) != 1:
            raise ValueError(
                f"a scene with {len(hinges)} hinges was given to campbell; bearing=, the number of "
                "the joint about which the rotor spins, is wanted"
                if hinges
                else "a scene without a Hinge was given to campbell; one about which the rotor "
                "spins is wanted"
            )
        return hinges[0]
    bearing = _place(scene, bearing)
    if bearing not in hinges:
        raise refusal(f"bearing = {bearing}, a {scene.joints[bearing].called},", "a Hinge")
    return bearing


def _place(scene: Scene, joint: Any) -> int:
    return place("bearing", joint, len(scene.joints), "joints")


def _refuse_in_plane(plane: str | None, axis: Tensor) -> None:
    """ValueError for an axis (..., 3) about which what stays in a plane cannot spin."""
    if plane is not None and (concrete(axis)[..., ["xyz".index(e) for e in plane]] != 0).any():
        raise ValueError(
            f"a bearing whose axis is not normal to plane={plane!r} was given to campbell; "
            "plane=None is wanted"
        )


def _connected(scene: Scene, start: int, without: tuple[int, ...]) -> list[bool]:
    """Of each node whether it is connected with `start`, by anything but joints `without`."""
    beam = scene.beam
    ties: list[Any] = [tuple(range(part.nodes.start, part.nodes.stop)) for part in beam.parts]
    ties += [joint.ends for k, joint in enumerate(scene.joints) if k not in without]
    ties += [x.nodes for x in (*scene.tendons, *scene.interactions)]
    reached, grew = {start}, True
    while grew:
        grew = False
        for tie in ties:
            nodes = {node for node in tie if node is not None}
            if reached & nodes and not nodes <= reached:
                reached, grew = reached | nodes, True
    return [node in reached for node in range(beam.node_count)]


def _refuse_held(scene: Scene, turning: list[bool], bearings: tuple[int, ...]) -> None:
    """ValueError for a rotor that something beside the bearing holds to frame a."""
    if any(turning[support.node] for support in scene.supports):
        raise ValueError(
            "a support of the rotor was given to campbell; supports of what stands are wanted"
        )
    others = (joint.ends for k, joint in enumerate(scene.joints) if k not in bearings)
    if any(turning[node] for ends in others if None in ends for node in ends if node is not None):
        raise ValueError(
            "a joint of the rotor with the ground beside its bearing was given to campbell; all "
            "bearings of the rotor are wanted, bearing=(0, 1)"
        )
    if scene.frame is not None or any(support.moves for support in scene.supports):
        raise ValueError(
            "a scene whose frame or support moves was given to campbell; a bearing whose rotor "
            "spins in a frame at rest is wanted (of what turns as a whole `modes` tells)"
        )
    if scene.pairs:
        raise ValueError("contact of two parts was given to campbell; none is wanted there")
