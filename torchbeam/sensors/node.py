"""Sensors at a node: position, velocity, rotation, angles, spin."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import boolean, choice, place
from ..core.leaves import option
from ..core.validation import as_tensor, axis_last, common_dtype, finite, rotations
from ..math import quaternions as quat
from ..scene.parts import Place, check_node
from ..state.state import State
from .sensor import XYZ, Sensor


@dataclass(frozen=True, eq=False, repr=False)
class _OfNode(Sensor):
    """A sensor at a node, counted from the root; -1 is the tip. In a structure the node is
    (name, node) or the name of a body; or `on` has the name.
    """

    on: str | None = field(default=None, kw_only=True)
    of_part = True

    node: Place = option(check_node)

    def __post_init__(self) -> None:
        super().__post_init__()
        node, on = self.node, self.on
        if isinstance(node, (str, tuple)):
            if on is not None:
                raise ValueError(
                    f"node = {node!r} and on = {on!r} were given; one of them is wanted to say "
                    "the part"
                )
            on, node = node if isinstance(node, tuple) else (node, 0)
        vars(self).update(node=int(node), on=on)

    @property
    def name(self) -> str:
        return f"{self._prefix}{'tip' if self.node == -1 else f'node {self.node}'} {self.what}"

    def __call__(self, state: Any) -> Tensor:
        position = getattr(state, "position", None)
        if position is None:
            return super().__call__(state)  # says so
        seen = self.seen(state)
        place("node", self.node, seen.position.shape[-2], "the beam has the nodes")
        return self.read(seen)


@dataclass(frozen=True, eq=False, repr=False)
class NodePosition(_OfNode):
    """Position (..., 3) m of a node, frame a; with a reference its displacement.

    Args:
        reference: subtracted from the position: (..., 3) m, or a state, whose position it is

    Examples:
        >>> moved = tb.sensors.NodePosition(2, reference=tb.rest(scene))
        >>> moved(solution.state)[-1]  # m, its displacement
        tensor([-0.0052,  0.0000,  0.0652])
    """

    reference: Any = None
    unit = "m"
    labels = XYZ

    @property
    def what(self) -> str:
        return "position" if self.reference is None else "displacement"

    @property
    def transforms_as(self) -> str:
        return "point" if self.reference is None else "vector"

    def __post_init__(self) -> None:
        super().__post_init__()
        reference = self.reference
        if hasattr(reference, "position"):
            reference = self.seen(reference).node(self.node).position
        elif reference is not None:
            reference = _given(reference)
        if reference is not None:
            finite("reference", axis_last("reference", reference, 3))
        object.__setattr__(self, "reference", reference)

    def read(self, state: Any) -> Tensor:
        position = state.position[..., self.node, :]
        return position if self.reference is None else position - self.reference.to(position)


@dataclass(frozen=True, eq=False, repr=False)
class NodeVelocity(_OfNode):
    """Velocity (..., 3) m/s of a node: absolute, in the axes of frame a.

    Examples:
        >>> tb.sensors.NodeVelocity(2)(solution.state)[-1]  # m/s
        tensor([-0.2013,  0.0000,  1.2654])
    """

    what = "velocity"
    unit = "m/s"
    labels = XYZ
    transforms_as = "vector"

    def read(self, state: Any) -> Tensor:
        return state.velocity[..., self.node, :]


@dataclass(frozen=True, eq=False, repr=False)
class Spin(_OfNode):
    """Angular velocity (..., 3) rad/s of a node: absolute, in the axes of frame a.

    With `body` it is in the axes of the section, as a gyroscope there reads.

    Examples:
        >>> gyroscope = tb.sensors.Spin(-1, body=True)
        >>> gyroscope(solution.state)[-1]  # rad/s, in section axes
        tensor([ 0.0000, -5.2346,  0.0000])
    """

    body: bool = option(boolean, default=False)
    what = "spin"
    unit = "rad/s"
    labels = XYZ

    @property
    def transforms_as(self) -> str | None:
        return None if self.body else "vector"

    def read(self, state: Any) -> Tensor:
        if self.body and isinstance(state, State):
            return state.spin[..., self.node, :]
        node = state.node(self.node)
        return (node.rotation.mT @ node.spin[..., None])[..., 0] if self.body else node.spin


@dataclass(frozen=True, eq=False, repr=False)
class _Turned(_OfNode):
    """A node's rotation R, section axes -> frame a; relative to a reference R_0, R_0^T R.

    reference  None, a matrix (..., 3, 3), or a state whose node has it: `tb.rest(scene)` for the
               rotation since rest, seen in the axes that the section had there (x along the beam)
    """

    reference: Any = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.reference is not None:
            reference = self.reference
            if hasattr(reference, "position"):
                q = _quaternion(self.seen(reference), self.node)
            else:
                q = quat.from_matrix(rotations("reference", _given(reference)))
            object.__setattr__(self, "reference", quat.conjugate(q))

    def quaternion(self, state: Any) -> Tensor:
        q = _quaternion(state, self.node)
        return q if self.reference is None else quat.multiply(self.reference.to(q), q)


@dataclass(frozen=True, eq=False, repr=False)
class NodeRotation(_Turned):
    """Rotation matrix (..., 3, 3) of a node: section axes -> frame a, or -> the reference's axes.

    Examples:
        >>> tb.sensors.NodeRotation(-1)(solution.state).shape  # rotation matrices
        torch.Size([6, 3, 3])
    """

    what = "rotation"
    unit = "1"
    labels = tuple(i + j for i in XYZ for j in XYZ)
    shape = (3, 3)

    def read(self, state: Any) -> Tensor:
        return quat.matrix(self.quaternion(state))


@dataclass(frozen=True, eq=False, repr=False)
class Angles(_Turned):
    """A node's rotation as three angles (..., 3) rad.

    Args:
        kind: "tait-bryan": yaw, pitch and roll of R = Rz(yaw) Ry(pitch) Rx(roll). These turn about
            z, then the new y, then the section's own x along the beam. Yaw and roll are in (-pi,
            pi], pitch in [-pi/2, pi/2]. If the section's x points along z (pitch = +-pi/2), yaw and
            roll turn about the same axis; yaw is then zero, and derivatives mean nothing. "vector":
            the rotation vector, axis times angle, |.| <= pi; it jumps where the angle passes pi

    Examples:
        >>> tb.sensors.Angles(-1)(solution.state).shape  # rad: roll, pitch, yaw of the tip
        torch.Size([6, 3])
        >>> tb.sensors.Angles(-1)["pitch"](solution.state)[-1]
        tensor([-0.3550])
    """

    kind: str = option(partial(choice, known=("tait-bryan", "vector")), default="tait-bryan")
    what = "angles"
    unit = "rad"

    @property
    def labels(self) -> tuple[str, ...]:
        return ("yaw", "pitch", "roll") if self.kind == "tait-bryan" else XYZ

    def read(self, state: Any) -> Tensor:
        q = self.quaternion(state)
        return quat.logarithm(q) if self.kind == "vector" else tait_bryan(quat.matrix(q))


def tait_bryan(R: Tensor) -> Tensor:
    """yaw, pitch, roll (..., 3) rad of R (..., 3, 3) = Rz(yaw) Ry(pitch) Rx(roll), see `Angles`."""
    (xx, _, _), (yx, yy, yz), (zx, zy, zz) = (row.unbind(-1) for row in R.unbind(-2))
    flat2 = xx * xx + yx * yx  # cos(pitch)^2
    lost = flat2 < torch.finfo(R.dtype).eps ** 1.5
    one, zero = torch.ones_like(flat2), torch.zeros_like(flat2)
    pitch = torch.atan2(-zx, torch.where(lost, one, flat2).sqrt() * torch.where(lost, zero, one))
    yaw = torch.atan2(torch.where(lost, zero, yx), torch.where(lost, one, xx))
    roll = torch.atan2(torch.where(lost, -yz, zy), torch.where(lost, yy, zz))
    return torch.stack((yaw, pitch, roll), -1)


def _given(reference: Any) -> Tensor:
    return as_tensor(reference, *common_dtype(reference))


def _quaternion(state: Any, node: int) -> Tensor:
    if not isinstance(state, State):
        return quat.from_matrix(state.node(node).rotation)
    k = place("node", node, state.rotation.shape[-2], "the beam has the nodes")
    return state.rotation[..., k, :]


@dataclass(frozen=True, eq=False, repr=False)
class TipPosition(NodePosition):
    """`NodePosition` of the tip.

    Examples:
        >>> tb.sensors.TipPosition()(solution.state).shape  # m; time first
        torch.Size([6, 3])
    """

    node: int = field(default=-1, init=False)


@dataclass(frozen=True, eq=False, repr=False)
class TipVelocity(NodeVelocity):
    """`NodeVelocity` of the tip.

    Examples:
        >>> tb.sensors.TipVelocity()(solution.state)[-1]  # m/s
        tensor([-0.9755,  0.0000,  3.6511])
    """

    node: int = field(default=-1, init=False)
