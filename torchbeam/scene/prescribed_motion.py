"""Prescribed motion: of frame a, and of the supports in it. The rotation of axes whose angular
velocity is told in themselves is the integral of R' = R ~omega.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.functions_of_time import at_time, taken, with_rate, with_user_rate, within_dual_numbers
from ..core.leaves import with_values
from ..core.validation import concrete
from ..math import quaternions as quat
from ..math.quaternions import cross
from ..math.shapes import broadcast_shapes
from .effects import Pose
from .supports import Support

Omega = Callable[[Tensor], Tensor]  # t (...) s -> (..., 3) rad/s

# Lobatto's points and weights on [0, 1], exact to the fifth power: with the ends, next to which a
# jump would else stay unseen
POINTS = 0.0, 0.5 - 0.05**0.5, 0.5 + 0.05**0.5, 1.0
WEIGHTS = 1 / 12, 5 / 12, 5 / 12, 1 / 12
FIRST, MOST = 16, 2**17  # parts of the interval: at first, and at most
ACCURACY = 500.0  # ulp of a turn over a part, beside those of its angle
NARROWEST = 2.0**-46  # part, of the interval: a jump of omega is somewhere in it


def turn_between(omega: Omega, start: Tensor, end: Tensor) -> Tensor:
    """Quaternion (..., 4) of the rotation R(start)^T R(end), start and end (...) s: a vector told
    in the axes at `end` in those at `start`. By the Magnus expansion of sixth order (see `magnus`)
    over parts of the interval that are halved until halves agree with the whole to rounding, so
    that kinks and jumps of omega cost parts, no accuracy. Differentiable.

    Raises ValueError for an omega that this takes too many parts for.
    """
    # functions bring batch axes of their own
    shape = broadcast_shapes(start.shape, end.shape, omega(start).shape[:-1])
    start, end = (t.reshape([1] * (len(shape) - t.ndim) + [*t.shape]) for t in (start, end))
    with no_derivatives():
        edges = _parts(omega, start, end)
    turns = quat.exponential(_vectors(omega, start, end, edges[:-1], edges[1:]))
    while len(turns) > 1:  # neighbours together, in their order
        pairs = quat.multiply(turns[: len(turns) // 2 * 2 : 2], turns[1::2])
        turns = torch.cat((pairs, turns[len(turns) // 2 * 2 :]))
    return quat.normalize(turns[0]).expand(*shape, 4)


def magnus(omega: tuple[Tensor, ...], h: Tensor) -> Tensor:
    """Rotation vector (..., 3) rad over h (...) s from omega (..., 3) rad/s at the four points, of
    sixth order (Blanes, Casas and Ros 2000; with [x, y] = -x x y, because omega is told in the axes
    that turn). With A_i the integral of (t/h)^i omega, t from the middle:

        a_1 = 9/4 A_0 - 15 A_2,   a_2 = 12 A_1,   a_3 = 180 A_2 - 15 A_0
        C_1 = [a_1, a_2],   C_2 = -[a_1, 2 a_3 + C_1]/60
        turn = a_1 + a_3/12 + [-20 a_1 - a_3 + C_1, a_2 + C_2]/240
    """
    A_0, A_1, A_2 = (
        h[..., None]
        * sum(b * (x - 0.5) ** i * w for x, b, w in zip(POINTS, WEIGHTS, omega, strict=True))
        for i in range(3)
    )
    a_1, a_2, a_3 = 9 / 4 * A_0 - 15 * A_2, 12 * A_1, 180 * A_2 - 15 * A_0
    C_1 = torch.linalg.cross(a_2, a_1)
    C_2 = torch.linalg.cross(a_1, 2 * a_3 + C_1) / 60
    return a_1 + a_3 / 12 + torch.linalg.cross(a_2 + C_2, C_1 - 20 * a_1 - a_3) / 240


def _vectors(omega: Omega, start: Tensor, end: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Rotation vectors (n, ..., 3) over the parts from low to high (n), of the interval."""
    ndim = max(start.ndim, end.ndim)
    low, high = (x.reshape([-1] + [1] * ndim) for x in (low, high))
    h = (high - low) * (end - start)
    w = omega(torch.cat([start + (low + x * (high - low)) * (end - start) for x in POINTS]))
    return magnus(w.unflatten(0, (len(POINTS), -1)).unbind(0), h)


def _parts(omega: Omega, start: Tensor, end: Tensor) -> Tensor:
    """Edges (n + 1) in [0, 1] of parts that are short enough for all samples."""
    accuracy = ACCURACY * torch.finfo(start.dtype).eps
    edges = torch.linspace(0, 1, FIRST + 1, dtype=start.dtype, device=start.device)
    low, high, edges_of_parts = edges[:-1], edges[1:], [edges[:1]]
    while len(low):
        middle = (low + high) / 2
        parts = (low, high), (low, middle), (middle, high)
        whole, *halves = (_vectors(omega, start, end, *part) for part in parts)
        turn, first, second = map(quat.exponential, (whole, *halves))
        off = quat.multiply(quat.conjugate(turn), quat.multiply(first, second))[..., 1:].abs()
        over = off - accuracy * (1 + torch.linalg.vector_norm(whole, dim=-1, keepdim=True))
        worst = concrete(over.flatten(1).amax(-1)).reshape(-1, len(low)).amax(0)
        bad = (worst > 0) & (high - low > NARROWEST)
        edges_of_parts += [high[~bad], middle[~bad]]
        low, high = torch.cat((low[bad], middle[bad])), torch.cat((middle[bad], high[bad]))
        if len(low) > MOST:
            raise ValueError(
                f"an angular velocity of the frame that takes more than {MOST} parts to be "
                "integrated from t = 0 was given; a smoother function is wanted, or a start at t "
                "= 0"
            )
    return torch.cat(edges_of_parts).sort().values


STILL = 1e-6  # rad, and m: a support that is no further from where the beam has it has not begun


@dataclass(frozen=True)
class PrescribedMotion:
    """A scene's prescribed motions as functions of t, 0-dim or one of each sample; frame a. Their
    rates are exact, see `functions_of_time.with_rate`.
    """

    scene: Any

    def frame(self, t: Tensor) -> tuple[Tensor | None, Tensor | None]:
        """v (..., 3) m/s and omega (..., 3) rad/s of frame a; None = at rest."""
        frame = self.scene.frame
        rates = (None, None) if frame is None else (frame.velocity, frame.angular_velocity)
        return tuple(None if x is None else self._value(x, t) for x in rates)

    def turn(self, start: Tensor, end: Tensor) -> Tensor:
        """Quaternion (..., 4) by which frame a, which turns, does so from `start` to `end` (...) s,
        in its axes at `start`.
        """
        omega = self.scene.frame.angular_velocity
        if not callable(omega):
            return quat.exponential(omega * (end - start)[..., None])
        return turn_between(lambda t: self._value(omega, t), start, end)

    def pose(
        self,
        support: Support,
        t: Tensor,
        share: Tensor | float = 1.0,
        start: tuple[Tensor, Tensor] | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Position (..., 3) and quaternion (..., 4) of a support, after a share of its motion from
        where the beam has the node; or of the way from `start`, a pose likewise, turned the shorter
        way about one axis, where that is another.
        """
        beam = self.scene.beam
        position, rotation = beam.nodes[..., support.node, :], beam.frames[..., support.node, :]
        motion = self.displacement(support, t)
        pose = moved(position, rotation, *motion, share)
        if start is None or not support.displaced:
            return pose
        end, left = moved(position, rotation, *motion), 1 - share
        away = quat.logarithm(quat.multiply(start[1], quat.conjugate(end[1])))
        way = (
            end[0] + left * (start[0] - end[0]),
            quat.multiply(quat.exponential(left * away), end[1]),
        )
        begun = ~still(start, (position, rotation))[..., None]
        return torch.where(begun, way[0], pose[0]), torch.where(begun, way[1], pose[1])

    def displacement(self, support: Support, t: Tensor) -> tuple[Tensor | None, Tensor | None]:
        """Displacement m and turn rad (..., 3) of a support; None = none."""
        moves = support.displacement, support.turn
        return tuple(None if x is None else self._value(x, t) for x in moves)

    def rates(self, support: Support, t: Tensor) -> tuple[Tensor, Tensor]:
        """Velocity and spin (..., 3) of a support in frame a, in its axes, relative to it."""
        still = torch.zeros_like(self.scene.beam.nodes[..., support.node, :])
        velocity = spin = still
        if callable(support.displacement):
            _, velocity = self._moving("a displacement", support.displacement, t)
        if callable(support.turn):
            phi, rate = self._moving("a rotation", support.turn, t)
            spin = quat.spin_of_vector(phi, rate)
        return velocity, spin

    def absolute(self, support: Support, t: Tensor) -> tuple[Tensor, Tensor]:
        """Absolute velocity (..., 3), frame a, and spin (..., 3), section axes, of a clamp."""
        position, rotation = self.pose(support, t)
        velocity = spin = torch.zeros_like(position)
        if support.moves:
            velocity, spin = self.rates(support, t)
        v, omega = self.frame(t)
        if v is not None:
            velocity = velocity + v
        if omega is not None:
            velocity = velocity + cross(omega, position)
            spin = spin + omega
        return velocity, quat.rotate(quat.conjugate(rotation), spin)

    def acceleration(self, support: Support, t: Tensor) -> Tensor:
        """Rates (..., 2, 3) of a clamp's absolute velocity and spin, absolute, frame a."""

        def motion(now: Tensor) -> Tensor:
            v, spin = self.absolute(support, now)
            spin = quat.rotate(self.pose(support, now)[1], spin)
            return torch.stack(torch.broadcast_tensors(v, spin), -2)

        now, rate = with_rate(motion, t)
        omega = self.frame(t)[1]
        return rate if omega is None else rate + cross(omega[..., None, :], now)

    def root_pose(self, t: Tensor) -> Pose:
        """Pose of the support of node 0, for elastic clamps."""
        root, beam = self.scene.root, self.scene.beam
        if root is None and self.scene.frame is None:  # it rests where the beam has it
            position, rotation = beam.nodes[..., 0, :], beam.frames[..., 0, :]
            zero = torch.zeros_like(position)
            return Pose(position, quat.matrix(rotation), zero, zero)
        support = Support(0)
        if root is not None:
            support = with_values(support, displacement=root.displacement, turn=root.rotation)
        position, rotation = self.pose(support, t)
        velocity, spin = self.absolute(support, t)
        return Pose(position, quat.matrix(rotation), velocity, quat.rotate(rotation, spin))

    def _value(self, value: Any, t: Tensor) -> Tensor:
        nodes = self.scene.beam.nodes
        if not callable(value):
            return value
        return at_time(lambda now: taken("a motion function's value", value(now), nodes, 3), t)

    def _moving(self, name: str, function: Any, t: Tensor) -> tuple[Tensor, Tensor]:
        """The function's value and rate (..., 3)."""

        def value(now: Tensor) -> Tensor:
            return taken("a motion function's value", function(now), self.scene.beam.nodes, 3)

        return at_time(lambda now: with_user_rate(name, value, now), t)


def moved(
    position: Tensor,
    rotation: Tensor,
    displacement: Tensor | None,
    turn: Tensor | None,
    share: Tensor | float = 1.0,
) -> tuple[Tensor, Tensor]:
    """A position (..., 3) and quaternion (..., 4) after a share of a displacement and a turn."""
    if displacement is not None:
        position = position + share * displacement
    if turn is not None:
        rotation = quat.multiply(quat.exponential(share * turn), rotation)
    return position, rotation


def still(a: tuple[Tensor, Tensor], b: tuple[Tensor, Tensor]) -> Tensor:
    """(...) whether two poses, positions (..., 3) and quaternions (..., 4), are one."""
    moved = torch.linalg.vector_norm(a[0] - b[0], dim=-1)
    turned = torch.linalg.vector_norm(a[1] - quat.nearer(b[1], a[1]), dim=-1)
    return (moved <= STILL * (1 + torch.linalg.vector_norm(b[0], dim=-1))) & (turned <= STILL)


def turning(scene: Any) -> bool:
    """Whether frame a turns."""
    return scene.frame is not None and scene.frame.angular_velocity is not None


def orientation(scene: Any, shape: tuple[int, ...], t: Tensor | float = 0.0) -> Tensor | None:
    """Of frame a at t (...) s, in the inertial axes with which it coincides at t = 0: (..., 4),
    with the batch axes `shape` and those of a function; None where it does not turn.
    """
    if not turning(scene):
        return None
    nodes = scene.beam.nodes
    return oriented(scene, quat.identity(shape, nodes.dtype, nodes.device), 0.0, t)


def oriented(scene: Any, frame: Tensor, start: Tensor | float, end: Tensor | float) -> Tensor:
    """Orientation (..., 4) of frame a at `end` (...) s, if it is `frame` (..., 4) at `start`."""
    start, end = (torch.as_tensor(t, dtype=frame.dtype, device=frame.device) for t in (start, end))
    gap = end - start
    recorded = gap is not concrete(gap) or gap.requires_grad or within_dual_numbers()
    if not recorded and bool((gap == 0).all()):
        return frame
    return quat.multiply(frame, PrescribedMotion(scene).turn(start, end))
